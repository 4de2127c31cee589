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


_CLOSE_BITS, _FAR = 16, 0xFFFF
"""A cell's word: the owner within the close radius above these bits, the one within the radius below."""


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
        self._board = np.zeros((rows, columns), dtype=np.int32)
        self._paint(x_px[::-1] / self._cell, y_px[::-1] / self._cell)
        self.chances = tuple(
            float(area_share(x_px, y_px, radius, width_px=width_px, height_px=height_px).mean())
            for radius in (radius_px, radius_px * CLOSE_CELLS / CELLS)
        )
        """Chance of a hit within the radius, and within the close one."""

    def _paint(self, x: Array, y: Array) -> None:
        """Write measurements' numbers, from 1, round their places (in cells); the last owns what overlaps."""
        rows, columns = self._board.shape
        for reach, bits in ((CELLS, 0), (CLOSE_CELLS, _CLOSE_BITS)):
            offset = np.arange(-reach - 1, reach + 2)
            down, right = (side.ravel() for side in np.meshgrid(offset, offset, indexing="ij"))
            nearest = np.maximum(np.abs(down) - 1, 0) ** 2 + np.maximum(np.abs(right) - 1, 0) ** 2
            down, right = down[nearest <= reach**2], right[nearest <= reach**2]
            row, column = y.astype(np.int64)[:, None] + down, x.astype(np.int64)[:, None] + right
            hit = (row + 0.5 - y[:, None]) ** 2 + (column + 0.5 - x[:, None]) ** 2 <= reach**2
            hit &= (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
            number = np.broadcast_to((x.size - np.arange(x.size))[:, None], hit.shape)[hit]
            row, column = row[hit], column[hit]
            below = self._board[row, column] & _FAR if bits else 0
            self._board[row, column] = below | (number << bits)

    def _owners(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """What each predicted place's cell holds, and whether it is in the frame; shape (n, stars) each."""
        back = 1.0 / turn
        start = -shift * back
        sign = np.where(mirrored, -1.0, 1.0)
        along = np.stack((w.real, w.imag, np.ones(w.size))).astype(np.float32)
        # in cells; single precision is a thousandth of a pixel
        to_x = np.stack((back.real, -back.imag, start.real), axis=1) / self._cell
        to_y = np.stack((back.imag, back.real, start.imag), axis=1) * (sign / self._cell)[:, None]
        x, y = to_x.astype(np.float32) @ along, to_y.astype(np.float32) @ along
        least, right, high = (
            np.float32(one / self._cell) for one in (-0.5, self._width - 0.5, self._height - 0.5)
        )
        inside = (x > least) & (x < right)
        inside &= y > least
        inside &= y < high
        # what isn't in the frame is asked for in the corner, and left out
        x *= inside
        y *= inside
        flat = y.astype(np.int32)
        flat *= self._board.shape[1]
        flat += x.astype(np.int32)
        return self._board.ravel().take(flat) * inside, inside

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
        owners, _ = self._owners(turn, shift, mirrored, w[:FIRST_LOOK])
        return np.flatnonzero(np.count_nonzero(owners, axis=1) >= FIRST_HITS)

    def count(
        self,
        turn: NDArray[np.complex128],
        shift: NDArray[np.complex128],
        mirrored: NDArray[np.bool_],
        w: NDArray[np.complex128],
    ) -> tuple[Array, Array, Array]:
        """Hits, close hits (each measurement once at most) and predictions in the frame; shape (n,) each."""
        owners, inside = self._owners(turn, shift, mirrored, w)
        far, close = (owners & _FAR).astype(np.int16), (owners >> _CLOSE_BITS).astype(np.int16)
        return _different(far), _different(close), np.count_nonzero(inside, axis=1).astype(float)


def _different(owner: NDArray[np.int16]) -> Array:
    """How many different measurements stand in each row, 0 being none; shape (n,)."""
    owner.sort(axis=1)
    fresh = (owner[:, 1:] != owner[:, :-1]) & (owner[:, 1:] > 0)
    return np.asarray(fresh.sum(axis=1) + (owner[:, 0] > 0), dtype=float)
