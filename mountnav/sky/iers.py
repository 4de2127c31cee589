"""The Earth's orientation comes from the table installed beside us: no network, and no exception at its end.

The tables are those of the package ``astropy-iers-data``: *finals2000A.all* (UT1-UTC and polar motion) and
*Leap_Second.dat*. They are read here directly, which costs 50 ms once and microseconds afterwards. Before the
first row and after the last one the nearest row is held; `iers_status` says how long the table still lasts.
An unknown dut1 (less than 0.9 s) costs at most 13.5″, in hour angle alone [POINTING §2].
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from itertools import pairwise
from pathlib import Path

import astropy_iers_data

from mountnav.clock import utc_now
from mountnav.errors import BadRequest, BadSettings
from mountnav.units import SECONDS_PER_DAY

ALARM_DAYS = 60.0
"""So many days before the table of the Earth's orientation ends it is said so: time for an update. Chosen by
hand."""
_MJD_ZERO = datetime(1858, 11, 17, tzinfo=UTC)
"""Zero of the modified Julian date."""
_TT_MINUS_TAI_S = 32.184
"""Terrestrial time less atomic time, seconds, by definition [IAU 1991]."""


@dataclass(frozen=True, slots=True)
class EarthOrientation:
    """How the Earth stands at one instant.

    Attributes
    ----------
    dut1_s : float
        UT1 - UTC.
    polar_x_arcsec, polar_y_arcsec : float
        Place of the pole, x towards Greenwich, y towards 90° west.
    """

    dut1_s: float
    polar_x_arcsec: float
    polar_y_arcsec: float


@dataclass(frozen=True, slots=True)
class IersStatus:
    """What is known of the Earth's orientation, and for how long it will be.

    Attributes
    ----------
    first_row_utc, last_row_utc : datetime
        Span of the table, predictions included.
    last_measured_utc : datetime
        Last row that is measured rather than predicted.
    age_days : float
        Time since `last_measured_utc`.
    days_left : float
        Time until `last_row_utc`; negative once the table has ended.
    dut1_s : float
        UT1 - UTC in use.
    dut1_overridden : bool
        Whether `dut1_s` was set by the operator.
    leap_seconds_expire_utc : datetime or None
        Until when the list of leap seconds is promised to be complete.
    warning : str or None
        What is wrong and what to do about it; None when all is well.
    """

    first_row_utc: datetime
    last_row_utc: datetime
    last_measured_utc: datetime
    age_days: float
    days_left: float
    dut1_s: float
    dut1_overridden: bool
    leap_seconds_expire_utc: datetime | None
    warning: str | None


@dataclass(frozen=True, slots=True)
class _Table:
    """Daily rows without a gap; UT1-TAI rather than UT1-UTC, since it has no jumps at leap seconds."""

    first_mjd: int
    last_measured_mjd: int
    ut1_tai_s: tuple[float, ...]
    x_arcsec: tuple[float, ...]
    y_arcsec: tuple[float, ...]

    @property
    def last_mjd(self) -> int:
        return self.first_mjd + len(self.ut1_tai_s) - 1


@dataclass(frozen=True, slots=True)
class _LeapSeconds:
    """From which day on TAI-UTC has which value."""

    mjd: tuple[float, ...]
    tai_utc_s: tuple[float, ...]
    expire_utc: datetime | None

    def at(self, mjd: float) -> float:
        """TAI-UTC at a UTC day."""
        return self.tai_utc_s[max(0, bisect_right(self.mjd, mjd) - 1)]


class _Override:
    """The operator's own dut1, if there is one."""

    dut1_s: float | None = None


def _text(path: str) -> list[str]:
    return Path(path).read_text(encoding="ascii").splitlines()


@cache
def _leap_seconds() -> _LeapSeconds:
    mjd, tai_utc_s, expire_utc = [], [], None
    for line in _text(astropy_iers_data.IERS_LEAP_SECOND_FILE):
        if "expires on" in line:
            # day, English month name, year; strptime would read the month in the machine's language
            day, month, year = line.split("expires on")[1].split()
            months = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
            expire_utc = datetime(int(year), months.index(month[:3].lower()) + 1, int(day), tzinfo=UTC)
        elif line.strip() and not line.startswith("#"):
            fields = line.split()
            mjd.append(float(fields[0]))
            tai_utc_s.append(float(fields[4]))
    return _LeapSeconds(tuple(mjd), tuple(tai_utc_s), expire_utc)


@cache
def _table() -> _Table:
    """Read the Bulletin A columns of *finals2000A.all* [IERS ReadMe.finals2000A].

    Not those of Bulletin B: its old rows are rounded, and lie 0.6 ms off the final series C04 in 1985
    where Bulletin A is within 0.05 ms.
    """
    leap = _leap_seconds()
    days: list[int] = []
    ut1_tai_s: list[float] = []
    x_arcsec: list[float] = []
    y_arcsec: list[float] = []
    last_measured_mjd = 0
    for line in _text(astropy_iers_data.IERS_A_FILE):
        if not (line[58:68].strip() and line[18:27].strip() and line[37:46].strip()):
            continue  # dates ahead of the predictions stand there without values
        day = int(float(line[7:15]))
        if line[57] == "I":
            last_measured_mjd = day
        days.append(day)
        ut1_tai_s.append(float(line[58:68]) - leap.at(day))
        x_arcsec.append(float(line[18:27]))
        y_arcsec.append(float(line[37:46]))
    if not days or any(b - a != 1 for a, b in pairwise(days)):
        raise BadSettings(
            "the installed table of the Earth's orientation has gaps or no rows",
            device=Path(astropy_iers_data.IERS_A_FILE).name,
            advice="reinstall the package astropy-iers-data",
        )
    return _Table(days[0], last_measured_mjd, tuple(ut1_tai_s), tuple(x_arcsec), tuple(y_arcsec))


def utc_mjd(utc: datetime) -> tuple[int, float]:
    """Split an instant into Modified Julian Date and fraction of the day.

    Raises
    ------
    BadRequest
        The datetime is naive, or from before UTC in its present form (1972) or after 2099.
    """
    if utc.utcoffset() is None:
        raise BadRequest(
            f"the instant {utc.isoformat()} doesn't say its time zone",
            advice="give UTC, for example 2026-11-21T22:00:00Z",
        )
    instant = utc.astimezone(UTC)
    if not 1972 <= instant.year < 2100:
        raise BadRequest(
            f"the instant {instant.isoformat()} lies outside the years 1972 to 2099", advice="check the clock"
        )
    since = instant - _MJD_ZERO
    return since.days, (since.seconds + since.microseconds * 1e-6) / SECONDS_PER_DAY


def _datetime(mjd: float) -> datetime:
    return _MJD_ZERO + timedelta(days=mjd)


def tt_minus_utc_s(utc: datetime) -> float:
    """Terrestrial time minus UTC, leap seconds included.

    Raises
    ------
    BadRequest
        See `utc_mjd`.
    """
    return _leap_seconds().at(utc_mjd(utc)[0]) + _TT_MINUS_TAI_S


def earth_orientation(utc: datetime) -> EarthOrientation:
    """UT1-UTC and polar motion at an instant, interpolated linearly between the days of the table.

    Outside the table the nearest row is held. A dut1 set with `override_dut1` takes precedence.

    Raises
    ------
    BadRequest
        See `utc_mjd`.
    """
    table = _table()
    day, fraction = utc_mjd(utc)
    position = min(max(day + fraction - table.first_mjd, 0.0), float(table.last_mjd - table.first_mjd))
    low = min(int(position), table.last_mjd - table.first_mjd - 1)
    part = position - low

    def between(rows: tuple[float, ...]) -> float:
        return rows[low] + part * (rows[low + 1] - rows[low])

    dut1_s = _Override.dut1_s
    if dut1_s is None:
        # the leap seconds of the row's own day, so that what is held beyond the end is UT1-UTC
        held_day = min(max(day, table.first_mjd), table.last_mjd)
        dut1_s = between(table.ut1_tai_s) + _leap_seconds().at(held_day)
    return EarthOrientation(dut1_s, between(table.x_arcsec), between(table.y_arcsec))


def override_dut1(dut1_s: float | None) -> None:
    """Use the operator's UT1-UTC instead of the table's; None goes back to the table.

    Raises
    ------
    BadSettings
        Not a number between -0.9 and +0.9 s, which leap seconds keep it within.
    """
    if dut1_s is not None and not (math.isfinite(dut1_s) and abs(dut1_s) <= 0.9):
        raise BadSettings(
            f"dut1_s = {dut1_s} is not between -0.9 and 0.9",
            advice="take UT1-UTC from IERS Bulletin A, in seconds",
        )
    _Override.dut1_s = dut1_s


def iers_status(utc: datetime | None = None) -> IersStatus:
    """How good the Earth's orientation is, and for how long.

    Parameters
    ----------
    utc : datetime, optional
        As of when; now if not given.

    Raises
    ------
    BadRequest
        See `utc_mjd`.
    """
    instant = utc_now() if utc is None else utc
    day, fraction = utc_mjd(instant)
    table, leap = _table(), _leap_seconds()
    days_left = table.last_mjd - (day + fraction)
    overridden = _Override.dut1_s is not None
    warning = None
    if days_left < ALARM_DAYS:
        ends = f"{_datetime(table.last_mjd):%Y-%m-%d}"
        warning = (
            f"the table of the Earth's orientation {'ended' if days_left < 0 else 'ends'} on {ends}: "
            "update the package astropy-iers-data, or set dut1"
        )
    elif leap.expire_utc is not None and instant > leap.expire_utc:
        warning = (
            f"the list of leap seconds is valid until {leap.expire_utc:%Y-%m-%d} only: "
            "update the package astropy-iers-data"
        )
    return IersStatus(
        first_row_utc=_datetime(table.first_mjd),
        last_row_utc=_datetime(table.last_mjd),
        last_measured_utc=_datetime(table.last_measured_mjd),
        age_days=day + fraction - table.last_measured_mjd,
        days_left=days_left,
        dut1_s=earth_orientation(instant).dut1_s,
        dut1_overridden=overridden,
        leap_seconds_expire_utc=leap.expire_utc,
        warning=warning,
    )


def read_tables() -> None:
    """Read the tables before the first request. Calling it again is free.

    Our own processes begin with this: none asks astropy for a time, and loading its times costs more than all
    else that a fake mount needs.

    Raises
    ------
    BadSettings
        The installed table has gaps.
    """
    _table()


@cache
def prepare() -> None:
    """Forbid astropy the network and read the tables, for programs that use astropy's times as well.

    Calling it again is free. Without this astropy raises `ValueError` once the predictions are older than 30
    days; ``auto_max_age = None`` alone prevents that [POINTING §2].
    """
    from astropy.utils import iers  # half a second, and not needed by the chain itself: see `read_tables`

    iers.conf.auto_download = False
    iers.conf.auto_max_age = None
    iers.conf.iers_degraded_accuracy = "warn"
    read_tables()
