"""Units, epochs and constants of nature: one home for each, and how a duration and an angle are written.

All are definitions; none is a choice, and doubled each makes every place or time that is converted by it
wrong by that factor. Names read as "so many of these in one of those". Where both sides of a conversion carry
their units in their names (``off_arcsec / 3600.0``), the number stands as it is: a name would say it a third
time.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta

ARCSEC_PER_DEG = 3600.0
"""Arcseconds in a degree."""
ARCSEC_PER_RAD = math.degrees(1.0) * ARCSEC_PER_DEG
"""Arcseconds in a radian: 206264.8."""
RAD_PER_ARCSEC = math.radians(1.0 / ARCSEC_PER_DEG)
"""Radians in an arcsecond: 4.848e-6."""
RAD_PER_MAS = math.pi / 180.0 / 3600.0e3
"""Radians in a milliarcsecond: 4.848e-9."""
MAS_PER_RAD = 180.0 * 3600_000.0 / math.pi
"""Milliarcseconds in a radian."""
DEG_PER_HOUR = 15.0
"""Degrees in an hour of right ascension or hour angle."""
SKY_DEG2 = 4.0 * math.pi * math.degrees(1.0) ** 2
"""Square degrees of the whole sky: 41252.96."""

SECONDS_PER_HOUR = 3600.0
"""Seconds in an hour of time."""
SECONDS_PER_DAY = 86400.0
"""Seconds in a day without a leap second; those of UTC with one are `sky.iers`'s to know."""
JULIAN_YEAR_DAYS = 365.25
"""Days in a Julian year, the year of proper motions and epochs."""

J2000_JD = 2451545.0
"""Julian date of J2000.0, in whichever time scale the date is."""
MJD_ZERO_JD = 2400000.5
"""Julian date of the zero of the modified Julian date."""
UNIX_ZERO_JD = 2440587.5
"""Julian date, UTC, of 1970-01-01T00:00, the zero of Unix time."""
J2000_UTC = datetime(2000, 1, 1, 12, tzinfo=UTC)
"""J2000.0 but for the 64 s between UTC and TT, which no proper motion and no wire format asks for."""

AU_KM = 149597870.700
"""Kilometers in an astronomical unit, by definition [IAU 2012 B2]."""
LIGHT_KM_S = 299792.458
"""Speed of light, km/s, by definition [SI]."""


def julian_year(utc: datetime) -> float:
    """Julian year of an instant, the epoch that proper motions are carried to.

    Plain arithmetic, without the minute between UTC and TT, which moves no star, and without astropy, which
    warns of years before 1960.
    """
    return 2000.0 + (utc - J2000_UTC) / timedelta(days=JULIAN_YEAR_DAYS)


def pixel_scale_arcsec(pixel_um: float, focal_length_mm: float) -> float:
    """Scale of an image, ″/px, of a pixel of `pixel_um` (binned: of the larger pixel) behind a focal length.

    The same with the scale in the place of the focal length gives the focal length, mm.
    """
    return ARCSEC_PER_RAD * 1e-3 * pixel_um / focal_length_mm


def duration_text(seconds: float | None, unknown: str = "an unknown time") -> str:
    """Write a duration for a person: "75 s", "12 min", "1 h 30 min"."""
    if seconds is None:
        return unknown
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def sexagesimal_text(value: float, decimals: int, *, plus: str = "", wrap: int | None = None) -> str:
    """Write hours or degrees as "dd mm ss.s", rounded before it is split so that no 60 appears.

    Parameters
    ----------
    decimals : int
        Of the seconds, > 0.
    plus : str
        Stands before what is not negative.
    wrap : int, optional
        Where the whole units begin again: 24 for right ascension.
    """
    unit = 10**decimals
    ticks = round(abs(value) * 3600.0 * unit)
    whole, ticks = divmod(ticks, 3600 * unit)
    minutes, ticks = divmod(ticks, 60 * unit)
    if wrap:
        whole %= wrap
    sign = "-" if value < 0.0 else plus
    return f"{sign}{whole:02d} {minutes:02d} {ticks / unit:0{decimals + 3}.{decimals}f}"
