"""Stellarium's side of its telescope protocol: gotos written, positions read, by a codec of its own."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from api.planetarium.stellarium_codec import Goto
from mountnav.sky.coordinates import Icrs

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Position:
    """Where a telescope is; `status` is 0 when all is well."""

    place: Icrs
    utc: datetime
    status: int


def goto_message(goto: Goto) -> bytes:
    """A goto as Stellarium writes it."""
    ra = round(goto.place.ra_deg / 360.0 * 2**32) % 2**32
    return struct.pack("<HHqIi", 20, 0, goto.time_us, ra, round(goto.place.dec_deg / 90.0 * 2**30))


def read_position(message: bytes) -> Position:
    """A position as Stellarium reads it."""
    length, kind, time_us, ra, dec, status = struct.unpack("<HHqIii", message)
    assert (length, kind) == (24, 0)
    assert abs(dec) <= 2**30
    place = Icrs(ra * 360.0 / 2**32, dec * 90.0 / 2**30)
    return Position(place, _EPOCH + timedelta(microseconds=time_us), status)
