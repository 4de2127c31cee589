"""A patch of sky fetched once: it deals out the stars of its tiles, and knows which tiles are too empty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import Catalog, Stars
from mountnav.identification.area import magnitude_for, tiles
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Index = NDArray[np.int64]


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


class Patch:
    """The stars of a search area, and its tiles, nearest first.

    Parameters
    ----------
    catalog : Catalog
    center : Icrs
    radius_deg : float
        Of the area in which the frame's center is sought.
    step_deg, tile_deg : float
        Distance of neighboring tiles, and the radius of a tile's stars.
    count : int
        The catalog is read so deep that even a poor tile has so many stars, if the catalog has them.
    epoch_yr : float
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
        self._center, self._tile_deg = center, tile_deg
        # no wider than most_tiles can cover: a hexagonal tile has the area √3/2·step²
        reach_deg = min(radius_deg, step_deg * (np.sqrt(most_tiles * np.sqrt(3.0) / 2 / np.pi) + 1.0))
        self._places = tiles(center, reach_deg, step_deg)[:most_tiles]
        axes = _axes(
            np.array([one.ra_deg for one in self._places]), np.array([one.dec_deg for one in self._places])
        )
        self._off_deg = 2.0 * np.degrees(np.arcsin(np.minimum(np.linalg.norm(axes - axes[0], axis=1) / 2, 1)))
        cone_deg = min(float(self._off_deg.max()) + tile_deg, 180.0)
        limit = magnitude_for(count, np.pi * tile_deg**2)
        self.stars: Stars = catalog.cone(center, cone_deg, epoch_yr=epoch_yr, mag_limit=limit)
        chord = 2.0 * np.sin(np.radians(tile_deg) / 2.0)
        if len(self.stars):
            tree = cKDTree(_axes(self.stars.ra_deg, self.stars.dec_deg))
            self._found = tree.query_ball_point(axes, chord, return_sorted=True)
        else:
            self._found = np.empty(len(self._places), dtype=object)
            self._found[:] = [[] for _ in self._places]

    def __len__(self) -> int:
        return len(self._places)

    def tile(self, number: int) -> Tile:
        """One of the tiles, 0 being the assumed center's."""
        return Tile(
            self._places[number],
            float(self._off_deg[number]),
            np.asarray(self._found[number], dtype=np.int64),
        )


def _axes(ra_deg: Array, dec_deg: Array) -> Array:
    return np.asarray(unit_vectors(ra_deg, dec_deg), dtype=float).T
