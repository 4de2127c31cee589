"""OnStep and OnStepX: an LX200 with its whole status in one word, refusals with reasons, and fine angles.

What matters of its behavior [ONSTEP]:

- switched on it believes to be at its home, doesn't track, and refuses gotos until date and time are set;
- a parked one keeps its position when it is switched off; a sync on the other side of the pier is refused;
- `:MS#` during a goto is refused *and* ends that goto; so is `:hC#`;
- `:hF#` declares the present place to be the home: never sent;
- `:MN#` flips: never sent.

Facts from the firmware's own source, OnStep 4.24 and OnStepX 10.28 [ONSTEP], and from the recorded dialogue
of INDI's driver. Answers by number are one bare character, texts end with `#`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from drivers.lx200.codec import base
from drivers.lx200.codec.angles import (
    WireAngle,
    dec_from_text,
    degrees_to_fine_text,
    longitude_from_text,
    ra_from_text,
    ra_to_fine_text,
)
from drivers.lx200.codec.base import Answer, coded, nothing, of_text, text, words_but_no_place, yes_or_no
from drivers.lx200.codec.dialect import Ask, Dialect, Handshake, Lacks, Order, Pointing, State
from drivers.lx200.codec.meade import BASIC
from drivers.lx200.codec.rates import MotionKeys, OffsetWords
from drivers.lx200.codec.site_and_time import Writing, read_clock, read_site
from drivers.wire.command import Command, Read, Unreadable
from mountnav.devices import Direction, OffsetRates, PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S, SOLAR_TO_SIDEREAL, Site

FINE_STEP_ARCSEC = 0.0015
"""Right ascensions have four decimals of a second of time."""
LONGEST_PULSE_MS = 16399
"""Longer pulses are sent in pieces [ONSTEP :Mg]."""
_FASTEST_PULSE = 8.0
"""Faster guide rates, in times sidereal, are taken for a damaged answer. Chosen by hand."""
_FLAGS = frozenset("nNpIPFeHhBSGgrst(OkwvuzaR/,~;^")
_PARK = "pIPF"
_PIER = {"o": PierSide.UNKNOWN, "T": PierSide.EAST, "W": PierSide.WEST}
_PIER_LETTER = {b"E": PierSide.EAST, b"W": PierSide.WEST, b"N": PierSide.UNKNOWN}
_DESTINATION = {b"0": PierSide.EAST, b"1": PierSide.WEST, b"2": PierSide.UNKNOWN}
_RATES = {"(": TrackingRate.LUNAR, "O": TrackingRate.SOLAR, "k": TrackingRate.KING}

REFUSALS: Mapping[str, tuple[str, Refusal]] = {
    "1": ("below the horizon limit", Refusal.BELOW_HORIZON),
    "2": ("above the overhead limit", Refusal.LIMIT),
    "3": ("controller in standby: its motors are off", Refusal.OTHER),
    "4": ("parked", Refusal.PARKED),
    "5": ("a goto is in progress", Refusal.BUSY),
    "6": ("outside limits, or its date and time are not set", Refusal.LIMIT),
    "7": ("hardware fault", Refusal.OTHER),
    "8": ("already in motion", Refusal.BUSY),
    "9": ("unspecified error", Refusal.OTHER),
}
"""What a digit of `:MS#`, or of `E` and a digit of `:CM#`, says [ONSTEP :MS#]."""

# what :GE# reports of the last command; the ten from 15 on are the digits of :MS# [ONSTEP CommandError]
_LAST_ERRORS: Mapping[int, tuple[str, Refusal]] = {
    8: ("not parked or at home", Refusal.OTHER),
    9: ("parked, or its date and time are not set", Refusal.PARKED),
    10: ("parking, or parking has failed", Refusal.BUSY),
    11: ("not parked, and not at home either", Refusal.OTHER),
    12: ("no park position is set", Refusal.OTHER),
    **{14 + int(digit): refusal for digit, refusal in REFUSALS.items()},
}

PROBLEMS: Mapping[int, str] = {
    1: "motor fault",
    2: "below the horizon limit",
    3: "limit switch",
    4: "declination limit",
    5: "azimuth limit",
    6: "under the pole, or beyond a limit of the polar axis",
    7: "past the meridian limit",
    8: "sync error",
    9: "park error",
    10: "goto or sync error",
    11: "unspecified error",
    12: "above the overhead limit",
    13: "weather sensor failed",
    14: "date and time are not set",
    15: "its memory of settings failed",
}
"""What the error digit of `:GU#` says [ONSTEP GeneralErrors]."""


@dataclass(frozen=True, slots=True)
class Status:
    """All that `:GU#` or `:Gu#` reports that matters here.

    Attributes
    ----------
    tracking, slewing : bool
        `slewing` is a goto, also to park or home [ONSTEP :GU# N].
    guiding : bool
        A pulse or a motion at guide rate.
    rate : TrackingRate
        Sidereal where no letter says otherwise.
    error : int
        Of `PROBLEMS`; 0 is none.
    equatorial : bool
        German or fork; else it stands in azimuth and altitude, or on two level axes.
    """

    tracking: bool
    slewing: bool
    parked: bool
    parking: bool
    park_failed: bool
    at_home: bool
    homing: bool
    guiding: bool
    pier_side: PierSide
    rate: TrackingRate
    error: int
    equatorial: bool = True


def status_from_text(wire: bytes) -> Status:
    """Understand ``flags, mount letter, pier letter, two rate digits, error digit`` [ONSTEP :GU#].

    Firmware adds flags and changes their order, so the order doesn't count; an unknown flag, one that comes
    twice and two park letters do.

    Raises
    ------
    Unreadable
        If it is no such text.
    """
    said = wire.decode("latin-1")
    flags, tail = said[:-5], said[-5:]
    single = flags.replace("rs", "r").replace("ts", "t")
    parked = [letter for letter in single if letter in _PARK]
    if (
        len(tail) < 5
        or tail[0] not in "EKAL"
        or tail[1] not in _PIER
        or not (tail[2:4].isascii() and tail[2:4].isdigit())
        or not 0 <= ord(tail[4]) - ord("0") <= 15
        or len(parked) != 1
        or len(set(single)) != len(single)
        or not _FLAGS.issuperset(single)
    ):
        raise Unreadable(f"{wire!r} is not a status")
    return Status(
        tracking="n" not in single,
        slewing="N" not in single,
        parked=parked == ["P"],
        parking=parked == ["I"],
        park_failed=parked == ["F"],
        at_home="H" in single,
        homing="h" in single,
        guiding="G" in single or "g" in single,
        pier_side=_PIER[tail[1]],
        rate=next((rate for letter, rate in _RATES.items() if letter in single), TrackingRate.SIDEREAL),
        error=ord(tail[4]) - ord("0"),
        equatorial=tail[0] in "EK",
    )


def guide_rate_from_text(wire: bytes) -> float:
    """Understand a rate in times sidereal, as degrees per second [ONSTEP :GX90#].

    Raises
    ------
    Unreadable
        If it is none, or faster than any pulse.
    """
    if re.fullmatch(rb" *\d{1,2}\.\d\d", wire) is None or not 0.0 < float(wire) <= _FASTEST_PULSE:
        raise Unreadable(f"{wire!r} is not a rate of a guide pulse")
    return float(wire) * SIDEREAL_DEG_S


def _letter(letters: Mapping[bytes, PierSide]) -> Callable[[bytes], PierSide]:
    def understand(wire: bytes) -> PierSide:
        if wire not in letters:
            raise Unreadable(f"{wire!r} is not a side of the pier")
        return letters[wire]

    return understand


def _bare_side(buffer: bytes, final: bool) -> Read[PierSide] | None:
    if not buffer:
        return None
    return Read(_letter(_DESTINATION)(buffer[:1]), 1)


def _sync_answer(buffer: bytes, final: bool) -> Read[Answer] | None:
    # OnStep 4 answers a sync that it can't even consider (parked, slewing) by a bare digit [ONSTEP :CM#]
    if final and buffer in (b"0", b"1"):
        return Read(Answer("parked, or a goto is in progress", Refusal.PARKED), 1)
    whole = text(buffer, final)
    if whole is None:
        return None
    said = words_but_no_place(whole.value)
    if said[:1] == "E" and said[1:] in REFUSALS:
        return Read(Answer(*REFUSALS[said[1:]]), whole.length)
    if said != "N/A":
        raise Unreadable(f"{whole.value!r} is not an answer to a sync")
    return Read(Answer(), whole.length)


def _with_reason(buffer: bytes, final: bool) -> Read[Answer] | None:
    """A bare digit, and `NN#` of the `:GE#` that was sent with the order."""
    done = yes_or_no(buffer, final)
    if done is None:
        return None
    why = text(buffer[1:], final)
    if why is None:
        # a firmware without :GE# says 0, or nothing
        if final and buffer[1:] in (b"", b"0"):
            return Read(Answer() if done.value else Answer("0"), len(buffer))
        return None
    if len(why.value) != 2 or not why.value.isdigit():
        raise Unreadable(f"{buffer!r} is not an answer and its reason")
    answer = Answer()
    if not done.value:
        code = int(why.value)
        answer = Answer(*_LAST_ERRORS.get(code, (f"error {code}", Refusal.OTHER)))
    return Read(answer, 1 + why.length)


def _order(word: bytes, meaning: str) -> Command[Answer]:
    # in one write, so that no other answer comes between; sent once, like every order
    return Command(b":" + word + b"#:GE#", meaning, _with_reason, False)


GET_FINE_RA: Command[WireAngle] = Command(b":GRH#", "right ascension", of_text(ra_from_text))
GET_FINE_DEC: Command[WireAngle] = Command(b":GDH#", "declination", of_text(dec_from_text))
STATUS: Command[Status] = Command(b":GU#", "status", of_text(status_from_text))
PIER_SIDE: Command[PierSide] = Command(b":Gm#", "pier side", of_text(_letter(_PIER_LETTER)))
DESTINATION_SIDE: Command[PierSide] = Command(b":MD#", "destination pier side", _bare_side)
GUIDE_RATE_DEG_S: Command[float] = Command(b":GX90#", "pulse guide rate", of_text(guide_rate_from_text))
CLOCK_UNSET: Command[bool] = Command(b":GX89#", "whether date and time are missing", yes_or_no)
SLEW: Command[Answer] = Command(b":MS#", "slew to target", coded(REFUSALS), False)
SYNC: Command[Answer] = Command(b":CM#", "sync to target", _sync_answer, False)
TRACKING_ON = _order(b"Te", "tracking on")
TRACKING_OFF = _order(b"Td", "tracking off")
PARK = _order(b"hP", "park")
UNPARK = _order(b"hR", "unpark")
SET_PARK = _order(b"hQ", "set the park position")
HOME: Command[None] = Command(b":hC#", "go home", nothing, False, False)
RATES: Mapping[TrackingRate, Command[None]] = {
    rate: Command(b":T" + letter + b"#", f"{rate} rate", nothing, True, False)
    for rate, letter in (
        (TrackingRate.SIDEREAL, b"Q"),
        (TrackingRate.LUNAR, b"L"),
        (TrackingRate.SOLAR, b"S"),
        (TrackingRate.KING, b"K"),
    )
}


def set_ra(ra_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target right ascension, to 0.0001 s; answers whether it was taken [ONSTEP :Sr#]."""
    return Command(b":Sr" + ra_to_fine_text(ra_deg, 4) + b"#", "target right ascension", yes_or_no)


def set_dec(dec_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target declination, to 0.001″; answers whether it was taken [ONSTEP :Sd#]."""
    return Command(b":Sd" + degrees_to_fine_text(dec_deg, 3) + b"#", "target declination", yes_or_no)


def pulse(direction: Direction, duration_ms: int) -> Command[None]:
    """Order a guide pulse that the mount times [ONSTEP :Mg#].

    Raises
    ------
    ValueError
        If it is longer than the firmware takes.
    """
    if not 0 < duration_ms <= LONGEST_PULSE_MS:
        raise ValueError(f"a pulse of {duration_ms} ms can't be ordered")
    word = b":Mg%s%04d#" % (direction.value.encode(), duration_ms)
    return Command(word, f"pulse {direction.name.lower()}", nothing, False, False)


GET_FINE_LATITUDE: Command[float] = Command(
    b":GtH#", "latitude", of_text(lambda wire: dec_from_text(wire).deg)
)
GET_FINE_LONGITUDE: Command[float] = Command(b":GgH#", "longitude", of_text(longitude_from_text))


async def _place(ask: Ask) -> Pointing:
    ra = await ask.known(GET_FINE_RA)
    dec = await ask.known(GET_FINE_DEC)
    # the coarse words are those of any LX200: without them there is no place
    return Pointing(
        await ask(base.GET_RA) if ra is None else ra, await ask(base.GET_DEC) if dec is None else dec
    )


async def _status(ask: Ask) -> Status | None:
    """Ask once; twice for what one flipped bit can make of the usual answer: `N` and `n`, `p` and `P`."""
    status = await ask.known(STATUS)
    if status is None:
        return None
    if status.slewing or status.parked or status.parking or status.park_failed or status.homing:
        again = await ask(STATUS)
        if again != status:
            return await ask(STATUS)
    return status


async def _state(ask: Ask) -> State:
    status = await _status(ask)
    if status is None:
        return State()
    fresh = False
    if status.at_home and not status.tracking and not status.parked and not status.slewing:
        # where it wakes up; one with a clock of its own knows the time at once, see `_woke_up`
        fresh = bool(await ask.known(CLOCK_UNSET))
    return State(
        slewing=status.slewing or status.homing or status.parking,
        tracking=status.tracking,
        parked=status.parked,
        at_home=status.at_home,
        pier_side=status.pier_side,
        fresh=fresh,
    )


async def _woke_up(ask: Ask) -> bool:
    """Whether it stands as after power-up; one that was sent home stands so, too."""
    status = await _status(ask)
    if status is None:
        return False
    return status.at_home and not status.tracking and not status.parked and not status.slewing


async def _read_site(ask: Ask) -> Site | None:
    latitude_deg = await ask.known(GET_FINE_LATITUDE)
    longitude_deg = await ask.known(GET_FINE_LONGITUDE)
    if latitude_deg is None or longitude_deg is None:
        return await read_site(ask)
    return Site(latitude_deg, longitude_deg)


async def _guiding(ask: Ask) -> bool:
    status = await ask.known(STATUS)
    return status is not None and status.guiding


async def _guide_rate_deg_s(ask: Ask) -> float | None:
    return await ask.known(GUIDE_RATE_DEG_S)


_MOST_OFFSET = 1800.0
"""Arcseconds per sidereal second; greater rates are taken for this one [ONSTEP :SXTR]."""
_OFFSET_STEP_ARCSEC_S = 1e-6
"""Step of a rate on this wire as it is written here, ″/s. The firmware keeps what a `float` holds, which is
finer for any comet. Doubled, a rate is off by 0.004″ in an hour."""


def _offset(wire: bytes) -> float:
    if re.fullmatch(rb"-?\d{1,4}\.\d{1,9}", wire) is None or abs(float(wire)) > _MOST_OFFSET + 0.01:
        raise Unreadable(f"{wire!r} is not a rate beside the sidereal one")
    return float(wire)


RA_OFFSET: Command[float] = Command(b":GXTR#", "offset rate in right ascension", of_text(_offset))
DEC_OFFSET: Command[float] = Command(b":GXTD#", "offset rate in declination", of_text(_offset))


def set_offset(axis: str, rate_arcsec_s: float) -> Command[bool]:
    """Order a rate of `R` or `D` beside the sidereal one, east and north positive [ONSTEP :SXTR :SXTD].

    That of right ascension counts in its own angle, not on the sky.

    Raises
    ------
    ValueError
        If the firmware would take another one for it.
    """
    rate = rate_arcsec_s / SOLAR_TO_SIDEREAL
    if not abs(rate) <= _MOST_OFFSET:
        raise ValueError(f"a rate of {rate_arcsec_s}″/s can't be told")
    word = f":SXT{axis},{rate:.6f}#".replace("-0.000000", "0.000000")
    return Command(word.encode("ascii"), f"offset rate {axis}", yes_or_no)


def _offset_orders(rates: OffsetRates) -> tuple[Order, ...]:
    return set_offset("R", rates.ra_arcsec_s), set_offset("D", rates.dec_arcsec_s)


async def _read_offsets(ask: Ask) -> OffsetRates | None:
    ra, dec = await ask.known(RA_OFFSET), await ask.known(DEC_OFFSET)
    if ra is None or dec is None:
        return None
    return OffsetRates(ra * SOLAR_TO_SIDEREAL, dec * SOLAR_TO_SIDEREAL)


OFFSETS = OffsetWords(
    set=_offset_orders,
    most_arcsec_s=OffsetRates(_MOST_OFFSET * SOLAR_TO_SIDEREAL, _MOST_OFFSET * SOLAR_TO_SIDEREAL),
    step_arcsec_s=_OFFSET_STEP_ARCSEC_S,
    read=_read_offsets,
)

KEY_SPEEDS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 20.0, 48.0)
"""Times sidereal, of the numbers 0 to 7 of `:Rn#`; 8 and 9 depend on how it is built. On top of tracking,
which `:RA#` and `:RE#` would replace [ONSTEP :Rn :RA]. A slow mount moves more slowly at 48."""


async def _no_keys(ask: Ask) -> str:
    # there `:Me#` turns it in azimuth
    status = await ask.known(STATUS)
    return "it stands in azimuth and altitude" if status is not None and not status.equatorial else ""


KEYS = MotionKeys(
    speeds={
        speed * SIDEREAL_DEG_S: (base.quiet(b":R%d#" % number, f"speed {number}"),)
        for number, speed in enumerate(KEY_SPEEDS)
    },
    press={
        way: base.quiet(b":M" + way.value.encode() + b"#", f"move {way.name.lower()}", repeatable=False)
        for way in Direction
    },
    let_go={
        way: base.quiet(b":Q" + way.value.encode() + b"#", f"end moving {way.name.lower()}")
        for way in (Direction.EAST, Direction.NORTH)
    },
    never=_no_keys,
)


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    """What reads coarsely is written coarsely; what has no status has no side and no park."""
    if lacks(GET_FINE_RA, GET_FINE_DEC):
        dialect = replace(dialect, set_ra=base.set_ra, set_dec=base.set_dec, step_arcsec=BASIC.step_arcsec)
    if lacks(STATUS):
        dialect = replace(dialect, tells_pier_side=False, parks_unread=True)
    if lacks(RA_OFFSET, DEC_OFFSET):
        # OnStep 4, and firmware that was sold before these words came
        dialect = replace(dialect, offsets=None)
    return dialect


async def _destination_side(ask: Ask) -> PierSide | None:
    side = await ask(DESTINATION_SIDE)
    return None if side is PierSide.UNKNOWN else side


def _west_positive(longitude_deg: float) -> bytes:
    # east may be negative; the bare form 0..360 is taken by old firmware, too [ONSTEP :Sg#]
    return degrees_to_fine_text(-longitude_deg % 360.0, 2, digits=3)[1:]


_WRITING = Writing(
    zone=b":SG+00:00#",
    date_answers_bare=True,
    latitude=lambda deg: degrees_to_fine_text(deg, 2),
    longitude=_west_positive,
)
"""How OnStep is given time and site."""


def _is_onstep(handshake: Handshake) -> bool:
    return (handshake.product or "").lower().replace("-", "").startswith("onstep")


ONSTEP = Dialect(
    name="onstep",
    caption="OnStep",
    recognizes=_is_onstep,
    place=_place,
    state=_state,
    set_ra=set_ra,
    set_dec=set_dec,
    slew=SLEW,
    sync=SYNC,
    stop=(base.STOP,),
    step_arcsec=FINE_STEP_ARCSEC,
    tracks_before_slew=True,
    tracking_on=(TRACKING_ON,),
    tracking_off=(TRACKING_OFF,),
    rates=RATES,
    park=(PARK,),
    unpark=(UNPARK,),
    home=(HOME,),
    set_park=(SET_PARK,),
    tells_pier_side=True,
    pulse=pulse,
    guiding=_guiding,
    read_guide_rate=_guide_rate_deg_s,
    longest_pulse_ms=LONGEST_PULSE_MS,
    offsets=OFFSETS,
    keys=KEYS,
    read_clock=read_clock,
    write_clock=_WRITING.clock,
    read_site=_read_site,
    write_site=_WRITING.site,
    destination_side=_destination_side,
    fresh=_woke_up,
    asked_sometimes=(CLOCK_UNSET,),
    without=_without,
)
