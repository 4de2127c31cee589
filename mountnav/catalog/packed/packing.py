"""Packing in memory: columns of some million stars in, one file out, the same bytes each time.

What doesn't fit into memory goes through `mountnav.catalog.packed.spool`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import classify
from mountnav.catalog.packed.fast_stars import FAST_LIMITS_MAS_YR, fast_limit
from mountnav.catalog.packed.format import Header
from mountnav.catalog.packed.raw_stars import raw_stars, sorted_order, speeds_mas_yr
from mountnav.catalog.packed.writer import PackedFacts, PackedShape, PackedWriter

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
        Shape (n, 3): from `mountnav.catalog.packed.error_classes.error_curve`.
    color_mag
        Color index; NaN where unknown. None if the catalog has no colors.
    flags
        Bits of `mountnav.catalog.stars.StarFlag`, uint8. None if the catalog has no flags.
    """

    ra_deg: Array
    dec_deg: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    mag: Array
    error_curve: Array
    color_mag: Array | None = None
    flags: NDArray[np.uint8] | None = None


def pack(
    columns: CatalogColumns,
    path: Path,
    *,
    name: str,
    band: str,
    epoch_yr: float,
    nside: int = 64,
    color_name: str = "",
    made_from: str = "",
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
        HEALPix resolution; 64 (level 6) suits a few million stars. A file has 6 bytes for each of 12 nside²
        pixels: take 1 to 8 for a few thousand stars of a small piece of the sky.
    color_name : str
        "B-V", "BP-RP"; without it the colors are left out.
    made_from : str
        One line for people.

    Returns
    -------
    Header
        As written.

    Raises
    ------
    ValueError
        A value is not finite or cannot be written.
    BadSettings
        The folder can't be written, or there is no room.
    """
    if columns.ra_deg.size == 0:
        raise ValueError("a catalog of no stars can't be packed")
    raw = raw_stars(columns)
    order = sorted_order(raw, nside)
    code, classes = classify(columns.error_curve)
    speed = speeds_mas_yr(raw)
    slow_mas_yr, fast_count = fast_limit([int(np.sum(speed > limit)) for limit in FAST_LIMITS_MAS_YR])
    shape = PackedShape(nside, raw.size, classes.shape[0], fast_count, slow_mas_yr, columns.flags is not None)
    facts = PackedFacts(name, band, epoch_yr, color_name, made_from)
    with PackedWriter(path, facts, shape) as writer:
        writer.write(raw[order], code[order], 12 * nside**2)
        return writer.finish(classes)
