"""Which measurements and stars take part: bright ones, spread evenly, without those that are no stars."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from mountnav.measuring.measurements import Flag, Measurements

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)
"""Flags of sources that are no star images [S23 §3]."""


def star_like(measurements: Measurements) -> Index:
    """Measurements that can be stars, brightest first.

    Parameters
    ----------
    measurements : Measurements

    Returns
    -------
    ndarray of int, shape (k,)
        Indices of finite measurements without NO_PEAK, TRAIL and BLEED.
    """
    return np.flatnonzero(_finite(measurements) & ((measurements.flags & NO_STAR) == 0))


def all_finite(measurements: Measurements) -> Index:
    """Indices of every measurement with a finite place, whatever its flags; shape (k,)."""
    return np.flatnonzero(_finite(measurements))


def _finite(measurements: Measurements) -> NDArray[np.bool_]:
    finite: NDArray[np.bool_] = (
        np.isfinite(measurements.x_px) & np.isfinite(measurements.y_px) & np.isfinite(measurements.flux)
    )
    return finite


def spread_brightest(x: Array, y: Array, count: int, *, regions: int, cap: float) -> Index:
    """Take the brightest points, but not too many from one region [S23 §2.2, Ω_bl and Ω_star].

    A trail or a bleeding star then can't fill the list.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Places, brightest first, any unit.
    count : int
        How many to take.
    regions : int
        The bounding box is cut in regions × regions parts.
    cap : float
        A region gives at most ceil(cap·count/regions²) points, and at least one.

    Returns
    -------
    ndarray of int, shape (k,), k <= count
        Indices in order of brightness.
    """
    if x.size == 0:
        return np.zeros(0, dtype=np.int64)
    column = _region(x, regions)
    row = _region(y, regions)
    cell = row * regions + column
    most = max(1, math.ceil(cap * count / regions**2))
    return np.flatnonzero(rank_in_cell(cell) < most)[:count]


def rank_in_cell(cell: Index) -> Index:
    """How many of those before it share each one's cell.

    Parameters
    ----------
    cell : ndarray of int, shape (n,)
        In order of brightness.

    Returns
    -------
    ndarray of int, shape (n,)
    """
    order = np.argsort(cell, kind="stable")
    sorted_cell = cell[order]
    rank = np.empty(cell.size, dtype=np.int64)
    rank[order] = np.arange(cell.size) - np.searchsorted(sorted_cell, sorted_cell)
    return rank


def _region(value: Array, regions: int) -> Index:
    low, high = float(value.min()), float(value.max())
    if high <= low:
        return np.zeros(value.size, dtype=np.int64)
    cell: Index = np.minimum(((value - low) / (high - low) * regions).astype(np.int64), regions - 1)
    return cell
