"""The NexStar words: round trips, every reply whole, cut at each byte, with a tail, a bit flipped."""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.nexstar.codec import base, passthrough, replies, site_and_time
from drivers.nexstar.codec import replies as angles
from drivers.nexstar.codec.dialect import Handset, Tracking, Version
from drivers.nexstar.codec.passthrough import Axis, PassThrough
from drivers.nexstar.codec.site_and_time import WireSite, WireTime
from drivers.wire.command import Command, Unreadable

AVX = Handset(Version(5, 31), 0x11, 20)
GET_TRACKING = base.get_tracking(AVX)
RA = st.floats(0.0, 360.0, exclude_max=True)
DEC = st.floats(-90.0, 90.0)


@given(RA, DEC)
def test_places_there_and_back(ra_deg: float, dec_deg: float) -> None:
    forms = {16: {"short": True}, 24: {"coarse": True}, 32: {}}
    for bits, form in forms.items():
        text = angles.pair_to_text(ra_deg, dec_deg, **form)
        back = angles.pair_from_text(text)
        step_deg = 360.0 / 2**bits
        assert abs((back.first_deg - ra_deg + 180.0) % 360.0 - 180.0) <= step_deg * 0.5000001
        assert abs(back.second_deg - dec_deg) <= step_deg * 0.5000001
        assert back.step_arcsec == (angles.SHORT_STEP_ARCSEC if bits == 16 else angles.LONG_STEP_ARCSEC)
        assert angles.pair_to_text(back.first_deg, back.second_deg, **form) == text


@pytest.mark.parametrize(
    ("text", "ra_deg", "dec_deg"),
    [
        # Celestron's manual, appendix RS-232: the two forms of one place
        (b"34AB0500,12CE0500", 74.06444, 26.44420),
        (b"34AB,12CE", 74.06433, 26.44409),
        (b"00000000,C0000000", 0.0, -90.0),
        (b"FFFF,4000", 360.0 - 360.0 / 65536, 90.0),
        (b"00000000,FFFFFF00", 0.0, -360.0 / 2**24),
    ],
)
def test_places_known_beforehand(text: bytes, ra_deg: float, dec_deg: float) -> None:
    pair = angles.pair_from_text(text)
    assert (pair.first_deg, pair.second_deg) == pytest.approx((ra_deg, dec_deg), abs=1e-4)


def test_a_turn_wraps_after_rounding() -> None:
    assert angles.pair_to_text(359.9999, -0.0001, short=True) == b"0000,0000"
    assert angles.pair_to_text(359.9999999999, -90.0) == b"00000000,C0000000"


@given(
    st.integers(-90 * 3600, 90 * 3600),
    st.integers(-180 * 3600, 180 * 3600),
)
def test_sites_there_and_back(latitude_arcsec: int, longitude_arcsec: int) -> None:
    site = WireSite(latitude_arcsec / 3600.0, longitude_arcsec / 3600.0)
    assert site_and_time.site_from_bytes(site_and_time.site_to_bytes(site)) == site


def test_the_site_of_the_manual() -> None:
    # Celestron's communication protocol: 118°20'17" W, 33°50'41" N
    packed = bytes([33, 50, 41, 0, 118, 20, 17, 1])
    site = WireSite(33 + 50 / 60 + 41 / 3600, -(118 + 20 / 60 + 17 / 3600))
    assert site_and_time.site_to_bytes(site) == packed
    west = site_and_time.site_from_bytes(bytes([0, 0, 0, 0, 179, 59, 59, 1]))
    assert west.longitude_deg == pytest.approx(-(180.0 - 1 / 3600))


@given(st.datetimes(datetime(2000, 1, 1), datetime(2255, 12, 31)), st.integers(-12, 14), st.booleans())
def test_times_there_and_back(local: datetime, zone_h: int, saving: bool) -> None:
    time = WireTime(local.replace(microsecond=0), zone_h, saving)
    assert site_and_time.time_from_bytes(site_and_time.time_to_bytes(time)) == time


def test_the_time_of_the_manual() -> None:
    # Celestron's communication protocol: 3:26:00 PM on April 6, 2005, Eastern, daylight saving
    packed = bytes([15, 26, 0, 4, 6, 5, 251, 1])
    time = WireTime(datetime(2005, 4, 6, 15, 26), -5, True)
    assert site_and_time.time_from_bytes(packed) == time
    assert site_and_time.time_to_bytes(time) == packed
    assert time.utc == datetime(2005, 4, 6, 19, 26)


@pytest.mark.parametrize(
    "packed",
    [
        bytes([15, 26, 0, 13, 6, 5, 0, 0]),
        bytes([24, 26, 0, 4, 6, 5, 0, 0]),
        bytes([15, 26, 0, 2, 30, 5, 0, 0]),
        bytes([15, 26, 0, 4, 6, 5, 100, 0]),
        bytes([15, 26, 0, 4, 6, 5, 0, 2]),
        b"",
    ],
)
def test_no_time(packed: bytes) -> None:
    with pytest.raises(Unreadable):
        site_and_time.time_from_bytes(packed)


@pytest.mark.parametrize(
    "packed",
    [
        bytes([90, 0, 1, 0, 0, 0, 0, 0]),
        bytes([0, 60, 0, 0, 0, 0, 0, 0]),
        bytes([0, 0, 0, 2, 0, 0, 0, 0]),
        bytes([0, 0, 0, 0, 181, 0, 0, 0]),
        b"",
    ],
)
def test_no_site(packed: bytes) -> None:
    with pytest.raises(Unreadable):
        site_and_time.site_from_bytes(packed)


@given(st.integers(0, 255), st.integers(0, 255), st.binary(max_size=3), st.integers(0, 255))
def test_pass_through_there_and_back(device: int, order: int, data: bytes, length: int) -> None:
    message = PassThrough(device, order, data, length)
    assert passthrough.pass_through_from_bytes(message.to_bytes()) == message


@pytest.mark.parametrize(
    ("command", "sent"),
    [
        # as the INDI driver sent them [celestron_gps.jsonl]
        (base.move(Axis.DEC, -1), "5002112501000000"),
        (base.move(Axis.RA, 0), "5002102400000000"),
        (base.guide(Axis.DEC, 50, 0.5), "5003112632320000"),
        (base.guiding(Axis.RA), "5001102700000001"),
        (base.guide_rate(Axis.DEC), "5001114700000001"),
        (base.device_version(0x10), "500110fe00000002"),
        (base.set_tracking(Tracking.EQUATORIAL_NORTH), "5402"),
        (base.echo(b"x"), "4b78"),
        # Celestron's communication protocol: 150 arcsec/s is 2 and 88
        (base.move_at(Axis.RA, 150.0), "5003100602580000"),
        (base.move_at(Axis.DEC, -150.0), "5003110702580000"),
        (base.guide(Axis.RA, -50, 2.55), "50031026ceff0000"),
        (base.STOP, "4d" + "5002102400000000" + "5002112400000000"),
    ],
)
def test_orders_are_these_bytes(command: Command[Any], sent: str) -> None:
    assert command.sent.hex() == sent


def test_what_cannot_be_said_is_not_sent() -> None:
    for order in (
        lambda: base.slew(10.0, 90.1),
        lambda: base.move(Axis.RA, 10),
        lambda: base.move_at(Axis.RA, 20000.0),
        lambda: base.guide(Axis.RA, 50, 2.6),
        lambda: base.guide(Axis.RA, 101, 1.0),
        lambda: base.set_site(WireSite(91.0, 0.0)),
        lambda: base.set_time(WireTime(datetime(1999, 1, 1), 0, False)),
        lambda: PassThrough(0x10, 0x24, b"1234").to_bytes(),
    ):
        with pytest.raises(ValueError):
            order()


PLACE, SHORT = b"34AB0500,12CE0500", b"34AB,12CE"
SITE = bytes([33, 35, 41, 0, 118, 35, 17, 1])
TIME = bytes([15, 35, 0, 4, 6, 35, 251, 1])
REPLIES: list[tuple[Command[Any], bytes, object]] = [
    (base.GET_PLACE, PLACE + b"#", angles.pair_from_text(PLACE)),
    (base.GET_PLACE_SHORT, SHORT + b"#", angles.pair_from_text(SHORT)),
    (base.GET_HORIZON, PLACE + b"#", angles.pair_from_text(PLACE)),
    (base.GET_HORIZON_SHORT, SHORT + b"#", angles.pair_from_text(SHORT)),
    (base.SLEWING, b"0#", False),
    (base.SLEWING, b"1#", True),
    (base.ALIGNED, b"\x00#", False),
    (base.ALIGNED, b"\x01#", True),
    (base.PIER_SIDE, b"E#", "E"),
    (base.PIER_SIDE, b"W#", "W"),
    (base.VERSION, b"\x05\x1f#", Version(5, 31)),
    (base.VERSION, b"\x23\x23#", Version(35, 35)),
    (base.VERSION, b"042507#", Version(4, 37, 7)),
    (base.VARIANT, b"\x11#", 0x11),
    (base.MODEL, b"\x14#", 20),
    # the number 35 is the byte of the end itself
    (base.MODEL, b"##", 35),
    (GET_TRACKING, b"\x02#", Tracking.EQUATORIAL_NORTH),
    (base.GET_SITE, SITE + b"#", site_and_time.site_from_bytes(SITE)),
    (base.GET_TIME, TIME + b"#", site_and_time.time_from_bytes(TIME)),
    (base.slew(1.0, 2.0), b"#", None),
    (base.slew_horizon(1.0, 2.0), b"#", None),
    (base.sync(1.0, 2.0, short=True), b"#", None),
    (base.echo(b"x"), b"x#", None),
    (base.guiding(Axis.RA), b"\x01#", True),
    (base.guide_rate(Axis.RA), b"\x80#", 50.0),
    (base.device_version(0x10), b"\x07\x0b#", Version(7, 11)),
    (base.device_version(0x10), b"##" + b"#", Version(35, 35)),
]
# these may hold any byte: a flipped bit makes another value, and nothing tells
ANY_BYTE = {"version", "kind of hand control", "model", "guide rate", "version of a board"}


@pytest.mark.parametrize(("command", "reply", "value"), REPLIES)
def test_replies_whole_cut_and_with_a_tail(command: Command[Any], reply: bytes, value: object) -> None:
    whole = command.read(reply, False)
    assert whole is not None
    assert (whole.value, whole.length) == (value, len(reply))
    for cut in range(len(reply)):
        assert command.read(reply[:cut], False) is None
        assert command.read(reply[:cut], True) is None
    tailed = command.read(reply + b"1#", False)
    assert tailed is not None
    assert (tailed.value, tailed.length) == (value, len(reply))


@pytest.mark.parametrize(("command", "reply", "value"), REPLIES)
def test_a_flipped_bit_is_no_answer_or_another_legal_one(
    command: Command[Any], reply: bytes, value: object
) -> None:
    for at in range(len(reply)):
        for bit in range(8):
            flipped = reply[:at] + bytes([reply[at] ^ (1 << bit)]) + reply[at + 1 :]
            try:
                read = command.read(flipped, False)
            except Unreadable:
                continue
            if read is None:
                # the rest seems to come yet; no end may be missing from a reply of fixed length. Another
                # letter before an echo is an older echo
                assert (
                    reply[at] == 0x23
                    or command is base.VERSION
                    or flipped.startswith(b"#")
                    or (command.meaning == "echo" and flipped[:1] in replies.ECHOES)
                )
            elif command.meaning not in ANY_BYTE:
                # only what the wire itself allows: another digit, another field within its range
                assert at < len(reply) - 1
                assert (
                    chr(flipped[at]) in "0123456789ABCDEF"
                    or command
                    in (
                        base.ALIGNED,
                        GET_TRACKING,
                        base.GET_SITE,
                        base.GET_TIME,
                        base.guiding(Axis.RA),
                    )
                    or command.meaning == "guiding"
                )


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (base.GET_PLACE, SHORT + b"#"),
        (base.GET_PLACE_SHORT, PLACE + b"#"),
        (base.GET_PLACE, b"34ab0500,12CE0500#"),
        (base.GET_PLACE, b"34AB0500,50000000#"),
        (base.GET_PLACE, b"34AB0500;12CE0500#"),
        (base.GET_PLACE, b"0#"),
        (base.GET_PLACE, b"W#"),
        (base.SLEWING, PLACE + b"#"),
        (base.SLEWING, b"\x01#"),
        (base.ALIGNED, b"1#"),
        (base.PIER_SIDE, b"0#"),
        (base.VERSION, PLACE + b"#"),
        (GET_TRACKING, b"\x05#"),
        (base.GET_SITE, PLACE + b"#"),
        (base.GET_TIME, b"#" + TIME + b"#"),
        (base.GET_SITE, SITE + b"\x01"),
        (base.slew(1.0, 2.0), PLACE + b"#"),
        (base.echo(b"x"), b"Y#"),
        (base.echo(b"x"), b"\x01#x#"),
    ],
)
def test_the_answer_of_another_question_is_none(command: Command[Any], reply: bytes) -> None:
    with pytest.raises(Unreadable):
        command.read(reply, False)


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (base.GET_PLACE, PLACE + b"#"),
        (base.SLEWING, b"1#"),
        (base.PIER_SIDE, b"E#"),
        (base.ALIGNED, b"\x01#"),
        (GET_TRACKING, b"\x02#"),
        (base.echo(b"x"), b"x#"),
    ],
)
def test_what_was_owed_to_a_stop_is_skipped(command: Command[Any], reply: bytes) -> None:
    alone = command.read(reply, False)
    among = command.read(b"###" + reply + b"###", False)
    assert alone is not None
    assert among is not None
    assert (among.value, among.length) == (alone.value, 6 + len(reply))
    assert command.read(b"###", True) is None


def test_an_echo_is_found_behind_all_that_was_owed() -> None:
    read = base.echo(b"z").read(b"#x#y##z#", False)
    assert read is not None
    assert read.length == 8
    assert base.echo(b"z").read(b"#x#y##z", False) is None


@given(st.binary(max_size=40))
def test_no_bytes_break_a_reader(noise: bytes) -> None:
    for command, _, _ in REPLIES:
        try:
            read = command.read(noise, False)
        except Unreadable:
            continue
        assert read is None or 0 < read.length <= len(noise)
