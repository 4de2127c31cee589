"""Stars of Siril's catalog: are they sound, where are they, and how well is that known."""

from __future__ import annotations

import numpy as np
from astropy import units
from astropy_healpix import healpix_to_lonlat, lonlat_to_healpix
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.siril.layout import STAR, STEP_DEG
from mountnav.catalog.readers.unknown_motion import unknown_motion_mas_yr
from mountnav.catalog.stars import StarFlag

Array = NDArray[np.float64]

_LARGEST_RAW = 2**31 - 1
_POLE_RAW = int(90.0 / STEP_DEG)
_FASTEST_MAS_YR = 12_000
"""Barnard's star moves 10,393."""
_BRIGHTEST_MMAG, _FAINTEST_MMAG = -2_000, 25_000
_RADIUS_RAD = 1.08
"""From a pixel's center to its farthest corner, times 2^level: measured on all pixels of levels 1 to 6."""
_SLACK_DEG = 120.0 / 3600.0
"""A source of Gaia's is numbered by the pixel where it was first seen: a fast star has left it since."""
_NO_MAGNITUDE_STANDS_FOR = 21.0
_MAS_PER_DEG = 3.6e6
_G = (13.0, 15.0, 17.0, 18.0, 20.0, 21.0)
_SIGMA_MAS = (0.02, 0.03, 0.06, 0.12, 0.45, 1.1)
_SIGMA_PM_MAS_YR = (0.02, 0.03, 0.07, 0.14, 0.5, 1.4)
"""Of Gaia DR3 itself, rounded up from Lindegren et al. 2021 (A&A 649, A2); the file has no errors."""
_CUT_OFF_MAS_YR = 1.0 / np.sqrt(3.0)
"""Root mean square of what is lost by cutting off a proper motion's decimals."""


def require_sound(stars: NDArray[np.void], pixel: NDArray[np.int64], level: int, file: str, at: int) -> None:
    """Refuse numbers out of range, and stars that lie in another pixel than the index says.

    Parameters
    ----------
    stars : ndarray of `STAR`, shape (n,)
    pixel : ndarray, shape (n,)
        By the index.
    level : int
        HEALPix level of the pixels.
    file : str
    at : int
        Where in the file the first star begins.

    Raises
    ------
    BadCatalog
    """
    mag = stars["mag"].astype(np.int64)
    for field, expected, sound in (
        ("ra", f"a right ascension (0 to {_LARGEST_RAW})", stars["ra"] >= 0),
        (
            "dec",
            f"a declination (-{_POLE_RAW} to {_POLE_RAW})",
            np.abs(stars["dec"].astype(np.int64)) <= _POLE_RAW,
        ),
        *(
            (
                field,
                f"a proper motion of at most {_FASTEST_MAS_YR} mas/yr",
                np.abs(stars[field].astype(np.int64)) <= _FASTEST_MAS_YR,
            )
            for field in ("pm_ra", "pm_dec")
        ),
        (
            "mag",
            f"a magnitude ({_BRIGHTEST_MMAG} to {_FAINTEST_MMAG} mmag)",
            (mag >= _BRIGHTEST_MMAG) & (mag <= _FAINTEST_MMAG),
        ),
    ):
        bad = np.flatnonzero(~sound)
        if bad.size:
            assert STAR.fields is not None
            offset = at + int(bad[0]) * STAR.itemsize + int(STAR.fields[field][1])
            raise malformed_at(file, offset, expected, str(stars[field][bad[0]]))
    ra, dec = _places(stars)
    nside = 2**level
    found = lonlat_to_healpix(ra * units.deg, dec * units.deg, nside, order="nested")
    elsewhere = np.flatnonzero(found != pixel)
    if elsewhere.size == 0:
        return
    lon, lat = healpix_to_lonlat(pixel[elsewhere], nside, order="nested")
    far = _distance_deg(ra[elsewhere], dec[elsewhere], lon.deg, lat.deg) > _reach_deg(level)
    if np.any(far):
        row = int(elsewhere[int(np.flatnonzero(far)[0])])
        raise malformed_at(
            file,
            at + row * STAR.itemsize,
            f"a star of pixel {pixel[row]} (level {level}), as the index says",
            f"RA {ra[row]:.5f}, Dec {dec[row]:.5f}, in pixel {found[row]}",
        )


def pixels_dec_range_deg(first: int, end: int, level: int) -> tuple[float, float]:
    """Between which declinations the stars of pixels `first` to before `end` lie."""
    _, lat = healpix_to_lonlat(np.arange(first, end), 2**level, order="nested")
    return float(lat.deg.min()) - _reach_deg(level), float(lat.deg.max()) + _reach_deg(level)


def columns_of(stars: NDArray[np.void], epoch_yr: float) -> CatalogColumns:
    """Stars in units.

    Parameters
    ----------
    stars : ndarray of `STAR`, shape (n,)
    epoch_yr : float
        Gaia's reference epoch.

    Returns
    -------
    CatalogColumns
        A star with both proper motions 0 counts as one without: where Gaia has none, the file has 0 too.
    """
    ra, dec = _places(stars)
    pm_ra, pm_dec = stars["pm_ra"].astype(np.float64), stars["pm_dec"].astype(np.float64)
    still = (pm_ra == 0) & (pm_dec == 0)
    no_magnitude = stars["mag"] == 0
    mag = np.where(no_magnitude, _NO_MAGNITUDE_STANDS_FOR, stars["mag"] * 0.001)
    own, own_pm = np.interp(mag, _G, _SIGMA_MAS), np.interp(mag, _G, _SIGMA_PM_MAS_YR)
    sigma_pm = np.where(still, unknown_motion_mas_yr(mag), np.hypot(own_pm, _CUT_OFF_MAS_YR))
    sigma = (
        np.hypot(own, _rounding_mas(ra) * np.cos(np.radians(dec))),
        np.hypot(own, _rounding_mas(dec)),
    )
    epoch = np.full(mag.size, epoch_yr)
    flags = np.where(still, StarFlag.NO_PROPER_MOTION, 0) | np.where(no_magnitude, StarFlag.NO_MAGNITUDE, 0)
    return CatalogColumns(
        ra_deg=ra,
        dec_deg=dec,
        pm_ra_cosdec_mas_yr=np.where(still, np.nan, pm_ra),
        pm_dec_mas_yr=np.where(still, np.nan, pm_dec),
        mag=mag,
        error_curve=error_curve(sigma, (sigma_pm, sigma_pm), (epoch, epoch)),
        flags=flags.astype(np.uint8),
    )


def _reach_deg(level: int) -> float:
    """How far a star may be from the center of its pixel."""
    return float(np.degrees(_RADIUS_RAD / 2**level)) + _SLACK_DEG


def _places(stars: NDArray[np.void]) -> tuple[Array, Array]:
    return stars["ra"].astype(np.float64) * STEP_DEG, stars["dec"].astype(np.float64) * STEP_DEG


def _rounding_mas(coordinate_deg: Array) -> Array:
    """One sigma of having been a 32-bit float: steps of 110 mas beyond 256 degrees, 55 beyond 128, ..."""
    step_deg = np.abs(np.spacing(coordinate_deg.astype(np.float32))).astype(np.float64) + STEP_DEG
    return np.asarray(step_deg * _MAS_PER_DEG / np.sqrt(12.0), dtype=np.float64)


def _distance_deg(ra_a: Array, dec_a: Array, ra_b: Array, dec_b: Array) -> Array:
    ra_a, dec_a, ra_b, dec_b = (np.radians(each) for each in (ra_a, dec_a, ra_b, dec_b))
    haversine = np.sin(0.5 * (dec_a - dec_b)) ** 2
    haversine += np.cos(dec_a) * np.cos(dec_b) * np.sin(0.5 * (ra_a - ra_b)) ** 2
    return np.asarray(np.degrees(2.0 * np.arcsin(np.sqrt(np.minimum(haversine, 1.0)))), dtype=np.float64)
