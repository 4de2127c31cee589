"""Paints on a frame what isn't the sky: trails, bleed columns, cosmic rays, hot pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def add_trail(
    image: Array,
    ends: tuple[float, float, float, float],
    height: float,
    *,
    fwhm_px: float = 3.0,
    sagitta_px: float = 0.0,
    dash_px: tuple[float, float] | None = None,
    seed: int = 1,
) -> None:
    """Add a trail of a peak height per pixel from (x0, y0) to (x1, y1); dash_px: period and lit length."""
    x0, y0, x1, y1 = ends
    rows, columns = np.mgrid[0 : image.shape[0], 0 : image.shape[1]]
    length = np.hypot(x1 - x0, y1 - y0)
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    along = (columns - x0) * ux + (rows - y0) * uy
    t = along / length
    across = (rows - y0) * ux - (columns - x0) * uy - 4.0 * sagitta_px * t * (1.0 - t)
    lit = (t > 0) & (t < 1)
    if dash_px is not None:
        lit &= np.mod(along, dash_px[0]) < dash_px[1]
    near = lit & (np.abs(across) < 4.0 * fwhm_px)
    light = height * np.exp(-4.0 * np.log(2.0) * (across[near] / fwhm_px) ** 2)
    image[near] += np.random.default_rng(seed).poisson(light)


def add_bleed(
    image: Array, x: float, y: float, up_px: int, down_px: int, top: float, width_px: int = 3
) -> None:
    """Fill a column upwards and downwards to full well, with a tail of the same length at a third of it."""
    column = round(x) - width_px // 2
    row = round(y)
    columns = slice(column, column + width_px)
    image[max(0, row - up_px) : row + down_px, columns] = top
    for part in (
        slice(max(0, row - 2 * up_px), max(0, row - up_px)),
        slice(row + down_px, row + 2 * down_px),
    ):
        image[part, columns] = np.maximum(image[part, columns], 0.33 * top)


def add_cosmics(image: Array, count: int, seed: int) -> tuple[Array, Array]:
    """Add hits of 1 to 12 pixels, 300 to 20 000 electrons a pixel; return where they start."""
    rng = np.random.default_rng(seed)
    height, width = image.shape
    x, y = rng.uniform(15, width - 16, count), rng.uniform(15, height - 16, count)
    for i in range(count):
        length = 1.0 if rng.random() < 0.5 else rng.uniform(2.0, 12.0)
        angle = rng.uniform(0, np.pi)
        charge = np.exp(rng.uniform(np.log(300.0), np.log(20_000.0)))
        steps = np.arange(0.0, length, 0.25)
        columns = np.floor(x[i] + steps * np.cos(angle)).astype(int)
        rows = np.floor(y[i] + steps * np.sin(angle)).astype(int)
        # what a straight track deposits in a pixel goes with its length there
        np.add.at(image, (rows, columns), charge * 0.25 if length > 1.0 else charge / steps.size)
    return x, y


def add_hot_pixels(image: Array, count: int, seed: int) -> tuple[Array, Array]:
    """Add single hot pixels; return their positions."""
    rng = np.random.default_rng(seed)
    x, y = rng.integers(15, image.shape[1] - 15, count), rng.integers(15, image.shape[0] - 15, count)
    np.add.at(image, (y, x), np.exp(rng.uniform(np.log(500.0), np.log(30_000.0), count)))
    return x.astype(float), y.astype(float)
