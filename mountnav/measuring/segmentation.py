"""The bright patches of a frame: light that hangs together, be it a point's, an arc's or a piece of one."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from mountnav.measuring.background import Image
from mountnav.measuring.fast.coarse import coarse_plane
from mountnav.measuring.star_trail import FAR_BIN_PX, in_sigmas

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

_LARGE_PX = 3_000_000
"""Larger frames are looked at in bins of 4 px, others of 2: as fine as a few milliseconds allow."""
_BRIGHT_SIGMA = 6.0
"""A bin above this is light; half of it would join strangers by the noise between them, twice as much would
break dim trails."""
_JOINED = 0.1
"""Patches are one where the way between them is shorter than twice this share of the mean distance of all: an
eighth of them have a stranger so near. Doubled, half of them would have one."""
_FARTHEST_JOINED_PX = 20
"""And no farther than twice this: longer gaps are seen as light elsewhere."""


@dataclass(frozen=True, slots=True)
class LightSegments:
    """Patches of light; each array has shape (n,).

    Attributes
    ----------
    x_px, y_px : ndarray
        Centers of light, 0-based.
    flux : ndarray
        To a common scale.
    whole : ndarray of bool
        Away from the frame's edges.
    labels : ndarray of int, shape (rows, columns)
        Of each bin: 1 + index of its patch, or 0 where there is no light.
    parts : Patches or None
        The same light, each piece that hangs together by itself; None where none were joined.
    """

    x_px: Array
    y_px: Array
    flux: Array
    whole: Mask
    labels: NDArray[np.int32]
    bin_px: int
    parts: LightSegments | None = None

    def at(self, x_px: Array, y_px: Array) -> Index:
        """Index of the patch that lies at a position or right beside it, -1 for none; shape (n,).

        Parameters
        ----------
        x_px, y_px : ndarray, shape (n,)
            Pixels, 0-based: the middle of the first pixel is (0, 0).
        """
        height, width = self.labels.shape
        column = np.rint((x_px - 0.5 * (self.bin_px - 1)) / self.bin_px).astype(np.int64)
        row = np.rint((y_px - 0.5 * (self.bin_px - 1)) / self.bin_px).astype(np.int64)
        columns = [np.minimum(np.maximum(column + right, 0), width - 1) for right in (0, 1, -1)]
        rows = [np.minimum(np.maximum(row + down, 0), height - 1) * width for down in (0, 1, -1)]
        labels = self.labels.reshape(-1)
        found = labels[rows[0] + columns[0]].astype(np.int64)
        for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            left = np.flatnonzero(found == 0)
            found[left] = labels[rows[down][left] + columns[right][left]]
        return np.asarray(found - 1)


def segment_light(pixels: NDArray[np.generic], bins: Image | None = None) -> LightSegments:
    """Find the patches of light in a frame.

    Parameters
    ----------
    pixels : ndarray, shape (height, width)
        The frame, ADU.
    bins : ndarray, optional
        The frame by `star_trail.in_bins`, if it is at hand: enough for a large one.
    """
    bin_px = FAR_BIN_PX if pixels.size > _LARGE_PX else 2
    if bins is not None and bin_px == FAR_BIN_PX:
        level = bins
    else:
        level, _ = in_sigmas(coarse_plane(pixels, bin_px), bin_px, whole=pixels.dtype.kind in "ui")
    lit = level > _BRIGHT_SIGMA
    at = np.flatnonzero(lit)
    found, count = ndimage.label(lit, structure=np.ones((3, 3)))
    labels = np.asarray(found, dtype=np.int32)
    parts = None
    # pieces of one star's light lie nearer to each other than stars do on the mean
    apart_px = _JOINED * math.sqrt(pixels.size / max(count, 1))
    join = int(min(apart_px, _FARTHEST_JOINED_PX) / bin_px)
    if join > 0:
        found, fewer = ndimage.label(_widened(lit, join))
        if fewer < count:
            parts = _segments(level, labels, at, count, bin_px)
        joined = np.zeros_like(labels)
        joined.reshape(-1)[at] = found.reshape(-1)[at]
        labels, count = joined, fewer
    return replace(_segments(level, labels, at, count, bin_px), parts=parts)


def _widened(lit: Mask, by: int) -> Mask:
    """True within `by` rows and columns of what is True.

    A twentieth of the time of a filter for any numbers: shifts that double, along one axis and the other.
    """
    wide = lit.copy()
    for axis in (0, 1):
        reached = 0
        while reached < by:
            step = min(reached + 1, by - reached)
            seen = wide.copy()
            low, high = [slice(None)] * 2, [slice(None)] * 2
            low[axis], high[axis] = slice(None, -step), slice(step, None)
            wide[tuple(low)] |= seen[tuple(high)]
            wide[tuple(high)] |= seen[tuple(low)]
            reached += step
    return wide


def _segments(level: Image, labels: NDArray[np.int32], at: Index, count: int, bin_px: int) -> LightSegments:
    """Middle and light of each label; `at` are the labelled bins of the flattened plane."""
    rows, columns = np.divmod(at, labels.shape[1])
    label = labels.reshape(-1)[at].astype(np.int64) - 1
    light = level.reshape(-1)[at].astype(np.float64)
    flux: Array = np.bincount(label, light, minlength=count).astype(np.float64)
    x = np.bincount(label, light * columns.astype(np.float64), minlength=count) / flux
    y = np.bincount(label, light * rows.astype(np.float64), minlength=count) / flux
    height, width = labels.shape
    rim = (rows <= 0) | (columns <= 0) | (rows >= height - 1) | (columns >= width - 1)
    cut = np.bincount(label[rim], minlength=count) > 0
    middle = 0.5 * (bin_px - 1)
    return LightSegments(bin_px * x + middle, bin_px * y + middle, flux, ~cut, labels, bin_px)
