"""10micron: an LX200 with absolute encoders, read by one line, precise to a tenth of an arcsecond.

What matters of its behavior [10MICRON]:

- it keeps its position without power, so there is no evidence of a power-up and none is needed;
- `:CM#` shifts the whole pointing (or adds a star to its model, as its `:CMCFG` was set: never set here);
- parking, unparking and tracking have no answers: what came of them shows in the status;
- `:hF#` is not sent: only mounts with home sensors know it.

From the protocol document, versions 2.13.2 and 2.14.11 [10MICRON], and INDI's driver. A lone `#` before a
command is nothing; single characters come without `#`, texts end with it.

This is the right way to feed its model; a sync only shifts it. Nothing here was tried on a real mount.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from enum import IntEnum

from drivers.lx200.codec import base
from drivers.lx200.codec.angles import WireAngle, degrees_to_fine_text, ra_to_fine_text
from drivers.lx200.codec.base import Answer, nothing, of_text, quiet, taken, text, words_but_no_place
from drivers.lx200.codec.dialect import Ask, Dialect, Handshake, Lacks, Order, Pointing, State
from drivers.lx200.codec.site_and_time import Writing, read_site
from drivers.wire.command import Command, Read, Unreadable
from mountnav.devices import Direction, PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.units import UNIX_ZERO_JD

RA_STEP_ARCSEC = 0.15
"""Right ascensions have two decimals of a second of time in ultra precision."""
LONGEST_PULSE_MS = 9999
"""A pulse has four digits [10MICRON :Mg]."""
# 1970 to 2100: clocks that were never set, too
_DAYS = range(2440588, 2488070)
# more fields may follow in later versions [10MICRON :Ginfo#]
_INFO = re.compile(
    r"(\d{1,3}\.\d{3,8}),([+-]?\d{1,2}\.\d{3,8}),([EW]),([+-]?\d{1,3}\.\d{2,8}),([+-]?\d{1,2}\.\d{2,8}),"
    r"(\d{7}\.\d{2,10})L?,(\d{1,2}),([01])(?:,.*)?"
)
_UTC = re.compile(rb"(\d{4})-(\d{2})-(\d{2}),(\d{2}):(\d{2}):(\d{2})(?:\.(\d{1,2}))?")
_SIDES = {"E": PierSide.EAST, "W": PierSide.WEST}
_SIDE_WORDS = {b"East": PierSide.EAST, b"West": PierSide.WEST}
_DESTINATION = {b"0": PierSide.UNKNOWN, b"2": PierSide.WEST, b"3": PierSide.EAST}

REFUSALS: Mapping[str, Refusal] = {
    "1": Refusal.BELOW_HORIZON,
    "2": Refusal.LIMIT,
    "3": Refusal.OTHER,
    "4": Refusal.PARKED,
    "5": Refusal.LIMIT,
}
"""What the digit before a slew's refusal says [10MICRON :MS#]."""


class MountStatus(IntEnum):
    """What it does [10MICRON :Gstat#]."""

    TRACKING = 0
    STOPPED = 1
    PARKING = 2
    UNPARKING = 3
    HOMING = 4
    PARKED = 5
    SLEWING = 6
    STATIONARY = 7
    TOO_COLD = 8
    OUTSIDE_LIMITS = 9
    SATELLITE = 10
    NEEDS_OK = 11
    UNKNOWN = 98
    ERROR = 99


MOVING = frozenset({MountStatus.PARKING, MountStatus.UNPARKING, MountStatus.HOMING, MountStatus.SLEWING})
FOLLOWING = frozenset({MountStatus.TRACKING, MountStatus.OUTSIDE_LIMITS, MountStatus.SATELLITE})
PROBLEMS: Mapping[MountStatus, str] = {
    MountStatus.TOO_COLD: "its motors are off: too cold",
    MountStatus.OUTSIDE_LIMITS: "it tracks outside its limits",
    MountStatus.NEEDS_OK: "it waits for its operator's word",
    MountStatus.UNKNOWN: "it doesn't know its own status",
    MountStatus.ERROR: "it has an error",
}


@dataclass(frozen=True, slots=True)
class Info:
    """All of `:Ginfo#`.

    Attributes
    ----------
    ra, dec : WireAngle
        Of date.
    utc : datetime
        Its clock.
    """

    ra: WireAngle
    dec: WireAngle
    pier_side: PierSide
    azimuth_deg: float
    altitude_deg: float
    utc: datetime
    status: MountStatus
    slewing: bool


def _decimals(digits: str) -> int:
    return len(digits.partition(".")[2])


def _status_of(number: int) -> MountStatus:
    try:
        return MountStatus(number)
    except ValueError as cause:
        raise Unreadable(f"there is no status {number}") from cause


def info_from_text(wire: bytes) -> Info:
    """Right ascension (h), declination, side, azimuth, altitude, Julian date, status, slewing.

    Raises
    ------
    Unreadable
        If it does not match wholly or one of it is out of range.
    """
    match = _INFO.fullmatch(wire.decode("latin-1"))
    if match is None:
        raise Unreadable(f"{wire!r} is not a reading")
    ra_h, dec_deg, azimuth_deg, altitude_deg = (float(match[n]) for n in (1, 2, 4, 5))
    if not (ra_h < 24.0 and abs(dec_deg) <= 90.0 and abs(altitude_deg) <= 90.0 and abs(azimuth_deg) <= 360.0):
        raise Unreadable(f"{wire!r} is out of range for a reading")
    days, _, fraction = match[6].partition(".")
    if int(days) not in _DAYS:
        raise Unreadable(f"{wire!r} has a date of no mount")
    # in two parts: one double holds a Julian date only to 40 microseconds
    utc = datetime.fromtimestamp(0.0, UTC) + timedelta(
        days=int(days) - UNIX_ZERO_JD, microseconds=round(float(f"0.{fraction}") * 86400e6)
    )
    return Info(
        WireAngle(ra_h * 15.0, 15.0 * 3600.0 / 10 ** _decimals(match[1])),
        WireAngle(dec_deg, 3600.0 / 10 ** _decimals(match[2])),
        _SIDES[match[3]],
        azimuth_deg,
        altitude_deg,
        utc,
        _status_of(int(match[7])),
        match[8] == "1",
    )


def _utc_from_text(wire: bytes) -> datetime:
    match = _UTC.fullmatch(wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not an instant")
    year, month, day, hour, minute, second = (int(match[n]) for n in range(1, 7))
    try:
        utc = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError as cause:
        raise Unreadable(f"{wire!r} is not an instant: {cause}") from cause
    return utc + timedelta(milliseconds=int((match[7] or b"").ljust(3, b"0")))


def _status_from_text(wire: bytes) -> MountStatus:
    if re.fullmatch(rb"\d{1,2}", wire) is None:
        raise Unreadable(f"{wire!r} is not a status")
    return _status_of(int(wire))


def _side_from_text(wire: bytes) -> PierSide:
    if wire not in _SIDE_WORDS:
        raise Unreadable(f"{wire!r} is not a side of the pier")
    return _SIDE_WORDS[wire]


def _bare_side(buffer: bytes, final: bool) -> Read[PierSide] | None:
    if not buffer:
        return None
    if buffer[:1] not in _DESTINATION:
        raise Unreadable(f"{buffer!r} is not a destination side")
    return Read(_DESTINATION[buffer[:1]], 1)


def _slew_answer(buffer: bytes, final: bool) -> Read[Answer] | None:
    if not buffer:
        return None
    if buffer[:1] == b"0":
        return Read(Answer(), 1)
    code = chr(buffer[0])
    if code not in REFUSALS:
        raise Unreadable(f"{buffer!r} is not an answer to a slew")
    whole = text(buffer, final)
    if whole is None:
        return None
    said = words_but_no_place(whole.value[1:])
    return Read(Answer(said or f"code {code}", REFUSALS[code]), whole.length)


def _sync_answer(wire: bytes) -> Answer:
    said = words_but_no_place(wire)
    if said.startswith("Match fail"):
        return Answer(said, Refusal.LIMIT)
    if not said.startswith("Coordinates"):
        raise Unreadable(f"{wire!r} is not an answer to a sync")
    return Answer()


ULTRA_PRECISION: Command[None] = quiet(b"#:U2#", "ultra precision")
INFO: Command[Info] = Command(b":Ginfo#", "reading", of_text(info_from_text))
STATUS: Command[MountStatus] = Command(b":Gstat#", "status", of_text(_status_from_text))
PIER_SIDE: Command[PierSide] = Command(b":pS#", "pier side", of_text(_side_from_text))
DESTINATION_SIDE: Command[PierSide] = Command(b":GTsid#", "destination pier side", _bare_side)
GET_UTC: Command[datetime] = Command(b":GUDT#", "clock", of_text(_utc_from_text))
SLEW: Command[Answer] = Command(b":MS#", "slew to target", _slew_answer, False)
SYNC: Command[Answer] = Command(b":CM#", "sync to target", of_text(_sync_answer), False)
PARK: Command[None] = quiet(b":KA#", "park", repeatable=False)
UNPARK: Command[None] = quiet(b":PO#", "unpark", repeatable=False)
TRACKING_ON: Command[None] = quiet(b":AP#", "tracking on")
TRACKING_OFF: Command[None] = quiet(b":AL#", "tracking off")
RATES: Mapping[TrackingRate, Command[None]] = {
    TrackingRate.SIDEREAL: quiet(b":TQ#", "sidereal rate"),
    TrackingRate.LUNAR: quiet(b":TL#", "lunar rate"),
    TrackingRate.SOLAR: quiet(b":TSOLAR#", "solar rate"),
}


def set_ra(ra_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target right ascension, to 0.01 s; answers whether it was taken [10MICRON :Sr#]."""
    return taken(b":Sr" + ra_to_fine_text(ra_deg, 2) + b"#", "target right ascension")


def set_dec(dec_deg: float, short: bool = False) -> Command[bool]:
    """Order to take a target declination, to 0.1″; answers whether it was taken [10MICRON :Sd#]."""
    return taken(b":Sd" + degrees_to_fine_text(dec_deg, 1) + b"#", "target declination")


def pulse(direction: Direction, duration_ms: int) -> Command[None]:
    """Order a guide pulse that the mount times [10MICRON :Mg#].

    Raises
    ------
    ValueError
        If it is longer than the firmware takes.
    """
    if not 0 < duration_ms <= LONGEST_PULSE_MS:
        raise ValueError(f"a pulse of {duration_ms} ms can't be ordered")
    word = b":Mg%s%04d#" % (direction.value.encode(), duration_ms)
    return Command(word, f"pulse {direction.name.lower()}", nothing, False, False)


_FIRST_WITH_INFO = (2, 14, 9)
"""The first firmware with the reading in one line [10MICRON :Ginfo]."""


def _as_state(status: MountStatus, side: PierSide | None, *, slewing: bool = False) -> State:
    return State(
        slewing=slewing or status in MOVING,
        tracking=status in FOLLOWING,
        parked=status is MountStatus.PARKED,
        pier_side=side,
    )


async def _one_line(ask: Ask) -> Pointing:
    info = await ask.known(INFO)
    if info is None:
        return await _place(ask)
    return Pointing(info.ra, info.dec, _as_state(info.status, info.pier_side, slewing=info.slewing))


async def _place(ask: Ask) -> Pointing:
    return Pointing(await ask(base.GET_RA), await ask(base.GET_DEC))


async def _state(ask: Ask) -> State:
    status = await ask.known(STATUS)
    side = await ask.known(PIER_SIDE)
    return State(pier_side=side) if status is None else _as_state(status, side)


async def _read_clock(ask: Ask) -> datetime | None:
    return await ask.known(GET_UTC)


async def _destination_side(ask: Ask) -> PierSide | None:
    side = await ask(DESTINATION_SIDE)
    return None if side is PierSide.UNKNOWN else side


def _for_firmware(dialect: Dialect, handshake: Handshake) -> Dialect:
    """Older firmware has no `:Ginfo#`, or another one under that name."""
    numbers = tuple(int(part) for part in re.findall(r"\d+", handshake.firmware or ""))
    if not numbers or numbers >= _FIRST_WITH_INFO:
        return dialect
    return replace(dialect, place=_place, state=_state)


def _without(dialect: Dialect, lacks: Lacks) -> Dialect:
    if lacks(INFO):
        dialect = replace(dialect, place=_place, state=_state)
    return replace(
        dialect,
        tells_pier_side=not lacks(PIER_SIDE),
        parks_unread=lacks(STATUS),
    )


def _write_clock(utc: datetime) -> tuple[Order, ...]:
    # in ultra precision it takes hundredths and the ISO date, and answers one character [10MICRON :SC#]
    utc = utc.astimezone(UTC)
    hundredths = utc.microsecond // 10_000
    return (
        base.taken(b":SG+00.0#", "hours to UTC"),
        base.taken(utc.strftime(f":SL%H:%M:%S.{hundredths:02d}#").encode(), "local time"),
        base.taken(utc.strftime(":SC%Y-%m-%d#").encode(), "date"),
    )


_WRITING = Writing(
    latitude=lambda deg: degrees_to_fine_text(deg, 1),
    longitude=lambda deg: degrees_to_fine_text(-deg, 1, digits=3),
)
"""How a 10micron is given its site."""

TENMICRON = Dialect(
    name="10micron",
    caption="10micron",
    recognizes=lambda handshake: (handshake.product or "").lower().startswith("10micron"),
    place=_one_line,
    set_ra=set_ra,
    set_dec=set_dec,
    slew=SLEW,
    sync=SYNC,
    stop=(base.STOP,),
    prelude=(ULTRA_PRECISION,),
    step_arcsec=RA_STEP_ARCSEC,
    tracking_on=(TRACKING_ON,),
    tracking_off=(TRACKING_OFF,),
    rates=RATES,
    park=(PARK,),
    unpark=(UNPARK,),
    tells_pier_side=True,
    pulse=pulse,
    longest_pulse_ms=LONGEST_PULSE_MS,
    read_clock=_read_clock,
    write_clock=_write_clock,
    read_site=read_site,
    write_site=_WRITING.site,
    destination_side=_destination_side,
    fitted=_for_firmware,
    without=_without,
)
