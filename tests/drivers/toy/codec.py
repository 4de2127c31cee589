"""The toy's words: lines of text, answered by lines of text; no I/O.

who                     ->  toy 1.0
where                   ->  123.4567 -12.3456 0 1      right ascension, declination (degrees), slews, tracks
goto 123.4567 -12.3456  ->  ok, or no and a reason
sync 123.4567 -12.3456  ->  ok, or no and a reason
stop                    ->  nothing
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from drivers.wire.command import Command, Read, Unreadable

T = TypeVar("T")
STEP_ARCSEC = 0.36
"""The smallest step of a coordinate: four decimals of a degree."""


@dataclass(frozen=True, slots=True)
class Where:
    """Where the mount points, and what it does."""

    ra_deg: float
    dec_deg: float
    slewing: bool
    tracking: bool


def line(understand: Callable[[str], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """Reader of a whole line, understood by a function that raises `Unreadable` for what it is not."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        end = buffer.find(b"\n")
        return None if end < 0 else Read(understand(buffer[:end].decode("latin-1")), end + 1)

    return read


_WHERE = re.compile(r"(\d{1,3}\.\d{4}) ([+-]\d{1,2}\.\d{4}) ([01]) ([01])")


def where_from_text(text: str) -> Where:
    """Read the answer to ``where``."""
    match = _WHERE.fullmatch(text)
    if match is None or float(match[1]) >= 360.0 or abs(float(match[2])) > 90.0:
        raise Unreadable(f"{text!r} is no place")
    return Where(float(match[1]), float(match[2]), match[3] == "1", match[4] == "1")


def where_to_text(where: Where) -> str:
    """Write the answer to ``where``, as the fake does."""
    ra_deg = round(where.ra_deg, 4) % 360.0
    return f"{ra_deg:.4f} {where.dec_deg:+.4f} {where.slewing:d} {where.tracking:d}"


def _name(text: str) -> str:
    if not text.startswith("toy "):
        raise Unreadable(f"{text!r} is not a toy")
    return text


def _refusal(text: str) -> str | None:
    if text == "ok":
        return None
    if not text.startswith("no "):
        raise Unreadable(f"{text!r} is neither ok nor no")
    return text.removeprefix("no ")


def _nothing(buffer: bytes, final: bool) -> Read[None] | None:
    return Read(None, 0)


WHO: Command[str] = Command(b"who\n", "name and version", line(_name))
WHERE: Command[Where] = Command(b"where\n", "where it points", line(where_from_text))
STOP: Command[None] = Command(b"stop\n", "stop", _nothing, answered=False)


def slew(ra_deg: float, dec_deg: float) -> Command[str | None]:
    """Order a slew; the answer is None, or why not."""
    return _order("goto", ra_deg, dec_deg)


def sync(ra_deg: float, dec_deg: float) -> Command[str | None]:
    """Order a sync; the answer is None, or why not."""
    return _order("sync", ra_deg, dec_deg)


def _order(word: str, ra_deg: float, dec_deg: float) -> Command[str | None]:
    sent = f"{word} {round(ra_deg, 4) % 360.0:.4f} {dec_deg:+.4f}\n"
    # sent once: after a lost answer the readings tell what became of it
    return Command(sent.encode(), word, line(_refusal), repeatable=False)
