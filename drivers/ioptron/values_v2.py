"""What the longer words of iOptron's v2 set hold, from text to value and back: pure, full-match or nothing.

Declinations are hundredths of an arcsecond as in v3; right ascensions are milliseconds of time, site angles
whole arcseconds, and the clock tells local time [IOPTRON25, INDI ieqdriverbase].
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

from drivers.ioptron.values import (
    MountClock,
    MountState,
    PierSide,
    Pointing,
    Status,
    TrackingRate,
    angle_from_text,
    dec_to_text,
    offset_from_text,
    offset_to_text,
)
from drivers.wire.command import Unreadable

STEP_ARCSEC = 0.015
"""A millisecond of time."""
_MS_DEG = 240_000
_DAY_MS = 86_400_000

_STATUS = re.compile(rb"([+-][0-9]{6})([0-9]{6})([0-2])([0-7])([0-4])([1-9])([1-3])([01])")
_POINTING = re.compile(rb"([+-][0-9]{8})([0-9]{8})")
_CLOCK = re.compile(rb"([+-][0-9]{3})([01])([0-9]{6})([0-9]{6})")


def ra_to_text(ra_deg: float) -> bytes:
    """Eight digits, milliseconds of time; 24 h is 0."""
    return b"%08d" % (round(ra_deg * _MS_DEG) % _DAY_MS)


def ra_from_text(text: bytes) -> float:
    """Read eight digits; degrees. Raises `Unreadable` beyond 24 h."""
    if re.fullmatch(rb"[0-9]{8}", text) is None or int(text) > _DAY_MS:
        raise Unreadable(f"{text!r} is no right ascension")
    return int(text) % _DAY_MS / _MS_DEG


def signed_arcsec(deg: float) -> bytes:
    """Sign and six digits, whole arcseconds."""
    arcsec = round(deg * 3600.0)
    return b"%s%06d" % (b"-" if arcsec < 0 else b"+", abs(arcsec))


def arcsec_from_text(text: bytes, most_deg: int, what: str) -> float:
    """Read sign and six digits; degrees. Raises `Unreadable` where they are none, or beyond `most_deg`."""
    if re.fullmatch(rb"[+-][0-9]{6}", text) is None or abs(int(text)) > most_deg * 3600:
        raise Unreadable(f"{text!r} is no {what}")
    return int(text) / 3600.0


def status_from_text(text: bytes) -> Status:
    """Read `:GLS#`'s 19 characters; raises `Unreadable` where they don't match wholly and in range."""
    match = _STATUS.fullmatch(text)
    if match is None or int(match[2]) > 180 * 3600:
        raise Unreadable(f"{text!r} is no status")
    return Status(
        arcsec_from_text(match[1], 180, "longitude"),
        int(match[2]) / 3600.0 - 90.0,
        int(match[3]),
        MountState(int(match[4])),
        TrackingRate(int(match[5])),
        int(match[6]),
        int(match[7]),
        match[8] == b"1",
    )


def status_to_text(status: Status) -> bytes:
    """Write the 19 characters of `:GLS#`."""
    return b"%s%06d%s" % (
        signed_arcsec(status.longitude_deg),
        round((status.latitude_deg + 90.0) * 3600.0),
        flags_to_text(status),
    )


def flags_to_text(status: Status) -> bytes:
    """Write the six digits that end `:GLS#`; older firmware tells them alone, as `:GAS#`."""
    return b"%d%d%d%d%d%d" % (
        status.gps,
        status.state,
        status.rate,
        status.arrow_speed,
        status.time_source,
        status.northern,
    )


def pointing_from_text(text: bytes) -> Pointing:
    """Read `:GEC#`'s 17 characters; raises `Unreadable` where they don't match wholly and in range.

    They tell neither the side of the pier nor the counterweight's place.
    """
    match = _POINTING.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is no pointing")
    dec_deg = angle_from_text(match[1], -90, 90, "declination")
    return Pointing(ra_from_text(match[2]), dec_deg, PierSide.UNKNOWN, False)


def pointing_to_text(pointing: Pointing) -> bytes:
    """Write the 17 characters of `:GEC#`."""
    return dec_to_text(pointing.dec_deg) + ra_to_text(pointing.ra_deg)


def clock_from_text(text: bytes) -> MountClock:
    """Read `:GLT#`'s 17 characters; raises `Unreadable` where they don't match wholly or are no date.

    The document leaves out the digit of summer time, which real mounts have; the offset doesn't include it
    [INDI ieqprolegacydriver, IOPTRON25].
    """
    match = _CLOCK.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is no clock")
    offset_min, summer_time = offset_from_text(match[1]), match[2] == b"1"
    try:
        local = datetime.strptime((match[3] + match[4]).decode("ascii"), "%y%m%d%H%M%S").replace(tzinfo=UTC)
    except ValueError as cause:
        raise Unreadable(f"{text!r} is no date and time") from cause
    if local.year < 2000:
        local = local.replace(year=local.year + 100)
    return MountClock(local - timedelta(minutes=offset_min + 60 * summer_time), offset_min, summer_time)


def clock_to_text(clock: MountClock) -> bytes:
    """Write the 17 characters of `:GLT#`, whole seconds gone by."""
    local = clock.utc + timedelta(minutes=clock.offset_min + 60 * clock.summer_time)
    return b"%s%d%s" % (
        offset_to_text(clock.offset_min),
        clock.summer_time,
        local.strftime("%y%m%d%H%M%S").encode("ascii"),
    )
