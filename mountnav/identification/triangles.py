"""Triangles of stars: their corner angles, and an index that finds the like-shaped ones [S23 §2.2]."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Triangles:
    """Triangles over a list of points.

    Attributes
    ----------
    corners : ndarray of int, shape (n, 3)
        Point indices, corner of the largest angle first, of the smallest last.
    angles_rad : ndarray, shape (n, 3)
        Unsigned corner angles in the same order.
    parity : ndarray of int, shape (n,)
        Sign of the turn along the corners: a mirrored image flips it.
    log_length : ndarray, shape (n,)
        Natural logarithm of the longest side, in the points' unit.
    """

    corners: Index
    angles_rad: Array
    parity: Index
    log_length: Array

    def __len__(self) -> int:
        return int(self.corners.shape[0])


FEW_POINTS = 50
"""Tables of triples are kept for every number of points up to this, 12 MB in all: tiles of poor fields have
each another. Doubled, 200 MB."""


def _triples(count: int) -> tuple[Index, Index]:
    """All index triples below `count`, those of the brightest points first; shape (3, C(count, 3)).

    And for each corner where the side opposite to it stands in a flattened table of distances.
    """
    return _triples_of_few(count) if count <= FEW_POINTS else _triples_of_many(count)


@lru_cache(maxsize=FEW_POINTS + 1)
def _triples_of_few(count: int) -> tuple[Index, Index]:
    return _made_triples(count)


@lru_cache(maxsize=16)
def _triples_of_many(count: int) -> tuple[Index, Index]:
    return _made_triples(count)


def _made_triples(count: int) -> tuple[Index, Index]:
    if count < 3:
        return np.zeros((3, 0), dtype=np.int64), np.zeros((3, 0), dtype=np.int64)
    first, second = np.triu_indices(count, 1)
    left = count - 1 - second
    third = np.arange(left.sum()) - np.repeat(np.cumsum(left) - left - second - 1, left)
    triples = np.stack((np.repeat(first, left), np.repeat(second, left), third))
    triples = triples[:, np.argsort(triples.sum(axis=0), kind="stable")]
    return triples, triples[[1, 2, 0]] * count + triples[[2, 0, 1]]


def _tables(x: Array, y: Array, lists: Sequence[int] | None) -> tuple[Array, Index, Index]:
    """Squared distances within each list of points, one table after the other; and triples of all lists."""
    if lists is None or len(lists) == 1:
        triples, opposite = _triples(int(x.size))
        return ((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2).ravel(), triples, opposite
    tables, triples_of, opposite_of = [], [], []
    point = place = 0
    for count in lists:
        here_x, here_y = x[point : point + count], y[point : point + count]
        tables.append(((here_x[:, None] - here_x) ** 2 + (here_y[:, None] - here_y) ** 2).ravel())
        triples, opposite = _triples(count)
        triples_of.append(triples + point)
        opposite_of.append(opposite + place)
        point, place = point + count, place + count * count
    return np.concatenate(tables), np.concatenate(triples_of, axis=1), np.concatenate(opposite_of, axis=1)


def make_triangles(
    x: Array,
    y: Array,
    *,
    min_side: float,
    min_height: float,
    max_side: float = np.inf,
    min_longest: float = 0.0,
    limit: int | None = None,
    wanted: Callable[[Array, Array, Array], NDArray[np.bool_]] | None = None,
    lists: Sequence[int] | None = None,
) -> Triangles:
    """All triangles that are large enough [S23 eq. 9, 10], those of the brightest points first.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Points, brightest first.
    min_side, min_height, max_side, min_longest : float
        Least side, least height over the longest side, bounds of the longest side; in the points' unit.
    limit : int, optional
        Keep this many.
    wanted : callable, optional
        Tells by largest angle, smallest angle and logarithm of the longest side which triangles are of use:
        most of a catalog's are not, and to order their corners costs more than to look them up.
    lists : sequence of int, optional
        The points are several lists, one after the other, of so many points each: no triangle has corners of
        two lists, and all of one list come before those of the next.
    """
    length2, triples, opposite = _tables(x, y, lists)
    # sides opposite to each corner: looked up, since each pair belongs to many triangles
    fits = (length2 >= min_side**2) & (length2 <= max_side**2)
    fit = [fits.take(side) for side in opposite]
    chosen = np.flatnonzero(fit[0] & fit[1] & fit[2])
    sides = [length2.take(side.take(chosen)) for side in opposite]
    longest = np.maximum(np.maximum(sides[0], sides[1]), sides[2])
    # Heron: four times the area, squared
    squared = 4.0 * sides[0] * sides[1] - (sides[0] + sides[1] - sides[2]) ** 2
    high = (squared >= 4.0 * min_height**2 * longest) & (longest >= min_longest**2) & (longest > 0)
    high = np.flatnonzero(high)[:limit]
    if wanted is not None:
        high = high[wanted(*_shape([side[high] for side in sides], squared[high]))]
    corners, sides = [corner.take(chosen[high]) for corner in triples], [side[high] for side in sides]
    a, b, c = corners
    twice_area = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
    parity = _by_side(corners, sides, twice_area)
    # u · v at a corner is half of what the squares of its sides exceed that of the opposite one by
    cross = np.abs(twice_area)
    first = np.arctan2(cross, 0.5 * (sides[1] + sides[2] - sides[0]))
    last = np.arctan2(cross, 0.5 * (sides[0] + sides[1] - sides[2]))
    return Triangles(
        corners=np.stack(corners).T,
        angles_rad=np.stack((first, np.pi - first - last, last)).T,
        parity=parity,
        log_length=0.5 * np.log(sides[0]),
    )


def _shape(sides: list[Array], squared: Array) -> tuple[Array, Array, Array]:
    """Largest angle, smallest angle, logarithm of the longest side; of squared sides and of (4·area)²."""
    a, b, c = sides
    low, high = np.minimum(a, b), np.maximum(a, b)
    longest, rest = np.maximum(high, c), np.minimum(high, c)
    shortest, middle = np.minimum(low, rest), np.maximum(low, rest)
    cross = np.sqrt(squared)
    return (
        np.arctan2(cross, middle + shortest - longest),
        np.arctan2(cross, longest + middle - shortest),
        0.5 * np.log(longest),
    )


def _by_side(corners: list[Index], sides: list[Array], twice_area: Array) -> Index:
    """Order corners by the opposite side, the longest first, in place; returns which way they turn then."""
    parity = np.where(twice_area >= 0, 1, -1)
    for one, other in ((0, 1), (1, 2), (0, 1)):
        swap = sides[other] > sides[one]
        for part in (corners, sides):
            part[one], part[other] = (
                np.where(swap, part[other], part[one]),
                np.where(swap, part[one], part[other]),
            )
        parity = np.where(swap, -parity, parity)
    return parity.astype(np.int64)


_MOST_CELLS = 100_000_000
"""Cells of the table that says where triangles like the frame's may lie, a byte each. The defaults take 20
million; doubled, a narrow tolerance takes twice the memory; halved, more triangles are looked up in vain."""


_MOST_PAIRS = 400_000
"""Pairs of triangles compared at once: some 30 MB. Doubled, twice that for nothing; a tenth costs time."""


class TriangleIndex:
    """The frame's triangles in a raster over two angles and the length, in cells as wide as the tolerance.

    A catalog has many times more triangles than a frame; most of them fall in cells that have no frame's
    triangle near, and are left out at once. The others are compared with those in and beside their cell.

    Parameters
    ----------
    triangles : Triangles
        The frame's; lengths in pixels.
    angle_rad : float
        How far each of the three corner angles may differ (Δγ).
    scale_low, scale_high : float
        Bounds of the scale, arcsec per pixel.
    """

    def __init__(
        self, triangles: Triangles, *, angle_rad: float, scale_low: float, scale_high: float
    ) -> None:
        self._triangles = triangles
        self._angle_rad = angle_rad
        self._log_scale = 0.5 * (np.log(scale_low) + np.log(scale_high))
        # a bound known exactly still has the width of the angles' tolerance
        self._log_width = 0.5 * (np.log(scale_high) - np.log(scale_low)) + 0.5 * angle_rad
        self._cell = 1.0
        if len(triangles) == 0:
            return
        place = np.stack(self._place(triangles, self._log_scale), axis=1)
        self._places = place
        # a cell is as wide as the tolerance, or wider where so many would take too much memory
        tolerances = np.ptp(place, axis=0) + 3.0
        self._cell = max(1.0, float(np.prod(tolerances) / _MOST_CELLS) ** (1.0 / 3.0))
        cell = np.floor(place / self._cell).astype(np.int64)
        # the rim stays empty: what lies beyond is looked up there
        self._low = cell.min(axis=0) - 2
        self._shape = cell.max(axis=0) - self._low + 3
        self._near = np.zeros(self._shape, dtype=bool)
        beside = np.array(list(product((-1, 0, 1), repeat=3)))
        at = np.ravel_multi_index(
            tuple(((cell - self._low)[None, :, :] + beside[:, None, :]).reshape(-1, 3).T), self._shape
        )
        self._near.reshape(-1)[at] = True
        # which triangles are in or beside a cell, cell after cell
        order = np.argsort(at, kind="stable")
        self._owner = order % len(triangles)
        self._filled, self._first = np.unique(at[order], return_index=True)
        self._held = np.diff(np.append(self._first, order.size))

    def length_bounds(self) -> tuple[float, float]:
        """Between which lengths (arcsec) the longest side of a catalog triangle like any here must lie."""
        length = self._triangles.log_length
        if length.size == 0:
            return 0.0, 0.0
        least, most = float(length.min()), float(length.max())
        return (
            float(np.exp(least + self._log_scale - self._log_width)),
            float(np.exp(most + self._log_scale + self._log_width)),
        )

    def _place(self, triangles: Triangles, log_scale: float) -> tuple[Array, Array, Array]:
        """Largest and smallest angle and length, in tolerances."""
        return (
            triangles.angles_rad[:, 0] / self._angle_rad,
            triangles.angles_rad[:, 2] / self._angle_rad,
            (triangles.log_length + log_scale) / self._log_width,
        )

    def may_hold(self, largest_rad: Array, smallest_rad: Array, log_length: Array) -> NDArray[np.bool_]:
        """Tell which triangles may be like one here, and which surely aren't.

        Parameters
        ----------
        largest_rad, smallest_rad : ndarray, shape (n,)
            Angles.
        log_length : ndarray, shape (n,)
            Natural logarithm of the longest side, arcsec.

        Returns
        -------
        ndarray of bool, shape (n,)
            False: surely none is like it.
        """
        if not len(self._triangles):
            return np.zeros(log_length.size, dtype=bool)
        place = largest_rad / self._angle_rad, smallest_rad / self._angle_rad, log_length / self._log_width
        return np.asarray(self._near.take(self._cells(place)))

    def _cells(self, place: tuple[Array, Array, Array]) -> NDArray[np.int32]:
        """Where the raster has each triangle, in one number; what lies beyond is at its rim: empty."""
        flat = np.zeros(place[0].size, dtype=np.int32)
        for one, low, count in zip(place, self._low.tolist(), self._shape.tolist(), strict=True):
            cell = one * (1.0 / self._cell)
            cell -= low
            np.clip(cell, 0.0, count - 1.0, out=cell)
            flat *= count
            flat += cell.astype(np.int32)
        return flat

    def like(self, triangles: Triangles, list_of: Index | None = None) -> tuple[Index, Index]:
        """Find the frame's triangles like each of the catalog's.

        Parameters
        ----------
        triangles : Triangles
            The catalog's; lengths in arcsec.
        list_of : ndarray of int, shape (n,), optional
            From which list of points each triangle is.

        Returns
        -------
        frame, catalog : ndarray of int, shape (m,)
            Indices of like-shaped triangles, list after list, and within a list in the frame triangles'
            order: the brightest first.
        """
        empty = np.zeros(0, dtype=np.int64)
        if not len(self._triangles) or len(triangles) == 0:
            return empty, empty
        place = self._place(triangles, 0.0)
        cells = self._cells(place)
        likely = np.flatnonzero(self._near.take(cells))
        if likely.size == 0:
            return empty, empty
        slot = np.searchsorted(self._filled, cells[likely])
        until = np.cumsum(self._held[slot])
        parts = np.searchsorted(until, np.arange(_MOST_PAIRS, int(until[-1]), _MOST_PAIRS))
        found = [
            self._alike(place, likely[part], slot[part])
            for part in np.split(np.arange(likely.size), parts)
            if part.size
        ]
        frame = np.concatenate([frame_part for frame_part, _ in found])
        catalog = np.concatenate([other for _, other in found])
        # two angles within Δγ leave the third free to differ by 2 Δγ
        third = np.abs(self._triangles.angles_rad[frame, 1] - triangles.angles_rad[catalog, 1])
        alike = np.flatnonzero(third <= self._angle_rad)
        keys = (catalog[alike], frame[alike])
        order = alike[np.lexsort(keys if list_of is None else (*keys, list_of[keys[0]]))]
        return frame[order], catalog[order]

    def _alike(self, place: tuple[Array, Array, Array], catalog: Index, slot: Index) -> tuple[Index, Index]:
        """Which of the triangles held by these cells are within the tolerance of those that fell there."""
        held = self._held[slot]
        begin = np.repeat(self._first[slot] - (np.cumsum(held) - held), held)
        frame = self._owner[begin + np.arange(begin.size)]
        catalog = np.repeat(catalog, held)
        near = np.ones(frame.size, dtype=bool)
        for axis, there in enumerate(place):
            near &= np.abs(self._places[:, axis][frame] - there[catalog]) <= 1.0
        return frame[near], catalog[near]
