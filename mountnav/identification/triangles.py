"""Triangles of stars: their corner angles, and an index that finds the like-shaped ones [S23 §2.2]."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, product

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
    """All index triples below `count`, those of the brightest points first; shape (C(count, 3), 3).

    And for each corner where the side opposite to it stands in a flattened table of distances.
    """
    if count < 3:
        return np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3), dtype=np.int64)
    triples = np.array(list(combinations(range(count), 3)), dtype=np.int64)
    triples = triples[np.argsort(triples.sum(axis=1), kind="stable")]
    return triples, triples[:, [1, 2, 0]] * count + triples[:, [2, 0, 1]]


def corner_angle(at_x: Array, at_y: Array, u_x: Array, u_y: Array, v_x: Array, v_y: Array) -> Array:
    """Signed angle at a corner, from the ray to `u` to the ray to `v` [S23 eq. 11-16, corrected].

    Parameters
    ----------
    at_x, at_y, u_x, u_y, v_x, v_y : ndarray, shape (n,)
        The corner and the two other points.

    Returns
    -------
    ndarray, shape (n,)
        atan2(u × v, u · v) in radians.
    """
    ax, ay, bx, by = u_x - at_x, u_y - at_y, v_x - at_x, v_y - at_y
    angle: Array = np.arctan2(ax * by - ay * bx, ax * bx + ay * by)
    return angle


def make_triangles(
    x: Array,
    y: Array,
    *,
    min_side: float,
    min_height: float,
    max_side: float = np.inf,
    limit: int | None = None,
) -> Triangles:
    """All triangles that are large enough [S23 eq. 9, 10], those of the brightest points first.

    Parameters
    ----------
    x, y : ndarray, shape (n,)
        Points, brightest first.
    min_side, min_height, max_side : float
        Least side, least height over the longest side, longest side; in the points' unit.
    limit : int, optional
        Keep this many.

    Returns
    -------
    Triangles
    """
    count = int(x.size)
    triples, opposite = _triples(count)
    place = x + 1j * y
    length = np.abs(place[:, None] - place[None, :]).ravel()
    # sides opposite to each corner: looked up, since each pair belongs to many triangles
    fits = (length >= min_side) & (length <= max_side)
    chosen = np.flatnonzero(fits[opposite[:, 0]] & fits[opposite[:, 1]] & fits[opposite[:, 2]])
    triples, sides = triples[chosen], length[opposite[chosen]]
    order = np.argsort(-sides, axis=1, kind="stable")  # the largest angle faces the longest side
    corners, sides = np.take_along_axis(triples, order, axis=1), np.take_along_axis(sides, order, axis=1)
    a, b, c = (place[corners[:, number]] for number in range(3))
    twice_area = ((b - a).conj() * (c - a)).imag
    with np.errstate(divide="ignore", invalid="ignore"):
        high = np.flatnonzero(np.abs(twice_area) / sides[:, 0] >= min_height)[:limit]
    corners, sides, twice_area = corners[high], sides[high], twice_area[high]
    a, b, c = a[high], b[high], c[high]
    angles = np.abs(
        np.stack(
            [
                corner_angle(at.real, at.imag, to.real, to.imag, off.real, off.imag)
                for at, to, off in ((a, b, c), (b, c, a), (c, a, b))
            ],
            axis=1,
        )
    )
    return Triangles(
        corners=corners,
        angles_rad=angles,
        parity=np.where(twice_area >= 0, 1, -1).astype(np.int64),
        log_length=np.log(sides[:, 0]),
    )


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
        place = self._place(triangles, self._log_scale)
        self._tree = cKDTree(place)
        cell = np.floor(place).astype(np.int64)
        self._low = cell.min(axis=0) - 1
        self._shape = cell.max(axis=0) - self._low + 2
        self._near = np.zeros(self._shape, dtype=bool)
        for a, b, c in product((-1, 0, 1), repeat=3):  # a cell is as wide as the tolerance
            at = cell - self._low + np.array((a, b, c))
            self._near[at[:, 0], at[:, 1], at[:, 2]] = True

    def _place(self, triangles: Triangles, log_scale: float) -> Array:
        return np.column_stack(
            (
                triangles.angles_rad[:, 0] / self._angle_rad,
                triangles.angles_rad[:, 2] / self._angle_rad,
                (triangles.log_length + log_scale) / self._log_width,
            )
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
        cell = np.floor(place).astype(np.int64) - self._low
        inside = np.flatnonzero(np.all((cell >= 0) & (cell < self._shape), axis=1))
        cell = cell[inside]
        likely = inside[self._near[cell[:, 0], cell[:, 1], cell[:, 2]]]
        if likely.size == 0:
            return empty, empty
        found = self._tree.query_ball_point(place[likely], 1.0, p=np.inf)
        counts = np.array([len(one) for one in found], dtype=np.int64)
        if counts.sum() == 0:
            return empty, empty
        catalog = np.repeat(likely, counts)
        frame = np.concatenate([np.asarray(one, dtype=np.int64) for one in found if one])
        # two angles within Δγ leave the third free to differ by 2 Δγ
        third = np.abs(self._triangles.angles_rad[frame, 1] - triangles.angles_rad[catalog, 1])
        alike = np.flatnonzero(third <= self._angle_rad)
        order = alike[np.argsort(frame[alike], kind="stable")]
        return frame[order], catalog[order]
