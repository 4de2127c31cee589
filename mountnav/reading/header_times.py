"""Times of a header: values and their units as cards hold them, exposure time and mid-exposure UTC."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from datetime import UTC, datetime, timedelta

from mountnav.sky.iers import tt_minus_utc_s

Value = str | int | float | bool
Header = Mapping[str, Value]
Comments = Mapping[str, str]

_NUMBER_UNIT = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d+)?)\s*([^\d\s].*)?$")
# sign, then up to three fields; only the last of them may have decimals
_FIELDS = re.compile(
    r"([+-]?)\s*(\d{1,3})\s*([:hd°*\s])\s*(\d{1,2}(?:\.\d*)?)\s*(?:[:m'′\s]\s*(\d{1,2}(?:\.\d*)?))?\s*[ms\"″']*$",
    re.I,
)


def number(value: object) -> float | None:
    """Return a finite number, written as one or as text without a unit; None for all else."""
    if value is None or isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return None
    try:
        result = float(value)
    except (ValueError, OverflowError):
        return None
    return result if math.isfinite(result) else None


def number_unit(header: Header, comments: Comments, key: str) -> tuple[float, str] | None:
    """Return a card's number, and in lower case what value and comment say about its unit."""
    value, told = header.get(key), comments.get(key, "")
    found = number(value)
    if found is None and isinstance(value, str) and (match := _NUMBER_UNIT.match(value)):
        found, told = number(match[1].upper().replace("D", "E")), f"{match[2] or ''} {told}"
    return None if found is None else (found, told.lower())


def sexagesimal(text: str) -> tuple[float, bool] | None:
    """Read "12 34 56.7", "-0:30.5", "5h35m17s" or "+22*30'15".

    Returns
    -------
    value : float
        In units of the first field; "-00 30 00" is -0.5.
    degrees : bool
        The text itself says that the first field counts degrees.
    """
    match = _FIELDS.match(text.strip())
    if match is None or ("." in match[4] and match[5]):
        return None
    minutes, seconds = float(match[4]), float(match[5] or 0.0)
    if minutes >= 60.0 or seconds >= 60.0:
        return None
    size = int(match[2]) + minutes / 60.0 + seconds / 3600.0
    return (-size if match[1] == "-" else size), match[3].lower() in ("d", "°", "*")


_EXPOSURE_CARDS = ("EXPTIME", "EXPOSURE", "EXP_TIME", "ITIME", "XPOSURE", "TELAPSE", "EXPOSED", "EXP")
_MOST_EXPOSURE_S = 1e6
"""Longer exposures, 11 days, are no exposures but another quantity."""
_CLOCK_CARDS = ("TIME-OBS", "UT", "UTSTART", "UTC", "UT-OBS", "TIME_OBS", "UTIME", "UTC-OBS")
_MIDDLE_CARDS = ("DATE-AVG", "DATE-MID", "MIDPOINT", "MJD-AVG", "MJD-MID", "MJDMID")
_START_CARDS = ("DATE-OBS", "DATE-BEG", "DATE_OBS", "UT-OBS", "DATE-UTC", "DATE-GPS", "GPS_SUTC")
_START_JULIAN_CARDS = ("MJD-OBS", "MJD-BEG", "MJD", "JD", "JD_UTC", "EXPSTART", "JULIAN")
_END_CARDS = ("DATE-END", "MJD-END", "EXPEND")
_MJD_EPOCH = datetime(1858, 11, 17, tzinfo=UTC)
"""Zero of the modified Julian date."""
_YEAR_FIRST = re.compile(r"^(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})(?:[T ]\s*(.*))?$")
_DAY_FIRST = re.compile(r"^(\d{1,2})/(\d{1,2})/(\d{2}|\d{4})(?:[T ]\s*(.*))?$")
_CLOCK = re.compile(
    r"^(\d{1,2})[:h ](\d{1,2})(?:[:m ](\d{1,2}(?:\.\d*)?)s?)?\s*(?:Z|UTC?|([+-]\d{2}):?(\d{2}))?$", re.I
)
_LOCAL = re.compile(r"\blocal\b|\blt\b")
_MIDDLE = re.compile(r"\bmid(?!night)|\bcent(er|re) of|\baverage\b")
# SharpCap up to 3.2 wrote when it had received the frame: "System Clock-Frame Grabbed"
_END = re.compile(r"\bend\b|\bgrabbed\b|\bfinish")
_START = re.compile(r"\bstart|\bbegin")
_TT_MINUS_TAI_S = 32.184
"""Terrestrial time less atomic time, seconds, by definition [IAU 1991]."""
_AHEAD_OF_TAI_S = {"TAI": 0.0, "IAT": 0.0, "GPS": -19.0}
"""Other time scales less atomic time, seconds; the barycentric ones are within 2 ms of terrestrial time."""
_AHEAD_OF_TAI_S |= dict.fromkeys(("TT", "TDT", "TDB", "ET"), _TT_MINUS_TAI_S)


def exposure_s_from_header(header: Header, comments: Comments | None = None) -> float | None:
    """Return the exposure in seconds, or None.

    The unit is taken from the comment where it names one (ms, minutes). Without one, an exposure that is a
    thousand times what another card tells (`EXPOSURE`, `DATE-END`) was written in milliseconds. Negative
    ones, with which some programs mark dark frames, count as absent.
    """
    comments = comments or {}
    told = [seconds for key in _EXPOSURE_CARDS if (seconds := _seconds(header, comments, key)) is not None]
    if not told:
        return None
    first = told[0]
    begin, end = _first_date(header, ("DATE-OBS", "DATE-BEG")), _first_date(header, ("DATE-END",))
    others = told[1:] + ([(end - begin).total_seconds()] if begin and end else [])
    if first > 0.0 and any(0.9 < 1000.0 * other / first < 1.5 for other in others):
        return first / 1000.0
    return first


def mid_exposure_from_header(header: Header, comments: Comments | None = None) -> datetime | None:
    """Return the instant of mid-exposure, or None.

    ``DATE-AVG`` and its kin are that instant [FITS 4.0 §9.5]; ``DATE-OBS``, ``MJD-OBS``, ``JD`` and their kin
    are taken as the start, unless their comment says that they are the middle or the end, and half the
    exposure is added. A time whose comment calls it local, without an offset from UTC, is passed over.

    Parameters
    ----------
    header : mapping
        Values by keyword.
    comments : mapping, optional
        The cards' comments.

    Returns
    -------
    datetime or None
        Aware, UTC.
    """
    comments = comments or {}
    half = timedelta(seconds=(exposure_s_from_header(header, comments) or 0.0) / 2.0)
    cards = [(key, 0) for key in _MIDDLE_CARDS]
    cards += [(key, 1) for key in (*_START_CARDS, *_START_JULIAN_CARDS)] + [(key, -1) for key in _END_CARDS]
    scale = str(header.get("TIMESYS", "UTC")).strip().upper()
    for key, sign in cards:
        told = comments.get(key, "").lower()
        instant = _date(header, key, told) or _julian(header, key)
        if instant is None:
            continue
        if sign == 1 and not _START.search(told):
            sign = 0 if _MIDDLE.search(told) else (-1 if _END.search(told) else 1)
        try:
            return _as_utc(instant + sign * half, "UTC" if "UTC" in key or key == "UT-OBS" else scale)
        except OverflowError:
            return None
    return None


def _seconds(header: Header, comments: Comments, key: str) -> float | None:
    found = number_unit(header, comments, key)
    if found is None:
        return None
    value, unit = found
    if re.search(r"\bms\b|\bmsec|millisec", unit):
        value /= 1e3
    elif re.search(r"\bus\b|µs|\busec|microsec", unit):
        value /= 1e6
    elif re.search(r"\bmin\b|\bminutes?\b", unit):
        value *= 60.0
    return value if 0.0 <= value < _MOST_EXPOSURE_S else None


def _as_utc(instant: datetime, scale: str) -> datetime | None:
    """Turn an instant counted in another time scale into UTC; None where UTC is not known."""
    if scale in ("LOCAL", "LT", "LST"):
        return None
    if scale not in _AHEAD_OF_TAI_S:
        return instant
    if not 1973 <= instant.year < 2099:
        return None
    behind_tt_s = _TT_MINUS_TAI_S - _AHEAD_OF_TAI_S[scale]
    # the day's leap seconds are those of the UTC day
    guess = instant - timedelta(seconds=tt_minus_utc_s(instant) - behind_tt_s)
    return instant - timedelta(seconds=tt_minus_utc_s(guess) - behind_tt_s)


def _first_date(header: Header, keys: tuple[str, ...]) -> datetime | None:
    return next((found for key in keys if (found := _date(header, key, ""))), None)


def _date(header: Header, key: str, told: str) -> datetime | None:
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
        clocks = (str(header.get(card, "")).strip() for card in _CLOCK_CARDS)
        clock = next((text for text in clocks if _CLOCK.match(text)), "")
        if not clock:
            return None  # a date alone is no instant: half a day wrong is worse than unknown
    parts = _CLOCK.match(clock.strip())
    if parts is None or (_LOCAL.search(told) and not parts[4] and "ut" not in told):
        return None
    try:
        midnight = datetime(year, month, day, tzinfo=UTC)
    except ValueError:
        return None
    hours, minutes, seconds = int(parts[1]), int(parts[2]), float(parts[3] or 0.0)
    if hours > 24 or minutes > 59 or seconds >= 61.0:
        return None
    try:
        instant = midnight + timedelta(hours=hours, minutes=minutes, seconds=seconds)
        if parts[4]:
            ahead = timedelta(hours=abs(int(parts[4])), minutes=int(parts[5]))
            instant += ahead if parts[4].startswith("-") else -ahead
    except OverflowError:
        return None
    return instant if _sane(instant) else None


def _julian(header: Header, key: str) -> datetime | None:
    """Read a Julian Date or a Modified one; their sizes distinguish them."""
    value = number(header.get(key))
    if value is None or not math.isfinite(value):
        return None
    days = value - 2400000.5 if value > 2_000_000.0 else value
    if not 15_000.0 < days < 100_000.0:
        return None
    instant = _MJD_EPOCH + timedelta(days=days)
    return instant if _sane(instant) else None


def _sane(instant: datetime) -> bool:
    return 1900 <= instant.year < 2100 and instant.year != 1970
