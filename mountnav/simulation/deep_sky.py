"""A whole sky to magnitude 22: Tycho-2's stars, and below them invented ones, as many as the Galaxy has."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.space_motion import motion_vectors, motions_seen, places, unit_vectors
from mountnav.catalog.stars import Catalog, Stars
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.simulation.seeded_random import salted
from mountnav.simulation.sky_cells import FAINTEST_MAG, SkyRows, cells_near, invented, joined
from mountnav.sky.coordinates import Icrs

if TYPE_CHECKING:
    from mountnav.simulation.sky_catalogs import SkyCatalog

Array = NDArray[np.float64]

EPOCH_YR = 2016.0
"""Of the places of `SkyRows`."""
MARGIN_DEG = 0.02
"""A cone's stars are looked for so much farther out: proper motion and companions."""
# B−V of a star without a color, mag: near the Sun's.
_ASSUMED_BV = 0.7


class DeepSky:
    """The true sky, to draw frames from. Implements `mountnav.catalog.stars.Catalog`.

    A star is the same in any cone, in any order, at any epoch; the seed makes another sky.

    Parameters
    ----------
    bright : Catalog, optional
        The brighter stars; the embedded Tycho-2 if left out. The invented ones fill up what Tycho-2 lacks, so
        another catalog must go as deep.
    faintest_mag : float
        V of the faintest star, at most 22.
    band : {"V", "G"}
        What `Stars.mag` is given in: an unfiltered CCD sees about what Gaia's G is.
    bright_errors : float
        The bright stars stand off their catalog places by so many times the errors that their catalog states
        for J2016.0 [1.14 to 1.20 for Tycho-2, docs/reference/catalog.md].
    """

    def __init__(
        self,
        seed: int = 0,
        *,
        bright: Catalog | None = None,
        faintest_mag: float = 20.5,
        band: Literal["V", "G"] = "V",
        bright_errors: float = 1.0,
    ) -> None:
        self.seed = seed
        self.faintest_mag = min(faintest_mag, FAINTEST_MAG)
        self.band = band
        self._bright = bright or embedded_catalog()
        self._erring = ErringCatalog(self._bright, seed=seed, factor=bright_errors)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return f"invented sky {self.seed} to V {self.faintest_mag:g}"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first.

        Parameters
        ----------
        radius_deg : float
            Some degrees at most: a square degree holds 20,000 stars.
        mag_limit : float, optional
            In the sky's band.

        Returns
        -------
        Stars
            Their errors are 0: this is the truth.
        """
        deepest = self.faintest_mag if mag_limit is None else min(self.faintest_mag, mag_limit + 1.5)
        rows = self.rows(center, radius_deg, faintest_mag=deepest)
        mag = rows.v_mag if self.band == "V" else g_mag(rows.v_mag, rows.bv_mag)
        keep = np.flatnonzero(mag <= (np.inf if mag_limit is None else mag_limit))
        stars = Stars(
            ra_deg=rows.ra_deg[keep],
            dec_deg=rows.dec_deg[keep],
            sigma_arcsec=np.zeros(keep.size),
            mag=mag[keep],
            pm_ra_cosdec_mas_yr=rows.pm_ra_cosdec_mas_yr[keep],
            pm_dec_mas_yr=rows.pm_dec_mas_yr[keep],
            epoch_yr=EPOCH_YR,
            band=self.band,
            source=self.name,
            color_mag=rows.bv_mag[keep],
            color_name="B-V",
        )
        return moved_and_cut(stars, center, radius_deg, epoch_yr)

    def as_catalog(self, kind: str) -> SkyCatalog:
        """What a catalog would state of this sky.

        Parameters
        ----------
        kind : str
            One of `mountnav.simulation.sky_kinds.KINDS`: "gaia", "ucac4", "usno-b1".

        Raises
        ------
        KeyError
            There is no such kind.
        """
        from mountnav.simulation.sky_catalogs import SkyCatalog
        from mountnav.simulation.sky_kinds import KINDS

        return SkyCatalog(self, KINDS[kind])

    def rows(
        self,
        center: Icrs,
        radius_deg: float,
        *,
        faintest_mag: float | None = None,
        cells: NDArray[np.int64] | None = None,
    ) -> SkyRows:
        """All that is known of the stars of a cone, and of some around it.

        Parameters
        ----------
        faintest_mag : float, optional
            V.
        cells : ndarray of int64, optional
            Invented stars of these cells only, instead of all that are near the cone.

        Returns
        -------
        SkyRows
            Places at J2016.0; whole cells of invented stars, so well beyond the cone.
        """
        deepest = self.faintest_mag if faintest_mag is None else min(faintest_mag, self.faintest_mag)
        reach = min(radius_deg + MARGIN_DEG, 180.0)
        bright = self._erring.displaced(self._bright.cone(center, reach, epoch_yr=EPOCH_YR))
        cells = cells_near(center, reach) if cells is None else cells
        return joined([_rows_of(bright, self.seed), invented(cells, self.seed, deepest)])


def g_mag(v_mag: Array, bv_mag: Array) -> Array:
    """Gaia's G, about as by its relation to B-V [Riello et al., A&A 649, A3, 2021, appendix C].

    Parameters
    ----------
    v_mag, bv_mag : ndarray, shape (n,)
        Johnson's V and B-V.
    """
    return np.asarray(v_mag - 0.04749 - 0.0124 * bv_mag - 0.2901 * bv_mag**2 + 0.02008 * bv_mag**3)


def moved_and_cut(stars: Stars, center: Icrs, radius_deg: float, epoch_yr: float) -> Stars:
    """Carry stars to an epoch and keep those of a cone, brightest first.

    Parameters
    ----------
    stars : Stars
        At their own epoch; those without proper motion stay.

    Returns
    -------
    Stars
        `sigma_arcsec` as it was.
    """
    pm_ra, pm_dec = np.nan_to_num(stars.pm_ra_cosdec_mas_yr), np.nan_to_num(stars.pm_dec_mas_yr)
    motion = motion_vectors(stars.ra_deg, stars.dec_deg, pm_ra, pm_dec)
    vectors = unit_vectors(stars.ra_deg, stars.dec_deg) + motion * (epoch_yr - stars.epoch_yr)
    axis = unit_vectors(center.ra_deg, center.dec_deg)
    chord = vectors / np.sqrt((vectors**2).sum(axis=0)) - axis[:, np.newaxis]
    inside = np.flatnonzero((chord**2).sum(axis=0) <= (2.0 * np.sin(np.radians(radius_deg) / 2.0)) ** 2)
    inside = inside[np.argsort(stars.mag[inside], kind="stable")]
    ra_deg, dec_deg = places(vectors[:, inside])
    east, north = motions_seen(vectors[:, inside], motion[:, inside])
    unknown = np.isnan(stars.pm_ra_cosdec_mas_yr[inside])
    east[unknown], north[unknown] = np.nan, np.nan
    kept = stars.only(inside)
    return replace(
        kept,
        ra_deg=ra_deg,
        dec_deg=dec_deg,
        pm_ra_cosdec_mas_yr=east,
        pm_dec_mas_yr=north,
        epoch_yr=epoch_yr,
    )


def _rows_of(stars: Stars, seed: int) -> SkyRows:
    """Catalog stars as true ones; an unknown proper motion is none, an unknown color is a common one."""
    place = np.rint(unit_vectors(stars.ra_deg, stars.dec_deg) * 2.0e8).astype(np.int64)  # cells of 1 mas
    identity = np.zeros(len(stars), dtype=np.uint64)
    for component in place:
        identity = salted(identity ^ np.ascontiguousarray(component).view(np.uint64), seed)
    return SkyRows(
        ra_deg=stars.ra_deg,
        dec_deg=stars.dec_deg,
        pm_ra_cosdec_mas_yr=np.nan_to_num(stars.pm_ra_cosdec_mas_yr),
        pm_dec_mas_yr=np.nan_to_num(stars.pm_dec_mas_yr),
        v_mag=np.nan_to_num(stars.mag, nan=12.0),
        bv_mag=np.nan_to_num(stars.color_mag, nan=_ASSUMED_BV),
        identity=identity,
        parent=np.full(len(stars), -1, dtype=np.int64),
        separation_arcsec=np.zeros(len(stars)),
    )
