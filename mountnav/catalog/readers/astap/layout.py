"""The layout of ASTAP's area files: the division of the sky, the head of 110 bytes, the records.

The two divisions of the sky in ASTAP's databases: rings of declination cut into cells of right ascension.

Source: the comments and tables of unit_star_database.pas of ASTAP, and name1476/name290 of the author's own
programs that make the databases (Han Kleijn, MPL-2.0). A file is called ``<database>_RRCC.<areas>``: ring RR
from the south pole, cell CC from right ascension 0, both from 1. A star at the border of two rings is in the
northern one.

- ``.290``: 18 rings; k of the 289 parts of a hemisphere lie beyond an edge, k = 1, 9, 25, ... 225, 289
  (Gringorten and Yepez 1992); ASTAP's solver took such files written by benchmarks/peers/astap_stars.py.
- ``.1476``: 36 rings of 90/17.5 degrees, the polar ones of half that;
  tests/catalog/readers/test_astap_solves.py has ASTAP's solver take such files.

The records of ASTAP's and HNSKY's area files: from bytes to places, magnitudes and colors.

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

The 110 bytes at the head of each area file: what the database is, in words, and how long a record is.

Source: the program that makes the databases (gaia_to_1476unit.pas, Han Kleijn) and ASTAP's open_database.
The head is text, such as ``GAIA DR3, density<=5000 stars/sqr(degree), Epoch=2025. Including 82 bright Tycho2
stars. Magnitude is Gaia BP.``; byte 109 is the length of a record (a space: 11). Byte 108 is the version of
the color byte where there is one (2: B-V), in older databases ten times the faintest magnitude, and where
the text is as long as that of D50, a letter of it: the P of BP.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at

Array = NDArray[np.float64]

_SOUTH_290 = (1, 4, 8, 12, 16, 20, 24, 28, 32)
"""Cells of the rings of the southern sky in the .290 division, pole first."""
_SOUTH_1476 = (1, 3, 9, 15, 21, 27, 33, 38, 43, 48, 52, 56, 60, 63, 65, 67, 68, 69)
"""The same of the .1476 division."""
CELLS: dict[int, tuple[int, ...]] = {
    290: _SOUTH_290 + _SOUTH_290[::-1],
    1476: _SOUTH_1476 + _SOUTH_1476[::-1],
}
"""Cells of each ring, south pole first, for each division."""
_FILE_NAME = re.compile(r"(?P<database>[a-z0-9]+)_(?P<ring>\d\d)(?P<cell>\d\d)\.(?P<areas>290|1476)", re.I)


@cache
def ring_edges_deg(areas: int) -> Array:
    """Declinations between which the rings lie, south pole first; one more than there are rings."""
    if areas == 290:
        south = -np.degrees(np.arcsin(1.0 - np.arange(1, 18, 2) ** 2 / 289.0))
    else:
        south = np.concatenate((90.0 / 17.5 * (np.arange(17) + 0.5) - 90.0, [0.0]))
    return np.concatenate(([-90.0], south, -south[-2::-1], [90.0]))


@dataclass(frozen=True, slots=True)
class Area:
    """A piece of the sky with a file of its own.

    Attributes
    ----------
    database : str
        Which database: "d50".
    areas : int
        Which division: 290 or 1476.
    ring, cell : int
        From 1.
    """

    database: str
    areas: int
    ring: int
    cell: int

    @property
    def label(self) -> str:
        """As in the file's name: "0101"."""
        return f"{self.ring:02d}{self.cell:02d}"

    @property
    def dec_range_deg(self) -> tuple[float, float]:
        """South and north edge."""
        edges = ring_edges_deg(self.areas)
        return float(edges[self.ring - 1]), float(edges[self.ring])

    @property
    def ra_range_deg(self) -> tuple[float, float]:
        """West and east edge, 0 to 360."""
        width = 360.0 / CELLS[self.areas][self.ring - 1]
        return (self.cell - 1) * width, self.cell * width

    def outside(self, ra_deg: Array, dec_deg: Array, slack_deg: float) -> NDArray[np.bool_]:
        """Which positions lie outside by more than the slack.

        Parameters
        ----------
        ra_deg, dec_deg : ndarray, shape (n,)
            Positions to be checked.
        slack_deg : float
            On the sky.

        Returns
        -------
        ndarray of bool, shape (n,)
            True: outside.
        """
        south, north = self.dec_range_deg
        west, east = self.ra_range_deg
        half = 0.5 * (east - west)
        from_middle = np.abs((ra_deg - west - half + 180.0) % 360.0 - 180.0)
        cos_dec = np.maximum(np.cos(np.radians(dec_deg)), 1e-9)
        beyond: NDArray[np.bool_] = (
            (dec_deg < south - slack_deg)
            | (dec_deg > north + slack_deg)
            | (np.abs(dec_deg) > 90.0)
            | ((from_middle - half) * cos_dec > slack_deg)
        )
        return beyond


def area_of(path: Path) -> Area | None:
    """The area that a file is of, by its name.

    Returns
    -------
    Area or None
        None if it is no name of such a file, or of an area that doesn't exist.
    """
    match = _FILE_NAME.fullmatch(path.name)
    if match is None:
        return None
    areas, ring, cell = int(match["areas"]), int(match["ring"]), int(match["cell"])
    cells = CELLS[areas]
    if not (1 <= ring <= len(cells) and 1 <= cell <= cells[ring - 1]):
        return None
    return Area(match["database"].lower(), areas, ring, cell)


def all_labels(areas: int) -> list[str]:
    """The labels of all areas of a division, south to north."""
    return [
        f"{ring:02d}{cell:02d}"
        for ring, cells in enumerate(CELLS[areas], start=1)
        for cell in range(1, cells + 1)
    ]


Integers = NDArray[np.int64]

RA_STEP_DEG = 360.0 / (256**3 - 1)
"""77 mas."""
DEC_STEP_DEG = 90.0 / (128 * 256**2 - 1)
"""39 mas."""
MAG_STEP = 0.1
"""Magnitudes are whole tenths."""
_MARK = 0xFFFFFF
"""Right ascension of a record that is no star but gives the magnitude of those that follow."""
_NO_COLOR = -128
"""Byte of a star without a color."""
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
    dec_upper_at : int or None
        Upper byte of the declination; None: in the mark.
    mag_at : int or None
        Magnitude of the star; None: in the mark.
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
    file : str
        For errors.
    start : int
        Where the body begins in the file, for errors.

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


HEAD_BYTES = 110
"""Length of the head: the form of the files."""
_TEXT_BYTES = 108
"""Readable in any case; the byte after them may be."""
_VERSION_AT, _SIZE_AT = 108, 109
"""Offsets in the head of the database's version and of the length of a record."""
_B_V_VERSION = 2
"""Databases whose head has this version have B-V as color, others Gaia's BP-RP."""
_EPOCH = re.compile(r"epoch\s*=?\s*J?(\d{4}(?:\.\d+)?)", re.I)
_BAND = re.compile(
    r"magnitude (?:is|transformed to)\s+(?:gaia |johnson-cousins |johnson |cousins )?(BP|RP|V|B|R|Ic)\b", re.I
)
_BAND_OF_LETTER = {"d": "BP", "g": "BP", "h": "BP", "v": "V"}
"""By ASTAP's manual; believed only where the text names Gaia and tells no band."""
UNTOLD_EPOCH_YR, UNTOLD_EPOCH_SIGMA_YR = 2012.5, 8.0
"""Where the text tells no epoch: anything from J2000 (HNSKY's old ones) to 2025."""
UNKNOWN_BAND = "unknown"
_EPOCHS_YR = (1950.0, 2100.0)
"""Julian years between which an epoch in the head is believed; another is a damaged head."""


@dataclass(frozen=True, slots=True)
class Head:
    """What a head states.

    Attributes
    ----------
    layout : Layout
        Of the records.
    epoch_yr : float
        Julian year of the places: the databases are made of Gaia's, moved to it by proper motion.
    epoch_sigma_yr : float
        0 where the text tells the epoch.
    band : str
        Of the magnitudes; "unknown" if the text doesn't tell.
    color_name : str
        "B-V", "BP-RP", or empty.
    """

    text: str
    layout: Layout
    epoch_yr: float
    epoch_sigma_yr: float
    band: str
    color_name: str


def parse_head(head: bytes, file: str, database: str) -> Head:
    """Understand a head.

    Parameters
    ----------
    head : bytes
        The file's first `HEAD_BYTES`, or fewer if it has no more.
    file : str
        Its name, for errors.
    database : str
        Which database, by the file's name: "d50".

    Raises
    ------
    BadCatalog
        Too short, no text, no known length of a record, or an impossible epoch.
    """
    if len(head) < HEAD_BYTES:
        raise malformed_at(file, len(head), f"a head of {HEAD_BYTES} bytes", "the end of the file")
    for offset, byte in enumerate(head[:_TEXT_BYTES]):
        if not (0x20 <= byte < 0x7F or byte in (0, 1, 2)):
            raise malformed_at(file, offset, "readable text", f"byte 0x{byte:02x}")
    text = " ".join(re.sub(r"[^ -~]", " ", head[: _TEXT_BYTES + 1].decode("latin-1")).split())
    size = 11 if head[_SIZE_AT] == 0x20 else head[_SIZE_AT]
    if size not in LAYOUTS:
        raise malformed_at(
            file, _SIZE_AT, f"the length of a record ({', '.join(map(str, LAYOUTS))})", str(head[_SIZE_AT])
        )
    layout = LAYOUTS[size]
    epoch = _EPOCH.search(text)
    if epoch and not _EPOCHS_YR[0] <= float(epoch[1]) <= _EPOCHS_YR[1]:
        raise malformed_at(
            file, head.lower().find(b"epoch"), "an epoch of {:.0f} to {:.0f}".format(*_EPOCHS_YR), epoch[1]
        )
    color = ("B-V" if head[_VERSION_AT] == _B_V_VERSION else "BP-RP") if layout.color_at is not None else ""
    return Head(
        text=text,
        layout=layout,
        epoch_yr=float(epoch[1]) if epoch else UNTOLD_EPOCH_YR,
        epoch_sigma_yr=0.0 if epoch else UNTOLD_EPOCH_SIGMA_YR,
        band=_band(text, database),
        color_name=color,
    )


def _band(text: str, database: str) -> str:
    told = _BAND.search(text)
    if told:
        band = told[1].upper()
        return "I" if band == "IC" else band
    if "gaia" in text.lower():
        return _BAND_OF_LETTER.get(database[:1], UNKNOWN_BAND)
    return UNKNOWN_BAND
