"""The search area: its stars, read once, and its tiles of the size of a frame, nearest first."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.star_counts import depth_for, stars_deep_enough
from mountnav.catalog.stars import Catalog, Stars
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WIDEST_FRAME_DEG = 60.0
"""No frame diagonal beyond this is tried: the tangent plane ends."""


def tiles(center: Icrs, radius_deg: float, step_deg: float) -> list[Icrs]:
    """Cover a circle on the sky with a hexagonal grid of positions, nearest first.

    Parameters
    ----------
    radius_deg : float
        Radius of the circle, at most 60.
    step_deg : float
        Distance of neighbors.

    Returns
    -------
    list of Icrs
        The center first; every point of the circle is within step/√3 of one of them.
    """
    radius = min(radius_deg, WIDEST_FRAME_DEG)
    if radius < 0.5 * step_deg:
        return [center]
    reach = int(np.ceil(radius / step_deg)) + 1
    row, column = np.mgrid[-2 * reach : 2 * reach + 1, -2 * reach : 2 * reach + 1]
    x = (column + 0.5 * row) * step_deg
    y = row * (np.sqrt(3.0) / 2) * step_deg
    distance = np.hypot(x, y).ravel()
    order = np.argsort(distance, kind="stable")
    order = order[distance[order] <= radius + step_deg / np.sqrt(3.0) - 1e-9]
    # the grid is laid out in the plane, and wrapped on the sphere along great circles from the center
    stretch = np.tan(np.radians(distance[order])) / np.radians(np.maximum(distance[order], 1e-12))
    ra, dec = gnomonic_inverse(
        np.radians(x.ravel()[order]) * stretch,
        np.radians(y.ravel()[order]) * stretch,
        center.ra_deg,
        center.dec_deg,
    )
    places = [
        Icrs(float(a) % 360.0, float(d)) for a, d in zip(np.atleast_1d(ra), np.atleast_1d(dec), strict=True)
    ]
    places[0] = center
    return places


def arcsec(value_rad: Array) -> Array:
    """Radians to arcseconds."""
    return np.asarray(value_rad, dtype=float) * ARCSEC_PER_RAD


ASKED_DIRECTLY = 8
"""So many tiles are cut out by distance; only then a tree is built, which most searches never need. It
changes time, no result."""


@dataclass(frozen=True, slots=True)
class Tile:
    """A part of the search area.

    Attributes
    ----------
    place : Icrs
        Its middle.
    off_deg : float
        How far that is from the assumed center.
    stars : ndarray of int, shape (n,)
        Its stars in the patch's list, brightest first.
    """

    place: Icrs
    off_deg: float
    stars: Index


class SearchArea:
    """The stars of a search area, and its tiles, nearest first.

    Parameters
    ----------
    radius_deg : float
        Of the area in which the frame's center is sought.
    step_deg, tile_deg : float
        Distance of neighboring tiles, and the radius of a tile's stars.
    count : int
        The catalog is read so deep that even a poor tile has so many stars, if the catalog has them.
    most_tiles : int
        The nearest so many are kept.
    """

    def __init__(
        self,
        catalog: Catalog,
        center: Icrs,
        radius_deg: float,
        step_deg: float,
        tile_deg: float,
        *,
        count: int,
        epoch_yr: float,
        most_tiles: int,
    ) -> None:
        self._center = center
        # no wider than most_tiles can cover: a hexagonal tile has the area √3/2·step²
        reach_deg = min(radius_deg, step_deg * (np.sqrt(most_tiles * np.sqrt(3.0) / 2 / np.pi) + 1.0))
        self._places = tiles(center, reach_deg, step_deg)[:most_tiles]
        axes = _axes(
            np.array([place.ra_deg for place in self._places]),
            np.array([place.dec_deg for place in self._places]),
        )
        self._off_deg = 2.0 * np.degrees(np.arcsin(np.minimum(np.linalg.norm(axes - axes[0], axis=1) / 2, 1)))
        cone_deg = min(float(self._off_deg.max()) + tile_deg, 180.0)
        limit = depth_for(catalog, center, count, np.pi * tile_deg**2)
        wanted = count * min((cone_deg / tile_deg) ** 2, 1e6)
        self.stars: Stars = stars_deep_enough(catalog, center, cone_deg, limit, wanted, epoch_yr=epoch_yr)
        self._chord = 2.0 * float(np.sin(np.radians(tile_deg) / 2.0))
        self._axes, self._star_axes = axes, _axes(self.stars.ra_deg, self.stars.dec_deg)
        self._tree: cKDTree | None = None
        self._asked = 0

    def __len__(self) -> int:
        return len(self._places)

    def tile(self, number: int) -> Tile:
        """One of the tiles, 0 being the assumed center's."""
        return Tile(self._places[number], float(self._off_deg[number]), self._within(self._axes[number]))

    def _within(self, axis: Array) -> Index:
        """Stars of the tile round an axis, brightest first."""
        self._asked += 1
        if self._asked <= ASKED_DIRECTLY:
            away = self._star_axes - axis
            return np.flatnonzero(np.einsum("ij,ij->i", away, away) <= self._chord**2)
        if self._tree is None:
            self._tree = cKDTree(self._star_axes)
        found = self._tree.query_ball_point(axis, self._chord, return_sorted=True)
        return np.asarray(found, dtype=np.int64)


def _axes(ra_deg: Array, dec_deg: Array) -> Array:
    return np.asarray(unit_vectors(ra_deg, dec_deg), dtype=float).T
