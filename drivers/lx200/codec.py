"""The LX200 words: each command's bytes together with the reader of its reply. No wire, no clock.

Nothing in an LX200 reply says where it ends [LX200 link and framing]: `:Sr…#` answers one bare character,
`:GR#` a text up to `#`, `:Q#` nothing at all, and `:MS#` a bare `0` or else a digit with a text up to `#`.
So every command owns its reader. What goes wrong on a real cable, and how reading copes:

- a reply comes in pieces: a reader says None until it is whole;
- a reply is cut, or a bit flips: whatever does not match wholly and within its range is `Unreadable`;
- a late reply comes after the next question: declinations need their sign, so no right ascension is one;
- a reply is longer than any can be: `Unreadable`, rather than waiting for a `#` that never comes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from drivers.command import Command, Read, Unreadable
from drivers.lx200.angles import (
    WireAngle,
    dec_from_text,
    dec_to_text,
    ra_from_text,
    ra_to_text,
)

T = TypeVar("T")
_LONGEST_TEXT = 80
_BAR = 0x7F


class Alignment(StrEnum):
    """How the mount stands, as its ACK answer tells [LX200 0x06]."""

    POLAR = "polar"
    ALTAZ = "altaz"
    LAND = "land"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class SlewAnswer:
    """What `:MS#` answered: `refusal` is None when the slew was taken up, else the mount's own words."""

    refusal: str | None


def _nothing(buffer: bytes, final: bool) -> Read[None] | None:
    return Read(None, 0)


def _text(buffer: bytes, final: bool) -> Read[bytes] | None:
    end = buffer.find(b"#")
    if end < 0:
        if len(buffer) > _LONGEST_TEXT:
            raise Unreadable(f"no end within {_LONGEST_TEXT} bytes: {buffer!r}")
        return None
    if end > _LONGEST_TEXT:
        raise Unreadable(f"longer than {_LONGEST_TEXT} bytes: {buffer!r}")
    return Read(buffer[:end], end + 1)


def _of_text(understand: Callable[[bytes], T]) -> Callable[[bytes, bool], Read[T] | None]:
    def read(buffer: bytes, final: bool) -> Read[T] | None:
        text = _text(buffer, final)
        return None if text is None else Read(understand(text.value), text.length)

    return read


def _yes_or_no(buffer: bytes, final: bool) -> Read[bool] | None:
    if not buffer:
        return None
    if buffer[:1] not in (b"0", b"1"):
        raise Unreadable(f"{buffer!r} is neither 0 nor 1")
    return Read(buffer[:1] == b"1", 1)


def _alignment(buffer: bytes, final: bool) -> Read[Alignment] | None:
    if not buffer:
        return None
    kinds = {b"P": Alignment.POLAR, b"A": Alignment.ALTAZ, b"L": Alignment.LAND}
    # Gemini answers a letter and a `#` [LX200 0x06]
    length = 2 if buffer[1:2] == b"#" else 1
    if buffer[:1] in kinds:
        return Read(kinds[buffer[:1]], length)
    if buffer[:1].isalpha():
        return Read(Alignment.OTHER, length)
    raise Unreadable(f"{buffer!r} is no alignment letter")


def _slew_answer(buffer: bytes, final: bool) -> Read[SlewAnswer] | None:
    if not buffer:
        return None
    if buffer[:1] == b"0":
        return Read(SlewAnswer(None), 1)
    if not buffer[:1].isdigit():
        raise Unreadable(f"{buffer!r} is no answer to a slew")
    text = _text(buffer, final)
    if text is not None:
        words = text.value[1:].decode("ascii", "replace").strip()
        return Read(SlewAnswer(words or f"code {chr(buffer[0])}"), text.length)
    # OnStep says a bare digit: nothing more came, so that was all [ONSTEP :MS#]
    return Read(SlewAnswer(f"code {chr(buffer[0])}"), 1) if final and len(buffer) == 1 else None


def _words(text: bytes) -> str:
    if any(byte < 0x20 or byte == _BAR for byte in text):
        raise Unreadable(f"{text!r} is not plain text")
    return text.decode("latin-1").strip()


def _sync_words(text: bytes) -> str:
    words = _words(text)
    # a coordinate here is the late answer of another question
    if re.fullmatch(r"[+-]?\d{2}\D\d{2}([:.'].*)?", words):
        raise Unreadable(f"{text!r} is no answer to a sync")
    return words


def _bars(text: bytes) -> bool:
    if len(text) > 33 or any(byte not in (0x20, _BAR, 0xFF) for byte in text):
        raise Unreadable(f"{text!r} are no distance bars")
    return any(byte != 0x20 for byte in text)


GET_RA: Command[WireAngle] = Command(b":GR#", "right ascension", _of_text(ra_from_text))
GET_DEC: Command[WireAngle] = Command(b":GD#", "declination", _of_text(dec_from_text))
SLEWING: Command[bool] = Command(b":D#", "distance bars", _of_text(_bars))
ALIGNMENT: Command[Alignment] = Command(b"\x06", "alignment", _alignment)
PRODUCT: Command[str] = Command(b":GVP#", "product name", _of_text(_words))
TOGGLE_PRECISION: Command[None] = Command(b":U#", "toggle precision", _nothing, False, False)
SLEW: Command[SlewAnswer] = Command(b":MS#", "slew to target", _slew_answer, False)
SYNC: Command[str] = Command(b":CM#", "sync to target", _of_text(_sync_words), False)
STOP: Command[None] = Command(b":Q#", "stop", _nothing, True, False)


def set_ra(ra_deg: float, *, short: bool = False) -> Command[bool]:
    """Order to take a target right ascension; answers whether it was taken [LX200 :Sr#]."""
    return Command(b":Sr" + ra_to_text(ra_deg, short=short) + b"#", "target right ascension", _yes_or_no)


def set_dec(dec_deg: float, *, short: bool = False) -> Command[bool]:
    """Order to take a target declination; answers whether it was taken [LX200 :Sd#]."""
    return Command(b":Sd" + dec_to_text(dec_deg, short=short) + b"#", "target declination", _yes_or_no)


def sync_refusal(words: str) -> str | None:
    """Find the refusal within a sync's answer, or None: OnStep says `E1`…`E9` [ONSTEP :CM#]."""
    return f"code {words}" if re.fullmatch(r"E\d+", words) else None
