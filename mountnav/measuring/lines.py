"""Straight lines in a noisy picture: the fast discrete Radon transform of all dyadic pieces at once.

Brady's transform (SIAM J. Comput. 27, 107, 1998), used for satellites by Nir, Zackay and Ofek (AJ 156,
229, 2018): sums along all lines through all blocks of 2, 4, 8 ... rows, each level from the one before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_SIDE_BINS = 3
_MOST_A_LEVEL = 1500
_SAMPLE_STEP = 7


@dataclass(frozen=True, slots=True)
class Segments:
    """Straight pieces that stand out, best first; each array has shape (n,), lengths in bins.

    Attributes
    ----------
    x0, y0, x1, y1 : ndarray
        The ends.
    strength : ndarray
        How far the sum along the piece rises above the higher one of its two neighbors, in units of the
        scatter of this difference.
    """

    x0: Array
    y0: Array
    x1: Array
    y1: Array
    strength: Array


def find_segments(picture: Image, least_length: float, threshold: float) -> Segments:
    """Find straight bright pieces of any direction.

    Parameters
    ----------
    picture : ndarray of float32, shape (height, width)
        Cut above, so that single bright bins don't count as lines.
    least_length : float
        Shorter pieces aren't looked for, bins.
    threshold : float
        Least strength.

    Returns
    -------
    Segments
    """
    first = max(3, int(np.ceil(np.log2(max(least_length, 2.0)))))
    parts: list[Array] = []
    for upright in (True, False):
        lines = picture if upright else picture.T
        for mirrored in (False, True):
            found = _steep(lines[:, ::-1] if mirrored else lines, first, threshold)
            if mirrored:
                found[:, [0, 2]] = lines.shape[1] - 1 - found[:, [0, 2]]
            parts.append(found if upright else found[:, [1, 0, 3, 2, 4]])
    rows = np.concatenate(parts)
    rows = rows[np.argsort(-rows[:, 4], kind="stable")]
    return Segments(*rows.T)


def _steep(picture: Image, first: int, threshold: float) -> Array:
    """Pieces that go down and right, up to 45° off the columns; rows of (x0, y0, x1, y1, strength)."""
    height, width = picture.shape
    levels = int(np.ceil(np.log2(height)))
    sums = np.zeros((2**levels, 1, width), dtype=np.float32)
    sums[:height, 0] = picture
    found = [np.zeros((0, 5))]
    for level in range(1, levels + 1):
        upper, lower = sums[0::2], sums[1::2]
        sums = np.repeat(upper, 2, axis=1)
        for slope in range(2**level):
            shift = (slope + 1) // 2
            if shift < width:
                sums[:, slope, : width - shift] += lower[:, slope // 2, shift:]
        if level >= first:
            found.append(_standing_out(sums, level, threshold, height))
    return np.concatenate(found)


def _standing_out(sums: Image, level: int, threshold: float, height: int) -> Array:
    ridge = sums[:, :, _SIDE_BINS:-_SIDE_BINS] - np.maximum(
        sums[:, :, : -2 * _SIDE_BINS], sums[:, :, 2 * _SIDE_BINS :]
    )
    sample = ridge.ravel()[::_SAMPLE_STEP]
    sample = np.sort(sample[sample != 0.0])
    if sample.size < 100:
        return np.zeros((0, 5))
    middle, low = sample[sample.size // 2], sample[int(0.158655 * sample.size)]
    scatter = max(float(middle - low), 1e-6)
    places = np.flatnonzero(ridge > middle + threshold * scatter)
    if places.size == 0:
        return np.zeros((0, 5))
    strength = (ridge.ravel()[places] - middle) / scatter
    if places.size > _MOST_A_LEVEL:
        best = np.argpartition(-strength, _MOST_A_LEVEL)[:_MOST_A_LEVEL]
        places, strength = places[best], strength[best]
    block, slope, x = np.unravel_index(places, ridge.shape)
    rows = 2**level
    x0 = x + float(_SIDE_BINS)
    y0 = block * float(rows)
    y1 = np.minimum(y0 + rows - 1, height - 1.0)  # the last block may hang over the picture's edge
    return np.stack([x0, y0, x0 + slope * (y1 - y0) / (rows - 1), y1, strength], axis=1)
