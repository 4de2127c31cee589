"""Which HEALPix pixels a cone may touch, in two steps: coarse ones by a table, then only their children.

astropy_healpix.cone_search_lonlat misses pixels for small cones; a padded disc of pixel centers doesn't. But
a table of all centers has 3 million rows at the level of a deep catalog. So the disc is cut out of a table of
49,152 coarse pixels. Those that lie inside as a whole give all their children, and only of those on the rim
are the children's own centers asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import COARSE_NSIDE
from mountnav.catalog.packed.pixel_centers import pixel_centers
from mountnav.catalog.space_motion import unit_vectors

Array = NDArray[np.float64]
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
    """Largest distance of a pixel's corner from its center [HEALPix, `max_pixrad`], with 1 % to spare.

    Parameters
    ----------
    nside : int
    """
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
