"""When a frame was exposed, and for how long, read from header cards of every odd form."""

from __future__ import annotations

import math
import re
from datetime import UTC, datetime, timedelta

Header = dict[str, str | int | float | bool]

_EXPOSURE_CARDS = ("EXPTIME", "EXPOSURE", "EXP_TIME", "ITIME", "TELAPSE", "XPOSURE")
_CLOCK_CARDS = ("TIME-OBS", "UT", "UTSTART", "UTC", "UT-OBS", "TIME_OBS", "UTIME")
_MJD_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)
_YEAR_FIRST = re.compile(r"^(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})(?:[T ]\s*(.*))?$")
_DAY_FIRST = re.compile(r"^(\d{1,2})/(\d{1,2})/(\d{2}|\d{4})(?:[T ]\s*(.*))?$")
_CLOCK = re.compile(
    r"^(\d{1,2})[:h ](\d{1,2})(?:[:m ](\d{1,2}(?:\.\d*)?)s?)?\s*(?:Z|UTC?|([+-]\d{2}):?(\d{2}))?$", re.I
)
# No leap second has been added since; earlier frames in these scales get no time rather than a wrong one.
_TAI_MINUS_UTC_S = 37.0
_LAST_LEAP = datetime(2017, 1, 1, tzinfo=UTC)
_SCALE_MINUS_UTC_S = {
    "TAI": _TAI_MINUS_UTC_S,
    "TT": _TAI_MINUS_UTC_S + 32.184,
    "GPS": _TAI_MINUS_UTC_S - 19.0,
}


def exposure_s_from_header(header: Header) -> float | None:
    """Return the exposure in seconds, or None."""
    for key in _EXPOSURE_CARDS:
        value = _number(header.get(key))
        if value is not None and 0.0 <= value < 1e6:
            return value
    return None


def mid_exposure_from_header(header: Header) -> datetime | None:
    """Return the instant of mid-exposure, or None.

    ``DATE-AVG`` and ``MJD-AVG`` are that instant [FITS 4.0 §9.5]; ``DATE-OBS`` (``DATE-BEG``, ``MJD-OBS``,
    ``JD``) is taken as the start, and half the exposure is added.

    Parameters
    ----------
    header : dict

    Returns
    -------
    datetime or None
        Aware, UTC.
    """
    half = timedelta(seconds=(exposure_s_from_header(header) or 0.0) / 2.0)
    found: datetime | None = None
    if (middle := _date(header, "DATE-AVG")) or (middle := _julian(header, "MJD-AVG", 0.0)):
        found = middle
    else:
        for start in (
            _date(header, "DATE-OBS"),
            _date(header, "DATE-BEG"),
            _date(header, "DATE_OBS"),
            _julian(header, "MJD-OBS", 0.0),
            _julian(header, "JD", 2400000.5),
        ):
            if start is not None:
                found = start + half
                break
    return None if found is None else _as_utc(found, str(header.get("TIMESYS", "UTC")).strip().upper())


def _as_utc(instant: datetime, scale: str) -> datetime | None:
    """Turn an instant counted in another time scale into UTC."""
    if scale == "TDB":
        scale = "TT"
    ahead_s = _SCALE_MINUS_UTC_S.get(scale)
    if ahead_s is None:
        return instant
    return instant - timedelta(seconds=ahead_s) if instant >= _LAST_LEAP else None


def _date(header: Header, key: str) -> datetime | None:
    text = header.get(key)
    if not isinstance(text, str):
        return None
    text = text.strip()
    if match := _YEAR_FIRST.match(text):
        year, month, day = (int(match[i]) for i in (1, 2, 3))
    elif match := _DAY_FIRST.match(text):
        day, month, year = (int(match[i]) for i in (1, 2, 3))
        year += 1900 if year < 100 else 0  # [FITS 4.0 §9.1.1]: the two-digit form means 19xx
    else:
        return None
    clock = match[4]
    if not clock:
        clock = next(
            (str(header[k]).strip() for k in _CLOCK_CARDS if _CLOCK.match(str(header.get(k, "")))), ""
        )
        if not clock:
            return None  # a date alone is no instant: half a day wrong is worse than unknown
    parts = _CLOCK.match(clock.strip())
    if parts is None:
        return None
    try:
        midnight = datetime(year, month, day, tzinfo=UTC)
    except ValueError:
        return None
    hours, minutes, seconds = int(parts[1]), int(parts[2]), float(parts[3] or 0.0)
    if hours > 24 or minutes > 59 or seconds >= 61.0:
        return None
    instant = midnight + timedelta(hours=hours, minutes=minutes, seconds=seconds)
    if parts[4]:
        ahead = timedelta(hours=abs(int(parts[4])), minutes=int(parts[5]))
        instant += ahead if parts[4].startswith("-") else -ahead
    return instant if _sane(instant) else None


def _julian(header: Header, key: str, zero: float) -> datetime | None:
    value = _number(header.get(key))
    if value is None or not 0.0 < value - zero < 100_000.0:
        return None
    instant = _MJD_EPOCH + timedelta(days=value - zero)
    return instant if _sane(instant) else None


def _sane(instant: datetime) -> bool:
    return 1900 <= instant.year < 2100 and instant.year != 1970


def _number(value: object) -> float | None:
    if isinstance(value, bool) or value is None:
        return None
    if not isinstance(value, (int, float, str)):
        return None
    try:
        number = float(value)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
