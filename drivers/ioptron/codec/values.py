"""What iOptron's longer words hold, from text to value and back: pure, exact, full-match or nothing.

Angles are whole hundredths of an arcsecond, the latitude and its pole distance too; time is milliseconds
since J2000 UTC [IOPTRON310]. Rounding is done once, in the wire's smallest step.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import IntEnum

from drivers.wire.command import Unreadable
from mountnav.units import J2000_UTC

STEP_ARCSEC = 0.01
"""The step of all angles on this wire [IOPTRON]."""
_STEPS_DEG = 360_000
"""Such steps in a degree."""
_TURN = 360 * _STEPS_DEG
"""Such steps in a whole turn."""
_MS = timedelta(milliseconds=1)
"""The unit of that count."""

# [0-9] and not \d: the fields are ASCII alone
_STATUS = re.compile(rb"([+-][0-9]{8})([0-9]{8})([0-2])([0-7])([0-4])([1-9])([1-3])([01])")
_POINTING = re.compile(rb"([+-][0-9]{8})([0-9]{9})([0-2])([01])")
_CLOCK = re.compile(rb"([+-][0-9]{3})([01])([0-9]{13})")


class MountState(IntEnum):
    """What the mount is doing, the fourth field of `:GLS#` [IOPTRON310 :GLS#]."""

    STOPPED = 0
    TRACKING = 1
    SLEWING = 2
    GUIDING = 3
    FLIPPING = 4
    TRACKING_PEC = 5
    PARKED = 6
    HOME = 7


class TrackingRate(IntEnum):
    """Which rate tracking follows [IOPTRON310 :GLS# :RTn#]."""

    SIDEREAL = 0
    LUNAR = 1
    SOLAR = 2
    KING = 3
    CUSTOM = 4


class PierSide(IntEnum):
    """On which side of the pier the tube is; INDI hands it on as it is [IOPTRON310 :GEP#]."""

    EAST = 0
    WEST = 1
    UNKNOWN = 2


@dataclass(frozen=True, slots=True)
class Status:
    """The answer to `:GLS#`.

    Attributes
    ----------
    longitude_deg, latitude_deg : float
        The mount's site; east and north positive.
    gps : int
        0 no module, 1 no data, 2 data.
    arrow_speed : int
        1..9, the speed of motion by arrow keys.
    time_source : int
        1..3.
    northern : bool
        Which hemisphere it is set to.
    """

    longitude_deg: float
    latitude_deg: float
    gps: int
    state: MountState
    rate: TrackingRate
    arrow_speed: int
    time_source: int
    northern: bool


@dataclass(frozen=True, slots=True)
class Pointing:
    """The answer to `:GEP#`: both coordinates in degrees, pier side, and whether the counterweight is up."""

    ra_deg: float
    dec_deg: float
    pier: PierSide
    counterweight_up: bool


@dataclass(frozen=True, slots=True)
class Horizontal:
    """Altitude and azimuth, degrees; azimuth from north over east."""

    alt_deg: float
    az_deg: float


@dataclass(frozen=True, slots=True)
class MountClock:
    """The answer to `:GUT#`.

    Attributes
    ----------
    utc : datetime
        Aware UTC, to the millisecond.
    offset_min : int
        Local standard time minus UTC; summer time is given apart from it.
    summer_time : bool
        Whether an hour is added to local time.
    """

    utc: datetime
    offset_min: int
    summer_time: bool


def _steps(deg: float) -> int:
    return round(deg * _STEPS_DEG)


def unsigned_angle(deg: float, digits: int) -> bytes:
    """Write a whole number of steps of the angle, zero-filled."""
    return b"%0*d" % (digits, _steps(deg))


def signed_angle(deg: float) -> bytes:
    """Write sign and eight digits, as declinations and site angles have them."""
    steps = _steps(deg)
    return b"%s%08d" % (b"-" if steps < 0 else b"+", abs(steps))


def ra_to_text(ra_deg: float) -> bytes:
    """Nine digits; 360° is 0."""
    return b"%09d" % (_steps(ra_deg) % _TURN)


def dec_to_text(dec_deg: float) -> bytes:
    """Sign and eight digits.

    Raises
    ------
    ValueError
        If the declination is not within -90..+90 degrees.
    """
    if not -90.0 <= dec_deg <= 90.0:
        raise ValueError(f"a declination of {dec_deg} degrees does not exist")
    return signed_angle(dec_deg)


def angle_from_text(text: bytes, least_deg: int, most_deg: int, what: str) -> float:
    """Read whole steps, with or without a sign.

    Raises
    ------
    Unreadable
        If the text is not such a number or is not within the bounds.
    """
    if re.fullmatch(rb"[+-]?[0-9]{8,9}", text) is None:
        raise Unreadable(f"{text!r} is no {what}")
    steps = int(text)
    if not least_deg * _STEPS_DEG <= steps <= most_deg * _STEPS_DEG:
        raise Unreadable(f"{text!r} is out of range for a {what}")
    return steps / _STEPS_DEG


def status_from_text(text: bytes) -> Status:
    """Read `:GLS#`'s 23 characters; raises `Unreadable` where they don't match wholly and in range."""
    match = _STATUS.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a status")
    return Status(
        angle_from_text(match[1], -180, 180, "longitude"),
        angle_from_text(match[2], 0, 180, "latitude + 90°") - 90.0,
        int(match[3]),
        MountState(int(match[4])),
        TrackingRate(int(match[5])),
        int(match[6]),
        int(match[7]),
        match[8] == b"1",
    )


def status_to_text(status: Status) -> bytes:
    """Write the 23 characters of `:GLS#`."""
    return b"%s%s%d%d%d%d%d%d" % (
        signed_angle(status.longitude_deg),
        unsigned_angle(status.latitude_deg + 90.0, 8),
        status.gps,
        status.state,
        status.rate,
        status.arrow_speed,
        status.time_source,
        status.northern,
    )


def pointing_from_text(text: bytes) -> Pointing:
    """Read `:GEP#`'s 20 characters; raises `Unreadable` where they don't match wholly and in range."""
    match = _POINTING.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a pointing")
    ra_deg = angle_from_text(match[2], 0, 360, "right ascension")
    return Pointing(
        ra_deg % 360.0,
        angle_from_text(match[1], -90, 90, "declination"),
        PierSide(int(match[3])),
        match[4] == b"0",
    )


def pointing_to_text(pointing: Pointing) -> bytes:
    """Write the 20 characters of `:GEP#`."""
    return b"%s%s%d%d" % (
        dec_to_text(pointing.dec_deg),
        ra_to_text(pointing.ra_deg),
        pointing.pier,
        not pointing.counterweight_up,
    )


def time_to_text(utc: datetime) -> bytes:
    """Thirteen digits: milliseconds since J2000.

    Raises
    ------
    ValueError
        If the instant is not after J2000.
    """
    since_ms = round((utc - J2000_UTC) / _MS)
    if not 0 <= since_ms < 10**13:
        raise ValueError(f"{utc} can't be told: the wire counts from 2000-01-01 12:00 UTC")
    return b"%013d" % since_ms


def time_from_text(text: bytes) -> datetime:
    """Read thirteen digits; raises `Unreadable` where they are no such number."""
    if re.fullmatch(rb"[0-9]{13}", text) is None:
        raise Unreadable(f"{text!r} is not a time")
    return J2000_UTC + int(text) * _MS


def clock_from_text(text: bytes) -> MountClock:
    """Read `:GUT#`'s 18 characters; raises `Unreadable` where they don't match wholly and in range."""
    match = _CLOCK.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a clock")
    return MountClock(time_from_text(match[3]), offset_from_text(match[1]), match[2] == b"1")


def clock_to_text(clock: MountClock) -> bytes:
    """Write the 18 characters of `:GUT#`."""
    return offset_to_text(clock.offset_min) + b"%d" % clock.summer_time + time_to_text(clock.utc)


def horizontal_from_text(text: bytes) -> Horizontal:
    """Read `:GAC#`'s 18 characters; raises `Unreadable` where they don't match wholly and in range."""
    if re.fullmatch(rb"[+-][0-9]{17}", text) is None:
        raise Unreadable(f"{text!r} is not an altitude and azimuth")
    return Horizontal(
        angle_from_text(text[:9], -90, 90, "altitude"), angle_from_text(text[9:], 0, 360, "azimuth") % 360.0
    )


def horizontal_to_text(place: Horizontal) -> bytes:
    """Write the 18 characters of `:GAC#`."""
    return signed_angle(place.alt_deg) + ra_to_text(place.az_deg)


def park_place_to_text(place: Horizontal) -> bytes:
    """Write the 17 digits of `:GPC#`."""
    return unsigned_angle(place.alt_deg, 8) + ra_to_text(place.az_deg)


def altitude_limit_from_text(text: bytes) -> int:
    """Read `:GAL#`'s sign and two digits, degrees; raises `Unreadable` beyond ±89."""
    if re.fullmatch(rb"[+-][0-8][0-9]", text) is None:
        raise Unreadable(f"{text!r} is not an altitude limit")
    return int(text)


def altitude_limit_to_text(alt_deg: int) -> bytes:
    """Write sign and two digits."""
    return b"%s%02d" % (b"-" if alt_deg < 0 else b"+", abs(alt_deg))


def guide_rates_from_text(text: bytes) -> tuple[float, float]:
    """Read `:AG#`'s four digits: right ascension's and declination's rate, in sidereal rates."""
    if re.fullmatch(rb"[0-9]{4}", text) is None:
        raise Unreadable(f"{text!r} are not guide rates")
    return int(text[:2]) / 100.0, int(text[2:]) / 100.0


def custom_rate_from_text(text: bytes) -> float:
    """Read the custom rate, in times sidereal [IOPTRON310 :GTR].

    Raises
    ------
    Unreadable
        If it is none that the mount takes: 0.1 to 1.9.
    """
    if re.fullmatch(rb"[0-9]{5}", text) is None or not 1_000 <= int(text) <= 19_000:
        raise Unreadable(f"{text!r} is not a custom rate")
    return int(text) / 10_000.0


def meridian_from_text(text: bytes) -> tuple[bool, int]:
    """Read `:GMT#`'s three digits: whether it flips (or stops), and how many degrees past the meridian."""
    if re.fullmatch(rb"[01][0-9]{2}", text) is None:
        raise Unreadable(f"{text!r} is not a treatment of the meridian")
    return text[:1] == b"1", int(text[1:])


def firmware_from_text(text: bytes) -> str:
    """Read two dates in digits; one that isn't there is written as x's [INDI ieqpro]."""
    half = len(text) // 2
    dates = text[:half], text[half:]
    if any(re.fullmatch(rb"[0-9]+|x+", date) is None for date in dates):
        raise Unreadable(f"{text!r} are not firmware dates")
    return "/".join(date.decode("ascii") for date in dates)


def offset_from_text(text: bytes) -> int:
    """Read sign and three digits, minutes; raises `Unreadable` beyond 14 hours east or 12 west."""
    if re.fullmatch(rb"[+-][0-9]{3}", text) is None or not -720 <= int(text) <= 840:
        raise Unreadable(f"{text!r} is not an offset from UTC in minutes")
    return int(text)


def offset_to_text(offset_min: int) -> bytes:
    """Sign and three digits; raises `ValueError` beyond 14 hours east or 12 west."""
    if not -720 <= offset_min <= 840:
        raise ValueError(f"an offset of {offset_min} minutes from UTC does not exist")
    return b"%s%03d" % (b"-" if offset_min < 0 else b"+", abs(offset_min))
