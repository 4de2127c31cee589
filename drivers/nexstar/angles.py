"""Angles as the NexStar wire writes them: a fraction of a turn in four or eight hex digits, nothing else.

Rounding is done once, on the wire's own step, and wraps at the full turn. Digits are upper case only: a
lower case letter is a flipped bit, not a number.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from drivers.wire.command import Unreadable

LONG_STEP_ARCSEC = 1296000.0 / 2**24
"""What a hand control resolves in the eight-digit form: the last two digits are always 00 [NexStar e]."""

SHORT_STEP_ARCSEC = 1296000.0 / 2**16
"""What the four-digit form resolves, 20 arcseconds [NexStar E]."""

_PAIR = re.compile(rb"([0-9A-F]{8}),([0-9A-F]{8})|([0-9A-F]{4}),([0-9A-F]{4})")
_DIGITS = frozenset(b"0123456789ABCDEF")


@dataclass(frozen=True, slots=True)
class WirePair:
    """Two angles as read: right ascension and declination, or azimuth and altitude.

    Attributes
    ----------
    first_deg : float
        Right ascension or azimuth, in [0, 360).
    second_deg : float
        Declination or altitude, within -90..+90.
    step_arcsec : float
        The smallest difference the form could show.
    """

    first_deg: float
    second_deg: float
    step_arcsec: float


def pair_from_text(text: bytes) -> WirePair:
    """Two angles from ``RRRRRRRR,DDDDDDDD`` or ``RRRR,DDDD`` [NexStar e, E, z, Z].

    Raises
    ------
    Unreadable
        If the text does not match wholly, or the second angle is beyond the pole.
    """
    match = _PAIR.fullmatch(text)
    if match is None:
        raise Unreadable(f"{text!r} is no pair of angles")
    long = match[1] is not None
    first, second = (match[1], match[2]) if long else (match[3], match[4])
    turn = 2**32 if long else 2**16
    second_deg = int(second, 16) * 360.0 / turn
    if second_deg > 180.0:
        second_deg -= 360.0
    if abs(second_deg) > 90.0:
        raise Unreadable(f"{text!r} lies beyond the pole")
    return WirePair(
        int(first, 16) * 360.0 / turn, second_deg, LONG_STEP_ARCSEC if long else SHORT_STEP_ARCSEC
    )


def pair_to_text(first_deg: float, second_deg: float, *, short: bool = False, coarse: bool = False) -> bytes:
    """Two angles in hex digits; negative ones as the rest of the turn [NexStar r, s, b].

    Parameters
    ----------
    first_deg, second_deg : float
        Right ascension and declination, or azimuth and altitude.
    short : bool
        Four digits instead of eight.
    coarse : bool
        Eight digits of which the last two are 00, as a hand control answers.

    Raises
    ------
    ValueError
        If the second is not within -90..+90 degrees.
    """
    if not -90.0 <= second_deg <= 90.0:
        raise ValueError(f"an angle of {second_deg} degrees is beyond the pole")
    bits = 16 if short else 24 if coarse else 32
    steps = [round(deg * 2**bits / 360.0) % 2**bits for deg in (first_deg, second_deg)]
    form = b"%04X,%04X" if short else b"%06X00,%06X00" if coarse else b"%08X,%08X"
    return form % tuple(steps)


def begins_a_pair(text: bytes, *, short: bool) -> bool:
    """Whether a text, cut anywhere, may still become a pair of this form."""
    comma = 4 if short else 8
    if len(text) > 2 * comma + 1:
        return False
    return all(byte == 0x2C if at == comma else byte in _DIGITS for at, byte in enumerate(text))
