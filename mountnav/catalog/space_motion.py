"""Uniform motion along a straight line in space: right at the poles and for the fastest stars."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mountnav.units import RAD_PER_MAS

Array = NDArray[np.float64]


def unit_vectors(ra_deg: Array | float, dec_deg: Array | float) -> Array:
    """Directions as vectors of length one.

    Parameters
    ----------
    ra_deg, dec_deg : ndarray, shape (n,), or float
        ICRS, or any other equatorial frame: the vector is in the same.

    Returns
    -------
    ndarray, shape (3, n) or (3,)
        x to RA 0, y to RA 90°, z to the pole.
    """
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    cos_dec = np.cos(dec)
    return np.array([cos_dec * np.cos(ra), cos_dec * np.sin(ra), np.sin(dec)])


def motion_vectors(ra_deg: Array, dec_deg: Array, pm_ra_cosdec_mas_yr: Array, pm_dec_mas_yr: Array) -> Array:
    """Proper motion as a vector across the line of sight [Hipparcos vol. 1 §1.5.5, radial velocity zero].

    Parameters
    ----------
    ra_deg, dec_deg, pm_ra_cosdec_mas_yr, pm_dec_mas_yr : ndarray, shape (n,)
        Position and proper motion at one epoch.

    Returns
    -------
    ndarray, shape (3, n)
        rad/yr.
    """
    ra, dec = np.radians(ra_deg), np.radians(dec_deg)
    sin_ra, cos_ra, sin_dec, cos_dec = np.sin(ra), np.cos(ra), np.sin(dec), np.cos(dec)
    east, north = pm_ra_cosdec_mas_yr * RAD_PER_MAS, pm_dec_mas_yr * RAD_PER_MAS
    return np.array(
        [
            -sin_ra * east - sin_dec * cos_ra * north,
            cos_ra * east - sin_dec * sin_ra * north,
            cos_dec * north,
        ]
    )


def places(vectors: Array) -> tuple[Array, Array]:
    """RA in [0, 360) and declination of vectors of any length.

    Parameters
    ----------
    vectors : ndarray, shape (3, n)
        x to RA 0, y to RA 90°, z to the pole.

    Returns
    -------
    ra_deg, dec_deg : ndarray, shape (n,)
        In the frame of the vectors.
    """
    x, y, z = vectors
    ra_deg = np.degrees(np.arctan2(y, x)) % 360.0
    # -1e-17 % 360 is 360.0 in floating point
    ra_deg[ra_deg >= 360.0] = 0.0
    return ra_deg, np.degrees(np.arctan2(z, np.hypot(x, y)))


def motions_seen(vectors: Array, motion: Array) -> tuple[Array, Array]:
    """Proper motion in the directions east and north of where the star is now.

    Parameters
    ----------
    vectors : ndarray, shape (3, n)
        Moved positions, not normalized: start + motion × years.
    motion : ndarray, shape (3, n)
        rad/yr at the start.

    Returns
    -------
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr : ndarray, shape (n,)
        To the east and to the north.
    """
    length = np.sqrt((vectors**2).sum(axis=0))
    unit = vectors / length
    across = (motion - unit * (unit * motion).sum(axis=0)) / length / RAD_PER_MAS
    flat = np.hypot(unit[0], unit[1])
    # exactly at a pole RA is 0 by `places`, so east is the y axis
    cos_ra = np.divide(unit[0], flat, out=np.ones_like(flat), where=flat > 0)
    sin_ra = np.divide(unit[1], flat, out=np.zeros_like(flat), where=flat > 0)
    east = cos_ra * across[1] - sin_ra * across[0]
    north = flat * across[2] - unit[2] * (cos_ra * across[0] + sin_ra * across[1])
    return east, north
