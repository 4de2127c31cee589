"""Angles as the NexStar wire writes them: a fraction of a turn in four or eight hex digits, nothing else.

Rounding is done once, on the wire's own step, and wraps at the full turn. Digits are upper case only: a
lower case letter is a flipped bit, not a number.

Every reply ends with ``#``, but packed ones may hold that byte before their end: they are read by length and
then their last byte is checked. What goes wrong on a real cable, and how reading copes:

- a reply comes in pieces: a reader says None until it is whole;
- a reply is cut or grown, or a bit flips: what does not match wholly and within its range is `Unreadable`.
  A hex digit that flips into another is a place like any other: that is for the mount's memory to doubt;
- the ``#`` that a stop is owed comes before the answer or after it: replies can't begin so, and skip it, but
  for packed ones of any byte; after a reply it belongs to no question, and is skipped as well;
- a late reply comes after the next question: most differ in length or alphabet. Not so two places, and ``#``
  alone, which answers every order: an echo of a letter not used before shows that nothing is owed any more.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from drivers.nexstar.codec.dialect import Handset, Tracking, Version
from drivers.wire.command import Read, Unreadable

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
        raise Unreadable(f"{text!r} is not a pair of angles")
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


T = TypeVar("T")
ECHOES = b"ghijklmnopqrstuvwxyz"
"""Letters for echoes: no other answer begins with one of them."""

_END = 0x23
"""The `#` that ends every answer, and may stand in a packed one as well [NexStar]."""


def _past_owed(buffer: bytes, start: int) -> int:
    """Where the ``#`` end that were owed to stops."""
    while buffer[start : start + 1] == b"#":
        start += 1
    return start


def packed(length: int, understand: Callable[[bytes], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """Read so many bytes and the ``#`` after them."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        if len(buffer) <= length:
            return None
        if buffer[length] != _END:
            raise Unreadable(f"{buffer!r} does not end after {length} bytes")
        return Read(understand(buffer[:length]), _past_owed(buffer, length + 1))

    return read


def small(understand: Callable[[bytes], T]) -> Callable[[bytes, bool], Read[T] | None]:
    """Read a byte that can't be the one of the end, and the ``#`` after it."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        start = _past_owed(buffer, 0)
        if len(buffer) <= start + 1:
            return None
        if buffer[start + 1] != _END:
            raise Unreadable(f"{buffer!r} does not end after 1 byte")
        return Read(understand(buffer[start : start + 1]), _past_owed(buffer, start + 2))

    return read


def done(payload: bytes) -> None:
    """Nothing but the ``#``."""


def number(payload: bytes) -> int:
    """Any byte."""
    return payload[0]


def flag(payload: bytes) -> bool:
    """A byte that is 0 or 1."""
    if payload[0] > 1:
        raise Unreadable(f"{payload!r} is neither 0 nor 1")
    return payload[0] == 1


def tracking(handset: Handset) -> Callable[[bytes], Tracking]:
    """Read a tracking mode as this hand control means it [NexStar t]."""

    def understand(payload: bytes) -> Tracking:
        try:
            return handset.mode(payload[0])
        except (ValueError, IndexError) as cause:
            raise Unreadable(f"{payload!r} is not a tracking mode") from cause

    return understand


def two_bytes(payload: bytes) -> Version:
    """A board's version."""
    return Version(payload[0], payload[1])


def pair(short: bool) -> Callable[[bytes, bool], Read[WirePair] | None]:
    """Two angles."""
    length = 9 if short else 17

    def read(buffer: bytes, final: bool) -> Read[WirePair] | None:
        start = _past_owed(buffer, 0)
        text = buffer[start : start + length]
        if not begins_a_pair(text, short=short):
            raise Unreadable(f"{buffer!r} is not a pair of angles")
        end = start + length
        if len(buffer) <= end:
            return None
        if buffer[end] != _END:
            raise Unreadable(f"{buffer!r} does not end after {length} bytes")
        return Read(pair_from_text(text), _past_owed(buffer, end + 1))

    return read


def letter(meanings: dict[bytes, T]) -> Callable[[bytes, bool], Read[T] | None]:
    """One of a few letters."""

    def read(buffer: bytes, final: bool) -> Read[T] | None:
        start = _past_owed(buffer, 0)
        letter, end = buffer[start : start + 1], buffer[start + 1 : start + 2]
        if (letter and letter not in meanings) or (end and end != b"#"):
            raise Unreadable(f"{buffer!r} is none of {sorted(meanings)}")
        return Read(meanings[letter], _past_owed(buffer, start + 2)) if end else None

    return read


def version(buffer: bytes, final: bool) -> Read[Version] | None:
    """A hand control's version in either maker's form [NexStar V]."""
    if len(buffer) < 3:
        return None
    if buffer[2] == _END:
        return Read(Version(buffer[0], buffer[1]), _past_owed(buffer, 3))
    # SynScan: three numbers of two hex digits each [NexStar V]
    if any(byte not in b"0123456789ABCDEF" for byte in buffer[:6]) or (len(buffer) > 6 and buffer[6] != _END):
        raise Unreadable(f"{buffer!r} is not a version")
    if len(buffer) < 7:
        return None
    major, minor, build = (int(buffer[at : at + 2], 16) for at in (0, 2, 4))
    return Read(Version(major, minor, build, synscan=True), _past_owed(buffer, 7))


def echoed(letter: bytes) -> Callable[[bytes, bool], Read[None] | None]:
    """Read an echo, past every ``#`` and every echo of another letter that was owed before it."""

    def read(buffer: bytes, final: bool) -> Read[None] | None:
        start = 0
        while start < len(buffer):
            byte = buffer[start : start + 1]
            if byte == letter and buffer[start + 1 : start + 2] == b"#":
                return Read(None, _past_owed(buffer, start + 2))
            if byte == b"#":
                start += 1
            elif byte in ECHOES and buffer[start + 1 : start + 2] in (b"#", b""):
                start += 2
            else:
                raise Unreadable(f"{buffer!r} is not an echo of {letter!r}")
        return None

    return read


def swapped_number(buffer: bytes, final: bool) -> Read[int] | None:
    """Read a SynScan's mount number; firmware 3.39 says the two bytes the wrong way round [INDI synscan]."""
    if len(buffer) < 2:
        return None
    if _END not in buffer[:2]:
        raise Unreadable(f"{buffer!r} does not end after 1 byte")
    return Read(buffer[0] if buffer[1] == _END else buffer[1], 2)
