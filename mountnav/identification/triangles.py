"""Triangles of stars: their corner angles, and an index that finds the like-shaped ones [S23 §2.2]."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

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
def _triples(count: int) -> Index:
    """All index triples below `count`, those of the brightest points first; shape (C(count, 3), 3)."""
    if count < 3:
        return np.zeros((0, 3), dtype=np.int64)
    triples = np.array(list(combinations(range(count), 3)), dtype=np.int64)
    return triples[np.argsort(triples.sum(axis=1), kind="stable")]


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
    triples = _triples(int(x.size))
    px, py = x[triples], y[triples]
    # sides opposite to each corner
    sides = np.hypot(px[:, [1, 2, 0]] - px[:, [2, 0, 1]], py[:, [1, 2, 0]] - py[:, [2, 0, 1]])
    longest = sides.max(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        twice_area = np.abs(
            (px[:, 1] - px[:, 0]) * (py[:, 2] - py[:, 0]) - (px[:, 2] - px[:, 0]) * (py[:, 1] - py[:, 0])
        )
        height = twice_area / longest
        good = (sides.min(axis=1) >= min_side) & (longest <= max_side) & (height >= min_height)
    chosen = np.flatnonzero(good)[:limit]
    triples, px, py = triples[chosen], px[chosen], py[chosen]
    sides, longest = sides[chosen], longest[chosen]
    signed = np.stack(
        [
            corner_angle(px[:, i], py[:, i], px[:, j], py[:, j], px[:, k], py[:, k])
            for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
        ],
        axis=1,
    )
    order = np.argsort(-np.abs(signed), axis=1, kind="stable")
    even = (order[:, 1] - order[:, 0]) % 3 == 1  # a cyclic order keeps the turn, any other flips it
    turn = np.where(signed[:, 0] >= 0, 1, -1)
    return Triangles(
        corners=np.take_along_axis(triples, order, axis=1),
        angles_rad=np.take_along_axis(np.abs(signed), order, axis=1),
        parity=np.where(even, turn, -turn).astype(np.int64),
        log_length=np.log(longest) if len(longest) else np.zeros(0),
    )


class TriangleIndex:
    """Catalog triangles in a k-d tree over two angles and the length.

    Parameters
    ----------
    triangles : Triangles
        The catalog's; lengths in arcsec.
    angle_rad : float
        How far each angle may differ (Δγ).
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
        self._tree = cKDTree(self._place(triangles, 0.0)) if len(triangles) else None

    def _place(self, triangles: Triangles, log_scale: float) -> Array:
        return np.column_stack(
            (
                triangles.angles_rad[:, 0] / self._angle_rad,
                triangles.angles_rad[:, 2] / self._angle_rad,
                (triangles.log_length + log_scale) / self._log_width,
            )
        )

    def like(self, triangles: Triangles) -> tuple[Index, Index]:
        """Find the catalog triangles like each of the frame's.

        Parameters
        ----------
        triangles : Triangles
            The frame's; lengths in pixels.

        Returns
        -------
        frame, catalog : ndarray of int, shape (m,)
            Indices of like-shaped triangles, in the frame triangles' order.
        """
        empty = np.zeros(0, dtype=np.int64)
        if self._tree is None or len(triangles) == 0:
            return empty, empty
        places = self._place(triangles, self._log_scale)
        found = np.atleast_1d(np.asarray(self._tree.query_ball_point(places, 1.0, p=np.inf), dtype=object))
        counts = np.array([len(one) for one in found], dtype=np.int64)
        if counts.sum() == 0:
            return empty, empty
        frame = np.repeat(np.arange(len(triangles), dtype=np.int64), counts)
        catalog = np.concatenate([np.asarray(one, dtype=np.int64) for one in found if one])
        return frame, catalog
