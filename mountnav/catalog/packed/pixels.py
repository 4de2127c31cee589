"""HEALPix pixels of a packed file: their centers, those a cone touches, and the sky that they cover.

Centers of the HEALPix pixels: from a table that lies beside the catalog, else from astropy-healpix.

Importing astropy-healpix brings all of astropy's units and coordinates: 0.28 s of CPU for 49,152 directions
that never change. So `tools/build_pixel_centers.py` asks it once, and what it said is mapped in 0.4 ms.

Which HEALPix pixels a cone may touch, in two steps: coarse ones by a table, then only their children.

astropy_healpix.cone_search_lonlat misses pixels for small cones; a padded disc of pixel centers doesn't. But
a table of all centers has 3 million rows at the level of a deep catalog. So the disc is cut out of a table of
49,152 coarse pixels. Those that lie inside as a whole give all their children, and only of those on the rim
are the children's own centers asked for.

Which part of the sky a packed file covers, by its table of pixels alone.

A file doesn't say where its stars were taken from. But a pixel in which dozens of stars are to be expected,
and in which there is none, wasn't covered. So the sky is cut into pixels just large enough for that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import COARSE_NSIDE
from mountnav.catalog.space_motion import unit_vectors

Array = NDArray[np.float64]

TABLE_NSIDE = 64
"""Division whose 49,152 centers lie in a file beside the catalog (1.2 MB), so that cones need no
astropy-healpix: that of `format.COARSE_NSIDE`."""
TABLE_PATH = Path(__file__).parent.parent / "data" / f"healpix_centers_{TABLE_NSIDE}.npy"


def pixel_centers(nside: int) -> Array:
    """Directions of all pixel centers, nested order.

    Parameters
    ----------
    nside : int
        A power of two.

    Returns
    -------
    ndarray, shape (3, 12 nside²)
        Unit vectors (ICRS). Read-only where they come from the table.
    """
    if nside == TABLE_NSIDE:
        try:
            table: Array = np.load(TABLE_PATH, mmap_mode="r", allow_pickle=False)
        except (OSError, EOFError, ValueError):  # not built, or cut short: the library knows as well
            pass
        else:
            if table.shape == (3, 12 * nside**2) and table.dtype == np.float64:
                return table.view(np.ndarray)
    return computed_centers(nside)


def computed_centers(nside: int) -> Array:
    """Ask astropy-healpix; parameters and result as for `pixel_centers`."""
    from astropy import units
    from astropy_healpix import healpix_to_lonlat

    lon, lat = healpix_to_lonlat(np.arange(12 * nside**2), nside=nside, order="nested")
    ra, dec = lon.to_value(units.rad), lat.to_value(units.rad)
    centers: Array = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    return centers


Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Runs:
    """Whole numbers as runs: first[k] to end[k] - 1, rising, none touching the next.

    Attributes
    ----------
    first, end
        Shape (n,).
    """

    first: Indices
    end: Indices

    @classmethod
    def of(cls, numbers: Indices) -> Runs:
        """From rising numbers."""
        if numbers.size == 0:
            return cls(numbers, numbers)
        breaks = np.flatnonzero(np.diff(numbers) != 1)
        return cls(
            np.concatenate((numbers[:1], numbers[breaks + 1])),
            np.concatenate((numbers[breaks], numbers[-1:])) + 1,
        )

    def all(self) -> Indices:
        """Each number."""
        counts = self.end - self.first
        before = np.cumsum(counts) - counts
        numbers: Indices = np.repeat(self.first - before, counts) + np.arange(int(counts.sum()))
        return numbers


class PixelChoice:
    """Chooses pixels of one resolution.

    Parameters
    ----------
    nside : int
        A power of two; NESTED.
    """

    def __init__(self, nside: int) -> None:
        self.nside = nside
        coarse = min(nside, COARSE_NSIDE)
        self._children = (nside // coarse) ** 2
        self._centers = pixel_centers(coarse)
        self._coarse_radius_rad = largest_pixel_radius_rad(coarse)
        self._radius_rad = largest_pixel_radius_rad(nside)

    def near(self, axis: Array, reach_rad: float) -> Runs:
        """Pixels that may hold a point of a cone; some that don't are among them, none is missing.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the center.
        reach_rad : float
            Radius of the cone.

        Returns
        -------
        Runs
            Of pixel numbers.
        """
        near_rad = reach_rad + self._coarse_radius_rad
        if near_rad >= np.pi:
            return Runs(np.array([0]), np.array([12 * self.nside**2]))
        cosine = axis @ self._centers
        if self._children == 1:
            return Runs.of(np.flatnonzero(cosine >= np.cos(near_rad)))
        chosen = np.flatnonzero(cosine >= np.cos(near_rad))
        whole_rad = reach_rad + self._radius_rad - self._coarse_radius_rad
        if whole_rad > 0.0:
            is_whole = cosine[chosen] >= np.cos(whole_rad)
        else:
            is_whole = np.zeros(chosen.size, dtype=bool)
        rim = self._near_children(axis, reach_rad, chosen[~is_whole])
        whole = chosen[is_whole]
        first = np.concatenate((rim.first, whole * self._children))
        end = np.concatenate((rim.end, (whole + 1) * self._children))
        order = np.argsort(first)
        return _joined(first[order], end[order])

    def _near_children(self, axis: Array, reach_rad: float, parents: Indices) -> Runs:
        # imported here: a catalog of the coarse resolution never needs it
        from astropy_healpix import healpix_to_xyz

        children = (parents[:, np.newaxis] * self._children + np.arange(self._children)).ravel()
        x, y, z = healpix_to_xyz(children, nside=self.nside, order="nested")
        cosine = axis[0] * x + axis[1] * y + axis[2] * z
        return Runs.of(children[cosine >= np.cos(reach_rad + self._radius_rad)])


def largest_pixel_radius_rad(nside: int) -> float:
    """Largest distance of a pixel's corner from its center [HEALPix, `max_pixrad`], with 1 % to spare."""
    center_z, corner_z = 2.0 / 3.0, 1.0 - (1.0 - 1.0 / nside) ** 2 / 3.0
    center = unit_vectors(45.0 / nside, float(np.degrees(np.arcsin(center_z))))
    corner = unit_vectors(0.0, float(np.degrees(np.arcsin(corner_z))))
    return 1.01 * float(2.0 * np.arcsin(np.linalg.norm(center - corner) / 2.0))


def _joined(first: Indices, end: Indices) -> Runs:
    """Put runs that touch into one; rising, none overlapping."""
    if first.size == 0:
        return Runs(first, end)
    apart = np.flatnonzero(first[1:] != end[:-1])
    return Runs(first[np.concatenate(([0], apart + 1))], end[np.concatenate((apart, [first.size - 1]))])


TYPICAL_STARS = 64
"""In half of the pixels at least so many: at the galactic poles, with a fifth to an eighth of that, an empty
one is still a rare accident."""
SMALL_SHARE = 0.05
"""A file of less of the sky is looked at with finer pixels: its border matters more."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """The pixels that hold stars.

    Attributes
    ----------
    nside
        Of the pixels, NESTED.
    occupied
        Their numbers, rising; shape (n,).
    cap
        Direction and radius (radians) of a circle that holds all stars, if it is smaller than the pixels are
        together; and the radius of what is surely covered, since neither the middle nor the border is known
        better than the stars are dense.
    """

    nside: int
    occupied: Indices
    cap: tuple[Array, float, float] | None = None

    def within(self, vectors: Array) -> Coverage:
        """Take a closer look at a catalog that may be one small piece of the sky.

        Parameters
        ----------
        vectors : ndarray, shape (3, n)
            Of all stars.
        """
        axis = vectors.mean(axis=1)
        length = float(np.sqrt((axis**2).sum()))
        if length < 0.1:
            return self
        axis = axis / length
        chord = float(np.sqrt(((vectors - axis[:, np.newaxis]) ** 2).sum(axis=0).max()))
        radius_rad = 2.0 * float(np.arcsin(min(0.5 * chord, 1.0)))
        if _cap_share(radius_rad) >= self.share():
            return self
        sure_rad = radius_rad * max(1.0 - 3.0 / np.sqrt(vectors.shape[1]), 0.0)
        return replace(self, cap=(axis, radius_rad, sure_rad))

    @classmethod
    def of(cls, offsets: NDArray[np.uint32], nside: int, coarse: NDArray[np.uint32]) -> Coverage:
        """From the tables of a packed file.

        Parameters
        ----------
        offsets : ndarray, shape (12 nside² + 1,)
            First star of each pixel, and the count; read only where a fine look pays.
        coarse : ndarray
            The same at min(nside, 64).
        """
        counts = np.diff(coarse.astype(np.int64))
        at = min(nside, COARSE_NSIDE)
        while at > 1 and np.median(counts[counts > 0]) < TYPICAL_STARS:
            counts, at = counts.reshape(-1, 4).sum(axis=1), at // 2
        found = cls(at, np.flatnonzero(counts))
        if at < COARSE_NSIDE or nside == at or found.share() > SMALL_SHARE:
            return found
        while at < nside:
            finer = _children_with_stars(offsets, nside, found)
            if finer is None:
                break
            found, at = finer, at * 2
        return found

    def share(self) -> float:
        """Of the sky, 0 to 1."""
        if self.cap is not None:
            return _cap_share(self.cap[1])
        return self.occupied.size / (12 * self.nside**2)

    def holds(self, axis: Array, radius_rad: float) -> bool:
        """Whether a whole cone is covered; said only if all pixels around it are, too.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the center.
        """
        if self.occupied.size == 12 * self.nside**2:
            return True
        if self.cap is not None:
            middle, _, reach_rad = self.cap
            off_rad = 2.0 * float(np.arcsin(min(0.5 * float(np.sqrt(((axis - middle) ** 2).sum())), 1.0)))
            return off_rad + radius_rad <= reach_rad
        # a pixel on the border may hold stars in a corner only
        margin_rad = 2.0 * largest_pixel_radius_rad(self.nside)
        wanted = PixelChoice(self.nside).near(axis, radius_rad + margin_rad)
        there = np.searchsorted(self.occupied, wanted.end) - np.searchsorted(self.occupied, wanted.first)
        return bool(np.all(there == wanted.end - wanted.first))


def _cap_share(radius_rad: float) -> float:
    return 0.5 * (1.0 - float(np.cos(radius_rad)))


def _children_with_stars(offsets: NDArray[np.uint32], nside: int, parents: Coverage) -> Coverage | None:
    """One step finer, or None if the pixels would be too small for the density of the stars."""
    finer = parents.nside * 2
    pixels = (parents.occupied[:, np.newaxis] * 4 + np.arange(4)).ravel()
    own = (nside // finer) ** 2
    counts = offsets[(pixels + 1) * own].astype(np.int64) - offsets[pixels * own].astype(np.int64)
    if np.median(counts[counts > 0]) < TYPICAL_STARS:
        return None
    return Coverage(finer, pixels[counts > 0])
