"""Stars in the steps of the packed form, not yet in its order: what the writer sorts and a spool keeps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import (
    COLOR_STEP,
    COLOR_UNKNOWN,
    DEC_STEP_DEG,
    MAG_STEP,
    MAG_ZERO,
    PM_STEP_MAS_YR,
    RA_STEP_DEG,
)

if TYPE_CHECKING:
    from mountnav.catalog.packed.packing import CatalogColumns

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Raw = NDArray[np.void]

KEY_NSIDE = 2**14
"""Resolution of `RAW` keys: 12 × 4**14 pixels are the most that 32 bits can number."""
RAW_PM_UNKNOWN = -(2**31)
FASTEST_RAW = 10_000_000
"""1000 arcsec/yr, a hundred times Barnard's star: more than that is an error in the file."""

LARGEST_CURVE = 1e30
"""Of an error curve's coefficients: what is larger gives no finite variance in 32-bit floats a century on."""

RAW = np.dtype(
    [
        ("key", "<u4"),
        ("ra", "<u4"),
        ("dec", "<i4"),
        ("pm_ra", "<i4"),
        ("pm_dec", "<i4"),
        ("mag", "<u2"),
        ("color", "<i2"),
        ("flags", "u1"),
        ("curve", "<f4", 3),
    ]
)
"""One star, 37 bytes; ``key`` is its NESTED pixel of `KEY_NSIDE`, ``curve`` its error curve."""


class NotWritable(ValueError):
    """The packed form has no place for a value."""


def require_writable(columns: CatalogColumns) -> None:
    """Refuse what the packed form has no place for.

    Raises
    ------
    NotWritable
        A value is not finite or out of range; tells which.
    """
    if not (np.all((columns.ra_deg >= 0) & (columns.ra_deg <= 360)) and np.all(abs(columns.dec_deg) <= 90)):
        raise NotWritable("RA must be within 0..360 and declination within -90..90 degrees")
    if not np.all((columns.mag >= MAG_ZERO) & (columns.mag <= MAG_ZERO + MAG_STEP * 65534)):
        raise NotWritable(f"magnitudes must be within {MAG_ZERO}..{MAG_ZERO + MAG_STEP * 65534:.3f}")
    # written so that NaN is refused too
    held = np.all(np.abs(columns.error_curve) < LARGEST_CURVE)
    if not held or not np.all(columns.error_curve[:, 0] > 0):
        raise NotWritable("error curves must be positive, and small enough for 32-bit floats")
    if not np.array_equal(np.isnan(columns.pm_ra_cosdec_mas_yr), np.isnan(columns.pm_dec_mas_yr)):
        raise NotWritable("a proper motion must be known in both coordinates or in neither")
    for motion in (columns.pm_ra_cosdec_mas_yr, columns.pm_dec_mas_yr):
        if bool(np.any(np.abs(motion) > FASTEST_RAW * PM_STEP_MAS_YR)):
            raise NotWritable(f"proper motions must be within ±{FASTEST_RAW * PM_STEP_MAS_YR:.0f} mas/yr")
    if columns.color_mag is not None and bool(np.any(np.abs(columns.color_mag) > 32.767)):
        raise NotWritable("color indices must be within ±32.767, or NaN")


def raw_stars(columns: CatalogColumns) -> Raw:
    """Round to the steps of the packed form.

    Parameters
    ----------
    columns : CatalogColumns

    Returns
    -------
    ndarray of RAW, shape (n,)
        In the same order.

    Raises
    ------
    NotWritable
        From `require_writable`.
    """
    from astropy import units
    from astropy_healpix import lonlat_to_healpix

    require_writable(columns)
    raw = np.zeros(columns.ra_deg.size, dtype=RAW)
    raw["key"] = lonlat_to_healpix(
        columns.ra_deg * units.deg, columns.dec_deg * units.deg, nside=KEY_NSIDE, order="nested"
    )
    raw["ra"], raw["dec"], raw["mag"] = raw_places(columns.ra_deg, columns.dec_deg, columns.mag)
    for field, motion in (("pm_ra", columns.pm_ra_cosdec_mas_yr), ("pm_dec", columns.pm_dec_mas_yr)):
        known = ~np.isnan(motion)
        steps = np.rint(np.where(known, motion, 0.0) / PM_STEP_MAS_YR)
        raw[field] = np.where(known, steps, RAW_PM_UNKNOWN)
    raw["color"] = COLOR_UNKNOWN
    if columns.color_mag is not None:
        known = ~np.isnan(columns.color_mag)
        raw["color"][known] = np.rint(columns.color_mag[known] / COLOR_STEP)
    if columns.flags is not None:
        raw["flags"] = columns.flags
    raw["curve"] = columns.error_curve
    return raw


def raw_places(
    ra_deg: Array, dec_deg: Array, mag: Array
) -> tuple[NDArray[np.uint32], NDArray[np.int32], NDArray[np.uint16]]:
    """Right ascension, declination and magnitude in steps.

    Parameters
    ----------
    ra_deg, dec_deg, mag : ndarray, shape (n,)
        Within the ranges that `require_writable` asks for.
    """
    ra = (np.rint(ra_deg / RA_STEP_DEG).astype(np.int64) % 2**32).astype(np.uint32)
    dec = np.rint(dec_deg / DEC_STEP_DEG).astype(np.int32)
    return ra, dec, np.rint((mag - MAG_ZERO) / MAG_STEP).astype(np.uint16)


def pixels_of(raw: Raw, nside: int) -> Indices:
    """NESTED pixel of each star; `nside` a power of two up to `KEY_NSIDE`."""
    return raw["key"].astype(np.int64) >> key_shift(nside)


def key_shift(nside: int) -> int:
    """By how many bits a key is finer than a pixel of `nside`."""
    return 2 * (KEY_NSIDE.bit_length() - nside.bit_length())


def sorted_order(raw: Raw, nside: int) -> Indices:
    """Order of the packed form: pixel, magnitude, then all that a star has, so that it is the same each time.

    Parameters
    ----------
    raw : ndarray of RAW, shape (n,)
    nside : int
        Of the pixels.

    Returns
    -------
    ndarray of int, shape (n,)
    """
    first = (pixels_of(raw, nside) << 16) | raw["mag"]
    order: Indices = np.argsort(first)
    same = first[order[1:]] == first[order[:-1]]
    tied = np.flatnonzero(np.concatenate((same, [False])) | np.concatenate(([False], same)))
    if tied.size:
        members = order[tied]
        found = raw[members]
        curve = found["curve"]
        rest = [curve[:, 2], curve[:, 1], curve[:, 0]]
        rest += [found[field] for field in ("flags", "color", "pm_dec", "pm_ra", "dec", "ra")]
        order[tied] = members[np.lexsort((*rest, first[members]))]
    return order


def speeds_mas_yr(raw: Raw) -> Array:
    """Proper motion in the direction it goes; 0 where unknown. Shape (n,)."""
    known = raw["pm_ra"] != RAW_PM_UNKNOWN
    speed: Array = np.where(
        known, np.hypot(raw["pm_ra"].astype(np.float64), raw["pm_dec"].astype(np.float64)), 0.0
    )
    return speed * PM_STEP_MAS_YR
