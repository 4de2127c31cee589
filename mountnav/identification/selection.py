"""Which measurements and stars take part: bright, evenly spread, no defects, no pieces of trails twice."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import pdtrc

from mountnav.measuring.measurements import Flag, Measurements

Array = NDArray[np.float64]
Index = NDArray[np.int64]

NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)
"""Flags of sources that are no star images [S23 §3]."""
SHARP_SHARE = 0.3
"""When more of the candidates than this have no peak, the stars are that sharp, or what isn't sky is so quiet
that the sky passes for restless, and the flag says nothing. Chosen by hand."""


def star_like(measurements: Measurements) -> Index:
    """Measurements that can be stars, brightest first.

    Returns
    -------
    ndarray of int, shape (k,)
        Indices of finite measurements without NO_PEAK, TRAIL and BLEED.
    """
    return np.flatnonzero(_finite(measurements) & ((measurements.flags & NO_STAR) == 0))


def star_like_beside(measurements: Measurements, some: Index) -> Index:
    """Measurements that can be stars as well as some that surely are, brightest first.

    Parameters
    ----------
    some : ndarray of int
        Indices of measurements that are identified.

    Returns
    -------
    ndarray of int, shape (k,)
        As `star_like`; where more than `SHARP_SHARE` of the identified ones have NO_PEAK, that flag says
        nothing of the others.
    """
    flags = measurements.flags
    if some.size and np.mean((flags[some] & int(Flag.NO_PEAK)) != 0) > SHARP_SHARE:
        return np.flatnonzero(_finite(measurements) & ((flags & int(Flag.TRAIL | Flag.BLEED)) == 0))
    return star_like(measurements)


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
        0 for the first of a cell.
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


PIECES_MOST_SOURCES: Final = 300
"""Number of the brightest measurements among which pieces are sought: no more than that take part in the odds
of most frames."""
PIECES_FEWEST_SOURCES: Final = 10
"""Among fewer no offset comes so often that it must be one of pieces."""
PIECES_REACH_PX: Final = 420.0
"""Pieces farther apart are taken for sources of their own, as where light of the stars is looked for."""
PIECES_CELL_PX: Final = 2.0
"""Offsets are counted in cells of this, two by two of them together: pieces are placed to a pixel."""
PIECES_CELLS_AROUND: Final = 15
"""The level that chance has is that of so many cells on each side: crowds have more pairs close by. Chosen by
hand."""
PIECES_CHANCE: Final = 1e-6
"""An offset that comes so often that chance brings it in fewer frames than this is one of pieces."""
PIECES_LEAST_PAIRS: Final = 5
"""And at least so many pairs have it. Chosen by hand."""


def trail_pieces(x_px: Array, y_px: Array) -> Index:
    """Number the sources that measurements belong to.

    A trail that was cut in pieces, a second exposure, a ghost that is shifted: each star's pieces lie at the
    same offsets. To count them as sources of their own is to take one event for several.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        Measurements, brightest first.

    Returns
    -------
    ndarray of int, shape (n,)
        The same number for pieces of one source.
    """
    alone = np.arange(x_px.size, dtype=np.int64)
    count = min(PIECES_MOST_SOURCES, x_px.size)
    if count < PIECES_FEWEST_SOURCES:
        return alone
    i, j = np.triu_indices(count, 1)
    dx, dy = x_px[j] - x_px[i], y_px[j] - y_px[i]
    near = (np.abs(dx) < PIECES_REACH_PX) & (np.abs(dy) < PIECES_REACH_PX)
    i, j, dx, dy = i[near], j[near], dx[near], dy[near]
    # either of two pieces may be the first: half of the plane holds all offsets
    sign = np.where((dy > 0) | ((dy == 0) & (dx > 0)), 1.0, -1.0)
    column = np.floor((sign * dx + PIECES_REACH_PX) / PIECES_CELL_PX).astype(np.int64)
    row = np.floor(sign * dy / PIECES_CELL_PX).astype(np.int64)
    columns, rows = int(2 * PIECES_REACH_PX / PIECES_CELL_PX) + 1, int(PIECES_REACH_PX / PIECES_CELL_PX) + 1
    cells = np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns).astype(float)
    # a window of 2 x 2 cells, named by its upper left one
    window = cells.copy()
    window[:, :-1] += cells[:, 1:]
    window[:-1] += window[1:].copy()
    some = np.argwhere(window >= PIECES_LEAST_PAIRS)
    if some.size == 0:
        return alone
    level = 4.0 * ndimage.uniform_filter(cells, 2 * PIECES_CELLS_AROUND + 1, mode="reflect")
    often = window[some[:, 0], some[:, 1]]
    chance = pdtrc(often - 1.0, level[some[:, 0], some[:, 1]]) * cells.size
    some = some[chance < PIECES_CHANCE]
    if some.size == 0:
        return alone
    frequent = np.zeros(cells.shape, dtype=bool)
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        frequent[np.minimum(some[:, 0] + down, rows - 1), np.minimum(some[:, 1] + right, columns - 1)] = True
    linked = frequent[row, column]
    from scipy.sparse import coo_array  # expensive to import, and few frames have pieces
    from scipy.sparse.csgraph import connected_components

    links = coo_array((np.ones(int(linked.sum())), (i[linked], j[linked])), shape=(x_px.size, x_px.size))
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
