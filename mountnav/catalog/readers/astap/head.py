"""The 110 bytes at the head of each area file: what the database is, in words, and how long a record is.

Source: the program that makes the databases (gaia_to_1476unit.pas, Han Kleijn) and ASTAP's open_database.
The head is text, such as ``GAIA DR3, density<=5000 stars/sqr(degree), Epoch=2025. Including 82 bright Tycho2
stars. Magnitude is Gaia BP.``; byte 109 is the length of a record (a space: 11). Byte 108 is the version of
the color byte where there is one (2: B-V), in older databases ten times the faintest magnitude, and where
the text is as long as that of D50, a letter of it: the P of BP.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.readers.astap.records import LAYOUTS, Layout

HEAD_BYTES = 110
_TEXT_BYTES = 108
"""Readable in any case; the byte after them may be."""
_VERSION_AT, _SIZE_AT = 108, 109
_B_V_VERSION = 2
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


@dataclass(frozen=True, slots=True)
class Head:
    """What a head tells.

    Attributes
    ----------
    text : str
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

    Returns
    -------
    Head

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
