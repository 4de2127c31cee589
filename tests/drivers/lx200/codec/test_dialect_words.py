"""Words of single dialects, of site and time: whole, cut at each byte, with a tail, with a flipped bit."""

from __future__ import annotations

from datetime import UTC, date, datetime, time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.lx200.codec import angles, astro_physics, base, gemini, meade, site_and_time
from drivers.lx200.codec.base import Answer
from drivers.lx200.codec.dialect import State
from drivers.wire.command import Command, Unreadable
from mountnav.devices import PierSide
from mountnav.errors import Refusal
from mountnav.sky.coordinates import Site

PLANETARY = b"1Updating        Planetary Data#" + b" " * 30 + b"#"
DATE = site_and_time.set_date(date(2026, 11, 22))

REPLIES: list[tuple[Command[Any], bytes, object]] = [
    (gemini.VELOCITY, b"T", "T"),
    (gemini.VELOCITY, b"!", "!"),
    (gemini.PARKING, b"2", 2),
    (gemini.SIDE, b"W#", PierSide.WEST),
    (gemini.STATUS, gemini.native(b"9"), 9),
    (gemini.GEMINI.slew, b"0", Answer()),
    (gemini.GEMINI.slew, b"5Not aligned.#", Answer("Not aligned.", Refusal.NOT_ALIGNED)),
    (
        gemini.GEMINI.slew,
        b"7Rejected - Mount is parked!#",
        Answer("Rejected - Mount is parked!", Refusal.PARKED),
    ),
    (gemini.GEMINI.sync, b"No object!#", Answer("No object!", Refusal.NOT_ALIGNED)),
    (gemini.GEMINI.sync, b"PC Object#", Answer()),
    (meade.ALIGNMENT_STATUS, b"AT1#", State(tracking=True)),
    (meade.ALIGNMENT_STATUS, b"PN0#", State(tracking=False, fresh=True)),
    (astro_physics.STATUS, b"029S00112O0000#", State(slewing=True, tracking=True, parked=False)),
    (astro_physics.STATUS, b"P99000112O000#", State(slewing=False, tracking=False, parked=True)),
    (astro_physics.SIDE, b"East#", PierSide.EAST),
    (astro_physics.RAW_RA, b"00:00:00.0#", True),
    (astro_physics.RAW_RA, b"00:00:01.0#", False),
    (site_and_time.GET_DATE, b"11/22/26#", date(2026, 11, 22)),
    (site_and_time.GET_DATE, b"01/01/94#", date(1994, 1, 1)),
    (site_and_time.GET_TIME, b"23:59:59#", time(23, 59, 59)),
    (site_and_time.GET_OFFSET, b"-02#", -2.0),
    (site_and_time.GET_OFFSET, b"+05.5#", 5.5),
    (site_and_time.GET_OFFSET, b"-05:30#", -5.5),
    (site_and_time.GET_OFFSET, b"+03:30:00#", 3.5),
    (site_and_time.GET_LATITUDE, b"+49*36#", 49.6),
    (site_and_time.GET_LONGITUDE, b"323*06#", 36.9),
    (DATE, PLANETARY, True),
    (DATE, b"0", False),
    (base.SLEW, b"4Object above lower.#", Answer("Object above lower.", Refusal.LIMIT)),
]


def same(value: object, expected: object) -> bool:
    return value == (pytest.approx(expected) if isinstance(expected, float) else expected)


@pytest.mark.parametrize(("command", "reply", "value"), REPLIES)
def test_whole_cut_and_with_a_tail(command: Command[Any], reply: bytes, value: object) -> None:
    read = command.read(reply, False)
    assert read is not None
    assert same(read.value, value)
    assert read.length == len(reply)
    for cut in range(len(reply)):
        try:
            early = command.read(reply[:cut], False)
        except Unreadable:
            continue
        assert early is None, reply[:cut]
    # two texts end a date: what follows isn't of it
    tail = command.read(reply + b"+12*34:56#", False)
    assert tail is not None
    assert same(tail.value, value)
    assert tail.length == len(reply)


@pytest.mark.parametrize("reply", [b"1", b"1Updating        Planetary Data#"])
def test_a_date_is_taken_by_those_that_say_less(reply: bytes) -> None:
    assert DATE.read(reply, False) is None
    read = DATE.read(reply, True)
    assert read is not None
    assert read.value is True
    assert DATE.read(b"1Updating", True) is None


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (gemini.VELOCITY, b"+12*34:56#"),
        (gemini.PARKING, b"T"),
        (gemini.STATUS, b"9#"),
        (gemini.STATUS, b"9A#"),
        (gemini.SIDE, b"N#"),
        (gemini.GEMINI.slew, b"8What?#"),
        (gemini.GEMINI.sync, b"12:34:56#"),
        (meade.ALIGNMENT_STATUS, b"AT9#"),
        (meade.ALIGNMENT_STATUS, b"12:34:56#"),
        (astro_physics.STATUS, b"12:34:56#"),
        (astro_physics.SIDE, b"+12*34:56#"),
        (site_and_time.GET_DATE, b"13/22/26#"),
        (site_and_time.GET_DATE, b"02/30/26#"),
        (site_and_time.GET_TIME, b"24:00:00#"),
        (site_and_time.GET_OFFSET, b"+15#"),
        (site_and_time.GET_OFFSET, b"12:34:56.7x#"),
        (site_and_time.GET_LONGITUDE, b"361*00#"),
        (DATE, b"+12*34:56#"),
    ],
)
def test_other_answers_are_none_of_theirs(command: Command[Any], reply: bytes) -> None:
    with pytest.raises(Unreadable):
        command.read(reply, False)


@given(st.sampled_from(REPLIES), st.data())
def test_a_flipped_bit_is_unreadable_or_another_value_of_the_kind(
    case: tuple[Command[Any], bytes, object], data: st.DataObject
) -> None:
    command, reply, value = case
    place = data.draw(st.integers(0, len(reply) - 1))
    bit = data.draw(st.integers(0, 7))
    spoilt = reply[:place] + bytes([reply[place] ^ (1 << bit)]) + reply[place + 1 :]
    try:
        read = command.read(spoilt, True)
    except Unreadable:
        return
    assert read is None or isinstance(read.value, type(value))


@given(st.sampled_from([command for command, _, _ in REPLIES]), st.binary(max_size=60), st.booleans())
def test_noise_is_read_or_unreadable_and_nothing_else(
    command: Command[Any], noise: bytes, final: bool
) -> None:
    try:
        read = command.read(noise, final)
    except Unreadable:
        return
    assert read is None or 0 < read.length <= len(noise)


@given(st.binary(min_size=1, max_size=12).filter(lambda body: b"#" not in body), st.integers(0, 7))
def test_a_native_checksum_notices_each_flipped_bit(body: bytes, bit: int) -> None:
    whole = gemini.native(body)
    # 64 to 191, as the maker adds 64 to seven bits
    assert 64 <= whole[-2] < 192
    spoilt = bytes([body[0] ^ (1 << bit)]) + body[1:]
    if bit < 7:
        assert gemini.checksum(spoilt) != gemini.checksum(body)


def test_native_commands_as_the_indi_driver_sends_them() -> None:
    # seen on the wire from indi_lx200gemini 1.9.9
    assert gemini.native(b">130:133") == b">130:133G#"
    assert gemini.native(b"<150:") == b"<150:r#"
    assert gemini.native(b"<508:") == b"<508:{#"


def test_clock_and_site_are_written_in_the_zone_of_utc_and_west_positive() -> None:
    writing = site_and_time.Writing()
    sent = [order.sent for order in writing.clock(datetime(2026, 11, 22, 23, 59, 59, 700000, UTC))]
    assert sent == [b":SG+00.0#", b":SL00:00:00#", b":SC11/23/26#"]
    assert [order.sent for order in writing.site(Site(49.6, 36.9))] == [b":St+49*36#", b":Sg323*06#"]
    assert [order.sent for order in writing.site(Site(-33.5, -70.5))] == [b":St-33*30#", b":Sg070*30#"]


@given(st.floats(0.0, 360.0, exclude_max=True), st.integers(1, 4))
def test_fine_right_ascension_there_and_back(ra_deg: float, decimals: int) -> None:
    back = angles.ra_from_text(angles.ra_to_text(ra_deg, decimals=decimals))
    assert back.step_arcsec == pytest.approx(15.0 / 10**decimals)
    off_deg = (back.deg - ra_deg + 180.0) % 360.0 - 180.0
    assert abs(off_deg) * 3600.0 <= back.step_arcsec / 2.0 + 1e-6


@given(st.floats(-90.0, 90.0), st.integers(1, 4))
def test_fine_declination_there_and_back(dec_deg: float, decimals: int) -> None:
    back = angles.dec_from_text(angles.dec_to_text(dec_deg, decimals=decimals))
    assert back.step_arcsec == pytest.approx(1.0 / 10**decimals)
    assert abs(back.deg - dec_deg) * 3600.0 <= back.step_arcsec / 2.0 + 1e-6
