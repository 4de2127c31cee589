"""Sexagesimal text with fractions of a second, for the dialects that take it: OnStep and 10micron."""

from __future__ import annotations


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
