"""What catalogs state of the invented sky: with errors, gaps, blends and false stars, each after its kind."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.stars import StarFlag, Stars
from mountnav.simulation.deep_sky import EPOCH_YR, DeepSky, g_mag, moved_and_cut
from mountnav.simulation.seeded_random import normal, salted, uniform
from mountnav.simulation.sky_cells import SkyRows, shifted
from mountnav.simulation.sky_kinds import CatalogKind
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]

# Entries that aren't there lie within so many arcsec of a true star, east and north. Chosen by hand so that
# they follow the density of the sky.
_FALSE_WITHIN_ARCSEC = 180.0


@dataclass(frozen=True, slots=True)
class Listed:
    """The stars of a catalog at its epoch, like `CatalogColumns`; shape (n,) each."""

    ra_deg: Array
    dec_deg: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    mag: Array
    color_mag: Array
    sigma_mas: Array
    sigma_pm_mas_yr: Array
    flags: NDArray[np.uint8]
    identity: NDArray[np.uint64]

    def only(self, chosen: NDArray[np.int64] | NDArray[np.bool_]) -> Listed:
        """Some of them."""
        return Listed(**{one.name: getattr(self, one.name)[chosen] for one in fields(Listed)})

    def columns(self, observed_yr: float) -> CatalogColumns:
        """Ready to be packed.

        Parameters
        ----------
        observed_yr : float
            From when on the errors grow.
        """
        observed = np.full(self.mag.size, observed_yr)
        return CatalogColumns(
            ra_deg=self.ra_deg,
            dec_deg=self.dec_deg,
            pm_ra_cosdec_mas_yr=self.pm_ra_cosdec_mas_yr,
            pm_dec_mas_yr=self.pm_dec_mas_yr,
            mag=self.mag,
            error_curve=error_curve((self.sigma_mas,) * 2, (self.sigma_pm_mas_yr,) * 2, (observed, observed)),
            color_mag=self.color_mag,
            flags=self.flags,
        )


class SkyCatalog:
    """A catalog of the invented sky. Implements `mountnav.catalog.stars.Catalog`."""

    def __init__(self, sky: DeepSky, kind: CatalogKind) -> None:
        self._sky = sky
        self.kind = kind
        self._salt = 1000 + sum(ord(letter) for letter in kind.name)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return f"{self.kind.name} of sky {self._sky.seed}"

    @property
    def seed(self) -> int:
        """Of the sky."""
        return self._sky.seed

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first."""
        found = self.listed(center, radius_deg)
        if mag_limit is not None:
            found = found.only(found.mag <= mag_limit)
        years = epoch_yr - self.kind.observed_yr
        stars = Stars(
            ra_deg=found.ra_deg,
            dec_deg=found.dec_deg,
            sigma_arcsec=np.hypot(found.sigma_mas, years * found.sigma_pm_mas_yr) / 1000.0,
            mag=found.mag,
            pm_ra_cosdec_mas_yr=found.pm_ra_cosdec_mas_yr,
            pm_dec_mas_yr=found.pm_dec_mas_yr,
            epoch_yr=self.kind.epoch_yr,
            band=self.kind.band,
            source=self.name,
            color_mag=found.color_mag,
            flags=found.flags,
            color_name=self.kind.color_name,
        )
        return moved_and_cut(stars, center, radius_deg, epoch_yr)

    def columns(self, cones: Sequence[tuple[Icrs, float]]) -> CatalogColumns:
        """The stars of some pieces of sky, each once, ready to be packed.

        Parameters
        ----------
        cones : sequence of (Icrs, float)
            Centers and radii in degrees. Somewhat more than the cones is given.

        Returns
        -------
        CatalogColumns
            At the kind's epoch.
        """
        parts = [self.listed(center, radius) for center, radius in cones]
        every = Listed(
            **{one.name: np.concatenate([getattr(p, one.name) for p in parts]) for one in fields(Listed)}
        )
        _, first = np.unique(every.identity, return_index=True)
        return every.only(first).columns(self.kind.observed_yr)

    def listed(self, center: Icrs, radius_deg: float, cells: NDArray[np.int64] | None = None) -> Listed:
        """The stars of a cone and some around it.

        Parameters
        ----------
        cells : ndarray of int64, optional
            As for `DeepSky.rows`.
        """
        kind, salt = self.kind, self._salt
        # the reddest stars are brightest in a catalog's band by so much
        deepest = kind.faintest_mag + 0.3 + max(1.0, 1.9 * kind.color_share) + 4.0 * kind.mag_error
        reach = radius_deg + _FALSE_WITHIN_ARCSEC / 3600.0
        rows = self._sky.rows(center, reach, faintest_mag=deepest, cells=cells)
        rows, double = _blended(rows, kind.resolves_arcsec)
        mag = rows.v_mag - kind.color_share * rows.bv_mag
        if kind.band == "G":
            mag = g_mag(rows.v_mag, rows.bv_mag)
        who = rows.identity
        has_motion = uniform(who, salt + 1) >= kind.without_motion
        sigma, sigma_pm = _errors(kind, mag)
        # true at the epoch of the file, and off by what observations of their own mean epoch make of it
        since = np.where(has_motion, kind.epoch_yr, kind.observed_yr) - EPOCH_YR
        error_years = np.where(has_motion, kind.epoch_yr - kind.observed_yr, 0.0)
        error_pm = [np.where(has_motion, sigma_pm * normal(who, salt + n), 0.0) for n in (2, 3)]
        east, north = (
            pm * since + sigma * normal(who, salt + n) + error * error_years
            for n, pm, error in zip(
                (4, 5), (rows.pm_ra_cosdec_mas_yr, rows.pm_dec_mas_yr), error_pm, strict=True
            )
        )
        ra, dec = shifted(rows.ra_deg, rows.dec_deg, east / 1000.0, north / 1000.0)
        mag = mag + kind.mag_error * normal(who, salt + 6)
        flags = np.where(has_motion, 0, int(StarFlag.NO_PROPER_MOTION))
        flags |= np.where(double, int(StarFlag.DOUBLE), 0)
        found = Listed(
            ra_deg=ra,
            dec_deg=dec,
            pm_ra_cosdec_mas_yr=np.where(has_motion, rows.pm_ra_cosdec_mas_yr + error_pm[0], np.nan),
            pm_dec_mas_yr=np.where(has_motion, rows.pm_dec_mas_yr + error_pm[1], np.nan),
            mag=mag,
            color_mag=kind.color_factor * rows.bv_mag + 1.4 * kind.mag_error * normal(who, salt + 13),
            sigma_mas=sigma,
            sigma_pm_mas_yr=sigma_pm,
            flags=flags.astype(np.uint8),
            identity=who,
        )
        has = kind.complete / (1.0 + np.exp((mag - kind.faintest_mag) / 0.1))
        has[mag > kind.faintest_mag + 0.3] = 0.0
        listed = uniform(who, salt + 7) < has
        return self._with_false(found.only(listed))

    def _with_false(self, found: Listed) -> Listed:
        """Some stars that aren't there, each near a true one, as faint as the catalog goes."""
        which = np.flatnonzero(uniform(found.identity, self._salt + 8) < self.kind.false_share)
        own = found.only(which)
        who = salted(own.identity, self._salt + 9)
        east, north = (_FALSE_WITHIN_ARCSEC * (2.0 * uniform(who, n) - 1.0) for n in (10, 11))
        ra, dec = shifted(own.ra_deg, own.dec_deg, east, north)
        mag = np.maximum(
            self.kind.faintest_mag + 1.0 * np.log(uniform(who, 12)), self.kind.faintest_mag - 6.0
        )
        false = replace(
            own,
            ra_deg=ra,
            dec_deg=dec,
            mag=mag,
            identity=who,
            flags=(own.flags | int(StarFlag.DOUBTFUL)).astype(np.uint8),
        )
        return Listed(
            **{
                one.name: np.concatenate([getattr(found, one.name), getattr(false, one.name)])
                for one in fields(Listed)
            }
        )


def _errors(kind: CatalogKind, mag: Array) -> tuple[Array, Array]:
    """Sigma of place and motion; in steps of a quarter magnitude, so that there are few kinds of stars."""
    step = np.rint(mag * 4.0) / 4.0
    sigma, sigma_pm = (
        np.exp(np.interp(step, kind.error_mags, np.log(values)))
        for values in (kind.sigma_mas, kind.sigma_pm_mas_yr)
    )
    return sigma, sigma_pm


def _blended(rows: SkyRows, resolves_arcsec: float) -> tuple[SkyRows, NDArray[np.bool_]]:
    """Close pairs as one star at the photocenter; and which those are."""
    second = np.flatnonzero((rows.parent >= 0) & (rows.separation_arcsec < resolves_arcsec))
    first = rows.parent[second]
    ratio = 10.0 ** (-0.4 * (rows.v_mag[second] - rows.v_mag[first]))
    part = ratio / (1.0 + ratio)
    ra, dec, v_mag = rows.ra_deg.copy(), rows.dec_deg.copy(), rows.v_mag.copy()
    east = (rows.ra_deg[second] - ra[first] + 180.0) % 360.0 - 180.0
    east *= np.cos(np.radians(dec[first])) * 3600.0 * part
    ra[first], dec[first] = shifted(
        ra[first], dec[first], east, (rows.dec_deg[second] - dec[first]) * 3600.0 * part
    )
    v_mag[first] -= 2.5 * np.log10(1.0 + ratio)
    double = np.zeros(len(rows), dtype=np.bool_)
    double[first] = True
    keep = np.ones(len(rows), dtype=np.bool_)
    keep[second] = False
    rows = replace(rows, ra_deg=ra, dec_deg=dec, v_mag=v_mag)
    # nobody asks for parents after this
    kept = {one.name: getattr(rows, one.name)[keep] for one in fields(SkyRows)}
    return SkyRows(**kept), double[keep]
