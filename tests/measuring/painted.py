"""A small painter of stars, integrated over the pixels; shares nothing with mountnav's own renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from mountnav.frames import Frame

Array = NDArray[np.float64]

FINE = 7


def spots(
    *, trail_px: float = 0.0, trail_deg: float = 0.0, donut_px: float = 0.0, hole: float = 0.4
) -> Array:
    """Points (n, 2) that a star's light is spread over before it is blurred: one, a line, or a ring."""
    if trail_px > 0.0:
        steps = (np.arange(60) + 0.5) / 60 - 0.5
        angle = np.radians(trail_deg)
        spread: NDArray[np.float64] = trail_px * steps[:, None] * np.array([np.cos(angle), np.sin(angle)])
        return spread
    if donut_px > 0.0:
        count = 600
        k = np.arange(count) + 0.5
        radius = 0.5 * donut_px * np.sqrt(hole**2 + (1.0 - hole**2) * k / count)
        turn = k * np.pi * (3.0 - np.sqrt(5.0))
        points = np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)
        return np.asarray(points - points.mean(axis=0))
    return np.zeros((1, 2))


def star(fwhm_px: float, beta: float, points: Array, x: float, y: float, half: int) -> Array:
    """One star of one electron on a cutout of (2 half + 1)², integrated over the pixels."""
    edges = np.arange(-half, half + 2) - 0.5
    if beta == 0.0:
        scale = fwhm_px / 2.354820045 * np.sqrt(2.0)
        in_x = np.diff(erf((edges[None, :] - x - points[:, :1]) / scale), axis=1) / 2.0
        in_y = np.diff(erf((edges[None, :] - y - points[:, 1:]) / scale), axis=1) / 2.0
        return np.asarray(in_y.T @ in_x / points.shape[0])
    fine = (np.arange(FINE) + 0.5) / FINE - 0.5
    steps = (np.arange(-half, half + 1)[:, None] + fine).ravel()
    alpha2 = 0.25 * fwhm_px**2 / (2.0 ** (1.0 / beta) - 1.0)
    psf = np.zeros((steps.size, steps.size))
    for px, py in points:
        psf += (1.0 + ((steps[None, :] - x - px) ** 2 + (steps[:, None] - y - py) ** 2) / alpha2) ** -beta
    psf *= (beta - 1.0) / (np.pi * alpha2) / points.shape[0]
    side = 2 * half + 1
    return np.asarray(psf.reshape(side, FINE, side, FINE).mean(axis=(1, 3)))


def painted(
    x: Array,
    y: Array,
    electrons: Array,
    *,
    fwhm_px: float,
    beta: float = 0.0,
    points: Array | None = None,
    size: tuple[int, int] = (300, 300),
    sky: float | Array = 100.0,
    read_noise: float = 5.0,
    seed: int = 1,
) -> Array:
    """Noisy frame (height, width) in electrons; Gaussian stars, or Moffat ones of exponent ``beta``.

    ``points`` (from `spots`) smears them; ``sky`` may be an image.
    """
    rng = np.random.default_rng(seed)
    smear = np.zeros((1, 2)) if points is None else points
    reach = float(np.abs(smear).max()) + (4.0 if beta == 0.0 else 8.0) * fwhm_px
    half = int(np.ceil(max(reach, 6.0)))
    truth = np.pad(np.broadcast_to(np.asarray(sky, dtype=np.float64), size), 2 * half)
    for cx, cy, total in zip(x, y, electrons, strict=True):
        column, row = round(cx), round(cy)
        cutout = star(fwhm_px, beta, smear, cx - column, cy - row, half)
        truth[row + half : row + 3 * half + 1, column + half : column + 3 * half + 1] += total * cutout
    truth = truth[2 * half : -2 * half, 2 * half : -2 * half]
    return np.asarray(rng.poisson(truth) + rng.normal(0.0, read_noise, size))


def as_frame(image: Array, top: float = 65535.0, gain: float | None = 1.0) -> Frame:
    """Give it the 16 bits of a camera, ``gain`` electrons per ADU; None: one, and the header doesn't tell."""
    header: dict[str, str | int | float | bool] = {} if gain is None else {"EGAIN": gain}
    adu = image / (gain or 1.0)
    return Frame(pixels=np.clip(np.rint(adu + 500.0), 0, top).astype(np.uint16), header=header)


def scattered(count: int, size: tuple[int, int], seed: int, margin: float = 20.0) -> tuple[Array, Array]:
    """Positions on a jittered grid, so that no two stars touch."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(count)))
    step_x, step_y = (size[1] - 2 * margin) / side, (size[0] - 2 * margin) / side
    j, i = np.divmod(np.arange(side * side)[:count], side)
    x = margin + (i + 0.5 + rng.uniform(-0.15, 0.15, count)) * step_x
    y = margin + (j + 0.5 + rng.uniform(-0.15, 0.15, count)) * step_y
    return x, y
