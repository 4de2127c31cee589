"""A camera with every fault that masters are made against, sharing nothing with mountnav's own renderer."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from astropy.io import fits
from numpy.typing import NDArray

Array = NDArray[np.float64]

HEIGHT, WIDTH = 300, 400


@dataclass
class SyntheticCamera:
    """Bias pattern, dark current with hot pixels and amp glow, vignetting, dust, dead pixels, full well."""

    seed: int = 7
    height: int = HEIGHT
    width: int = WIDTH
    gain_e_adu: float = 1.6
    read_noise_e: float = 6.0
    offset_adu: float = 500.0
    hot_pixels: int = 300
    dead_pixels: int = 40
    colored: bool = False
    bias: Array = field(init=False)
    dark_e_s: Array = field(init=False)
    response: Array = field(init=False)
    hot: NDArray[np.bool_] = field(init=False)
    dead: NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(self.seed)
        shape = (self.height, self.width)
        y, x = np.mgrid[0 : self.height, 0 : self.width].astype(float)
        self.bias = (
            self.offset_adu + rng.normal(0, 3, self.width)[None, :] + 0.02 * y + rng.normal(0, 1, shape)
        )
        self.dark_e_s = np.full(shape, 0.05) + 2.0 * np.exp(-((x - self.width) ** 2 + y**2) / (2 * 40.0**2))
        self.hot = np.zeros(shape, bool)
        self.hot.flat[rng.choice(self.hot.size, self.hot_pixels, replace=False)] = True
        self.dark_e_s[self.hot] += rng.uniform(5, 400, self.hot_pixels)
        radius2 = ((x - 0.52 * self.width) / self.width) ** 2 + ((y - 0.47 * self.height) / self.width) ** 2
        self.response = 1.0 / (1.0 + 1.6 * radius2) ** 2
        for _ in range(6):
            cx, cy = rng.uniform(0, self.width), rng.uniform(0, self.height)
            r = np.hypot(x - cx, y - cy)
            self.response *= 1.0 - 0.12 * np.exp(-(((r - 9.0) / 3.5) ** 2))
        self.response *= 1.0 + rng.normal(0, 0.008, shape)
        self.dead = np.zeros(shape, bool)
        self.dead.flat[rng.choice(self.dead.size, self.dead_pixels, replace=False)] = True
        self.dead &= ~self.hot
        self.response[self.dead] *= rng.uniform(0.0, 0.3, int(self.dead.sum()))

    def colors(self, red: float, green: float, blue: float) -> Array:
        """Light of an even source through an RGGB mosaic."""
        light = np.full((self.height, self.width), green)
        light[0::2, 0::2], light[1::2, 1::2] = red, blue
        return light

    def exposed(self, light_e: Array | float, exposure_s: float, seed: int) -> NDArray[np.uint16]:
        """Light (electrons over the exposure, before the optics' losses) becomes counts."""
        rng = np.random.default_rng((self.seed, seed))
        shape = (self.height, self.width)
        electrons = rng.poisson(np.broadcast_to(light_e, shape) * self.response + self.dark_e_s * exposure_s)
        noisy = electrons + rng.normal(0, self.read_noise_e, shape)
        counts = self.bias + noisy / self.gain_e_adu + rng.normal(0, 0.5)  # the zero drifts a little
        return np.clip(np.rint(counts), 0, 65535).astype(np.uint16)


def stars(camera: SyntheticCamera, x: Array, y: Array, electrons: Array, fwhm_px: float) -> Array:
    """Light of Gaussian stars."""
    light = np.zeros((camera.height, camera.width))
    sigma = fwhm_px / 2.3548
    rows, columns = np.arange(camera.height)[:, None], np.arange(camera.width)[None, :]
    for cx, cy, total in zip(x, y, electrons, strict=True):
        light += (
            total
            / (2 * np.pi * sigma**2)
            * np.exp(-((columns - cx) ** 2) / (2 * sigma**2))
            * np.exp(-((rows - cy) ** 2) / (2 * sigma**2))
        )
    return light


def write(path: Path, pixels: NDArray[np.generic], **cards: object) -> Path:
    """A FITS file as a camera program writes it; underscores in the cards' names stand for hyphens."""
    hdu = fits.PrimaryHDU(pixels)
    for key, value in cards.items():
        hdu.header[key.replace("_", "-")] = value
    hdu.writeto(path, overwrite=True)
    return path
