"""A raster of the frame that knows which cells lie near a measurement: a lookup for millions of stars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.identification.odds import area_share

Array = NDArray[np.float64]
Index = NDArray[np.int64]

CELLS = 6
"""Cells to a radius."""
CLOSE_CELLS = 2
"""A third of the radius: a camera without distortion hits so well, and then fewer stars suffice."""
FIRST_LOOK = 60
"""So many of the brightest stars are asked first; most hypotheses fail there."""
FIRST_HITS = 4
"""Hits that earn a second look: the triangle's three, and one."""


class Board:
    """Counts, for many plates at once, how many stars fall on measurements.

    Parameters
    ----------
    x_px, y_px : ndarray, shape (n,)
        The measurements of Ω_bl100, brightest first.
    radius_px : float
        Δr_ident.
    width_px, height_px : int
        Size of the frame.
    """

    def __init__(self, x_px: Array, y_px: Array, radius_px: float, *, width_px: int, height_px: int) -> None:
        self._cell = radius_px / CELLS
        self._width, self._height = width_px, height_px
        self.size = int(x_px.size)
        columns = int(np.ceil(width_px / self._cell)) + 1
        rows = int(np.ceil(height_px / self._cell)) + 1
        # zeros: pages that no measurement touches are never written
        self._board = np.zeros((rows, columns), dtype=np.int16)
        self._close = np.zeros((rows, columns), dtype=np.int16)
        self._paint(x_px[::-1] / self._cell, y_px[::-1] / self._cell)
        self.chances = tuple(
            float(area_share(x_px, y_px, radius, width_px=width_px, height_px=height_px).mean())
            for radius in (radius_px, radius_px * CLOSE_CELLS / CELLS)
        )
        """Chance of a hit within the radius, and within the close one."""

    def _paint(self, x: Array, y: Array) -> None:
        """Write measurements' numbers, from 1, round their places (in cells); the last owns what overlaps."""
        rows, columns = self._board.shape
        for board, reach in ((self._board, CELLS), (self._close, CLOSE_CELLS)):
            offset = np.arange(-reach - 1, reach + 2)
            down, right = (side.ravel() for side in np.meshgrid(offset, offset, indexing="ij"))
            nearest = np.maximum(np.abs(down) - 1, 0) ** 2 + np.maximum(np.abs(right) - 1, 0) ** 2
            down, right = down[nearest <= reach**2], right[nearest <= reach**2]
            row, column = y.astype(np.int64)[:, None] + down, x.astype(np.int64)[:, None] + right
            hit = (row + 0.5 - y[:, None]) ** 2 + (column + 0.5 - x[:, None]) ** 2 <= reach**2
            hit &= (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            number = np.broadcast_to((x.size - np.arange(x.size))[:, None], hit.shape)
            board[row[hit], column[hit]] = number[hit]

    def _cells(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.bool_]]:
        """Row, column and whether it is in the frame, for each predicted place; shape (n, stars)."""
        z = (w[None, :] - shift[:, None]) / turn[:, None]
        x, y = z.real, np.where(mirrored[:, None], -z.imag, z.imag)
        inside = (x > -0.5) & (x < self._width - 0.5) & (y > -0.5) & (y < self._height - 0.5)
        column = np.where(inside, x / self._cell, 0.0).astype(np.int32)
        row = np.where(inside, y / self._cell, 0.0).astype(np.int32)
        return np.maximum(row, 0), np.maximum(column, 0), inside

    def promising(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> Index:
        """Which plates hit anything beyond their own triangle among the brightest stars; shape (k,)."""
        if w.size <= FIRST_LOOK:
            return np.arange(turn.size, dtype=np.int64)
        row, column, inside = self._cells(turn, shift, mirrored, w[:FIRST_LOOK])
        hits = ((self._board[row, column] > 0) & inside).sum(axis=1)
        return np.flatnonzero(hits >= FIRST_HITS)

    def count(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[Array, Array, Array]:
        """Hits, close hits (each measurement once at most) and predictions in the frame; shape (n,) each."""
        row, column, inside = self._cells(turn, shift, mirrored, w)
        counts = [_different(np.where(inside, board[row, column], 0)) for board in (self._board, self._close)]
        return counts[0], counts[1], inside.sum(axis=1).astype(float)


def _different(owner: NDArray[np.int16]) -> Array:
    """How many different measurements stand in each row, 0 being none; shape (n,)."""
    owner.sort(axis=1)
    fresh = (owner[:, 1:] != owner[:, :-1]) & (owner[:, 1:] > 0)
    return np.asarray(fresh.sum(axis=1) + (owner[:, 0] > 0), dtype=float)
