"""Stellarium's telescope protocol as bytes: positions out, gotos in; pure.

Little-endian, each message begins with its length and its type, places are J2000 whatever Stellarium shows
[Stellarium telescope protocol 1.0]. Clients ask nothing: there is no sync, no stop and no answer to a goto.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from mountnav.sky.coordinates import Icrs

_POSITION = struct.Struct("<HHqIii")
_GOTO = struct.Struct("<HHqIi")
_FULL_TURN = 1 << 32
"""Right ascension counts a turn as 2^32 [Stellarium telescope protocol]."""
_RIGHT_ANGLE = 1 << 30
"""Declination counts 90° as 2^30."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
"""Times are microseconds since then."""
STEP_ARCSEC = 360.0 * 3600.0 / _FULL_TURN
"""The wire's smallest difference."""


class NotStellarium(ValueError):
    """What came is none of its messages: where the next one begins can't be known."""


@dataclass(frozen=True, slots=True)
class Goto:
    """A client wants the telescope there.

    Attributes
    ----------
    time_us : int
        Its clock, microseconds since 1970; nobody counts on it.
    """

    place: Icrs
    time_us: int


def position_message(place: Icrs, utc: datetime, status: int = 0) -> bytes:
    """Write where the telescope is."""
    time_us = (utc - _EPOCH) // timedelta(microseconds=1)
    return _POSITION.pack(_POSITION.size, 0, time_us, _turns(place.ra_deg), _angles(place.dec_deg), status)


class GotoStream:
    """Bytes in, gotos out."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Goto]:
        """Take bytes, and return the gotos they complete.

        Raises
        ------
        NotStellarium
            The stream is lost.
        """
        self._buffer += data
        found = []
        while len(self._buffer) >= 4:
            length, kind = struct.unpack_from("<HH", self._buffer)
            if length != _GOTO.size or kind != 0:
                raise NotStellarium(f"a message of {length} bytes and type {kind} is not a goto")
            if len(self._buffer) < length:
                break
            message, self._buffer = self._buffer[:length], self._buffer[length:]
            _, _, time_us, ra, dec = _GOTO.unpack(message)
            if abs(dec) > _RIGHT_ANGLE:
                raise NotStellarium(f"a declination of {dec} is beyond the pole")
            found.append(Goto(_place(ra, dec), time_us))
        return found


def _turns(ra_deg: float) -> int:
    return round(ra_deg / 360.0 * _FULL_TURN) % _FULL_TURN


def _angles(dec_deg: float) -> int:
    return round(dec_deg / 90.0 * _RIGHT_ANGLE)


def _place(ra: int, dec: int) -> Icrs:
    return Icrs(ra * 360.0 / _FULL_TURN, dec * 90.0 / _RIGHT_ANGLE)


__all__ = [
    "STEP_ARCSEC",
    "Goto",
    "GotoStream",
    "NotStellarium",
    "position_message",
]
