"""What of USNO-B1.0 goes into a packed catalog: which magnitude, which color, which warning, which error."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.usno_b1.record import NO_STAR_GALAXY, UsnoB1Stars
from mountnav.catalog.stars import StarFlag

Array = NDArray[np.float64]

B1, R1, B2, R2, INFRARED = range(5)
FLOOR_MAS = 200.0
"""The catalog's accuracy at J2000 [Monet et al. 2003, AJ 125, 984]; the stated sigma is the plates' scatter.
At the south pole its declinations differ from UCAC4's by 0.26", robust sigma, at magnitude 12 to 16."""
FLOOR_PM_MAS_YR = 4.0
"""Smaller stated errors "should not be taken at face value" [Gould 2003, AJ 126, 472]."""
UNKNOWN_MOTION_MAG = (8.5, 10.5, 11.5, 12.5, 13.5, 14.5, 15.5, 16.5)
UNKNOWN_MOTION_MAS_YR = (43.0, 25.5, 23.4, 18.9, 14.3, 13.7, 11.9, 11.0)
"""How far a star without a proper motion may move, per coordinate: 68.3 % of the UCAC4 stars of its magnitude
move less (CDS's sample of 1000, less their errors)."""
R_MINUS_BLUE_MAG = -0.9
R_MINUS_INFRARED_MAG = 0.5
NO_MAGNITUDE_MAG = 21.0
"""The catalog's limit."""
EXTENDED_AT_MOST = 2
"""Star/galaxy estimates of extended objects. 3 is too high: one in five UCAC4 stars near the pole has it."""


def columns_of(stars: UsnoB1Stars) -> CatalogColumns:
    """Choose what the packed form holds.

    Parameters
    ----------
    stars : UsnoB1Stars
        Of the catalog's own records.

    Returns
    -------
    CatalogColumns
        Band "R" (photographic), color B-R.
    """
    mag, color, mag_flags = magnitudes(stars)
    unknown = np.isnan(stars.pm_dec_mas_yr)
    typical = np.interp(mag, UNKNOWN_MOTION_MAG, UNKNOWN_MOTION_MAS_YR)
    stated = (stars.sigma_pm_ra_mas_yr, stars.sigma_pm_dec_mas_yr)
    flags = mag_flags.copy()
    flags[unknown] |= int(StarFlag.NO_PROPER_MOTION)
    flags[stars.diffraction_spike] |= int(StarFlag.DOUBTFUL)
    flags[is_extended(stars)] |= int(StarFlag.EXTENDED)
    return CatalogColumns(
        ra_deg=stars.ra_deg,
        dec_deg=stars.dec_deg,
        pm_ra_cosdec_mas_yr=stars.pm_ra_cosdec_mas_yr,
        pm_dec_mas_yr=stars.pm_dec_mas_yr,
        mag=mag,
        error_curve=error_curve(
            (np.hypot(stars.sigma_ra_mas, FLOOR_MAS), np.hypot(stars.sigma_dec_mas, FLOOR_MAS)),
            (
                np.where(unknown, typical, np.maximum(stated[0], FLOOR_PM_MAS_YR)),
                np.where(unknown, typical, np.maximum(stated[1], FLOOR_PM_MAS_YR)),
            ),
            (stars.epoch_yr, stars.epoch_yr),
        ),
        color_mag=color,
        flags=flags,
    )


def magnitudes(stars: UsnoB1Stars) -> tuple[Array, Array, NDArray[np.uint8]]:
    """R and B-R: R2, or R1; B of the same epoch if there is one.

    Parameters
    ----------
    stars : UsnoB1Stars

    Returns
    -------
    mag : ndarray, shape (n,)
        Finite.
    color : ndarray, shape (n,)
        NaN where unknown.
    flags : ndarray of uint8, shape (n,)
        NO_MAGNITUDE, OTHER_BAND.
    """
    m = stars.mag
    second = np.isfinite(m[:, R2])
    red = np.where(second, m[:, R2], m[:, R1])
    near, far = np.where(second, m[:, B2], m[:, B1]), np.where(second, m[:, B1], m[:, B2])
    blue = np.where(np.isnan(near), far, near)
    other = np.where(np.isnan(blue), m[:, INFRARED] + R_MINUS_INFRARED_MAG, blue + R_MINUS_BLUE_MAG)
    mag = np.where(np.isnan(red), other, red)
    nothing = np.isnan(mag)
    flags = np.where(
        nothing, int(StarFlag.NO_MAGNITUDE), np.where(np.isnan(red), int(StarFlag.OTHER_BAND), 0)
    )
    return np.where(nothing, NO_MAGNITUDE_MAG, mag), blue - red, flags.astype(np.uint8)


def is_extended(stars: UsnoB1Stars) -> NDArray[np.bool_]:
    """Whether two surveys or more take it for a galaxy, and none for a star.

    A 0 says nothing by itself: whole plates have it.

    Parameters
    ----------
    stars : UsnoB1Stars

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    told = np.isfinite(stars.mag) & (stars.star_galaxy > 0) & (stars.star_galaxy < NO_STAR_GALAXY)
    largest = np.where(told, stars.star_galaxy, 0).max(axis=1)
    return np.asarray((told.sum(axis=1) >= 2) & (largest <= EXTENDED_AT_MOST))
