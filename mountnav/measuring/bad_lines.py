"""Bad columns and rows of a frame: found, and filled from their neighbors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image

Array = NDArray[np.float64]
_LINE_SAMPLES = 160
"""Pixels of a line that are looked at. Doubled or halved, nothing changed on the frames that were tried."""
_LINE_OFFSET_SIGMA = 0.8
"""Offset from its neighbors, in units of the noise per pixel, from which a line is bad: eight sigmas of a
median of 160 pixels (1.25 / √160 each). At 0.6 or 0.9 nothing changed on the frames that were tried."""


def bad_lines(sky_free: Image, noise: float, axis: int) -> NDArray[np.intp]:
    """Return the numbers of columns (axis 0) or rows (axis 1) whose level stands off from their neighbors'.

    Parameters
    ----------
    sky_free : ndarray of float32, shape (height, width)
        The frame without its background, ADU.
    noise : float
        Noise per pixel.
    axis : int
        Along which the medians are taken.
    """
    length = sky_free.shape[axis]
    step = max(1, length // _LINE_SAMPLES)
    sample = sky_free[::step] if axis == 0 else sky_free[:, ::step]
    middle = _midmean(sample, axis)
    off = np.abs(middle - ndimage.median_filter(middle, size=9, mode="nearest"))
    # a median of n pixels is sure to 1.25 σ/√n: short lines need a larger offset
    limit = max(_LINE_OFFSET_SIGMA, 8.0 / np.sqrt(length / step)) * noise
    lines = np.flatnonzero(off > limit)
    return lines if lines.size < 0.05 * middle.size else lines[:0]


def _midmean(sample: Image, axis: int) -> Array:
    """Mean of the middle half along an axis: as robust as wanted, and not stuck to whole numbers."""
    quarter = sample.shape[axis] // 4
    parted = np.partition(sample, (quarter, sample.shape[axis] - quarter - 1), axis=axis)
    middle = slice(quarter, sample.shape[axis] - quarter)
    return np.asarray((parted[middle] if axis == 0 else parted[:, middle]).mean(axis=axis), dtype=np.float64)


def heal_lines(sky_free: Image, good: NDArray[np.bool_], lines: NDArray[np.intp], axis: int) -> None:
    """Replace bad lines by the mean of the nearest good ones, in place, and mark their pixels as not good."""
    bad = set(lines.tolist())
    count = sky_free.shape[1 - axis]
    for line in lines.tolist():
        near = [
            next((k for k in way if k not in bad), -1)
            for way in (range(line - 1, -1, -1), range(line + 1, count))
        ]
        near = [k for k in near if k >= 0]
        if axis == 0:
            sky_free[:, line] = sky_free[:, near].mean(axis=1)
            good[:, line] = False
        else:
            sky_free[line] = sky_free[near].mean(axis=0)
            good[line] = False
