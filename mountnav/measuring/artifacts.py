"""What is not the sky: trails, spikes and bleeds in a frame [S23 §0.3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.background import Image
from mountnav.measuring.detection import Peaks, Smoothed
from mountnav.measuring.measurements import Flag
from mountnav.measuring.saturation import Bleed, SaturatedPatch, find_bleeds, find_saturated_patches
from mountnav.measuring.trails import Trail, find_trails

Array = NDArray[np.float64]

_GRAIN_RATIO = 3.0
"""A peak on a trail below so many times the trail's height is its grain and no star. Halved, 14 pieces of a
painted trail's grain are listed (flagged `TRAIL`); doubled, nothing changed on the frames that were tried."""


@dataclass(frozen=True, slots=True)
class Artifacts:
    """The artifacts of a frame.

    Attributes
    ----------
    blobs : list of SaturatedPatch
        Patches of saturated pixels.
    bleeds : list of Bleed
        Charge that ran over from them.
    trails : list of Trail
        Satellites, planes, spikes of bright stars, and bad lines that weren't healed.
    """

    blobs: list[SaturatedPatch]
    bleeds: list[Bleed]
    trails: list[Trail]

    def flags_at(self, x_px: Array, y_px: Array, margin_px: float) -> NDArray[np.int64]:
        """Flags of sources at positions, shape (n,): TRAIL, BLEED, NO_PEAK on a spike.

        Parameters
        ----------
        x_px, y_px : ndarray, shape (n,)
            Pixels, 0-based: the middle of the first pixel is (0, 0).
        margin_px : float
            Sources so near are spoilt as well.

        Returns
        -------
        ndarray of int64, shape (n,)
            Bits of `Flag`; 0: none.
        """
        flags = np.zeros(x_px.size, dtype=np.int64)
        for trail in self.trails:
            flags[trail.touches(x_px, y_px, margin_px)] |= _cause(trail)
        for bleed in self.bleeds:
            flags[bleed.touches(x_px, y_px, 0.5 * margin_px + 1.0)] |= Flag.BLEED
        flags[(flags & Flag.BLEED) > 0] &= ~int(Flag.TRAIL)
        # the star to which spikes belong is a star
        for blob in self.blobs:
            own = np.hypot(x_px - blob.x_px, y_px - blob.y_px) < blob.radius_px + margin_px
            flags[own] &= ~int(Flag.NO_PEAK)
        return flags

    def spoil(self, good: NDArray[np.bool_], peaks: Peaks, core_px: float) -> NDArray[np.bool_]:
        """Return a mask of usable pixels, shape (height, width), without those of the artifacts.

        Spikes stay: they are a star's own light, and faint beside it. So do the cores of the stars that a
        trail crosses: without them nothing would be left to measure, and they are flagged.
        """
        left = good.copy()
        crossed = np.zeros(peaks.x_px.size, dtype=bool)
        for trail in self.trails:
            if not trail.spike:
                left[trail.pixels(*good.shape)] = False
                crossed |= trail.touches(peaks.x_px, peaks.y_px, 0.0)
        reach = round(core_px)
        for x, y in zip(np.rint(peaks.x_px[crossed]), np.rint(peaks.y_px[crossed]), strict=True):
            rows = slice(max(0, int(y) - reach), int(y) + reach + 1)
            columns = slice(max(0, int(x) - reach), int(x) + reach + 1)
            left[rows, columns] = good[rows, columns]
        for bleed in self.bleeds:
            left[max(0, bleed.top) : bleed.bottom + 1, max(0, bleed.left) : bleed.right + 1] = False
        return left

    def without_grain(self, peaks: Peaks) -> Peaks:
        """Leave out the peaks that are no more than the grain of a trail."""
        grain = np.zeros(peaks.x_px.size, dtype=bool)
        for trail in self.trails:
            if trail.along_axis or trail.spike:
                continue  # a star stands on it
            on = trail.touches(peaks.x_px, peaks.y_px, 0.5)
            grain |= on & (peaks.height < _GRAIN_RATIO * max(trail.height, 1.0))
        return Peaks(peaks.x_px[~grain], peaks.y_px[~grain], peaks.height[~grain])


def _cause(trail: Trail) -> Flag:
    if trail.spike:
        return Flag.NO_PEAK
    return Flag.BLEED if trail.along_axis else Flag.TRAIL


def find_artifacts(
    sky_free: Image, saturated: NDArray[np.bool_], smoothed: Smoothed, noise: float, fwhm_px: float
) -> Artifacts:
    """Find the artifacts of a frame.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        Without background, missing pixels zero.
    saturated : ndarray of bool, shape (height, width)
        Pixels at or above the saturation level.
    noise : float
        Noise per pixel.
    fwhm_px : float
        The stars' width.
    """
    blobs = find_saturated_patches(saturated, fwhm_px) if saturated.any() else []
    return Artifacts(blobs, find_bleeds(sky_free, blobs, noise, fwhm_px), find_trails(smoothed, fwhm_px))
