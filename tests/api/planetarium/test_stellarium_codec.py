"""Stellarium's messages as bytes: what is written is read, in whatever pieces it comes."""

from __future__ import annotations

import struct
from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from api.planetarium.stellarium_codec import (
    STEP_ARCSEC,
    Goto,
    GotoStream,
    NotStellarium,
    position_message,
)
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.planetarium.stellarium_client import goto_message, read_position

UTC_NOW = datetime(2026, 11, 22, 21, 30, 5, 250_000, tzinfo=UTC)
PLACES = st.builds(Icrs, st.floats(0.0, 360.0, exclude_max=True), st.floats(-90.0, 90.0))
GOTOS = st.builds(Goto, PLACES, st.integers(0, 2**53))


def test_a_position_byte_by_byte() -> None:
    """12 h, +45°: half of 2³², half of 2³⁰ [Stellarium telescope protocol]."""
    message = position_message(Icrs(180.0, 45.0), UTC_NOW)
    micros = int((UTC_NOW - datetime(1970, 1, 1, tzinfo=UTC)) / timedelta(microseconds=1))
    assert message == b"\x18\x00\x00\x00" + struct.pack("<q", micros) + b"\x00\x00\x00\x80" + (
        b"\x00\x00\x00\x20" + b"\x00\x00\x00\x00"
    )
    assert len(message) == 24


def test_a_goto_byte_by_byte() -> None:
    """6 h, -90°: as a client writes it."""
    wire = b"\x14\x00\x00\x00" + struct.pack("<q", 5) + b"\x00\x00\x00\x40" + b"\x00\x00\x00\xc0"
    assert GotoStream().feed(wire) == [Goto(Icrs(90.0, -90.0), 5)]
    assert goto_message(Goto(Icrs(90.0, -90.0), 5)) == wire


@settings(deadline=None)
@given(PLACES)
def test_a_position_is_read_as_it_was(place: Icrs) -> None:
    found = read_position(position_message(place, UTC_NOW))
    assert separation_arcsec(found.place, place) <= STEP_ARCSEC
    assert (found.utc, found.status) == (UTC_NOW, 0)


@settings(deadline=None)
@given(st.lists(GOTOS, max_size=5), st.lists(st.integers(1, 25), max_size=30))
def test_gotos_come_in_any_pieces(gotos: list[Goto], cuts: list[int]) -> None:
    wire = b"".join(map(goto_message, gotos))
    stream, found, at = GotoStream(), [], 0
    for cut in [*cuts, len(wire) + 1]:
        found += stream.feed(wire[at : at + cut])
        at += cut
    assert [one.time_us for one in found] == [one.time_us for one in gotos]
    for read, sent in zip(found, gotos, strict=True):
        assert separation_arcsec(read.place, sent.place) <= STEP_ARCSEC


@pytest.mark.parametrize(
    "wire",
    [
        b"GET / HTTP/1.1",
        struct.pack("<HHqIi", 24, 0, 0, 0, 0),
        struct.pack("<HHqIi", 20, 1, 0, 0, 0),
        struct.pack("<HHqIi", 20, 0, 0, 0, (1 << 30) + 1),
    ],
)
def test_what_is_no_goto_is_told(wire: bytes) -> None:
    with pytest.raises(NotStellarium):
        GotoStream().feed(wire)


@settings(deadline=None)
@given(st.binary(max_size=60))
def test_no_bytes_do_harm(junk: bytes) -> None:
    try:
        found = GotoStream().feed(junk)
    except NotStellarium:
        return
    assert all(abs(one.place.dec_deg) <= 90.0 and 0.0 <= one.place.ra_deg < 360.0 for one in found)
