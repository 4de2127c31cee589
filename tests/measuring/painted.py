"""A small painter of Gaussian stars, sharing nothing with mountnav's own renderer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.frames import Frame

Array = NDArray[np.float64]


def painted(
    x: Array,
    y: Array,
    electrons: Array,
    *,
    fwhm_px: float,
    size: tuple[int, int] = (300, 300),
    sky: float = 100.0,
    read_noise: float = 5.0,
    seed: int = 1,
) -> Array:
    """Noisy frame (height, width) in electrons; each star is a Gaussian sampled at the pixels' centers."""
    rng = np.random.default_rng(seed)
    sigma = fwhm_px / 2.3548
    rows, columns = np.arange(size[0])[:, None], np.arange(size[1])[None, :]
    truth = np.full(size, sky)
    for cx, cy, total in zip(x, y, electrons, strict=True):
        bell = np.exp(-((columns - cx) ** 2) / (2 * sigma**2)) * np.exp(-((rows - cy) ** 2) / (2 * sigma**2))
        truth += total / (2 * np.pi * sigma**2) * bell
    return np.asarray(rng.poisson(truth) + rng.normal(0.0, read_noise, size))


def as_frame(image: Array, top: float = 65535.0) -> Frame:
    """Give it the 16 bits of a camera, one electron per ADU."""
    return Frame(pixels=np.clip(np.rint(image + 500.0), 0, top).astype(np.uint16), header={"EGAIN": 1.0})


def scattered(count: int, size: tuple[int, int], seed: int, margin: float = 20.0) -> tuple[Array, Array]:
    """Places on a jittered grid, so that no two stars touch."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(count)))
    step_x, step_y = (size[1] - 2 * margin) / side, (size[0] - 2 * margin) / side
    j, i = np.divmod(np.arange(side * side)[:count], side)
    x = margin + (i + 0.5 + rng.uniform(-0.15, 0.15, count)) * step_x
    y = margin + (j + 0.5 + rng.uniform(-0.15, 0.15, count)) * step_y
    return x, y
