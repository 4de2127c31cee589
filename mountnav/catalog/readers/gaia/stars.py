"""Rows of a Gaia table become stars: one epoch for all, flags, larger sigmas where something is unknown."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import error_curve, unknown_motion_mas_yr
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.gaia.tables import (
    EARLIEST_YR,
    LATEST_YR,
    RELEASE_EPOCHS_YR,
    Block,
    unknown_epoch,
)
from mountnav.catalog.space_motion import motion_vectors, motions_seen, places, unit_vectors
from mountnav.catalog.stars import StarFlag

Array = NDArray[np.float64]

FAINT_MAG = 21.0
"""Stands in for a magnitude that isn't there; Gaia sees no fainter stars."""
LARGEST_RUWE = 1.4
"""Above it the single-star solution doesn't fit [L. Lindegren, GAIA-C3-TN-LU-LL-124-01]."""
FASTEST_MAS_YR = 20_000.0
"""Twice Barnard's star; more is another unit."""
LARGEST_ERROR = 100_000.0
"""Of a coordinate [mas] and of a proper motion [mas/yr]; more is a damaged value."""
TWO_PARAMETERS = 3.0
"""`astrometric_params_solved` of a solution for the position alone."""

_MAG = (12.0, 15.0, 17.0, 20.0, 21.0)
"""G magnitudes of the two tables below."""
_SIGMA_MAS = (0.04, 0.04, 0.1, 0.7, 2.0)
"""Position error per coordinate, mas; source below."""
_SIGMA_PM_MAS_YR = (0.06, 0.06, 0.2, 1.2, 3.0)
"""Typical errors of Gaia DR2 [A. G. A. Brown et al., A&A 616, A1 (2018)], larger than those of DR3;
they stand in for error columns that a file doesn't have."""

_DESIGNATION = re.compile(r"Gaia E?DR(\d)\b", re.IGNORECASE)


def stars_of(block: Block, *, file: str, told_epoch_yr: float | None, epoch_yr: float) -> CatalogColumns:
    """Make stars of some rows.

    Correlations between the five parameters are left aside: the packed form has one sigma per star.

    Parameters
    ----------
    file : str
        For messages.
    told_epoch_yr : float or None
        The positions' epoch where there is no column ref_epoch.
    epoch_yr : float
        Julian year to which they are moved.

    Returns
    -------
    CatalogColumns
        Colors are there if the file has them.

    Raises
    ------
    BadCatalog
        A value can't be, or the epoch isn't known.
    """
    values = block.values
    ra_deg, dec_deg = values["ra"], values["dec"]
    _require(block, (ra_deg >= 0.0) & (ra_deg <= 360.0), "a right ascension of 0 to 360 degrees", ra_deg)
    _require(block, np.abs(dec_deg) <= 90.0, "a declination of -90 to 90 degrees", dec_deg)
    own_epoch = epochs_of(block, file, told_epoch_yr)
    mag, no_mag = _magnitudes(block)

    pm_ra, pm_dec = _column(values, "pmra", ra_deg.size), _column(values, "pmdec", ra_deg.size)
    unknown = np.isnan(pm_ra) | np.isnan(pm_dec) | (_column(values, "solved", ra_deg.size) == TWO_PARAMETERS)
    pm_ra, pm_dec = np.where(unknown, np.nan, pm_ra), np.where(unknown, np.nan, pm_dec)
    _require(
        block,
        unknown | (np.hypot(pm_ra, pm_dec) <= FASTEST_MAS_YR),
        f"a proper motion of up to {FASTEST_MAS_YR:.0f} mas/yr",
        np.hypot(pm_ra, pm_dec),
    )
    for name in ("ra_error", "dec_error", "pmra_error", "pmdec_error"):
        error = _column(values, name, ra_deg.size)
        sound = np.isnan(error) | (error <= LARGEST_ERROR)
        _require(block, sound, f"a {name} of at most {LARGEST_ERROR:.0f}", error)
    curve = _error_curve(values, mag, unknown, own_epoch)
    ra_deg, dec_deg, pm_ra, pm_dec = moved(ra_deg, dec_deg, pm_ra, pm_dec, epoch_yr - own_epoch)

    flags = np.zeros(ra_deg.size, dtype=np.uint8)
    for chosen, flag in (
        (unknown, StarFlag.NO_PROPER_MOTION),
        (no_mag, StarFlag.NO_MAGNITUDE),
        (_column(values, "ruwe", ra_deg.size) > LARGEST_RUWE, StarFlag.DOUBTFUL),
        (_column(values, "duplicated", ra_deg.size) == 1.0, StarFlag.DOUBTFUL),
        (_column(values, "galaxy", ra_deg.size) == 1.0, StarFlag.EXTENDED),
        (_column(values, "non_single", ra_deg.size) > 0.0, StarFlag.DOUBLE),
    ):
        flags[chosen] |= np.uint8(flag)
    if "variable" in values:
        flags[np.char.upper(values["variable"].astype(str)) == "VARIABLE"] |= np.uint8(StarFlag.VARIABLE)
    return CatalogColumns(ra_deg, dec_deg, pm_ra, pm_dec, mag, curve, _colors(values, ra_deg.size), flags)


def moved(
    ra_deg: Array, dec_deg: Array, pm_ra: Array, pm_dec: Array, years: Array
) -> tuple[Array, Array, Array, Array]:
    """Bring stars to another epoch; those without proper motion stay where they are.

    Parameters
    ----------
    ra_deg, dec_deg, pm_ra, pm_dec : ndarray, shape (n,)
        Proper motions in mas/yr, NaN where unknown.
    years : ndarray, shape (n,)
        How far each has to go.

    Returns
    -------
    ra_deg, dec_deg, pm_ra, pm_dec : ndarray, shape (n,)
        At the new epoch; units as they came.
    """
    goes = np.flatnonzero((years != 0.0) & np.isfinite(pm_ra))
    if goes.size == 0:
        return ra_deg, dec_deg, pm_ra, pm_dec
    ra_deg, dec_deg, pm_ra, pm_dec = (values.copy() for values in (ra_deg, dec_deg, pm_ra, pm_dec))
    motion = motion_vectors(ra_deg[goes], dec_deg[goes], pm_ra[goes], pm_dec[goes])
    vectors = unit_vectors(ra_deg[goes], dec_deg[goes]) + motion * years[goes]
    ra_deg[goes], dec_deg[goes] = places(vectors)
    pm_ra[goes], pm_dec[goes] = motions_seen(vectors, motion)
    return ra_deg, dec_deg, pm_ra, pm_dec


def epochs_of(block: Block, file: str, told_epoch_yr: float | None) -> Array:
    """For which year each row's position holds.

    Parameters
    ----------
    file : str
        For messages.
    told_epoch_yr : float or None
        As the file's head tells it; a column ref_epoch goes before it.

    Returns
    -------
    ndarray, shape (n,)
        Julian years.

    Raises
    ------
    BadCatalog
        It isn't known, or can't be.
    """
    values = block.values
    size = values["ra"].size
    if "ref_epoch" in values:
        epochs: Array = values["ref_epoch"]
        sound = (epochs >= EARLIEST_YR) & (epochs <= LATEST_YR)
        _require(block, sound, f"a ref_epoch of {EARLIEST_YR} to {LATEST_YR} (Julian years)", epochs)
        return epochs
    if "designation" in values:
        releases = np.array([_release(text) for text in values["designation"]])
        known = np.isin(releases, list(RELEASE_EPOCHS_YR))
        if size and told_epoch_yr is None:
            _require(
                block, known, "a designation that names the release ('Gaia DR3 …')", values["designation"]
            )
        by_row = np.array([RELEASE_EPOCHS_YR.get(release, np.nan) for release in releases], dtype=np.float64)
        if told_epoch_yr is not None:
            contradicts = known & (by_row != told_epoch_yr)
            _require(block, ~contradicts, f"a designation of epoch {told_epoch_yr}", values["designation"])
            return np.full(size, told_epoch_yr)
        return by_row
    if told_epoch_yr is None:
        raise unknown_epoch(file)
    return np.full(size, told_epoch_yr)


def _release(designation: str) -> str:
    found = _DESIGNATION.search(designation)
    return found[1] if found else ""


def _magnitudes(block: Block) -> tuple[Array, NDArray[np.bool_]]:
    mag: Array = block.values["g"]
    unknown = np.isnan(mag)
    _require(block, unknown | ((mag > -5.0) & (mag < 30.0)), "a magnitude of -5 to 30", mag)
    return np.where(unknown, FAINT_MAG, mag), unknown


def _colors(values: dict[str, NDArray[np.float64]], size: int) -> Array | None:
    """BP - RP as given, or from its two magnitudes; None if the file has neither."""
    if "bp_rp" not in values and not ("bp" in values and "rp" in values):
        return None
    color = _column(values, "bp_rp", size)
    difference = _column(values, "bp", size) - _column(values, "rp", size)
    color = np.where(np.isnan(color), difference, color)
    # nothing that is a star is bluer or redder: a failed measurement, no color
    return np.where((color > -3.0) & (color < 12.0), color, np.nan)


def _error_curve(
    values: dict[str, NDArray[np.float64]], mag: Array, no_motion: NDArray[np.bool_], own_epoch: Array
) -> Array:
    sigmas, sigmas_pm = [], []
    for name, pm_name in (("ra_error", "pmra_error"), ("dec_error", "pmdec_error")):
        sigma, sigma_pm = _column(values, name, mag.size), _column(values, pm_name, mag.size)
        sigmas.append(np.where(sigma > 0.0, sigma, np.interp(mag, _MAG, _SIGMA_MAS)))
        sigma_pm = np.where(sigma_pm > 0.0, sigma_pm, np.interp(mag, _MAG, _SIGMA_PM_MAS_YR))
        sigmas_pm.append(np.where(no_motion, unknown_motion_mas_yr(mag), sigma_pm))
    return error_curve((sigmas[0], sigmas[1]), (sigmas_pm[0], sigmas_pm[1]), (own_epoch, own_epoch))


def _column(values: dict[str, NDArray[np.float64]], name: str, size: int) -> Array:
    return values[name] if name in values else np.full(size, np.nan)


def _require(block: Block, sound: NDArray[np.bool_], expected: str, found: NDArray[np.generic]) -> None:
    """Refuse the first row that isn't sound; comparisons with NaN are false, so what is missing isn't."""
    bad = np.flatnonzero(~sound)
    if bad.size:
        value = found[bad[0]]
        none = isinstance(value, np.floating) and np.isnan(value)
        raise block.error_at(int(bad[0]), expected, "none" if none else str(value))
