"""The iOptron words and values of the v2 set where they differ from v3; no wire, no clock.

Declinations are hundredths of an arcsecond as in v3; right ascensions are milliseconds of time, site angles
whole arcseconds, and the clock has local time [IOPTRON25, INDI ieqdriverbase].

After what is quoted of iOptron's "RS-232 Command Language", version 2.5 [IOPTRON25], and what INDI's
`indi_ieq_telescope` says and expects [INDI ieqdriverbase]. The document itself was not available.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

from drivers.ioptron.codec.dialect import CommandSet, Heading
from drivers.ioptron.codec.frames import nothing, order, signed_text
from drivers.ioptron.codec.v3 import set_dec, set_hemisphere, set_offset, set_summer_time
from drivers.ioptron.codec.values import (
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
from drivers.wire.command import Command, Unreadable

STEP_ARCSEC = 0.015
"""A millisecond of time."""
_MS_DEG = 240_000
"""Right ascensions are milliseconds of time on this wire: so many a degree [IOPTRON v2]."""
_DAY_MS = 86_400_000
"""A whole turn in the same unit."""

_STATUS = re.compile(rb"([+-][0-9]{6})([0-9]{6})([0-2])([0-7])([0-4])([1-9])([1-3])([01])")
_POINTING = re.compile(rb"([+-][0-9]{8})([0-9]{8})")
_CLOCK = re.compile(rb"([+-][0-9]{3})([01])([0-9]{6})([0-9]{6})")


def ra_to_text(ra_deg: float) -> bytes:
    """Eight digits, milliseconds of time; 24 h is 0."""
    return b"%08d" % (round(ra_deg * _MS_DEG) % _DAY_MS)


def ra_from_text(text: bytes) -> float:
    """Read eight digits; degrees. Raises `Unreadable` beyond 24 h."""
    if re.fullmatch(rb"[0-9]{8}", text) is None or int(text) > _DAY_MS:
        raise Unreadable(f"{text!r} is not a right ascension")
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
        raise Unreadable(f"{text!r} is not a status")
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
    """Write the six digits that end `:GLS#`; older firmware reports them alone, as `:GAS#`."""
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

    They have neither the side of the pier nor the counterweight's place.
    """
    match = _POINTING.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a pointing")
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
        raise Unreadable(f"{text!r} is not a clock")
    offset_min, summer_time = offset_from_text(match[1]), match[2] == b"1"
    try:
        local = datetime.strptime((match[3] + match[4]).decode("ascii"), "%y%m%d%H%M%S").replace(tzinfo=UTC)
    except ValueError as cause:
        raise Unreadable(f"{text!r} is not a date and time") from cause
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


_LONGEST_PULSE_MS = 32_767
"""The longest guide pulse that the set takes [IOPTRON25 :MnXXXXX]."""

STATUS: Command[Status] = Command(b":GLS#", "site and status", signed_text((19,), status_from_text))
POINTING: Command[Pointing] = Command(b":GEC#", "where it points", signed_text((17,), pointing_from_text))
CLOCK: Command[MountClock] = Command(b":GLT#", "clock", signed_text((17,), clock_from_text))
SLEW: Command[bool] = order(b"MS", "slew to target", repeatable=False)


def set_ra(ra_deg: float) -> Command[bool]:
    """Order to take a target right ascension [IOPTRON25 :Sr]."""
    return order(b"Sr" + ra_to_text(ra_deg), "target right ascension")


def set_longitude(longitude_deg: float) -> Command[bool]:
    """Order the site's longitude, EAST positive within ±180; raises `ValueError` beyond [IOPTRON25 :Sg]."""
    if not -180.0 <= longitude_deg <= 180.0:
        raise ValueError(f"a longitude of {longitude_deg} degrees is not within -180..180")
    return order(b"Sg" + signed_arcsec(longitude_deg), "longitude")


def set_latitude(latitude_deg: float) -> Command[bool]:
    """Order the site's latitude; raises `ValueError` beyond the poles [IOPTRON25 :St]."""
    if not -90.0 <= latitude_deg <= 90.0:
        raise ValueError(f"a latitude of {latitude_deg} degrees does not exist")
    return order(b"St" + signed_arcsec(latitude_deg), "latitude")


def set_date(local: datetime) -> Command[bool]:
    """Order the local date [IOPTRON25 :SC]."""
    return order(b"SC" + local.strftime("%y%m%d").encode("ascii"), "local date")


def set_local_time(local: datetime) -> Command[bool]:
    """Order the local time, whole seconds [IOPTRON25 :SL]."""
    return order(b"SL" + local.strftime("%H%M%S").encode("ascii"), "local time")


def pulse(heading: Heading, duration_ms: int) -> Command[None]:
    """Order a guide pulse, not answered; raises `ValueError` beyond 32767 ms [IOPTRON25 :MnXXXXX]."""
    if not 0 <= duration_ms <= _LONGEST_PULSE_MS:
        raise ValueError(f"a pulse of {duration_ms} ms can't be told")
    return Command(
        b":M%s%05d#" % (heading.encode("ascii"), duration_ms), "guide pulse", nothing, False, False
    )


def _set_clock(utc: datetime) -> tuple[Command[bool], ...]:
    nearest = (utc + timedelta(milliseconds=500)).replace(microsecond=0)
    return set_date(nearest), set_local_time(nearest)


def _set_site(latitude_deg: float, longitude_deg: float) -> tuple[Command[bool], ...]:
    return set_latitude(latitude_deg), set_longitude(longitude_deg), set_hemisphere(latitude_deg >= 0.0)


V2 = CommandSet(
    name="v2",
    step_arcsec=STEP_ARCSEC,
    status=STATUS,
    pointing=POINTING,
    has_pier_side=False,
    clock=CLOCK,
    clock_step_s=1.0,
    slew=SLEW,
    set_ra=set_ra,
    set_dec=set_dec,
    pulse=pulse,
    longest_pulse_ms=_LONGEST_PULSE_MS,
    # it keeps local time: its zone is set to UTC, so that it isn't converted twice
    before_clock=(set_offset(0), set_summer_time(False)),
    set_clock=_set_clock,
    set_site=_set_site,
)
