"""A sky that differs from its catalog as the real one does: each star off by its own stated error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from mountnav.catalog.space_motion import motion_vectors, places, unit_vectors
from mountnav.catalog.stars import Catalog, Stars
from mountnav.simulation.seeded_random import mixed
from mountnav.sky.coordinates import Icrs
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]
Bits = NDArray[np.uint64]

# Size of the cells that a star's identity is made from, rad (0.1″): stars closer together with one
# magnitude share their error.
_CELL_RAD = 0.1 / ARCSEC_PER_RAD
# Year for which a star's cell is found, so that its identity doesn't depend on the epoch asked for.
_EPOCH_YR = 2000.0
_MARGIN_DEG = 30.0 / 3600.0  # no star errs by more


class ErringCatalog:
    """The true sky behind a catalog: a `mountnav.catalog.stars.Catalog` to draw frames from.

    Each star stands off its catalog place by a Gaussian error of its own `sigma_arcsec` in each coordinate.
    The error belongs to the star and the seed: it is the same in every cone, in any order.

    Parameters
    ----------
    catalog : Catalog
        The catalog that errs.
    seed : int
        Another seed is another sky.
    factor : float
        Times the stated errors; Tycho-2's true errors are 1.14 to 1.20 times as large
        (docs/reference/catalog.md).

    Notes
    -----
    One deviate per star and coordinate is multiplied by sigma at the epoch asked for. At each epoch the
    errors have the right size; that position and proper motion err independently, so that the direction of
    the error turns over the decades, is left out. A star is known by its place at J2000 in cells of 0.1″ and
    by its magnitude; a star on the border of two cells may have another error at another epoch.
    """

    def __init__(self, catalog: Catalog, *, seed: int = 0, factor: float = 1.0) -> None:
        self._catalog = catalog
        self._seed = seed
        self._factor = factor

    @property
    def name(self) -> str:
        """Name for provenance."""
        return f"{self._catalog.name}, erring (seed {self._seed})"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars whose true places lie within `radius_deg` of `center`; else as the catalog has it."""
        wider = min(radius_deg + _MARGIN_DEG, 180.0)
        stars = self.displaced(self._catalog.cone(center, wider, epoch_yr=epoch_yr, mag_limit=mag_limit))
        chord = (
            unit_vectors(stars.ra_deg, stars.dec_deg) - unit_vectors(center.ra_deg, center.dec_deg)[:, None]
        )
        inside = (chord**2).sum(axis=0) <= (2.0 * np.sin(np.radians(radius_deg) / 2.0)) ** 2
        return stars.only(inside)

    def displaced(self, stars: Stars) -> Stars:
        """Move stars of the catalog to their true places; row for row the same stars.

        Parameters
        ----------
        stars : Stars
            From the catalog that errs, at any epoch.

        Returns
        -------
        Stars
            Those without a finite sigma stay where they are.
        """
        sigma = np.where(np.isfinite(stars.sigma_arcsec), stars.sigma_arcsec, 0.0) * self._factor
        bits = _identities(stars) + np.uint64(self._seed * 0xD1342543DE82EF95 % 2**64)
        east, north = (sigma * _deviate(mixed(bits + np.uint64(which))) for which in (1, 2))
        # the error vector is a motion of one year
        milli = 1000.0
        across = motion_vectors(stars.ra_deg, stars.dec_deg, east * milli, north * milli)
        ra_deg, dec_deg = places(unit_vectors(stars.ra_deg, stars.dec_deg) + across)
        return replace(stars, ra_deg=ra_deg, dec_deg=dec_deg, source=self.name)


def _identities(stars: Stars) -> Bits:
    """A number for each star that doesn't depend on the cone or on its epoch; shape (n,)."""
    motion = motion_vectors(
        stars.ra_deg,
        stars.dec_deg,
        np.nan_to_num(stars.pm_ra_cosdec_mas_yr),
        np.nan_to_num(stars.pm_dec_mas_yr),
    )
    vectors = unit_vectors(stars.ra_deg, stars.dec_deg) + motion * (_EPOCH_YR - stars.epoch_yr)
    vectors = vectors / np.sqrt((vectors**2).sum(axis=0))
    bits: Bits = np.rint(np.nan_to_num(stars.mag, nan=99.0) * 1000.0).astype(np.int64).view(np.uint64)
    # cells of the vector, not of RA and Dec: no seam and no pole
    for component in np.floor(vectors / _CELL_RAD).astype(np.int64):
        bits = mixed(bits ^ np.ascontiguousarray(component).view(np.uint64))
    return bits


def _deviate(bits: Bits) -> Array:
    """Standard normal deviates."""
    uniform = ((bits >> np.uint64(12)).astype(np.float64) + 0.5) / 2.0**52
    return np.asarray(ndtri(uniform))
