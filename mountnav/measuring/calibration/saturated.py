"""Saturated pixels stay recognizable, though a flat makes the same charge read differently in the corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.frames import Frame
from mountnav.measuring.calibration.raw_files import FloatImage
from mountnav.measuring.saturation import saturation_level

_ROOM = 1.02
_SAMPLE = 4_000_000


@dataclass(frozen=True, slots=True)
class Full:
    """From what level a raw pixel is saturated; infinity if none is known."""

    level_adu: float


def full_level(frame: Frame) -> Full:
    """Find from what level on a raw frame's pixels count as saturated.

    Parameters
    ----------
    frame : Frame
        With its pixels untouched.

    Returns
    -------
    Full
    """
    image = frame.pixels.astype(np.float32)
    step = max(1, image.size // _SAMPLE)
    sample = image.ravel()[::step]
    sample = sample[np.isfinite(sample)]
    if sample.size == 0:
        return Full(np.inf)
    sky = float(np.median(sample))
    noise = 1.4826 * float(np.median(np.abs(sample - sky)))
    return Full(saturation_level(frame.pixels, image, sky, max(noise, 0.3), frame.saturation_adu))


def keep_full(
    pixels: FloatImage, raw: NDArray[np.generic], full: Full, bad: NDArray[np.bool_] | None = None
) -> float | None:
    """Lift pixels that were saturated above all that were not, in place.

    A flat divides the full well by the response: a saturated pixel at the center would end below an
    unsaturated one in a dark corner, and no single level could tell them apart.

    Parameters
    ----------
    pixels : ndarray of float32, shape (height, width)
        Calibrated.
    raw : ndarray, shape (height, width)
        The same before.
    full : Full
    bad : ndarray of bool, shape (height, width), optional
        Pixels that tell nothing.

    Returns
    -------
    float or None
        The level from which pixels are saturated now; None if it wasn't known before.
    """
    if not np.isfinite(full.level_adu):
        return None
    saturated = np.asarray(raw, dtype=np.float32) >= full.level_adu
    telling = np.isfinite(pixels) & ~saturated
    if bad is not None:
        saturated &= ~bad
        telling &= ~bad
    highest = float(pixels.max(where=telling, initial=1.0))
    level = _ROOM * highest
    if saturated.any():
        # above the level by rounding at most: their height means nothing
        pixels[saturated] = np.float32(level * 1.001)
        return level
    return max(level, float(full.level_adu))
