"""Site and time in LX200's words: local time and the hours to add to it, longitudes west positive.

`:GG#` and `:SG#` carry the hours that are ADDED to local time to get UTC, the opposite of an ISO offset:
UTC+2 is ``-02`` [LX200 :GG#]. We write UTC as local time, with an offset of zero.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta

from drivers.lx200.codec.angles import dec_from_text, dec_to_text, longitude_from_text, longitude_to_text
from drivers.lx200.codec.base import of_text, taken
from drivers.lx200.codec.dialect import Ask, Order
from drivers.wire.command import Command, Read, Unreadable
from mountnav.sky.coordinates import Site

_DATE = re.compile(rb"(\d{2})[/:](\d{2})[/:](\d{2})")
_TIME = re.compile(rb"(\d{2}):(\d{2}):(\d{2})(?:\.(\d{1,3}))?")
_OFFSET = re.compile(rb"([+-]?)(\d{1,2})(?:\.(\d{1,2})|:(\d{2})(?::(\d{2})(?:\.\d+)?)?)?")
NOT_SET_BEFORE_YEAR = 2020
"""A clock before that was never set since it was switched on."""


def date_from_text(wire: bytes) -> date:
    """``MM/DD/YY``; 70..99 are of the last century [LX200 :GC#]."""
    match = _DATE.fullmatch(wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not a date")
    year = int(match[3])
    try:
        return date(year + (1900 if year >= 70 else 2000), int(match[1]), int(match[2]))
    except ValueError as cause:
        raise Unreadable(f"{wire!r} is not a date: {cause}") from cause


def time_from_text(wire: bytes) -> time:
    """``HH:MM:SS``, perhaps with a fraction [LX200 :GL#]."""
    match = _TIME.fullmatch(wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not a time of day")
    micros = int((match[4] or b"").ljust(6, b"0"))
    try:
        return time(int(match[1]), int(match[2]), int(match[3]), micros)
    except ValueError as cause:
        raise Unreadable(f"{wire!r} is not a time of day: {cause}") from cause


def hours_to_utc_from_text(wire: bytes) -> float:
    """``sHH``, ``sHH.H``, ``sHH:MM`` or ``sHH:MM:SS`` [LX200 :GG#]."""
    match = _OFFSET.fullmatch(wire)
    if match is None:
        raise Unreadable(f"{wire!r} is not an offset to UTC")
    fraction = int(match[3]) / 10 ** len(match[3]) if match[3] else 0.0
    minutes, seconds = int(match[4] or 0), int(match[5] or 0)
    size = int(match[2]) + fraction + minutes / 60.0 + seconds / 3600.0
    if size > 14.0 or minutes > 59 or seconds > 59:
        raise Unreadable(f"{wire!r} is out of range for an offset to UTC")
    return -size if match[1] == b"-" else size


def _latitude(wire: bytes) -> float:
    # 00*30 has no sign on some
    return dec_from_text(wire if wire[:1] in b"+-" else b"+" + wire).deg


GET_DATE: Command[date] = Command(b":GC#", "local date", of_text(date_from_text))
GET_TIME: Command[time] = Command(b":GL#", "local time", of_text(time_from_text))
GET_OFFSET: Command[float] = Command(b":GG#", "hours to UTC", of_text(hours_to_utc_from_text))
GET_LATITUDE: Command[float] = Command(b":Gt#", "latitude", of_text(_latitude))
GET_LONGITUDE: Command[float] = Command(b":Gg#", "longitude", of_text(longitude_from_text))


def _date_taken(buffer: bytes, final: bool) -> Read[bool] | None:
    """``0``, or ``1`` with two texts up to `#`, or with none on clones [LX200 :SC#]."""
    if not buffer:
        return None
    if buffer[:1] == b"0":
        return Read(False, 1)
    if buffer[:1] != b"1":
        raise Unreadable(f"{buffer!r} is not an answer to a date")
    ends = [index for index, byte in enumerate(buffer) if byte == ord("#")]
    if len(ends) >= 2:
        return Read(True, ends[1] + 1)
    if len(buffer) > 120:
        raise Unreadable(f"{buffer!r} is not an answer to a date")
    # some say one text only, some say none: time has run out, so that was all
    whole = len(buffer) == 1 or buffer.endswith(b"#")
    return Read(True, len(buffer)) if final and whole else None


def set_date(day: date, *, answers_bare: bool = False) -> Command[bool]:
    """Order to take a date; `answers_bare` for dialects that say ``1`` and no more [ONSTEP :SC#]."""
    sent = day.strftime(":SC%m/%d/%y#").encode()
    return taken(sent, "date") if answers_bare else Command(sent, "date", _date_taken)


@dataclass(frozen=True, slots=True)
class Writing:
    """How a dialect wants site and time written; the defaults are the classic's.

    Attributes
    ----------
    offset, clock, latitude, longitude : bytes
        Commands, with what they carry.
    """

    zone: bytes = b":SG+00.0#"
    date_answers_bare: bool = False
    latitude: Callable[[float], bytes] = lambda deg: dec_to_text(deg, short=True)
    longitude: Callable[[float], bytes] = longitude_to_text
    space: bytes = b""

    def clock(self, utc: datetime) -> tuple[Order, ...]:
        """Orders that make `utc` the mount's local time, in the zone of UTC."""
        utc = (utc.astimezone(UTC) + timedelta(milliseconds=500)).replace(microsecond=0)
        at = b":SL" + self.space + utc.strftime("%H:%M:%S").encode() + b"#"
        return (
            taken(self.zone, "hours to UTC"),
            taken(at, "local time"),
            set_date(utc.date(), answers_bare=self.date_answers_bare),
        )

    def site(self, site: Site) -> tuple[Order, ...]:
        """Orders that set its site."""
        latitude = self.latitude(site.latitude_deg)
        longitude = self.longitude(site.longitude_deg)
        return (
            taken(b":St" + self.space + latitude + b"#", "latitude"),
            taken(b":Sg" + self.space + longitude + b"#", "longitude"),
        )


async def read_clock(ask: Ask) -> datetime | None:
    """Ask for date, time and offset; the second that the time was cut to is centered.

    None where one of the three is missing: a guessed offset would be a clock wrong by hours.
    """
    day = await ask.known(GET_DATE)
    if day is None:
        return None
    while True:
        at = await ask.known(GET_TIME)
        again = await ask.known(GET_DATE)
        if again == day:
            break
        # midnight came between the two
        day = again
    hours = await ask.known(GET_OFFSET)
    if day is None or at is None or hours is None:
        return None
    local = datetime.combine(day, at, UTC)
    half = timedelta(0) if at.microsecond else timedelta(milliseconds=500)
    return local + half + timedelta(hours=hours)


async def clock_was_never_set(ask: Ask) -> bool:
    """Evidence of a power-up: the date is of long ago."""
    day = await ask.known(GET_DATE)
    return day is not None and day.year < NOT_SET_BEFORE_YEAR


async def read_site(ask: Ask) -> Site | None:
    """Ask for latitude and longitude; None where one of them is missing."""
    latitude_deg = await ask.known(GET_LATITUDE)
    longitude_deg = await ask.known(GET_LONGITUDE)
    if latitude_deg is None or longitude_deg is None:
        return None
    return Site(latitude_deg, longitude_deg)
