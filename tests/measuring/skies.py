"""Paints star fields under uneven skies; shares nothing with mountnav."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]

SIZE = (900, 1000)
FWHM_PX = 3.0
READ_NOISE = 5.0


def field(
    count: int, seed: int, faint: float = 150.0, size: tuple[int, int] = SIZE
) -> tuple[Array, Array, Array]:
    """Positions and electrons of stars, many faint and few bright."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(8, size[1] - 9, count), rng.uniform(8, size[0] - 9, count)
    bright, slope = 3e5, 0.9
    share = rng.uniform(size=count) * (1 - (faint / bright) ** slope)
    return x, y, faint * (1 - share) ** (-1 / slope)


def stamped(
    x: Array, y: Array, electrons: Array, size: tuple[int, int] = SIZE, fwhm_px: float = FWHM_PX
) -> Array:
    """Mean image of Gaussian stars, drawn in cutouts."""
    sigma = fwhm_px / 2.3548
    image, half = np.zeros(size), int(np.ceil(5 * sigma)) + 2
    for cx, cy, total in zip(x, y, electrons, strict=True):
        top, bottom = max(0, int(cy) - half), min(size[0], int(cy) + half + 1)
        left, right = max(0, int(cx) - half), min(size[1], int(cx) + half + 1)
        if top >= bottom or left >= right:
            continue
        rows, columns = np.arange(top, bottom)[:, None], np.arange(left, right)[None, :]
        psf = np.exp(-((rows - cy) ** 2 + (columns - cx) ** 2) / (2 * sigma**2))
        image[top:bottom, left:right] += total / (2 * np.pi * sigma**2) * psf
    return image


def exposed(sky: Array, stars: Array, through: Array | float = 1.0, seed: int = 5) -> Array:
    """Noisy electrons with a bias of 500; ``through`` is the share of light that a vignetted pixel gets."""
    rng = np.random.default_rng(seed)
    return np.asarray(rng.poisson((sky + stars) * through) + rng.normal(0.0, READ_NOISE, sky.shape) + 500.0)


def cloud(steepness: float, seed: int, size: tuple[int, int] = SIZE) -> Array:
    """Turbulence of unit scatter with a power law spectrum, seen through the stars' own blur."""
    rng = np.random.default_rng(seed)
    wave = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.fftfreq(size[1])[None, :])
    wave[0, 0] = 1.0
    spectrum = np.fft.fft2(rng.normal(size=size)) * wave ** (-steepness / 2) * (wave > 1.5 / size[1])
    image = np.real(np.fft.ifft2(spectrum))
    return np.asarray(ndimage.gaussian_filter(image / image.std(), FWHM_PX / 2.3548))


NAMES = (
    *("flat", "gradient", "moon", "vignetting", "amplifier glow", "nebula", "galaxy", "clouds"),
    *("two amplifiers", "four amplifiers"),
)
"""Of `skies`: who collects tests needs the names alone, and painting takes seconds."""


@cache
def skies(size: tuple[int, int] = SIZE) -> dict[str, tuple[Array, Array | float]]:
    """Sky in electrons per pixel, and the share of light let through, by name."""
    height, width = size
    y, x = np.mgrid[0:height, 0:width]
    flat = np.full(size, 100.0)
    corner2 = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
    glow = sum(
        1500 * np.exp(-np.hypot(x - a, y - b) / (0.05 * width))
        for a, b in [(0, 0), (width, height), (width, 0)]
    )
    mist = cloud(4.4, 11, size)
    heart = 8000 / (1 + (np.hypot(x - width * 0.55, y - height * 0.45) / 40) ** 2)
    turned = (
        (x - width / 2) * 0.88 + (y - height / 2) * 0.48,
        (y - height / 2) * 0.88 - (x - width / 2) * 0.48,
    )
    round_px = np.hypot(turned[0], turned[1] * 2.5)
    half, quarters = flat.copy(), flat.copy()
    half[:, width // 2 :] += 60.0
    quarters[: height // 2, width // 2 :] += 40.0
    quarters[height // 2 :, : width // 2] -= 30.0
    quarters[height // 2 :, width // 2 :] += 15.0
    return {
        "flat": (flat, 1.0),
        "gradient": (100 + 900 * x / width + 300 * (y / height) ** 2, 1.0),
        "moon": (100 + 1500 * np.exp(-np.hypot(x + 0.1 * width, y + 0.1 * height) / (0.4 * width)), 1.0),
        "vignetting": (4 * flat, 1.0 - 0.5 * corner2),
        "amplifier glow": (100 + np.asarray(glow), 1.0),
        "nebula": (100 + 150 * np.exp(0.8 * cloud(4.0, 3, size)) + heart, 1.0),
        "galaxy": (
            100 + 3000 * np.exp(3 - 7 * (round_px / 120) ** 0.4) + 300 * np.exp(-round_px / 90),
            1.0,
        ),
        "clouds": (300 * np.exp(0.35 * mist), np.clip(np.exp(-0.3 * np.clip(mist, -1, 3)), 0.3, 1)),
        "two amplifiers": (half, 1.0),
        "four amplifiers": (quarters, 1.0),
    }
