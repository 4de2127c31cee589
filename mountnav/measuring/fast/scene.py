"""What the fast measurement knows of a frame as a whole: sky, noise, where pixels are full."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.frames import Frame
from mountnav.measuring.fast.coarse import (
    SMOOTHED_NOISE,
    CoarseSky,
    Summed,
    coarse_plane,
    coarse_sky,
    pixel_noise,
    smooth_lightly,
)
from mountnav.measuring.fast.moments import Patches, cut_patches
from mountnav.measuring.medians import median
from mountnav.measuring.psf_photometry import known_gain
from mountnav.measuring.settings import MeasuringSettings

Array = NDArray[np.float64]

_SMALLEST_SIDE_PX = 64
"""Smaller frames are left to the full measurement, px: they are fast anyway."""
_BIN_BY_4_PX = 5_000_000
"""Frames of more pixels are summed in bins of 4 × 4 ..."""
_BIN_BY_2_PX = 1_000_000
"""... and of 2 × 2: the coarse plane then has 0.25 to 1.25 million bins at most for 20 Mpx."""
_MOST_MISSING = 0.05
"""Share of the bins that may lack a pixel, or the frame is left to the full measurement."""
_LEAST_NOISE = 0.5
"""Least noise of a tile over that of independent pixels: tiles cut off at zero or full show none."""
_MOST_RATIO = 4.0
"""Largest noise ratio of correlated pixels that is believed: a frame of clouds or leaves shows more."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A frame and what the fast measurement found out about it.

    Attributes
    ----------
    bin_px : int
        Side of the coarse plane's bins.
    sky : CoarseSky
        Of the coarse plane.
    sky_adu, noise_adu : float
        Median level, and noise per pixel.
    full_adu : float
        From where on pixels are saturated; infinity if they never are.
    gain : (float, bool)
        As `known_gain` gives it.
    fwhm_px : float
        Of the typical star, its pixels' width included.
    noise_ratio : float
        Noise of sums of pixels over what it were if pixels were independent; at least 1.
    """

    frame: Frame
    bin_px: int
    sky: CoarseSky
    sky_adu: float
    noise_adu: float
    full_adu: float
    gain: tuple[float, bool]
    fwhm_px: float
    noise_ratio: float

    def cut(self, x_px: Array, y_px: Array, half_px: int) -> Patches:
        """Cut squares round positions, shape (n,); missing pixels get the sky's level."""
        half = min(half_px, (min(self.frame.pixels.shape) - 1) // 2)
        patches = cut_patches(self.frame.pixels, x_px, y_px, half)
        if self.frame.pixels.dtype.kind == "f":
            missing = ~np.isfinite(patches.values)
            if missing.any():
                patches.values[missing] = self.sky_adu
        return patches

    def noise_at(self, x_px: Array, y_px: Array) -> Array:
        """Noise per pixel at positions, shape (n,): the frame's, in proportion to the tiles' own."""
        own = self.sky.at(self.sky.noise, *self.bins(x_px, y_px))
        return np.asarray(own * (self.noise_adu / median(self.sky.noise)))

    def bins(self, x_px: Array, y_px: Array) -> tuple[Array, Array]:
        """Column and row of the coarse plane for positions of the frame."""
        middle = 0.5 * (self.bin_px - 1)
        return (x_px - middle) / self.bin_px, (y_px - middle) / self.bin_px


def survey_frame(frame: Frame, settings: MeasuringSettings) -> tuple[Scene, Summed] | None:
    """Sum a frame up; neither its saturation nor its stars' width is known yet.

    Returns
    -------
    (Scene, Summed) or None
        With the coarse plane and its own sky; None if the frame isn't one for the fast measurement.
    """
    pixels = frame.pixels
    if frame.mosaic or pixels.ndim != 2 or min(pixels.shape) < _SMALLEST_SIDE_PX:
        return None
    if pixels.dtype.kind not in "uif":
        return None
    if not pixels.flags.c_contiguous or not pixels.dtype.isnative:
        pixels = np.ascontiguousarray(pixels.astype(pixels.dtype.newbyteorder("="), copy=False))
        frame = replace(frame, pixels=pixels)
    bin_px = 4 if pixels.size > _BIN_BY_4_PX else 2 if pixels.size > _BIN_BY_2_PX else 1
    plane = coarse_plane(pixels, bin_px)
    if pixels.dtype.kind == "f":
        missing = ~np.isfinite(plane)
        if missing.any():
            if missing.mean() > _MOST_MISSING:
                return None
            plane[missing] = median(plane[~missing])
    share = float(bin_px)
    if bin_px == 1:
        smooth_lightly(plane)
        share = SMOOTHED_NOISE
    sky = coarse_sky(plane, bin_px, whole_numbers=pixels.dtype.kind in "ui")
    summed = Summed(plane, bin_px, sky)
    noise = pixel_noise(pixels)
    if not (noise > 0.0 and np.isfinite(noise) and np.isfinite(sky.level).all()):
        return None
    # tiles cut off at zero or full show no scatter of their own
    sky = replace(sky, noise=np.maximum(sky.noise, _LEAST_NOISE * share * noise))
    ratio = float(np.clip(median(sky.noise) / (share * noise), 1.0, _MOST_RATIO))
    level = median(sky.level) / bin_px**2
    gain = known_gain(frame, settings.gain_e_adu, level, noise)
    return Scene(frame, bin_px, sky, level, noise, np.inf, gain, np.nan, ratio), summed
