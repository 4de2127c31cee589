"""Pieces of the sky that are fetched and kept as a whole: HEALPix pixels, NESTED, of mixed levels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.online.question import Circle
from mountnav.catalog.packed.pixel_centers import pixel_centers
from mountnav.catalog.space_motion import places, unit_vectors

Array = NDArray[np.float64]

SMALLEST_LEVEL, LARGEST_LEVEL = 3, 11
"""Tiles of 7.3° to 1.7′."""
_START_LEVEL = 6
_EDGE_POINTS = 16
_PADDING_DEG = 60.0 / 3600.0
"""A tile is asked for with this margin: a server's index may hold the places of another epoch."""
_DEPTHS = ((12.5, 4), (14.5, 5), (17.0, 6))
"""To which magnitude a tile of which level holds some thousand stars at most in the Milky Way."""
_DEEPEST_LEVEL = 7
_WIDE_DEG = 0.35


@dataclass(frozen=True, slots=True, order=True)
class Tile:
    """A HEALPix pixel.

    Attributes
    ----------
    level : int
        nside is 2**level.
    pixel : int
        NESTED.
    """

    level: int
    pixel: int

    @property
    def nside(self) -> int:
        """Resolution."""
        return int(2**self.level)

    @property
    def parent(self) -> Tile:
        """The tile of the next coarser level that holds it."""
        return Tile(self.level - 1, self.pixel >> 2)

    @property
    def children(self) -> tuple[Tile, ...]:
        """The four tiles that it is split into."""
        return tuple(Tile(self.level + 1, 4 * self.pixel + one) for one in range(4))

    @property
    def area_deg2(self) -> float:
        """Square degrees."""
        return 41252.96 / (12 * self.nside**2)

    def circle(self) -> Circle:
        """A circle that holds the tile with a margin."""
        center = _center(self)
        edge = _edge(self)
        half_chord = 0.5 * float(np.sqrt(((edge - center[:, np.newaxis]) ** 2).sum(axis=0).max()))
        ra_deg, dec_deg = places(center[:, np.newaxis])
        radius_deg = 2.0 * float(np.degrees(np.arcsin(half_chord)))
        return Circle(float(ra_deg[0]), float(dec_deg[0]), radius_deg * 1.002 + _PADDING_DEG)

    def holds(self, ra_deg: Array, dec_deg: Array) -> NDArray[np.bool_]:
        """Which places lie in it, exactly: each place lies in one tile of a level."""
        from astropy import units
        from astropy_healpix import lonlat_to_healpix

        pixels = lonlat_to_healpix(ra_deg * units.deg, dec_deg * units.deg, nside=self.nside, order="nested")
        inside: NDArray[np.bool_] = np.asarray(pixels == self.pixel)
        return inside

    def touches(self, axis: Array, radius_deg: float) -> bool:
        """Whether a cone reaches into it; true for some that it misses by a 32nd of their size.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the cone's center.
        radius_deg : float
        """
        # its points stand a 16th of a side apart: no place of the edge is farther from one than half that
        slack_deg = np.degrees(1.1 * np.sqrt(4.0 * np.pi / (12 * self.nside**2)) / _EDGE_POINTS)
        chord2 = ((_edge(self) - axis[:, np.newaxis]) ** 2).sum(axis=0).min()
        if chord2 <= (2.0 * np.sin(np.radians(min(radius_deg + slack_deg, 180.0)) / 2.0)) ** 2:
            return True
        ra_deg, dec_deg = places(axis[:, np.newaxis])
        return bool(self.holds(ra_deg, dec_deg)[0])


def tiles_of(axis: Array, radius_deg: float, level: int) -> list[Tile]:
    """The tiles of a level that a cone reaches into.

    Parameters
    ----------
    axis : ndarray, shape (3,)
        Unit vector of the cone's center.
    radius_deg : float
    level : int
        `SMALLEST_LEVEL` to `LARGEST_LEVEL`.

    Returns
    -------
    list of Tile
        In rising order; none is missing.
    """
    start = min(level, _START_LEVEL)
    reach = np.radians(min(radius_deg + _largest_radius_deg(start), 180.0))
    chosen = np.flatnonzero(axis @ pixel_centers(2**start) >= np.cos(reach))
    found = [Tile(start, int(pixel)) for pixel in chosen]
    found = [tile for tile in found if tile.touches(axis, radius_deg)]
    while found and found[0].level < level:
        found = [child for tile in found for child in tile.children if child.touches(axis, radius_deg)]
    return found


def level_for(mag_limit: float | None, faintest_mag: float, radius_deg: float) -> int:
    """How large tiles are: a few thousand stars in each, and few of them for a cone.

    Parameters
    ----------
    mag_limit : float or None
        To which they are fetched.
    faintest_mag : float
        Of the table; infinite if unknown.
    radius_deg : float
        Of the cone.

    Returns
    -------
    int
        Where the sky is richer, or the table deeper, than thought, the server's overflow splits a tile.
    """
    deep = min(faintest_mag, np.inf if mag_limit is None else mag_limit)
    level = next((one for depth, one in _DEPTHS if deep <= depth), _DEEPEST_LEVEL)
    return level - 1 if radius_deg > _WIDE_DEG else level


def axis_of(ra_deg: float, dec_deg: float) -> Array:
    """Unit vector, shape (3,)."""
    return np.asarray(unit_vectors(ra_deg, dec_deg), dtype=float).reshape(3)


def _largest_radius_deg(level: int) -> float:
    # the farthest corner of a pixel is 1.13 sides from its center or nearer (HEALPix, max_pixrad)
    return float(np.degrees(1.2 * np.sqrt(4.0 * np.pi / (12 * 4**level))))


@lru_cache(maxsize=4096)
def _edge(tile: Tile) -> Array:
    """Points of its edge, shape (3, 4 * _EDGE_POINTS), as unit vectors."""
    from astropy_healpix import boundaries_lonlat

    lon, lat = boundaries_lonlat([tile.pixel], step=_EDGE_POINTS, nside=tile.nside, order="nested")
    return np.asarray(unit_vectors(lon.to_value("deg")[0], lat.to_value("deg")[0]), dtype=float)


@lru_cache(maxsize=4096)
def _center(tile: Tile) -> Array:
    from astropy_healpix import healpix_to_lonlat

    lon, lat = healpix_to_lonlat([tile.pixel], nside=tile.nside, order="nested")
    return axis_of(float(lon.to_value("deg")[0]), float(lat.to_value("deg")[0]))
