"""Sexagesimal text and degrees as the LX200 wire writes them: pure, exact, full match or nothing.

Rounding is done once, on the whole angle in the wire's smallest step, so that 59.99 s carries into the
minute and 23:59:59.9 wraps to 00:00:00. A text that does not match wholly, or is out of range, is no angle.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.wire.command import Unreadable

RA_LONG_STEP_ARCSEC = 15.0
"""A second of time."""
RA_SHORT_STEP_ARCSEC = 90.0
"""A tenth of a minute of time."""
DEC_LONG_STEP_ARCSEC = 1.0
"""An arcsecond."""
DEC_SHORT_STEP_ARCSEC = 60.0
"""An arcminute."""

# 0xDF is the degree sign of old Meade displays, 0xB0 that of Latin-1 [LX200 :GD#]
_SEPARATOR = rb"[*:\xdf\xb0]"
_RA = re.compile(rb"(\d{2}):(\d{2})(?:\.(\d)|:(\d{2})(?:\.(\d{1,4}))?)", re.DOTALL)
_DEC = re.compile(
    rb"([+-])(\d{2})" + _SEPARATOR + rb"(\d{2})(?:[:'](\d{2})(?:\.(\d{1,4}))?'?)?",
    re.DOTALL,
)
# OnStep's driver writes one-digit seconds, as in 323:06:0.00 [LX200 :Sg#]
_LONGITUDE = re.compile(
    rb"([+-]?)(\d{1,3})" + _SEPARATOR + rb"(\d{2})(?:[:'](\d{1,2})(?:\.(\d{1,4}))?)?", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class WireAngle:
    """An angle as read, and the step it was written in.

    Attributes
    ----------
    deg : float
        The angle in degrees.
    step_arcsec : float
        The smallest difference the text could show, in arcseconds on the circle of that coordinate.
    """

    deg: float
    step_arcsec: float


def _fraction(digits: bytes | None) -> float:
    return int(digits) / 10 ** len(digits) if digits else 0.0


def ra_from_text(text: bytes) -> WireAngle:
    """Right ascension from ``HH:MM:SS``, ``HH:MM:SS.S…`` or ``HH:MM.T`` [LX200 :GR#].

    Raises
    ------
    Unreadable
        If the text does not match wholly or is not within 0..24 h.
    """
    match = _RA.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a right ascension")
    hours, minutes = int(match[1]), int(match[2])
    if match[3] is not None:
        seconds, step_arcsec = 6.0 * int(match[3]), RA_SHORT_STEP_ARCSEC
    else:
        seconds = int(match[4]) + _fraction(match[5])
        step_arcsec = RA_LONG_STEP_ARCSEC / 10 ** len(match[5] or b"")
    if hours > 23 or minutes > 59 or seconds >= 60.0:
        raise Unreadable(f"{text!r} is out of range for a right ascension")
    return WireAngle((hours * 3600 + minutes * 60 + seconds) / 240.0, step_arcsec)


def dec_from_text(text: bytes) -> WireAngle:
    """Declination from ``sDD*MM:SS`` or ``sDD*MM``; the sign counts for -00*30 too [LX200 :GD#].

    An unsigned text is refused: it may be a late right ascension.

    Raises
    ------
    Unreadable
        If the text does not match wholly or is not within -90..+90 degrees.
    """
    match = _DEC.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a declination")
    seconds = int(match[4] or 0) + _fraction(match[5])
    if int(match[3]) > 59 or seconds >= 60.0:
        raise Unreadable(f"{text!r} is out of range for a declination")
    size_deg = (int(match[2]) * 3600 + int(match[3]) * 60 + seconds) / 3600.0
    if size_deg > 90.0:
        raise Unreadable(f"{text!r} is out of range for a declination")
    step_arcsec = (
        DEC_SHORT_STEP_ARCSEC if match[4] is None else DEC_LONG_STEP_ARCSEC / 10 ** len(match[5] or b"")
    )
    return WireAngle(-size_deg if match[1] == b"-" else size_deg, step_arcsec)


def longitude_from_text(text: bytes) -> float:
    """Longitude EAST positive in (-180, 180], from the wire's WEST positive ``DDD*MM`` [LX200 :Sg#].

    Raises
    ------
    Unreadable
        If the text does not match wholly or is beyond 360 degrees.
    """
    match = _LONGITUDE.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is not a longitude")
    seconds = int(match[4] or 0) + _fraction(match[5])
    size_deg = (int(match[2]) * 3600 + int(match[3]) * 60 + seconds) / 3600.0
    if int(match[3]) > 59 or seconds >= 60.0 or size_deg > 360.0:
        raise Unreadable(f"{text!r} is out of range for a longitude")
    west_deg = -size_deg if match[1] == b"-" else size_deg
    east_deg = -west_deg % 360.0
    return east_deg - 360.0 if east_deg > 180.0 else east_deg


def ra_to_text(ra_deg: float, *, short: bool = False, decimals: int = 0) -> bytes:
    """``HH:MM:SS`` with decimals, or ``HH:MM.T`` if short; the nearest step within 0..24 h [LX200 :Sr#]."""
    if short:
        tenths = round(ra_deg * 40.0) % 14400
        return b"%02d:%02d.%d" % (tenths // 600, tenths // 10 % 60, tenths % 10)
    parts = 10**decimals
    steps = round(ra_deg * 240.0 * parts) % (86400 * parts)
    return b"%02d:%02d:%s" % (steps // (3600 * parts), steps // (60 * parts) % 60, _seconds(steps, decimals))


def dec_to_text(dec_deg: float, *, short: bool = False, decimals: int = 0) -> bytes:
    """``sDD*MM:SS`` with decimals, or ``sDD*MM`` if short; rounded to the nearest step [LX200 :Sd#].

    Raises
    ------
    ValueError
        If the declination is not within -90..+90 degrees.
    """
    if not -90.0 <= dec_deg <= 90.0:
        raise ValueError(f"a declination of {dec_deg} degrees does not exist")
    if short:
        minutes = round(abs(dec_deg) * 60.0)
        sign = b"-" if dec_deg < 0 and minutes else b"+"
        return b"%s%02d*%02d" % (sign, minutes // 60, minutes % 60)
    parts = 10**decimals
    steps = round(abs(dec_deg) * 3600.0 * parts)
    sign = b"-" if dec_deg < 0 and steps else b"+"
    degrees, minutes = steps // (3600 * parts), steps // (60 * parts) % 60
    return b"%s%02d*%02d:%s" % (sign, degrees, minutes, _seconds(steps, decimals))


def _seconds(steps: int, decimals: int) -> bytes:
    """``SS`` or ``SS.S...`` of a whole number of steps of 1 s / 10**decimals."""
    parts = 10**decimals
    whole = b"%02d" % (steps // parts % 60)
    return whole + b".%0*d" % (decimals, steps % parts) if decimals else whole


def longitude_to_text(longitude_deg: float) -> bytes:
    """``DDD*MM``, WEST positive 0..360, from a longitude EAST positive [LX200 :Gg#]."""
    minutes = round(-longitude_deg * 60.0) % 21600
    return b"%03d*%02d" % (minutes // 60, minutes % 60)


def ra_to_fine_text(ra_deg: float, decimals: int) -> bytes:
    """``HH:MM:SS.S…`` with so many decimals (or none), rounded once on the whole angle, within 0..24 h."""
    per_second = 10**decimals
    steps = round(ra_deg * 240.0 * per_second) % (86400 * per_second)
    seconds, fraction = divmod(steps, per_second)
    whole = b"%02d:%02d:%02d" % (seconds // 3600, seconds // 60 % 60, seconds % 60)
    return whole + (b".%0*d" % (decimals, fraction) if decimals else b"")


def degrees_to_fine_text(deg: float, decimals: int, *, separator: bytes = b"*", digits: int = 2) -> bytes:
    """``sDD*MM:SS.S…`` with so many decimals (or none); the sign is always there, and plus for a zero.

    Raises
    ------
    ValueError
        If a two-digit angle is beyond 90 degrees, or one of three digits beyond 360.
    """
    if not abs(deg) <= (90.0 if digits == 2 else 360.0):
        raise ValueError(f"{deg} degrees can't be written")
    per_second = 10**decimals
    steps = round(abs(deg) * 3600.0 * per_second)
    sign = b"-" if deg < 0 and steps else b"+"
    seconds, fraction = divmod(steps, per_second)
    minutes = seconds // 60
    whole = b"%s%0*d%s%02d:%02d" % (sign, digits, minutes // 60, separator, minutes % 60, seconds % 60)
    return whole + (b".%0*d" % (decimals, fraction) if decimals else b"")
