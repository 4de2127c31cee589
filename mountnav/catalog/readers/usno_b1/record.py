"""A star of USNO-B1.0: 20 words of packed decimal digits in, numbers out [CATALOGS, Formats §4]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.readers.zone_files import Records

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

SURVEYS = 5
"""First blue, first red, second blue, second red, infrared: always in this order."""
RECORD: np.dtype[np.void] = np.dtype(
    [
        ("ra", "<u4"),
        ("spd", "<u4"),
        ("motion", "<u4"),
        ("motion_errors", "<u4"),
        ("errors", "<u4"),
        ("photometry", "<u4", SURVEYS),
        ("residuals", "<u4", SURVEYS),
        ("scans", "<u4", SURVEYS),
    ]
)
"""80 bytes; each word but the first two holds several decimal fields."""

NO_STAR_GALAXY = 19
"""From this value on no star/galaxy estimate was computed."""
MOST_DETECTIONS = 5
"""Detections that a record can state: one in each survey."""
MOST_FIELD = 937
"""Largest plate field that the catalog's surveys have; more is a damaged or swapped record."""
MOST_SCAN = 9_999_999
"""Largest number of a star within a scan: seven digits."""
_FEWEST_DETECTIONS = 2
"""With fewer detections the fields of the surveys are not checked: such a record isn't the catalog's own
measurement."""


@dataclass(frozen=True, slots=True)
class UsnoB1Stars:
    """Stars as USNO-B1.0 describes them; each array has shape (n,) unless said.

    Attributes
    ----------
    ra_deg, dec_deg
        J2000, epoch 2000.0.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        Relative to the mean motion of the YS4.0 stars. NaN in both where no motion was found.
    pm_probability
        0 to 0.9.
    in_motion_catalog
        Bool: motion taken from a list of fast stars.
    sigma_fit_ra_mas, sigma_fit_dec_mas
        Scatter about the motion's fit, in steps of 100.
    detections
        2 to 5; 1 a reject; 0 a star taken from Tycho-2, whose record has another layout: nothing else holds.
    diffraction_spike
        Bool: may be an artifact of a bright star.
    sigma_ra_mas, sigma_dec_mas
        At the mean epoch.
    epoch_yr
        Mean epoch.
    ys4
        Bool: in the YS4.0 catalog.
    mag, field, survey, star_galaxy
        Shape (n, 5): B1, R1, B2, R2, I. Magnitude NaN, field 0 where it was not detected; star_galaxy is
        0 (galaxy) to 11 (star), NO_STAR_GALAXY or more where none was computed.
    residual_ra_arcsec, residual_dec_arcsec, calibration, scan
        Shape (n, 5).
    """

    ra_deg: Array
    dec_deg: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    pm_probability: Array
    in_motion_catalog: NDArray[np.bool_]
    sigma_pm_ra_mas_yr: Array
    sigma_pm_dec_mas_yr: Array
    sigma_fit_ra_mas: Array
    sigma_fit_dec_mas: Array
    detections: Whole
    diffraction_spike: NDArray[np.bool_]
    sigma_ra_mas: Array
    sigma_dec_mas: Array
    epoch_yr: Array
    ys4: NDArray[np.bool_]
    mag: Array
    field: Whole
    survey: Whole
    star_galaxy: Whole
    residual_ra_arcsec: Array
    residual_dec_arcsec: Array
    calibration: Whole
    scan: Whole

    def __len__(self) -> int:
        return int(self.ra_deg.size)


def detections(records: Records) -> Whole:
    """How often each object was detected: see `UsnoB1Stars.detections`; shape (n,)."""
    return _digits(records["motion_errors"], 8, 1)


def impossible(records: Records) -> NDArray[np.bool_]:
    """Which records hold what no record of the catalog does.

    Flags of more than 1, a field beyond the last plate's, a scan number of more than 7 digits:
    astrometry.net's reader asserts these on the whole catalog.

    Parameters
    ----------
    records : ndarray of RECORD, shape (n,)
        As the file has them.

    Returns
    -------
    ndarray of bool, shape (n,)
        True: not to be believed.
    """
    found = detections(records)
    own = found >= _FEWEST_DETECTIONS
    wrong = (found > MOST_DETECTIONS) | (_digits(records["motion_errors"], 9, 1) > 1)
    wrong |= _digits(records["motion"], 9, 1) > 1
    wrong |= (found > 0) & (_digits(records["errors"], 9, 1) > 1)
    wrong |= own & (_digits(records["photometry"], 4, 3) > MOST_FIELD).any(axis=1)
    wrong |= (records["scans"] > MOST_SCAN).any(axis=1)
    return np.asarray(wrong)


def decoded(records: Records) -> UsnoB1Stars:
    """Turn records into numbers with units.

    Parameters
    ----------
    records : ndarray of RECORD, shape (n,)
        As the file has them.
    """
    motion, sigmas, errors = records["motion"], records["motion_errors"], records["errors"]
    pm_ra, pm_dec = (_scaled(motion, start, 4, 2.0) - 10000.0 for start in (0, 4))
    sigma_pm_ra, sigma_pm_dec = (_scaled(sigmas, start, 3) for start in (0, 3))
    none = (pm_ra == 0) & (pm_dec == 0) & (sigma_pm_ra == 0) & (sigma_pm_dec == 0)
    photometry, residuals = records["photometry"], records["residuals"]
    mag, field = _digits(photometry, 0, 4), _digits(photometry, 4, 3)
    return UsnoB1Stars(
        ra_deg=records["ra"] / 3.6e5,
        dec_deg=records["spd"] / 3.6e5 - 90.0,
        pm_ra_cosdec_mas_yr=np.where(none, np.nan, pm_ra),
        pm_dec_mas_yr=np.where(none, np.nan, pm_dec),
        pm_probability=_scaled(motion, 8, 1, 0.1),
        in_motion_catalog=_digits(motion, 9, 1) > 0,
        sigma_pm_ra_mas_yr=sigma_pm_ra,
        sigma_pm_dec_mas_yr=sigma_pm_dec,
        sigma_fit_ra_mas=_scaled(sigmas, 6, 1, 100.0),
        sigma_fit_dec_mas=_scaled(sigmas, 7, 1, 100.0),
        detections=detections(records),
        diffraction_spike=_digits(sigmas, 9, 1) > 0,
        sigma_ra_mas=_scaled(errors, 0, 3),
        sigma_dec_mas=_scaled(errors, 3, 3),
        epoch_yr=1950.0 + _scaled(errors, 6, 3, 0.1),
        ys4=_digits(errors, 9, 1) > 0,
        mag=np.where((mag == 0) | (field == 0), np.nan, 0.01 * mag),
        field=field,
        survey=_digits(photometry, 7, 1),
        star_galaxy=_digits(photometry, 8, 2),
        residual_ra_arcsec=_scaled(residuals, 0, 4, 0.01) - 50.0,
        residual_dec_arcsec=_scaled(residuals, 4, 4, 0.01) - 50.0,
        calibration=_digits(residuals, 8, 1),
        scan=records["scans"].astype(np.int64),
    )


def _digits(word: NDArray[np.generic], start: int, count: int) -> Whole:
    """Decimal digits of words, counted from the last."""
    return (word.astype(np.uint32) // np.uint32(10**start) % np.uint32(10**count)).astype(np.int64)


def _scaled(word: NDArray[np.generic], start: int, count: int, step: float = 1.0) -> Array:
    return np.asarray(step * _digits(word, start, count), dtype=np.float64)
