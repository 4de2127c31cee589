"""Losmandy Gemini, levels 4 to 6: LX200's words with its own letters for what moves, and native commands.

From the maker's command descriptions [GEMINI L5 V2.1, L6 V1.02]; not tried on a real mount. Its places
include refraction, unless it is set otherwise; we take them as apparent, as its drivers do.
"""

from __future__ import annotations

import re
from dataclasses import replace

from drivers.lx200.codec import base
from drivers.lx200.codec.base import Answer, of_text, text, words_but_no_place
from drivers.lx200.codec.dialect import Ask, Dialect, Handshake, Lacks, State
from drivers.lx200.codec.meade import CLASSIC
from drivers.lx200.codec.site_and_time import clock_was_never_set
from drivers.wire.command import Command, Read, Unreadable
from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import Refusal

_STAGES = {
    "B": "the Gemini shows its startup message: not ready yet",
    "b": "the Gemini waits for its startup mode: choose cold start, warm start or warm restart at the mount",
    "S": "the Gemini is in its cold start: not ready yet",
}
_SLEW_CODES = {
    "1": Refusal.BELOW_HORIZON,
    "2": Refusal.OTHER,
    "3": Refusal.BUSY,
    "4": Refusal.LIMIT,
    "5": Refusal.NOT_ALIGNED,
    "6": Refusal.LIMIT,
    "7": Refusal.PARKED,
}
_ALIGNED = 1
"""The bit of status 99 that says that the mount was aligned [GEMINI native]."""


def checksum(said: bytes) -> int:
    """Of a native command: all its bytes combined by exclusive or, modulo 128, plus 64 [GEMINI native]."""
    value = 0
    for byte in said:
        value ^= byte
    return value % 128 + 64


def native(body: bytes) -> bytes:
    """Close a native command, ``<99:`` to ask or ``>130:131`` to set."""
    return body + bytes([checksum(body)]) + b"#"


def _native_value(wire: bytes) -> bytes:
    if len(wire) < 2 or wire[-1] != checksum(wire[:-1]):
        raise Unreadable(f"{wire!r} has a wrong checksum")
    return wire[:-1]


def _status(wire: bytes) -> int:
    value = _native_value(wire)
    if not re.fullmatch(rb"\d{1,3}", value):
        raise Unreadable(f"{wire!r} is not a status")
    return int(value)


def _velocity(buffer: bytes, final: bool) -> Read[str] | None:
    """A bare letter, no `#`: nothing, tracking, guiding, centering, slewing, stalled [GEMINI :Gv#]."""
    if not buffer:
        return None
    if buffer[:1] not in (b"N", b"T", b"G", b"C", b"S", b"!"):
        raise Unreadable(f"{buffer!r} is not a velocity")
    return Read(chr(buffer[0]), 1)


def _parking(buffer: bytes, final: bool) -> Read[int] | None:
    """A bare digit: 0 not parked, 1 parked, 2 on its way [GEMINI :h?#]."""
    if not buffer:
        return None
    if buffer[:1] not in (b"0", b"1", b"2"):
        raise Unreadable(f"{buffer!r} is not a parking state")
    return Read(int(buffer[:1]), 1)


def _slewed(buffer: bytes, final: bool) -> Read[Answer] | None:
    """``0``, or a digit of its own list with words up to `#` [GEMINI :MS#]."""
    if buffer[:1] == b"0":
        return Read(Answer(), 1)
    if buffer and chr(buffer[0]) not in _SLEW_CODES:
        raise Unreadable(f"{buffer!r} is not an answer to a slew")
    whole = text(buffer, final)
    if whole is None:
        return None
    said = whole.value[1:].decode("ascii", "replace").strip()
    return Read(Answer(said, _SLEW_CODES[chr(buffer[0])]), whole.length)


def _synced(wire: bytes) -> Answer:
    said = words_but_no_place(wire)
    # it isn't aligned, or no target was taken [GEMINI :CM#]
    return Answer(said, Refusal.NOT_ALIGNED) if said.startswith("No object") else Answer()


def _side(wire: bytes) -> PierSide:
    sides = {b"E": PierSide.EAST, b"W": PierSide.WEST}
    if wire not in sides:
        raise Unreadable(f"{wire!r} is not a side")
    return sides[wire]


VELOCITY: Command[str] = Command(b":Gv#", "velocity", _velocity)
PARKING: Command[int] = Command(b":h?#", "parking state", _parking)
SIDE: Command[PierSide] = Command(b":Gm#", "side of the pier", of_text(_side))
STATUS: Command[int] = Command(native(b"<99:"), "status", of_text(_status))


async def _state(ask: Ask) -> State:
    velocity = await ask.known(VELOCITY)
    parking = await ask.known(PARKING)
    status = await ask.known(STATUS)
    moves = None if velocity is None else velocity in ("S", "C")
    return State(
        slewing=True if parking == 2 else moves,
        tracking=velocity in ("T", "G") if velocity in ("N", "T", "G") else None,
        parked=None if parking is None else parking == 1,
        pier_side=await ask.known(SIDE),
        fresh=status is not None and not status & _ALIGNED,
    )


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    return replace(
        dialect,
        tells_pier_side=not lacks(SIDE),
        parks_unread=lacks(PARKING),
        fresh=clock_was_never_set if lacks(STATUS) else None,
    )


def _boot(handshake: Handshake) -> str | None:
    return _STAGES.get(handshake.letter or "") if handshake.ended else None


def _rate(number: int, meaning: str) -> Command[None]:
    return base.quiet(native(b">130:%d" % number), meaning)


GEMINI = replace(
    CLASSIC,
    name="gemini",
    caption="Losmandy Gemini",
    recognizes=lambda handshake: (
        handshake.ended
        and handshake.letter is not None
        and handshake.letter in "BbSGA"
        and (handshake.product is None or "Gemini" in handshake.product)
    ),
    state=_state,
    without=_without,
    slew=Command(b":MS#", "slew to target", _slewed, False),
    sync=Command(b":CM#", "sync to target", of_text(_synced), False),
    stop=(base.STOP,),
    tracking_on=(base.quiet(b":hW#", "wake up and track"),),
    tracking_off=(base.quiet(b":hN#", "sleep, stop tracking"),),
    rates={
        TrackingRate.SIDEREAL: _rate(131, "track the stars"),
        TrackingRate.KING: _rate(132, "track at the King rate"),
        TrackingRate.LUNAR: _rate(133, "track the Moon"),
        TrackingRate.SOLAR: _rate(134, "track the Sun"),
    },
    park=(base.quiet(b":hP#", "park", repeatable=False),),
    unpark=(base.quiet(b":hW#", "wake up"),),
    set_park=(base.quiet(b":hH#", "take this place as the home to park at", repeatable=False),),
    tells_pier_side=True,
    pulse=base.guide_pulse,
    nudge=None,
    fresh=None,
    boot=_boot,
)
