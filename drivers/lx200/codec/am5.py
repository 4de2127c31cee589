"""ZWO AM3, AM5, AM7: OnStep's frame without its fine words, with a park of its own.

What matters of its behavior [ZWO]:

- switched on it believes to be at its home, and refuses gotos until time and site are set;
- `:hC#` goes to the mechanical zero and latches nothing; `:hP#` parks (firmware from 1.1.9), and only `:Spu#`
  releases that; older firmware knows no park and is parked by going home (`dialect=am5-old` for one that
  reports no version);
- places are read and written to whole seconds: 15″ in right ascension.

From ZWO's protocol document 2.1 as public drivers quote it [ZWO], and INDI's driver; no real mount was seen.
Orders answer one bare character, or ``eN#`` [ZWO error codes].
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum

from drivers.lx200.codec import base
from drivers.lx200.codec.angles import dec_to_text, ra_to_text
from drivers.lx200.codec.base import Answer, of_text, quiet, text
from drivers.lx200.codec.dialect import Ask, Dialect, Handshake, Lacks, Pointing, State
from drivers.lx200.codec.rates import MotionKeys
from drivers.lx200.codec.site_and_time import Writing, read_clock, read_site
from drivers.wire.command import Command, Read, Unreadable
from mountnav.devices import Direction, PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S

LONGEST_PULSE_MS = 3000
"""Longer pulses are sent in pieces [ZWO :Mg]."""
_FLAGS = frozenset("nNLHSsTt")
_STATUS = re.compile(r"([a-zA-Z]*)(\d*)")
_SIDES = {b"E": PierSide.EAST, b"W": PierSide.WEST, b"N": PierSide.UNKNOWN}

REFUSALS: Mapping[int, tuple[str, Refusal]] = {
    1: ("parameter out of range", Refusal.OTHER),
    2: ("format error", Refusal.OTHER),
    3: ("it slews or goes home", Refusal.BUSY),
    4: ("it moves", Refusal.BUSY),
    5: ("below the horizon", Refusal.BELOW_HORIZON),
    6: ("below the altitude limit", Refusal.LIMIT),
    7: ("its time and site are not set", Refusal.NOT_ALIGNED),
    8: ("past its meridian limit", Refusal.LIMIT),
    9: ("the place of the sync is on the other side of the meridian", Refusal.LIMIT),
    10: ("altitude inverted", Refusal.LIMIT),
    11: ("a sync near the pole", Refusal.LIMIT),
    12: ("a sync too far from where it believes it points", Refusal.LIMIT),
    13: ("above the altitude limit", Refusal.LIMIT),
}
"""What the number of an ``eN#`` means, and which reason that is [ZWO error codes]."""


class ParkState(IntEnum):
    """What it says of parking [ZWO :Gps#]."""

    NOT_PARKED = 0
    PARKING = 1
    PARKED = 2
    FAILED = 3


@dataclass(frozen=True, slots=True)
class Status:
    """What `:GU#` reports.

    Attributes
    ----------
    equatorial : bool
        Or else set up as an altazimuth.
    """

    tracking: bool
    slewing: bool
    at_home: bool
    equatorial: bool
    low_voltage: bool
    stalled: bool
    guiding: bool


def status_from_text(wire: bytes) -> Status:
    """Understand letters (`G` or `Z` among them) and digits, as ``nNG001000060`` [ZWO :GU#].

    Raises
    ------
    Unreadable
        If it is no such text.
    """
    match = _STATUS.fullmatch(wire.decode("latin-1"))
    letters = match[1] if match else ""
    mode = [letter for letter in letters if letter in "GZ"]
    flags = set(letters) - {"G", "Z"}
    if match is None or len(mode) != 1 or len(flags) + 1 != len(letters) or not flags <= _FLAGS:
        raise Unreadable(f"{wire!r} is not a status")
    return Status(
        tracking="n" not in flags,
        slewing="N" not in flags,
        at_home="H" in flags,
        equatorial=mode == ["G"],
        low_voltage="L" in flags,
        stalled=bool(flags & {"S", "s"}),
        guiding=bool(flags & {"T", "t"}),
    )


def _refusal(wire: bytes) -> Answer:
    match = re.fullmatch(rb"e(\d{1,2})", wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not a refusal")
    number = int(match[1])
    return Answer(*REFUSALS.get(number, (f"error {number}", Refusal.OTHER)))


def answer_to(yes: bytes) -> Callable[[bytes, bool], Read[Answer] | None]:
    """Reader of a bare `yes`, another bare digit for no, or ``eN#`` [ZWO error codes]."""

    def read(buffer: bytes, final: bool) -> Read[Answer] | None:
        if not buffer:
            return None
        if buffer[:1] == yes:
            return Read(Answer(), 1)
        if buffer[:1] == b"e":
            whole = text(buffer, final)
            return None if whole is None else Read(_refusal(whole.value), whole.length)
        if buffer[:1] not in (b"0", b"1"):
            raise Unreadable(f"{buffer!r} is not an answer to an order")
        return Read(Answer("it says no"), 1)

    return read


def _taken(buffer: bytes, final: bool) -> Read[bool] | None:
    read = answer_to(b"1")(buffer, final)
    return None if read is None else Read(read.value.refusal is None, read.length)


def _sync_answer(wire: bytes) -> Answer:
    return Answer() if wire == b"N/A" else _refusal(wire)


def _tracking(wire: bytes) -> bool:
    if wire in (b"0", b"1"):
        return wire == b"1"
    _refusal(wire)
    return False


def _park_state(wire: bytes) -> ParkState:
    if wire not in (b"0", b"1", b"2", b"3"):
        raise Unreadable(f"{wire!r} is not a state of parking")
    return ParkState(int(wire))


def _side(wire: bytes) -> PierSide:
    if wire not in _SIDES:
        raise Unreadable(f"{wire!r} is not a side of the pier")
    return _SIDES[wire]


STATUS: Command[Status] = Command(b":GU#", "status", of_text(status_from_text))
TRACKING: Command[bool] = Command(b":GAT#", "whether it tracks", of_text(_tracking))
PIER_SIDE: Command[PierSide] = Command(b":Gm#", "pier side", of_text(_side))
PARK_STATE: Command[ParkState] = Command(b":Gps#", "state of parking", of_text(_park_state))
SLEW: Command[Answer] = Command(b":MS#", "slew to target", answer_to(b"0"), False)
SYNC: Command[Answer] = Command(b":CM#", "sync to target", of_text(_sync_answer), False)
TRACKING_ON: Command[Answer] = Command(b":Te#", "tracking on", answer_to(b"1"))
TRACKING_OFF: Command[Answer] = Command(b":Td#", "tracking off", answer_to(b"1"))
PARK: Command[None] = quiet(b":hP#", "park", repeatable=False)
UNPARK: Command[Answer] = Command(b":Spu#", "unpark", answer_to(b"1"), False)
HOME: Command[None] = quiet(b":hC#", "go home", repeatable=False)
RATES: Mapping[TrackingRate, Command[None]] = {
    TrackingRate.SIDEREAL: quiet(b":TQ#", "sidereal rate"),
    TrackingRate.LUNAR: quiet(b":TL#", "lunar rate"),
    TrackingRate.SOLAR: quiet(b":TS#", "solar rate"),
}


def set_ra(ra_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target right ascension, to 1 s; answers whether it was taken [ZWO :Sr#]."""
    return Command(b":Sr" + ra_to_text(ra_deg) + b"#", "target right ascension", _taken)


def set_dec(dec_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target declination, to 1″; answers whether it was taken [ZWO :Sd#]."""
    return Command(b":Sd" + dec_to_text(dec_deg) + b"#", "target declination", _taken)


def pulse(direction: Direction, duration_ms: int) -> Command[None]:
    """Order a guide pulse that the mount times [ZWO :Mg#].

    Raises
    ------
    ValueError
        If it is longer than the firmware takes.
    """
    if not 0 < duration_ms <= LONGEST_PULSE_MS:
        raise ValueError(f"a pulse of {duration_ms} ms can't be ordered")
    word = b":Mg%s%04d#" % (direction.value.encode(), duration_ms)
    return quiet(word, f"pulse {direction.name.lower()}", repeatable=False)


_FIRST_WITH_PARK = (1, 1, 9)
"""The firmware that parks [AM5]; older ones home, and report no state of parking."""


async def _place(ask: Ask) -> Pointing:
    return Pointing(await ask(base.GET_RA), await ask(base.GET_DEC))


async def _old_state(ask: Ask) -> State:
    status = await ask.known(STATUS)
    return State(
        slewing=None if status is None else status.slewing,
        tracking=await ask.known(TRACKING),
        at_home=None if status is None else status.at_home,
        pier_side=await ask.known(PIER_SIDE),
    )


async def _state(ask: Ask) -> State:
    state = await _old_state(ask)
    parking = await ask.known(PARK_STATE)
    return replace(
        state,
        slewing=True if parking is ParkState.PARKING else state.slewing,
        parked=None if parking is None else parking is ParkState.PARKED,
    )


async def _woke_up(ask: Ask) -> bool:
    """Whether it stands as after power-up; one that was sent home stands so, too."""
    status = await ask.known(STATUS)
    if status is None:
        return False
    return status.at_home and not status.slewing and not await ask.known(TRACKING)


def _for_firmware(dialect: Dialect, handshake: Handshake) -> Dialect:
    """Older firmware has no park; one that doesn't report its version is asked."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", handshake.firmware or ""))
    return _with_old_park(dialect) if numbers and numbers < _FIRST_WITH_PARK else dialect


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    if lacks(PARK_STATE):
        # what knows no `:Gps#` knows no `:hP#` either: both came with 1.1.9
        dialect = _with_old_park(dialect)
    return replace(dialect, tells_pier_side=not lacks(PIER_SIDE))


def _with_old_park(dialect: Dialect) -> Dialect:
    """Parks by going home, released by tracking; that it is parked only we know."""
    return replace(
        dialect,
        state=_old_state,
        park=(HOME,),
        unpark=(TRACKING_ON,),
        parks_unread=True,
    )


async def _guiding(ask: Ask) -> bool:
    status = await ask.known(STATUS)
    return status is not None and status.guiding


async def _no_keys(ask: Ask) -> str:
    # set up so, `:Me#` turns it in azimuth
    status = await ask.known(STATUS)
    return "" if status is None or status.equatorial else "it stands in azimuth and altitude"


def _west_positive(longitude_deg: float) -> bytes:
    west_deg = -longitude_deg
    west_deg -= 360.0 * round(west_deg / 360.0)
    # three digits of degrees and a sign, as INDI's driver writes it [ZWO :Sg#]
    seconds = round(abs(west_deg) * 3600.0)
    sign = b"-" if west_deg < 0 and seconds else b"+"
    return b"%s%03d*%02d:%02d" % (sign, seconds // 3600, seconds // 60 % 60, seconds % 60)


def _is_am(handshake: Handshake) -> bool:
    product = handshake.product or ""
    return product[:2] == "AM" and product[2:3].isdigit()


KEY_SPEEDS = {3: 2.0, 4: 4.0, 5: 8.0, 6: 20.0, 7: 60.0}
"""Times sidereal, by the numbers of `:Rn#`. Slower ones are left out, for it matters there whether they come
on top of tracking, which no source says; the fastest two depend on the limit that was set [INDI lx200am5]."""
KEYS = MotionKeys(
    speeds={
        times * SIDEREAL_DEG_S: (quiet(b":R%d#" % number, f"speed {number}"),)
        for number, times in KEY_SPEEDS.items()
    },
    press={
        way: quiet(b":M" + way.value.encode() + b"#", f"move {way.name.lower()}", repeatable=False)
        for way in Direction
    },
    let_go={
        way: quiet(b":Q" + way.value.encode() + b"#", f"end moving {way.name.lower()}") for way in Direction
    },
    never=_no_keys,
)

_WRITING = Writing(zone=b":SG+00:00#", date_answers_bare=True, latitude=dec_to_text, longitude=_west_positive)

AM5 = Dialect(
    name="am5",
    caption="ZWO AM",
    recognizes=_is_am,
    place=_place,
    state=_state,
    set_ra=set_ra,
    set_dec=set_dec,
    slew=SLEW,
    sync=SYNC,
    stop=(base.STOP,),
    tracks_before_slew=True,
    tracking_on=(TRACKING_ON,),
    tracking_off=(TRACKING_OFF,),
    rates=RATES,
    park=(PARK,),
    unpark=(UNPARK,),
    home=(HOME,),
    tells_pier_side=True,
    pulse=pulse,
    guiding=_guiding,
    longest_pulse_ms=LONGEST_PULSE_MS,
    keys=KEYS,
    read_clock=read_clock,
    write_clock=_WRITING.clock,
    read_site=read_site,
    write_site=_WRITING.site,
    fresh=_woke_up,
    fitted=_for_firmware,
    without=_without,
)

AM5_OLD = replace(
    _with_old_park(AM5),
    name="am5-old",
    caption="ZWO AM with firmware before 1.1.9",
    recognizes=lambda handshake: False,
)
