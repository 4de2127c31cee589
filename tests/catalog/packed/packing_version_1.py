"""The writer of version 1: the recipe of the embedded catalog must go on giving the same bytes."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from mountnav.catalog.packed.error_classes import classify
from mountnav.catalog.packed.format import (
    FAST_1,
    LARGEST_PM_RAW,
    OFFSET,
    PM_IN_SIDECAR,
    PM_STEP_MAS_YR,
    PM_UNKNOWN,
    STAR,
    Header,
    encode_header,
)
from mountnav.catalog.packed.packing import CatalogColumns, Indices, raw_places, require_writable


def order_of_version_1(columns: CatalogColumns, nside: int) -> tuple[Indices, Indices]:
    """Which star comes where.

    Parameters
    ----------
    columns : CatalogColumns
    nside : int

    Returns
    -------
    order, pixel : ndarray of int, shape (n,)
        Star numbers in the order of the file; the pixel of each star in the order of `columns`.
    """
    from astropy import units
    from astropy_healpix import lonlat_to_healpix

    pixel = lonlat_to_healpix(
        columns.ra_deg * units.deg, columns.dec_deg * units.deg, nside=nside, order="nested"
    )
    ra, dec, mag = raw_places(columns.ra_deg, columns.dec_deg, columns.mag)
    return np.lexsort((dec, ra, mag, pixel)), pixel


def pack_version_1(
    columns: CatalogColumns, path: Path, *, name: str, band: str, epoch_yr: float, nside: int = 64
) -> Header:
    """Write a packed catalog without colors and flags.

    Parameters
    ----------
    columns : CatalogColumns
    path : Path
        The file to write; replaced only when the new one is complete.
    name, band : str
    epoch_yr : float
        Julian year of the positions.
    nside : int
        HEALPix resolution.

    Returns
    -------
    Header
        As written.

    Raises
    ------
    ValueError
        A value is not finite or cannot be written.
    """
    if columns.ra_deg.size == 0:
        raise ValueError("a catalog of no stars can't be packed")
    require_writable(columns)
    order, pixel = order_of_version_1(columns, nside)
    ra, dec, mag = raw_places(columns.ra_deg, columns.dec_deg, columns.mag)
    code, classes = classify(columns.error_curve)
    stars = np.zeros(order.size, dtype=STAR)
    stars["ra"], stars["dec"], stars["mag"], stars["error"] = ra[order], dec[order], mag[order], code[order]
    pm = np.vstack([columns.pm_ra_cosdec_mas_yr[order], columns.pm_dec_mas_yr[order]])
    unknown = np.isnan(pm).any(axis=0)
    raw = np.rint(np.where(unknown, 0.0, pm) / PM_STEP_MAS_YR).astype(np.int32)
    is_fast = (np.abs(raw) > LARGEST_PM_RAW).any(axis=0)
    for field, values in zip(("pm_ra", "pm_dec"), raw, strict=True):
        stars[field] = np.where(unknown, PM_UNKNOWN, np.where(is_fast, PM_IN_SIDECAR, values))
    fast = np.zeros(int(is_fast.sum()), dtype=FAST_1)
    fast["star"] = np.flatnonzero(is_fast)
    fast["pm_ra"], fast["pm_dec"] = raw[:, is_fast]

    first = np.searchsorted(pixel[order], np.arange(12 * nside**2 + 1)).astype(OFFSET)
    sections = [first.tobytes(), classes.tobytes(), fast.tobytes(), stars.tobytes()]
    digest = hashlib.sha256()
    for section in sections:
        digest.update(section)
    fastest_mas_yr = round(float(np.hypot(*raw).max()) * PM_STEP_MAS_YR + 0.1, 1)
    header = Header(
        name=name,
        band=band,
        epoch_yr=epoch_yr,
        nside=nside,
        count=order.size,
        class_count=classes.shape[0],
        fast_count=fast.size,
        fastest_mas_yr=fastest_mas_yr,
        sections_sha256=digest.hexdigest(),
        version=1,
        slow_mas_yr=fastest_mas_yr,
    )
    part = path.with_name(path.name + ".part")
    with part.open("wb") as out:
        out.write(encode_header(header))
        for section in sections:
            out.write(section)
    part.replace(path)
    return header
