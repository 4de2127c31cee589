"""Angles and times as ephemeris tables write them."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta
from typing import Final

from mountnav.errors import BadRequest
from mountnav.sky.iers import tt_minus_utc_s
from mountnav.units import DEG_PER_HOUR, J2000_JD, J2000_UTC

_NUMBER: Final = re.compile(r"[+-]?[0-9]{1,12}(?:\.[0-9]{0,15})?")
_MONTHS: Final = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def plain_number(text: str, what: str, at: str) -> float:
    """A decimal number, nothing else. Raises BadRequest."""
    if not _NUMBER.fullmatch(text.strip()):
        raise BadRequest(f"{at}: {text.strip()[:24]!r} is no {what}")
    return float(text)


def ra_of(parts: list[str], at: str) -> tuple[float, float]:
    """Right ascension of hours, minutes and seconds, or of degrees; and its last digit, ″ on the equator.

    Parameters
    ----------
    parts : list of str
        Three: hours, minutes, seconds. One: degrees.

    Raises
    ------
    BadRequest
    """
    if len(parts) == 1:
        degrees = plain_number(parts[0], "right ascension", at)
        if not 0.0 <= degrees <= 360.0:
            raise BadRequest(f"{at}: a right ascension of {degrees:g}° is outside 0 to 360")
        return degrees % 360.0, _last_digit(parts[0]) * 3600.0
    return _sexagesimal(parts, 24.0, "right ascension", at) * 15.0, _last_digit(
        parts[-1]
    ) * DEG_PER_HOUR * _below(parts)


def dec_of(parts: list[str], at: str) -> tuple[float, float]:
    """Declination of degrees, minutes, seconds, or of degrees; and its last digit, ″. Raises BadRequest."""
    if len(parts) == 1:
        degrees = plain_number(parts[0], "declination", at)
        digit = _last_digit(parts[0]) * 3600.0
    else:
        told = parts[0].strip() if parts else ""
        sign = -1.0 if told.startswith("-") else 1.0
        first = told.lstrip("+-")
        degrees = sign * _sexagesimal([first, *parts[1:]], 90.0001, "declination", at)
        digit = _last_digit(parts[-1]) * _below(parts)
    if not -90.0 <= degrees <= 90.0:
        raise BadRequest(f"{at}: a declination of {degrees:g}° is outside -90 to 90")
    return degrees, digit


def _below(parts: list[str]) -> float:
    return 1.0 if len(parts) == 3 else 60.0


def _sexagesimal(parts: list[str], most: float, what: str, at: str) -> float:
    if len(parts) not in (2, 3):
        raise BadRequest(f"{at}: {' '.join(parts)[:30]!r} is no {what}")
    numbers = [plain_number(part, what, at) for part in parts]
    whole, below = numbers[0], numbers[1:]
    if not (whole.is_integer() and 0.0 <= whole < most and all(0.0 <= one < 60.0 for one in below)):
        raise BadRequest(f"{at}: {' '.join(parts)[:30]!r} is no {what}")
    if len(below) == 2 and not below[0].is_integer():
        raise BadRequest(f"{at}: {' '.join(parts)[:30]!r} is no {what}")
    return whole + below[0] / 60.0 + (below[1] / 3600.0 if len(below) == 2 else 0.0)


def _last_digit(text: str) -> float:
    _, _, decimals = text.strip().partition(".")
    return float(10.0 ** -len(decimals))


def utc_of_julian_date(jd: float, scale: str) -> datetime:
    """An instant of a Julian date. Scales: UT (UTC), TT, TDB. Raises BadRequest."""
    if not 2441317.5 <= jd <= 2488069.5:
        raise BadRequest(f"JD {jd:g} lies outside the years 1972 to 2099")
    return in_utc(J2000_UTC + timedelta(days=jd - J2000_JD), scale)


def calendar_instant(day: str, clock: str, scale: str, at: str) -> datetime:
    """An instant such as 2022-Jun-10 00:00:00.000 in a time scale. Raises BadRequest."""
    match = re.fullmatch(r"([0-9]{4})-([A-Za-z]{3}|[0-9]{2})-([0-9]{2})", day)
    hours = re.fullmatch(r"([0-9]{2}):([0-9]{2})(?::([0-9]{2}(?:\.[0-9]{1,9})?))?", clock)
    if match is None or hours is None:
        raise BadRequest(f"{at}: {day} {clock} is not a time such as 2022-Jun-10 00:00")
    month = match[2].lower()
    try:
        number = int(month) if month.isdigit() else _MONTHS.index(month) + 1
        seconds = float(hours[3] or 0.0)
        whole = math.floor(seconds)
        made = datetime(int(match[1]), number, int(match[3]), int(hours[1]), int(hours[2]), tzinfo=UTC)
        if seconds >= 60.0:
            raise ValueError
        return in_utc(made + timedelta(seconds=whole, microseconds=round((seconds - whole) * 1e6)), scale)
    except (ValueError, OverflowError) as wrong:
        raise BadRequest(f"{at}: {day} {clock} is not a time") from wrong


def in_utc(told: datetime, scale: str) -> datetime:
    """Of a clock's reading in UT, TT or TDB (which differ by 2 ms) the instant in UTC. Raises BadRequest."""
    if scale in ("UT", "UTC"):
        return told
    if scale in ("TT", "TDB", "CT"):
        # the leap seconds of a minute earlier are those of the instant but for one minute in years
        return told - timedelta(seconds=tt_minus_utc_s(told - timedelta(seconds=70)))
    raise BadRequest(f"the time scale {scale!r} is not supported; UT (UTC), TT and TDB are")
