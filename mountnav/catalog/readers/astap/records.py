"""The records of ASTAP's and HNSKY's area files: from bytes to places, magnitudes and colors.

Source: unit_star_database.pas of ASTAP (records of 5 and 6 bytes) and hns_U290.pas of HNSKY (all of them),
Han Kleijn. Least byte first: right ascension in 3 bytes (360 degrees / 0xFFFFFF), declination in 3 signed
bytes (90 degrees / 0x7FFFFF). Where a record has no room for the upper byte of the declination and the
magnitude, a *mark* before it tells them: right ascension 0xFFFFFF, in the first byte of the declination its
upper byte + 128, in the second ten times the magnitude + 16. Stars come brightest first.

=====  ==  ===========  ===================  =====  ========================================================
bytes  id  declination  magnitude            color  used by
=====  ==  ===========  ===================  =====  ========================================================
5      -   2 + mark     mark                 -      D05, D20, D50, D80, G05, H17, H18, G17, G18
6      -   2 + mark     mark                 1      V05, V50, V17 (B-V x 50 or BP-RP x 10; -128: unknown)
7      -   3            last byte            -      not in use
9      4   2 + mark     mark                 -      HNSKY's TUC (Tycho-2 and UCAC4)
10     4   3            mark, its last byte  -      HNSKY's Tycho-2
11     4   3            last byte            -      not in use
=====  ==  ===========  ===================  =====  ========================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

RA_STEP_DEG = 360.0 / (256**3 - 1)
"""77 mas."""
DEC_STEP_DEG = 90.0 / (128 * 256**2 - 1)
"""39 mas."""
MAG_STEP = 0.1
_MARK = 0xFFFFFF
_NO_COLOR = -128
_FAINT_TENTHS = 150
"""Databases made before 2021 hold a few stars at right ascension 360 degrees, which look like marks: fainter
than 15.0, where a mark would have to be fainter than the one before [HNSKY, hns_U290.pas, 2019-8-18]."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where things are in a record; None: they are not in it.

    Attributes
    ----------
    size : int
        Bytes.
    ra_at : int
    dec_upper_at : int or None
        Upper byte of the declination; None: in the mark.
    mag_at : int or None
        Magnitude of the star; None: in the mark.
    color_at : int or None
    """

    size: int
    ra_at: int
    dec_upper_at: int | None = None
    mag_at: int | None = None
    color_at: int | None = None


LAYOUTS: dict[int, Layout] = {
    5: Layout(5, 0),
    6: Layout(6, 0, color_at=5),
    7: Layout(7, 0, dec_upper_at=5, mag_at=6),
    9: Layout(9, 4),
    10: Layout(10, 4, dec_upper_at=9),
    11: Layout(11, 4, dec_upper_at=9, mag_at=10),
}


@dataclass(frozen=True, slots=True)
class Decoded:
    """Stars of a file; each array has shape (n,).

    Attributes
    ----------
    ra_deg, dec_deg, mag
    color_raw
        The color byte; NaN where it says "unknown" or there is none.
    offset
        Where in the file each star's record begins.
    """

    ra_deg: Array
    dec_deg: Array
    mag: Array
    color_raw: Array
    offset: Integers


def decode(body: bytes, layout: Layout, file: str, start: int) -> Decoded:
    """Read all records of a file.

    Parameters
    ----------
    body : bytes
        All of the file after its head.
    layout : Layout
    file : str
        For errors.
    start : int
        Where the body begins in the file, for errors.

    Returns
    -------
    Decoded

    Raises
    ------
    BadCatalog
        The body ends within a record or with a mark, begins without a mark, or a magnitude is brighter than
        the one before. Whether a file was cut between two records can't be seen.
    """
    count, rest = divmod(len(body), layout.size)
    if rest:
        raise malformed_at(
            file,
            start + count * layout.size,
            f"records of {layout.size} bytes to the end",
            f"{rest} bytes",
        )
    if count == 0:
        raise malformed_at(file, start, "stars", "the end of the file")
    rows = np.frombuffer(body, dtype=np.uint8).reshape(count, layout.size).astype(np.int64)
    ra_raw = rows[:, layout.ra_at] | rows[:, layout.ra_at + 1] << 8 | rows[:, layout.ra_at + 2] << 16
    low, middle = rows[:, layout.ra_at + 3], rows[:, layout.ra_at + 4]
    offset = start + np.arange(count, dtype=np.int64) * layout.size
    if layout.mag_at is not None:
        star = np.ones(count, dtype=bool)
        tenths = _wrapped_tenths(rows[:, layout.mag_at])
        _require_brightest_first(tenths, offset, file)
        last_mark = np.arange(count)
    else:
        marked = middle - 16 if layout.dec_upper_at is None else _wrapped_tenths(rows[:, layout.dec_upper_at])
        star, last_mark = _marks(ra_raw, marked, offset, file)
        tenths = marked[last_mark]
    upper = low[last_mark] - 128 if layout.dec_upper_at is None else _signed(rows[:, layout.dec_upper_at])
    dec_raw = (upper << 16) + (middle << 8) + low
    color = np.full(count, np.nan)
    if layout.color_at is not None:
        signed = _signed(rows[:, layout.color_at])
        color = np.where(signed == _NO_COLOR, np.nan, signed.astype(np.float64))
    return Decoded(
        ra_deg=ra_raw[star].astype(np.float64) * RA_STEP_DEG,
        dec_deg=dec_raw[star].astype(np.float64) * DEC_STEP_DEG,
        mag=tenths[star].astype(np.float64) * MAG_STEP,
        color_raw=color[star],
        offset=offset[star],
    )


def _marks(
    ra_raw: Integers, marked_tenths: Integers, offset: Integers, file: str
) -> tuple[NDArray[np.bool_], Integers]:
    """Which records are stars, and for each record the number of the mark that holds for it."""
    looks_marked = ra_raw == _MARK
    if not looks_marked[0]:
        raise malformed_at(
            file,
            int(offset[0]),
            "a mark (right ascension 0xFFFFFF) before the first star",
            f"right ascension 0x{int(ra_raw[0]):06X}",
        )
    places = np.flatnonzero(looks_marked)
    tenths = marked_tenths[places]
    faintest = np.maximum.accumulate(tenths)
    step_back = tenths < faintest
    # a star at 360 degrees, written by an old program, is no mark
    is_star = step_back & (faintest >= _FAINT_TENTHS)
    if np.any(step_back & ~is_star):
        first = int(np.flatnonzero(step_back & ~is_star)[0])
        raise malformed_at(
            file,
            int(offset[places[first]]),
            f"a magnitude not brighter than {faintest[first] / 10:.1f} (brightest stars come first)",
            f"{tenths[first] / 10:.1f}",
        )
    places = places[~is_star]
    star = np.ones(ra_raw.size, dtype=bool)
    star[places] = False
    if not star[-1]:
        raise malformed_at(file, int(offset[-1]), "a star after the last mark", "the end of the file")
    last_mark = places[np.searchsorted(places, np.arange(ra_raw.size), side="right") - 1]
    return star, last_mark


def _require_brightest_first(tenths: Integers, offset: Integers, file: str) -> None:
    back = np.flatnonzero(np.diff(tenths) < 0)
    if back.size:
        row = int(back[0]) + 1
        raise malformed_at(
            file,
            int(offset[row]),
            f"a magnitude not brighter than {tenths[row - 1] / 10:.1f} (brightest stars come first)",
            f"{tenths[row] / 10:.1f}",
        )


def _signed(byte: Integers) -> Integers:
    return np.where(byte > 127, byte - 256, byte)


def _wrapped_tenths(byte: Integers) -> Integers:
    """Ten times the magnitude in one byte: -19 to 127 as they are, and up to 236 wrapped."""
    signed = _signed(byte)
    return np.where(signed > -20, signed, signed + 256)
