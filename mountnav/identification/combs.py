"""Which measurements are pieces of one source: the same offset again and again, as trails and ghosts make."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import pdtrc

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST: Final = 300
"""So many of the brightest measurements are asked: no more than that take part in the odds of most frames."""
FEWEST: Final = 10
"""Among fewer no offset comes so often that it must be one of pieces."""
REACH_PX: Final = 420.0
"""Pieces farther apart are taken for sources of their own, as where light of the stars is looked for."""
CELL_PX: Final = 2.0
"""Offsets are counted in cells of this, two by two of them together: pieces are placed to a pixel."""
AROUND: Final = 15
"""The level that chance has is that of so many cells on each side: crowds have more pairs close by."""
CHANCE: Final = 1e-6
"""An offset that comes so often that chance brings it in fewer frames than this is one of pieces."""
LEAST_PAIRS: Final = 5
"""And at least so many pairs have it."""


def pieces(x_px: Array, y_px: Array) -> Index:
    """Number the sources that measurements belong to.

    A trail that was cut in pieces, a second exposure, a ghost that is shifted: each star's pieces lie at the
    same offsets. Whoever counts them as sources of their own takes one event for several.

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
    count = min(MOST, x_px.size)
    if count < FEWEST:
        return alone
    i, j = np.triu_indices(count, 1)
    dx, dy = x_px[j] - x_px[i], y_px[j] - y_px[i]
    near = (np.abs(dx) < REACH_PX) & (np.abs(dy) < REACH_PX)
    i, j, dx, dy = i[near], j[near], dx[near], dy[near]
    # either of two pieces may be the first: half of the plane holds all offsets
    sign = np.where((dy > 0) | ((dy == 0) & (dx > 0)), 1.0, -1.0)
    column = np.floor((sign * dx + REACH_PX) / CELL_PX).astype(np.int64)
    row = np.floor(sign * dy / CELL_PX).astype(np.int64)
    columns, rows = int(2 * REACH_PX / CELL_PX) + 1, int(REACH_PX / CELL_PX) + 1
    cells = np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns).astype(float)
    # a window of 2 x 2 cells, named by its upper left one
    window = cells.copy()
    window[:, :-1] += cells[:, 1:]
    window[:-1] += window[1:].copy()
    some = np.argwhere(window >= LEAST_PAIRS)
    if some.size == 0:
        return alone
    level = 4.0 * ndimage.uniform_filter(cells, 2 * AROUND + 1, mode="reflect")
    often = window[some[:, 0], some[:, 1]]
    chance = pdtrc(often - 1.0, level[some[:, 0], some[:, 1]]) * cells.size
    some = some[chance < CHANCE]
    if some.size == 0:
        return alone
    told = np.zeros(cells.shape, dtype=bool)
    for down, right in ((0, 0), (0, 1), (1, 0), (1, 1)):
        told[np.minimum(some[:, 0] + down, rows - 1), np.minimum(some[:, 1] + right, columns - 1)] = True
    together = told[row, column]
    links = coo_array(
        (np.ones(int(together.sum())), (i[together], j[together])), shape=(x_px.size, x_px.size)
    )
    return np.asarray(connected_components(links, directed=False)[1], dtype=np.int64)
