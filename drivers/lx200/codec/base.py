"""The LX200 words that most dialects share: each command's bytes and the reader of its reply.

Nothing in a reply says where it ends [LX200 link and framing], so every command owns its reader. What goes
wrong on a real cable, and how reading copes:

- a reply comes in pieces: a reader says None until it is whole;
- a reply is cut, or a bit flips: whatever does not match wholly and within its range is `Unreadable`;
- a late reply comes after the next question: declinations need their sign, so no right ascension is one;
- a reply is longer than any can be: `Unreadable`, rather than waiting for a `#` that never comes.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

from drivers.lx200.codec.angles import WireAngle, dec_from_text, dec_to_text, ra_from_text, ra_to_text
from drivers.wire.command import Command, Read, Unreadable
from mountnav.devices import Direction, TrackingRate
from mountnav.errors import Refusal

T = TypeVar("T")
_LONGEST_TEXT = 80
"""A reply without `#` after so many bytes is damaged. Chosen by hand, above the longest reply (10micron's
reading in one line)."""
BAR = 0x7F
"""The character of which old Meade displays draw distance bars [LX200 :D#]."""
_COORDINATE = re.compile(r"[+-]?\d{2,3}\D\d{2}([:.'].*)?")


@dataclass(frozen=True, slots=True)
class Answer:
    """What an order was answered.

    Attributes
    ----------
    refusal : str or None
        None when it was taken up, else the mount's own words.
    reason : Refusal
        As far as the words say.
    """

    refusal: str | None = None
    reason: Refusal = Refusal.OTHER


def nothing(buffer: bytes, final: bool) -> Read[None] | None:
    """No reply at all."""
    return Read(None, 0)


def text(buffer: bytes, final: bool) -> Read[bytes] | None:
    """All up to the next `#`."""
    end = buffer.find(b"#")
    if end < 0:
        if len(buffer) > _LONGEST_TEXT:
            raise Unreadable(f"no end within {_LONGEST_TEXT} bytes: {buffer!r}")
        return None
    if end > _LONGEST_TEXT:
        raise Unreadable(f"longer than {_LONGEST_TEXT} bytes: {buffer!r}")
    return Read(buffer[:end], end + 1)


def of_text(understand: Callable[[bytes], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """A text up to `#`, understood by a function that raises `Unreadable` for what it is not."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        whole = text(buffer, final)
        return None if whole is None else Read(understand(whole.value), whole.length)

    return read


def yes_or_no(buffer: bytes, final: bool) -> Read[bool] | None:
    """A bare `1` or `0`."""
    if not buffer:
        return None
    if buffer[:1] not in (b"0", b"1"):
        raise Unreadable(f"{buffer!r} is neither 0 nor 1")
    return Read(buffer[:1] == b"1", 1)


def words(wire: bytes) -> str:
    """Plain text."""
    if any(byte < 0x20 or byte == BAR for byte in wire):
        raise Unreadable(f"{wire!r} is not plain text")
    return wire.decode("latin-1").strip()


def words_but_no_place(wire: bytes) -> str:
    """Plain text; a coordinate here is the late answer of another question."""
    said = words(wire)
    if _COORDINATE.fullmatch(said):
        raise Unreadable(f"{wire!r} is not an answer to a sync")
    return said


def coded(codes: Mapping[str, tuple[str, Refusal]]) -> Callable[[bytes, bool], Read[Answer] | None]:
    """A bare digit: `0` is yes, another one of `codes` a refusal with its words and reason [ONSTEP :MS#]."""

    def read(buffer: bytes, final: bool) -> Read[Answer] | None:
        if not buffer:
            return None
        code = chr(buffer[0])
        if code == "0":
            return Read(Answer(), 1)
        if code not in codes:
            raise Unreadable(f"{buffer!r} is not an answer to a slew")
        return Read(Answer(*codes[code]), 1)

    return read


_MODES = {b"P": "polar", b"A": "altaz", b"L": "land"}
_HORIZON = re.compile(r"horizon|below|lower", re.IGNORECASE)
_BUSY = re.compile(r"slew|busy|progress", re.IGNORECASE)
_PARKED = re.compile(r"park", re.IGNORECASE)


class Alignment(StrEnum):
    """How the mount stands, as its ACK answer reports [LX200 0x06]."""

    POLAR = "polar"
    ALTAZ = "altaz"
    LAND = "land"
    OTHER = "other"


@dataclass(frozen=True, slots=True)
class Letter:
    """What ACK was answered; `ended` when a `#` followed, as from a Gemini [LX200 0x06]."""

    letter: str
    ended: bool = False

    @property
    def alignment(self) -> Alignment:
        """What it says of the mount."""
        return Alignment(_MODES.get(self.letter.encode(), "other"))


def _letter(buffer: bytes, final: bool) -> Read[Letter] | None:
    if not buffer:
        return None
    if not (buffer[:1].isalpha() and buffer.isascii()):
        raise Unreadable(f"{buffer!r} is not an alignment letter")
    if buffer[1:2] == b"#":
        return Read(Letter(chr(buffer[0]), True), 2)
    # a `#` may be on its way: the letters of the classics never have one
    whole = final or buffer[:1] in _MODES or len(buffer) > 1
    return Read(Letter(chr(buffer[0])), 1) if whole else None


def _reason(said: str) -> Refusal:
    for pattern, reason in (
        (_HORIZON, Refusal.BELOW_HORIZON),
        (_PARKED, Refusal.PARKED),
        (_BUSY, Refusal.BUSY),
    ):
        if pattern.search(said):
            return reason
    return Refusal.OTHER


def slew_answer(buffer: bytes, final: bool) -> Read[Answer] | None:
    """``0``, or a digit and the mount's own words up to `#`: 1 horizon, 2 and 4 its limits [LX200 :MS#]."""
    if not buffer:
        return None
    if buffer[:1] == b"0":
        return Read(Answer(), 1)
    code = chr(buffer[0])
    if not code.isdecimal():
        raise Unreadable(f"{buffer!r} is not an answer to a slew")
    by_code = {"1": Refusal.BELOW_HORIZON, "2": Refusal.LIMIT, "4": Refusal.LIMIT}
    whole = text(buffer, final)
    if whole is not None:
        said = whole.value[1:].decode("ascii", "replace").strip()
        reason = by_code.get(code) or _reason(said)
        return Read(Answer(said or f"code {code}", reason), whole.length)
    # a minimal clone says a bare digit: nothing more came, so that was all
    if final and len(buffer) == 1:
        return Read(Answer(f"code {code}", by_code.get(code, Refusal.OTHER)), 1)
    return None


def _sync_answer(wire: bytes) -> Answer:
    said = words_but_no_place(wire)
    # OnStep's way of saying no, which clones of it have too [ONSTEP :CM#]
    return Answer(f"code {said}") if re.fullmatch(r"E\d+", said) else Answer()


def _bars(wire: bytes) -> bool:
    if len(wire) > 33 or any(byte not in (0x20, BAR, 0xFF) for byte in wire):
        raise Unreadable(f"{wire!r} are not distance bars")
    return any(byte != 0x20 for byte in wire)


def quiet(sent: bytes, meaning: str, *, repeatable: bool = True) -> Command[None]:
    """A command without an answer."""
    return Command(sent, meaning, nothing, repeatable, False)


def taken(sent: bytes, meaning: str, *, repeatable: bool = True) -> Command[bool]:
    """A command that is answered by ``1`` (taken) or ``0``."""
    return Command(sent, meaning, yes_or_no, repeatable)


GET_RA: Command[WireAngle] = Command(b":GR#", "right ascension", of_text(ra_from_text))
GET_DEC: Command[WireAngle] = Command(b":GD#", "declination", of_text(dec_from_text))
SLEWING: Command[bool] = Command(b":D#", "distance bars", of_text(_bars))
ALIGNMENT: Command[Letter] = Command(b"\x06", "alignment", _letter)
PRODUCT: Command[str] = Command(b":GVP#", "product name", of_text(words_but_no_place))
FIRMWARE: Command[str] = Command(b":GVN#", "firmware number", of_text(words))
TOGGLE_PRECISION: Command[None] = quiet(b":U#", "toggle precision", repeatable=False)
SLEW: Command[Answer] = Command(b":MS#", "slew to target", slew_answer, False)
SYNC: Command[Answer] = Command(b":CM#", "sync to target", of_text(_sync_answer), False)
STOP: Command[None] = quiet(b":Q#", "stop")
STOP_MOVE = {
    way: quiet(b":Q%s#" % way.value.encode(), f"stop moving {way.name.lower()}") for way in Direction
}
START_MOVE = {
    way: quiet(b":M%s#" % way.value.encode(), f"move {way.name.lower()}", repeatable=False)
    for way in Direction
}
GUIDE_RATE: Command[None] = quiet(b":RG#", "guide rate")
RATES = {
    TrackingRate.SIDEREAL: quiet(b":TQ#", "track the stars"),
    TrackingRate.LUNAR: quiet(b":TL#", "track the Moon"),
    TrackingRate.SOLAR: quiet(b":TS#", "track the Sun"),
}


def set_ra(ra_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target right ascension; answers whether it was taken [LX200 :Sr#]."""
    return taken(b":Sr" + ra_to_text(ra_deg, short=short) + b"#", "target right ascension")


def set_dec(dec_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target declination; answers whether it was taken [LX200 :Sd#]."""
    return taken(b":Sd" + dec_to_text(dec_deg, short=short) + b"#", "target declination")


def guide_pulse(direction: Direction, duration_ms: int) -> Command[None]:
    """Pulse that the mount times, in milliseconds [LX200 :Mg#]."""
    sent = b":Mg%s%04d#" % (direction.value.encode(), duration_ms)
    return quiet(sent, f"guide {direction.name.lower()} {duration_ms} ms", repeatable=False)
