"""The embedded catalog in the .290 format that ASTAP reads: Debian has the program but no star database.

The format [HNSKY and ASTAP, star databases]: 290 files, one for each area of the sky in 18 rings of
declination; 110 bytes of text whose last byte is the size of a record, then records of 5 bytes, brightest
first: right ascension in 3 bytes and the lower two bytes of the declination. Wherever the declination's upper
byte or the magnitude (in tenths) changes, a record with a right ascension of 0xFFFFFF tells both.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.stars import Catalog
from mountnav.sky.coordinates import Icrs

NAME = "g17"
RING_AREAS = (1, 4, 8, 12, 16, 20, 24, 28, 32, 32, 28, 24, 20, 16, 12, 8, 4, 1)
"""Areas of each ring, south pole first."""
_HEADER_BYTES, _RECORD_BYTES = 110, 5
_MARK = 0xFFFFFF
_UNKNOWN_MAG = 12.0
Bytes = NDArray[np.uint8]


def ring_tops_deg() -> NDArray[np.float64]:
    """Upper declination of each ring: k of 289 parts of a hemisphere lie below the odd squares k."""
    odd_squares = np.arange(1, 17, 2) ** 2
    south = -np.degrees(np.arcsin(1.0 - odd_squares / 289.0))
    return np.concatenate((south, [0.0], -south[::-1], [90.0]))


def write_database(catalog: Catalog, folder: Path, *, epoch_yr: float) -> int:
    """Write every star of a catalog.

    Parameters
    ----------
    catalog : Catalog
    folder : Path
        Gets the files "g17_0101.290" to "g17_1801.290".
    epoch_yr : float
        Julian year the places hold for.

    Returns
    -------
    int
        Stars written.
    """
    stars = catalog.cone(Icrs(0.0, 90.0), 180.0, epoch_yr=epoch_yr)
    ra, dec = stars.ra_deg % 360.0, stars.dec_deg
    tenths = np.rint(10.0 * np.where(np.isfinite(stars.mag), stars.mag, _UNKNOWN_MAG)).astype(np.int64)
    ring = np.minimum(np.searchsorted(ring_tops_deg(), dec, side="left"), len(RING_AREAS) - 1)
    areas = np.array(RING_AREAS)[ring]
    area = np.minimum(np.floor(ra * areas / 360.0).astype(np.int64), areas - 1)
    ra_raw = np.minimum(np.rint(np.radians(ra) * ((256**3 - 1) / (2 * np.pi))), _MARK - 1).astype(np.int64)
    dec_raw = np.rint(np.radians(dec) * ((128 * 256**2 - 1) / (0.5 * np.pi))).astype(np.int64)
    for number, count in enumerate(RING_AREAS):
        for part in range(count):
            here = np.flatnonzero((ring == number) & (area == part))
            order = here[np.lexsort((dec_raw[here] >> 16, tenths[here]))]
            records = _records(ra_raw[order], dec_raw[order], tenths[order])
            head = b"The embedded catalog of mountnav".ljust(_HEADER_BYTES - 1) + bytes([_RECORD_BYTES])
            path = folder / f"{NAME}_{number + 1:02d}{part + 1:02d}.290"
            path.write_bytes(head + records.tobytes())
    return len(stars)


def _records(ra_raw: NDArray[np.int64], dec_raw: NDArray[np.int64], tenths: NDArray[np.int64]) -> Bytes:
    """Records of stars in order, with those between that tell magnitude and upper byte; shape (n, 5)."""
    upper = dec_raw >> 16
    star = np.empty((ra_raw.size, _RECORD_BYTES), dtype=np.uint8)
    for place, value in enumerate((ra_raw, ra_raw >> 8, ra_raw >> 16, dec_raw, dec_raw >> 8)):
        star[:, place] = value & 0xFF
    changes = np.flatnonzero(np.diff(upper, prepend=-999) | np.diff(tenths, prepend=-999))
    marks = np.full((changes.size, _RECORD_BYTES), 0xFF, dtype=np.uint8)
    marks[:, 3] = upper[changes] + 128
    marks[:, 4] = np.clip(tenths[changes] + 16, 0, 255)
    whole: Bytes = np.insert(star, changes, marks, axis=0)
    return whole
