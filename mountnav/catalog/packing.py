"""The writer of the packed form: columns of stars in, one file out, the same bytes each time."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy import units
from astropy_healpix import lonlat_to_healpix
from numpy.typing import NDArray

from mountnav.catalog.error_classes import classify
from mountnav.catalog.packed_format import (
    DEC_STEP_DEG,
    FAST,
    LARGEST_PM_RAW,
    MAG_STEP,
    MAG_ZERO,
    OFFSET,
    PM_IN_SIDECAR,
    PM_STEP_MAS_YR,
    PM_UNKNOWN,
    RA_STEP_DEG,
    STAR,
    Header,
    encode_header,
)

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CatalogColumns:
    """Stars to be packed; each array has shape (n,) unless said.

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS at the epoch of the file.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        NaN in both where unknown.
    mag
        In the band of the file, -5 to 60.
    error_curve
        Shape (n, 3): from `mountnav.catalog.error_classes.error_curve`.
    """

    ra_deg: Array
    dec_deg: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    mag: Array
    error_curve: Array


def pack(
    columns: CatalogColumns, path: Path, *, name: str, band: str, epoch_yr: float, nside: int = 64
) -> Header:
    """Write a packed catalog.

    Parameters
    ----------
    columns : CatalogColumns
    path : Path
        The file to write; replaced only when the new one is complete.
    name, band : str
    epoch_yr : float
        Julian year of the positions.
    nside : int
        HEALPix resolution; 64 (level 6) suits a few million stars.

    Returns
    -------
    Header
        As written.

    Raises
    ------
    ValueError
        A value is not finite or cannot be written.
    """
    _require_writable(columns)
    pixel = lonlat_to_healpix(
        columns.ra_deg * units.deg, columns.dec_deg * units.deg, nside=nside, order="nested"
    )
    mag = np.rint((columns.mag - MAG_ZERO) / MAG_STEP).astype(np.uint16)
    ra = (np.rint(columns.ra_deg / RA_STEP_DEG).astype(np.int64) % 2**32).astype(np.uint32)
    dec = np.rint(columns.dec_deg / DEC_STEP_DEG).astype(np.int32)
    order = np.lexsort((dec, ra, mag, pixel))

    code, classes = classify(columns.error_curve)
    stars = np.zeros(order.size, dtype=STAR)
    stars["ra"], stars["dec"], stars["mag"], stars["error"] = ra[order], dec[order], mag[order], code[order]
    pm = np.vstack([columns.pm_ra_cosdec_mas_yr[order], columns.pm_dec_mas_yr[order]])
    unknown = np.isnan(pm).any(axis=0)
    raw = np.rint(np.where(unknown, 0.0, pm) / PM_STEP_MAS_YR).astype(np.int32)
    is_fast = (np.abs(raw) > LARGEST_PM_RAW).any(axis=0)
    for field, values in zip(("pm_ra", "pm_dec"), raw, strict=True):
        stars[field] = np.where(unknown, PM_UNKNOWN, np.where(is_fast, PM_IN_SIDECAR, values))
    fast = np.zeros(int(is_fast.sum()), dtype=FAST)
    fast["star"] = np.flatnonzero(is_fast)
    fast["pm_ra"], fast["pm_dec"] = raw[:, is_fast]

    first = np.searchsorted(pixel[order], np.arange(12 * nside**2 + 1)).astype(OFFSET)
    sections = [first.tobytes(), classes.tobytes(), fast.tobytes(), stars.tobytes()]
    digest = hashlib.sha256()
    for section in sections:
        digest.update(section)
    header = Header(
        name=name,
        band=band,
        epoch_yr=epoch_yr,
        nside=nside,
        count=order.size,
        class_count=classes.shape[0],
        fast_count=fast.size,
        fastest_mas_yr=round(float(np.hypot(*raw).max()) * PM_STEP_MAS_YR + 0.1, 1),
        sections_sha256=digest.hexdigest(),
    )
    part = path.with_name(path.name + ".part")
    with part.open("wb") as out:
        out.write(encode_header(header))
        for section in sections:
            out.write(section)
    part.replace(path)
    return header


def _require_writable(columns: CatalogColumns) -> None:
    if columns.ra_deg.size == 0:
        raise ValueError("a catalog of no stars can't be packed")
    if not (np.all((columns.ra_deg >= 0) & (columns.ra_deg <= 360)) and np.all(abs(columns.dec_deg) <= 90)):
        raise ValueError("RA must be within 0..360 and declination within -90..90 degrees")
    if not np.all((columns.mag >= MAG_ZERO) & (columns.mag <= MAG_ZERO + MAG_STEP * 65535)):
        raise ValueError(f"magnitudes must be within {MAG_ZERO}..{MAG_ZERO + MAG_STEP * 65535:.3f}")
    if not np.all(np.isfinite(columns.error_curve)) or not np.all(columns.error_curve[:, 0] > 0):
        raise ValueError("error curves must be finite and positive")
    if not np.array_equal(np.isnan(columns.pm_ra_cosdec_mas_yr), np.isnan(columns.pm_dec_mas_yr)):
        raise ValueError("a proper motion must be known in both coordinates or in neither")
