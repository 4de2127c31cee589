"""The cards of a FITS header as plain values and comments; a card that breaks the standard stops nothing.

astropy reads headers too, but it warns of each odd card, and warnings can only be silenced for the whole
process (`warnings.catch_warnings` swaps global state), while frames are read in several threads at once.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from mountnav.reading.content import Content

Value = str | int | float | bool

CARD_LENGTH = 80
BLOCK_LENGTH = 2880
_BLOCKS_AT_ONCE = 4
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
            more, comment = _parsed(card[8:])
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
        value, comment = _parsed(field)
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


def _parsed(field: str) -> tuple[Value | None, str]:
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
