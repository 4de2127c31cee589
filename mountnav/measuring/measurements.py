"""Measurements: the sources found in one frame, as arrays side by side [S23 §0]."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.quality import SkyQuality

Array = NDArray[np.float64]


class Flag(IntFlag):
    """Why a measurement deserves less trust; later steps reject by these."""

    SATURATED = 1
    EDGE = 2
    ELONGATED = 4
    NO_PEAK = 8  # hot pixel, cosmic ray, flat top: no stellar profile
    BLENDED = 16
    TRAIL = 32
    BLEED = 64


@dataclass(frozen=True, slots=True)
class Measurements:
    """Detected sources, brightest first; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px
        Centroid, 0-based; the center of the file's first pixel is (0, 0).
    x_sigma_px, y_sigma_px
        One-sigma centroid errors.
    flux
        Background-subtracted flux, ADU.
    flux_sigma
        Its error.
    fwhm_px, ellipticity
        Shape of the fitted profile.
    flags
        `Flag` bits (int64).
    width_px, height_px
        Size of the frame.
    background_adu, noise_adu
        Median sky level and its noise per pixel.
    elongation_deg
        Direction of the major axis, from +x towards +y, in [-90, 90); shape (n,), or None if not measured.
    quality
        What the frame tells about the night; None for lists that no frame was measured for.
    """

    x_px: Array
    y_px: Array
    x_sigma_px: Array
    y_sigma_px: Array
    flux: Array
    flux_sigma: Array
    fwhm_px: Array
    ellipticity: Array
    flags: NDArray[np.int64]
    width_px: int
    height_px: int
    background_adu: float
    noise_adu: float
    elongation_deg: Array | None = None
    quality: SkyQuality | None = None

    def __len__(self) -> int:
        return int(self.x_px.size)
