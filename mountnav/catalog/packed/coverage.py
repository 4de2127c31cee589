"""Which part of the sky a packed file covers, told by its table of pixels alone.

A file doesn't say where its stars were taken from. But a pixel in which dozens of stars are to be expected,
and in which there is none, wasn't covered. So the sky is cut into pixels just large enough for that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import COARSE_NSIDE
from mountnav.catalog.packed.pixel_choice import PixelChoice, largest_pixel_radius_rad

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

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
        nside : int
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
        """Whether a whole cone is covered; said only if all pixels round it are, too.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the center.
        radius_rad : float
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
