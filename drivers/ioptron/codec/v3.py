"""The iOptron words of the v3 set, and those it shares with v2: bytes and readers. No wire, no clock.

After iOptron's "Mount RS-232 Command Language", version 3.10 of 2021-01-04 [IOPTRON310], and what a real
INDI driver was seen to say [IOPTRON].
"""

from __future__ import annotations

from datetime import datetime

from drivers.ioptron.codec.dialect import CommandSet, Heading
from drivers.ioptron.codec.frames import model, nothing, order, signed_text, text
from drivers.ioptron.codec.values import (
    STEP_ARCSEC,
    Horizontal,
    MountClock,
    Pointing,
    Status,
    TrackingRate,
    altitude_limit_from_text,
    clock_from_text,
    custom_rate_from_text,
    dec_to_text,
    firmware_from_text,
    horizontal_from_text,
    meridian_from_text,
    offset_to_text,
    pointing_from_text,
    ra_to_text,
    signed_angle,
    status_from_text,
    time_to_text,
    unsigned_angle,
)
from drivers.wire.command import Command

_LONGEST_PULSE_MS = 99_999
"""A guide pulse has five digits [IOPTRON310 :ZS :ZQ]."""
# `:ZS` RA+, `:ZQ` RA-, `:ZE` Dec+, `:ZC` Dec- [IOPTRON310]: S is not south, E not east
_PULSES: dict[Heading, bytes] = {"n": b"ZE", "s": b"ZC", "e": b"ZS", "w": b"ZQ"}

# -- questions of both sets ----------------------------------------------------------------------------

MODEL: Command[str] = Command(b":MountInfo#", "model number", model)
FIRMWARE: Command[str] = Command(
    b":FW1#", "firmware of main board and hand controller", text((12, 16), firmware_from_text)
)
MERIDIAN: Command[tuple[bool, int]] = Command(
    b":GMT#", "what it does at the meridian", text((3,), meridian_from_text)
)
HORIZONTAL: Command[Horizontal] = Command(
    b":GAC#", "altitude and azimuth", signed_text((18,), horizontal_from_text)
)
ALTITUDE_LIMIT: Command[int] = Command(
    b":GAL#", "altitude limit", signed_text((3,), altitude_limit_from_text)
)

# -- orders of both sets -------------------------------------------------------------------------------

SYNC: Command[bool] = order(b"CM", "sync to target", repeatable=False)
PARK: Command[bool] = order(b"MP1", "park", repeatable=False)
UNPARK: Command[bool] = order(b"MP0", "unpark")
HOME: Command[bool] = order(b"MH", "go to the home position", repeatable=False)
FIND_HOME: Command[bool] = order(b"MSH", "search the home position", repeatable=False)

# the mount answers each stop with `1`; nobody waits for it, as the stop's own path goes past all questions,
# and it leaves no answer owing: texts are read behind such ones, and a text is asked before every order
STOP: Command[None] = Command(b":Q#", "stop the slew", nothing, True, False)
STOP_RA: Command[None] = Command(b":qR#", "stop motion in right ascension", nothing, True, False)
STOP_DEC: Command[None] = Command(b":qD#", "stop motion in declination", nothing, True, False)


def set_dec(dec_deg: float) -> Command[bool]:
    """Order to take a target declination; raises `ValueError` beyond the poles [IOPTRON310 :Sd]."""
    return order(b"Sd" + dec_to_text(dec_deg), "target declination")


def set_tracking(on: bool) -> Command[bool]:
    """Order to track or not [IOPTRON310 :STn]."""
    return order(b"ST%d" % on, "tracking")


def set_rate(rate: TrackingRate) -> Command[bool]:
    """Order which rate to follow [IOPTRON310 :RTn]."""
    return order(b"RT%d" % rate, "tracking rate")


def set_park_azimuth(az_deg: float) -> Command[bool]:
    """Order the park position's azimuth [IOPTRON310 :SPA]."""
    return order(b"SPA" + ra_to_text(az_deg), "park azimuth")


def set_park_altitude(alt_deg: float) -> Command[bool]:
    """Order the park position's altitude, 0..90; raises `ValueError` beyond [IOPTRON310 :SPH]."""
    if not 0.0 <= alt_deg <= 90.0:
        raise ValueError(f"a park position at an altitude of {alt_deg} degrees is under the horizon or none")
    return order(b"SPH" + unsigned_angle(alt_deg, 8), "park altitude")


def set_offset(offset_min: int) -> Command[bool]:
    """Order standard time minus UTC; raises `ValueError` where there is no such zone [IOPTRON310 :SG]."""
    return order(b"SG" + offset_to_text(offset_min), "offset from UTC")


def set_summer_time(on: bool) -> Command[bool]:
    """Order whether an hour is added to local time [IOPTRON310 :SDS]."""
    return order(b"SDS%d" % on, "summer time")


def set_hemisphere(northern: bool) -> Command[bool]:
    """Order on which side of the equator it stands [IOPTRON310 :SHE]."""
    return order(b"SHE%d" % northern, "hemisphere")


# -- the v3 set's own ----------------------------------------------------------------------------------

STATUS: Command[Status] = Command(b":GLS#", "site and status", signed_text((23,), status_from_text))
POINTING: Command[Pointing] = Command(b":GEP#", "where it points", signed_text((20,), pointing_from_text))
CLOCK: Command[MountClock] = Command(b":GUT#", "clock", signed_text((18,), clock_from_text))
CUSTOM_RATE: Command[float] = Command(b":GTR#", "custom rate", text((5,), custom_rate_from_text))
SLEW: Command[bool] = order(b"MS1", "slew to target", repeatable=False)


def set_ra(ra_deg: float) -> Command[bool]:
    """Order to take a target right ascension [IOPTRON310 :SRA]."""
    return order(b"SRA" + ra_to_text(ra_deg), "target right ascension")


def set_custom_rate(sidereal: float) -> Command[bool]:
    """Order the custom rate, sidereal rates, 0.1..1.9; raises `ValueError` beyond [IOPTRON310 :RRnnnnn]."""
    if not 0.1 <= sidereal <= 1.9:
        raise ValueError(f"a custom rate of {sidereal} sidereal rates is not one that the mount accepts")
    return order(b"RR%05d" % round(sidereal * 10_000), "custom rate")


ARROW_SPEEDS = (1.0, 2.0, 8.0, 16.0, 64.0, 128.0, 256.0, 512.0)
"""Times sidereal, of the numbers 1 to 8 of `:SRn#`; 9 is the greatest that the model has [IOPTRON310]."""
END_RA: Command[bool] = order(b"qR", "end the motion in right ascension")


def set_arrow_speed(number: int) -> Command[bool]:
    """Order at which speed the arrow keys move, 1..9; raises `ValueError` beyond [IOPTRON310 :SRn]."""
    if not 1 <= number <= 9:
        raise ValueError(f"there is no speed {number}")
    return order(b"SR%d" % number, "speed of the arrow keys")


def move_ra(*, up: bool) -> Command[None]:
    """Order to move on to greater or to smaller right ascension, not answered [IOPTRON310 :mw :me]."""
    return Command(b":mw#" if up else b":me#", "move in right ascension", nothing, False, False)


def set_longitude(longitude_deg: float) -> Command[bool]:
    """Order the site's longitude, EAST positive within ±180; raises `ValueError` beyond [IOPTRON310 :SLO]."""
    if not -180.0 <= longitude_deg <= 180.0:
        raise ValueError(f"a longitude of {longitude_deg} degrees is not within -180..180")
    return order(b"SLO" + signed_angle(longitude_deg), "longitude")


def set_latitude(latitude_deg: float) -> Command[bool]:
    """Order the site's latitude; raises `ValueError` beyond the poles [IOPTRON310 :SLA]."""
    if not -90.0 <= latitude_deg <= 90.0:
        raise ValueError(f"a latitude of {latitude_deg} degrees does not exist")
    return order(b"SLA" + signed_angle(latitude_deg), "latitude")


def set_time(utc: datetime) -> Command[bool]:
    """Order the clock's UTC; raises `ValueError` before J2000 [IOPTRON310 :SUT]."""
    return order(b"SUT" + time_to_text(utc), "clock")


def pulse(heading: Heading, duration_ms: int) -> Command[None]:
    """Order a guide pulse, not answered; raises `ValueError` beyond five digits [IOPTRON310 :ZS :ZQ]."""
    if not 0 <= duration_ms <= _LONGEST_PULSE_MS:
        raise ValueError(f"a pulse of {duration_ms} ms can't be told")
    return Command(b":%s%05d#" % (_PULSES[heading], duration_ms), "guide pulse", nothing, False, False)


def _set_site(latitude_deg: float, longitude_deg: float) -> tuple[Command[bool], ...]:
    return set_latitude(latitude_deg), set_longitude(longitude_deg), set_hemisphere(latitude_deg >= 0.0)


V3 = CommandSet(
    name="v3",
    step_arcsec=STEP_ARCSEC,
    status=STATUS,
    pointing=POINTING,
    has_pier_side=True,
    clock=CLOCK,
    clock_step_s=0.001,
    slew=SLEW,
    set_ra=set_ra,
    set_dec=set_dec,
    pulse=pulse,
    longest_pulse_ms=_LONGEST_PULSE_MS,
    # the clock is UTC, whatever its zone
    before_clock=(),
    set_clock=lambda utc: (set_time(utc),),
    set_site=_set_site,
)
