"""The iOptron words of the v2 set where they differ from v3: bytes and readers. No wire, no clock.

After what is quoted of iOptron's "RS-232 Command Language", version 2.5 [IOPTRON25], and what INDI's
`indi_ieq_telescope` says and expects [INDI ieqdriverbase]. The document itself was not at hand.
"""

from __future__ import annotations

from datetime import datetime, timedelta

from drivers.ioptron.codec import set_dec, set_hemisphere, set_offset, set_summer_time
from drivers.ioptron.replies import nothing, order, signed_text
from drivers.ioptron.values import MountClock, Pointing, Status
from drivers.ioptron.values_v2 import (
    STEP_ARCSEC,
    clock_from_text,
    pointing_from_text,
    ra_to_text,
    signed_arcsec,
    status_from_text,
)
from drivers.ioptron.words import Heading, Words
from drivers.wire.command import Command

_LONGEST_PULSE_MS = 32_767

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


V2 = Words(
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
    # it keeps local time: its zone is set to UTC, so that nobody reckons twice
    before_clock=(set_offset(0), set_summer_time(False)),
    set_clock=_set_clock,
    set_site=_set_site,
)
