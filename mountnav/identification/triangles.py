"""Triangles of stars: their corner angles, and an index that finds the like-shaped ones [S23 §2.2]."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

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


@lru_cache(maxsize=16)
def _triples(count: int) -> tuple[Index, Index]:
    """All index triples below `count`, those of the brightest points first; shape (3, C(count, 3)).

    And for each corner where the side opposite to it stands in a flattened table of distances.
    """
    if count < 3:
        return np.zeros((3, 0), dtype=np.int64), np.zeros((3, 0), dtype=np.int64)
    first, second = np.triu_indices(count, 1)
    left = count - 1 - second
    third = np.arange(left.sum()) - np.repeat(np.cumsum(left) - left - second - 1, left)
    triples = np.stack((np.repeat(first, left), np.repeat(second, left), third))
    triples = triples[:, np.argsort(triples.sum(axis=0), kind="stable")]
    return triples, triples[[1, 2, 0]] * count + triples[[2, 0, 1]]


def make_triangles(
    x: Array,
    y: Array,
    *,
    min_side: float,
    min_height: float,
    max_side: float = np.inf,
    min_longest: float = 0.0,
    limit: int | None = None,
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

    Returns
    -------
    Triangles
    """
    count = int(x.size)
    triples, opposite = _triples(count)
    length2 = ((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2).ravel()
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
    corners, sides = [one.take(chosen[high]) for one in triples], [one[high] for one in sides]
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


def _by_side(corners: list[Index], sides: list[Array], twice_area: Array) -> Index:
    """Order corners by the opposite side, the longest first, in place; tell which way they turn then."""
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


class TriangleIndex:
    """The frame's triangles in a k-d tree over two angles and the length, behind a coarse raster of the same.

    A catalog has many times more triangles than a frame; most of them fall in empty cells of the raster and
    never come to the tree.

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
        self._tree = None
        if len(triangles) == 0:
            return
        place = np.stack(self._place(triangles, self._log_scale), axis=1)
        self._tree = cKDTree(place)
        cell = np.floor(place).astype(np.int64)
        self._low = cell.min(axis=0) - 1
        self._shape = cell.max(axis=0) - self._low + 2
        self._near = np.zeros(self._shape, dtype=bool)
        for a, b, c in product((-1, 0, 1), repeat=3):  # a cell is as wide as the tolerance
            at = cell - self._low + np.array((a, b, c))
            self._near[at[:, 0], at[:, 1], at[:, 2]] = True

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

    def like(self, triangles: Triangles) -> tuple[Index, Index]:
        """Find the frame's triangles like each of the catalog's.

        Parameters
        ----------
        triangles : Triangles
            The catalog's; lengths in arcsec.

        Returns
        -------
        frame, catalog : ndarray of int, shape (m,)
            Indices of like-shaped triangles, in the frame triangles' order: the brightest first.
        """
        empty = np.zeros(0, dtype=np.int64)
        if self._tree is None or len(triangles) == 0:
            return empty, empty
        place = self._place(triangles, 0.0)
        inside = np.ones(len(triangles), dtype=bool)
        cells = []
        for one, low, count in zip(place, self._low, self._shape, strict=True):
            cell = np.floor(one).astype(np.int64) - low
            inside &= (cell >= 0) & (cell < count)
            cells.append(cell)
        chosen = np.flatnonzero(inside)
        likely = chosen[self._near[cells[0][chosen], cells[1][chosen], cells[2][chosen]]]
        if likely.size == 0:
            return empty, empty
        found = self._tree.sparse_distance_matrix(
            cKDTree(np.stack([one[likely] for one in place], axis=1)), 1.0, p=np.inf, output_type="ndarray"
        )
        frame, catalog = found["i"].astype(np.int64), likely[found["j"]]
        # two angles within Δγ leave the third free to differ by 2 Δγ
        third = np.abs(self._triangles.angles_rad[frame, 1] - triangles.angles_rad[catalog, 1])
        alike = np.flatnonzero(third <= self._angle_rad)
        order = alike[np.lexsort((catalog[alike], frame[alike]))]
        return frame[order], catalog[order]
