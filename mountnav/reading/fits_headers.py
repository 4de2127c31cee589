"""FITS headers [FITS 4.0]: the cards of a header, and the header units (HDUs) of a file.

The cards of a FITS header as plain values and comments; a card that breaks the standard stops nothing.

astropy reads headers too, but it warns of each odd card, and warnings can only be silenced for the whole
process (`warnings.catch_warnings` swaps global state), while frames are read in several threads at once.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from mountnav.errors import BadFrame
from mountnav.reading.content import Content

Value = str | int | float | bool

CARD_LENGTH = 80
"""Bytes of a card [FITS 4.0, section 3.3.1]."""
BLOCK_LENGTH = 2880
"""Bytes of a block: headers and data are padded to whole ones [FITS 4.0, section 3.1]."""
COLUMN_BYTES = {
    "L": 1,
    "X": 0,
    "B": 1,
    "I": 2,
    "J": 4,
    "K": 8,
    "A": 1,
    "E": 4,
    "D": 8,
    "C": 8,
    "M": 16,
    "P": 8,
    "Q": 16,
}
"""Bytes of an element of a table's column, by the letter of its TFORM [FITS 4.0, table 18]; bits (X) are
counted apart."""
COLUMN_NUMBERS = {"B": "u1", "I": ">i2", "J": ">i4", "K": ">i8", "E": ">f4", "D": ">f8"}
"""numpy's types of the columns that hold numbers."""
_BLOCKS_AT_ONCE = 4
"""Blocks that are taken at a time while END is looked for; for speed alone."""
_NOT_VALUES = ("COMMENT", "HISTORY", "CONTINUE", "")
_STRING = re.compile(r"'((?:[^']|'')*)'\s*(?:/(.*))?$")
_INTEGER = re.compile(r"[+-]?\d+$")
_REAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([EDed][+-]?\d+)?$")
#: Longer digit strings are no quantity, and Python refuses to convert very long ones.
_MOST_DIGITS = 40


@dataclass(frozen=True, slots=True)
class Cards:
    """A header.

    Attributes
    ----------
    values : dict
        Values by keyword; where a keyword comes twice, the later card counts.
    comments : dict
        Comments by keyword, where there is one.
    length : int
        Bytes that the header takes, with padding.
    """

    values: dict[str, Value]
    comments: dict[str, str]
    length: int

    def integer(self, key: str, default: int = 0) -> int:
        """A whole number, or the default where there is none."""
        value = self.values.get(key, default)
        if isinstance(value, float) and value.is_integer():
            return int(value)
        return value if isinstance(value, int) and not isinstance(value, bool) else default

    def real(self, key: str, default: float) -> float:
        """A number, or the default where there is none."""
        value = self.values.get(key, default)
        return default if isinstance(value, (str, bool)) else float(value)


def read_cards(content: Content, start: int) -> Cards | None:
    """Read the header that starts at an offset.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The whole file.
    start : int
        Offset of the header's first card.

    Returns
    -------
    Cards or None
        None if the file ends before the header does.
    """
    values: dict[str, Value] = {}
    comments: dict[str, str] = {}
    long = _LongString("")  # that the next CONTINUE card goes on with
    for at, card in _cards(content, start):
        key = card[:8].strip()
        if key == "END" and not card[3:].strip(" \0"):
            long.end(values, comments)
            blocks = -(-(at + CARD_LENGTH - start) // BLOCK_LENGTH)
            return Cards(values, comments, blocks * BLOCK_LENGTH)
        if key == "CONTINUE" and long.key:
            more, comment = parsed_value(card[8:])
            long.add(more, comment)
            if not isinstance(more, str) or not more.endswith("&"):
                long.end(values, comments)
                long = _LongString("")
            continue
        key, field = _split(card, key)
        if field is None or key in _NOT_VALUES:
            continue
        long.end(values, comments)
        long = _LongString("")
        value, comment = parsed_value(field)
        if value is not None:
            values[key] = value
            comments.pop(key, None)
            if comment:
                comments[key] = comment
        if isinstance(value, str) and value.endswith("&"):
            long = _LongString(key)
            long.add(value, comment)
    return None


class _LongString:
    """A string over several cards, put together at its end: card by card each would copy all before it.

    Parameters
    ----------
    key : str
        Empty for none.
    """

    def __init__(self, key: str) -> None:
        self.key = key
        self._texts: list[str] = []
        self._comments: list[str] = []

    def add(self, text: Value | None, comment: str) -> None:
        """Go on with a card; what is no string only ends it."""
        if isinstance(text, str):
            self._texts.append(text)
        if comment:
            self._comments.append(comment)

    def end(self, values: dict[str, Value], comments: dict[str, str]) -> None:
        """Write it down; an & stays only where nothing goes on behind it."""
        if len(self._texts) > 1:
            values[self.key] = "".join([*(text[:-1] for text in self._texts[:-1]), self._texts[-1]])
        if len(self._comments) > 1:
            comments[self.key] = " ".join(self._comments)
        elif self._comments:
            comments[self.key] = self._comments[0]


def _cards(content: Content, start: int) -> Iterator[tuple[int, str]]:
    """The whole cards from an offset on, each with its own; some blocks are read at once."""
    for at in range(start, len(content), _BLOCKS_AT_ONCE * BLOCK_LENGTH):
        text = content[at : at + _BLOCKS_AT_ONCE * BLOCK_LENGTH].decode("latin-1")
        for place in range(0, len(text) - CARD_LENGTH + 1, CARD_LENGTH):
            yield at + place, text[place : place + CARD_LENGTH]


def _split(card: str, key: str) -> tuple[str, str | None]:
    """Part a card in keyword and value field; the field is None where there is no value."""
    if key == "HIERARCH" and "=" in card[9:]:
        long_key, _, field = card[9:].partition("=")
        return long_key.strip(), field
    return key, card[9:] if card[8] == "=" else None


def parsed_value(field: str) -> tuple[Value | None, str]:
    """Read a value field: value (None if there is none that can be read) and comment."""
    field = field.strip(" \0")
    if match := _STRING.match(field):
        return match[1].replace("''", "'").rstrip(), (match[2] or "").strip()
    text, _, comment = field.partition("/")
    text, comment = text.strip(), comment.strip()
    if text in ("T", "F"):
        return text == "T", comment
    if len(text) > _MOST_DIGITS or not text or text.startswith("'"):
        return None, comment
    if _INTEGER.match(text):
        return int(text), comment
    if _REAL.match(text):
        return float(text.upper().replace("D", "E")), comment
    return None, comment


#: More pixels than any camera on a telescope has; guards against decompression bombs.
MOST_PIXELS = 300_000_000
_MOST_EXTENSIONS = 10_000
"""Header units that are looked through for a picture; a file of more is one that was made to take long."""
_SIDE_PLANES = re.compile(
    r"(^|[^a-z])(bad|bkg|background|bpm|conf|dq|err|error|errors|exptime|flag|flags|invvar|ivar|mask|masks|"
    r"noise|psf|rms|unc|uncert|uncertainty|var|variance|weight|weights|wht)\d*($|[^a-z])"
)
_BITPIX = (8, 16, 32, 64, -32, -64)
"""Kinds of pixels [FITS 4.0, table 8]."""


@dataclass(frozen=True, slots=True)
class Hdu:
    """A header with its data, not yet read.

    Attributes
    ----------
    number : int
        0 for the primary.
    start, data_start : int
        Offsets of header and data in the file.
    data_length : int
        Bytes of the data, without padding; they may reach beyond the end of the file.
    shape : tuple of int
        Of the image, slowest axis first; empty where there is no image.
    tiled : bool
        It is a table that holds a compressed image.
    """

    number: int
    start: int
    cards: Cards
    data_start: int
    data_length: int
    shape: tuple[int, ...]
    tiled: bool

    @property
    def name(self) -> str:
        """EXTNAME, or nothing."""
        return str(self.cards.values.get("EXTNAME", "PRIMARY" if self.number == 0 else "")).strip()

    @property
    def bitpix(self) -> int:
        """Type of the image's stored numbers."""
        return self.cards.integer("ZBITPIX" if self.tiled else "BITPIX")


def walk(content: Content, label: str) -> list[Hdu]:
    """List a file's headers; what follows the last sound one is passed over.

    Raises
    ------
    BadFrame
        Not even the first one is whole.
    """
    hdus: list[Hdu] = []
    at = 0
    while at < len(content) and len(hdus) < _MOST_EXTENSIONS:
        if hdus and content[at : at + 8] != b"XTENSION":
            break  # some programs append notes
        cards = read_cards(content, at)
        if cards is None:
            if hdus:
                break
            raise BadFrame(
                "this FITS file can't be read: its header has no end",
                device=label,
                advice="it may be damaged or cut short; try it with `fitsverify`",
            )
        hdu = _hdu(len(hdus), at, cards)
        hdus.append(hdu)
        at = hdu.data_start + -(-hdu.data_length // BLOCK_LENGTH) * BLOCK_LENGTH
    return hdus


def _hdu(number: int, start: int, cards: Cards) -> Hdu:
    axes = _axes(cards, "NAXIS")
    size = math.prod(axes) if axes else 0
    groups, extra = max(1, cards.integer("GCOUNT", 1)), max(0, cards.integer("PCOUNT"))
    length = abs(cards.integer("BITPIX")) // 8 * groups * (size + extra)
    kind = "IMAGE" if number == 0 else str(cards.values.get("XTENSION", "")).strip()
    tiled = kind in ("BINTABLE", "A3DTABLE") and cards.values.get("ZIMAGE") is True
    shape: tuple[int, ...] = ()
    if tiled:
        shape = _axes(cards, "ZNAXIS")[::-1]
    elif kind == "IMAGE":
        shape = axes[::-1]
    if len(shape) < 2 or 0 in shape or cards.integer("ZBITPIX" if tiled else "BITPIX") not in _BITPIX:
        shape = ()
    return Hdu(number, start, cards, start + cards.length, length, shape, tiled)


def _axes(cards: Cards, key: str) -> tuple[int, ...]:
    count = min(max(0, cards.integer(key)), 999)
    return tuple(max(0, cards.integer(f"{key}{i}")) for i in range(1, count + 1))


def chosen_hdu(hdus: list[Hdu], wanted: int | str | None, label: str) -> Hdu:
    """Choose the wanted extension, else the largest image: science before masks, the first among equals.

    Raises
    ------
    BadFrame
        There is no such extension, or no image in it, or in none.
    """
    if wanted is not None:
        return _named(hdus, wanted, label)
    images = [hdu for hdu in hdus if hdu.shape]
    if not images:
        raise BadFrame(
            "the FITS file holds no image, only headers or tables",
            device=label,
            advice="send the exposure itself; star lists and tables can't be solved",
        )
    return max(images, key=lambda hdu: (not _SIDE_PLANES.search(hdu.name.lower()), _plane_size(hdu.shape)))


def science_images(hdus: list[Hdu]) -> list[Hdu]:
    """The images of a file, without masks, weights and errors by their names, unless all are such.

    Returns
    -------
    list of Hdu
        In the file's order.
    """
    images = [hdu for hdu in hdus if hdu.shape]
    return [hdu for hdu in images if not _SIDE_PLANES.search(hdu.name.lower())] or images


def _named(hdus: list[Hdu], wanted: int | str, label: str) -> Hdu:
    there = ", ".join(f"{hdu.number} {hdu.name}".strip() for hdu in hdus[:20])
    word = str(wanted).strip().upper()
    found = [hdu for hdu in hdus if isinstance(wanted, str) and hdu.name.upper() == word]
    found += [hdu for hdu in hdus if str(hdu.number) == word]
    if not found:
        raise BadFrame(f"there is no extension {wanted}", device=label, advice=f"choose one of: {there}")
    for hdu in found:
        if hdu.shape:
            return hdu
    raise BadFrame(f"extension {wanted} holds no image", device=label, advice=f"choose another of: {there}")


def _plane_size(shape: tuple[int, ...]) -> int:
    """Pixels of one plane; color may be the first or the last axis."""
    kept = [side for side in shape if side > 1]
    if len(kept) == 3 and kept[2] <= 4 < kept[0]:
        kept = kept[:2]
    return math.prod(kept[-2:])


def check_size(hdu: Hdu, label: str) -> None:
    """Refuse an image of absurd size before any memory is taken for it.

    Raises
    ------
    BadFrame
        More than `MOST_PIXELS` would be read.
    """
    planes = math.prod(hdu.shape) // max(1, _plane_size(hdu.shape))
    read = _plane_size(hdu.shape) * (planes if planes <= 4 or hdu.tiled else 1)
    if read > MOST_PIXELS:
        raise BadFrame(
            f"the image claims {hdu.shape[-1]} × {hdu.shape[-2]} pixels in {planes} planes",
            device=label,
            advice=f"more than {MOST_PIXELS} pixels are not supported",
        )
