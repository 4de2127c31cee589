"""OnStep's words: replies whole, cut, with a tail; flags and bytes tell the same; fractions survive."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.lx200.codec import onstep as codec
from drivers.lx200.codec.angles import (
    dec_from_text,
    degrees_to_fine_text,
    longitude_from_text,
    ra_from_text,
    ra_to_fine_text,
)
from drivers.lx200.codec.base import Answer
from drivers.lx200.codec.onstep import Status
from drivers.lx200.fake.onstep import flags
from drivers.wire.command import Command, Unreadable
from mountnav.devices import Direction, PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.sky.sphere import half_turn_deg

NO_GOTO = Status(
    tracking=True,
    slewing=False,
    parked=False,
    parking=False,
    park_failed=False,
    at_home=False,
    homing=False,
    guiding=False,
    pier_side=PierSide.EAST,
    rate=TrackingRate.SIDEREAL,
    error=0,
)


@st.composite
def statuses(draw: st.DrawFn) -> Status:
    park = draw(st.sampled_from(["p", "I", "P", "F"]))
    return Status(
        tracking=draw(st.booleans()),
        slewing=draw(st.booleans()),
        parked=park == "P",
        parking=park == "I",
        park_failed=park == "F",
        at_home=draw(st.booleans()),
        homing=draw(st.booleans()),
        guiding=draw(st.booleans()),
        pier_side=draw(st.sampled_from(list(PierSide))),
        rate=draw(
            st.sampled_from(
                [TrackingRate.SIDEREAL, TrackingRate.LUNAR, TrackingRate.SOLAR, TrackingRate.KING]
            )
        ),
        error=draw(st.integers(0, 15)),
    )


def whole(command: Command[Any], reply: bytes) -> Any:
    """What is understood of a reply; nothing may be understood of a part of it while more may come."""
    for end in range(len(reply)):
        assert command.read(reply[:end], False) is None, reply[:end]
    read = command.read(reply, False)
    assert read is not None
    assert read.length == len(reply)
    tailed = command.read(reply + b"junk#", False)
    assert tailed is not None
    assert tailed.length == len(reply)
    return read.value


@given(statuses(), st.sampled_from("EKAL"), st.integers(0, 9))
def test_flags_tell_the_status(status: Status, mounting: str, rate: int) -> None:
    status = replace(status, equatorial=mounting in "EK")
    assert whole(codec.STATUS, flags(status, mounting, rate)) == status


@pytest.mark.parametrize(
    ("reply", "status"),
    [
        # as its source composes them: N is no goto in progress, n is not tracking
        (b"NpET140#", NO_GOTO),
        (b"pET140#", {"slewing": True}),
        (b"nNpHEo140#", {"tracking": False, "at_home": True, "pier_side": PierSide.UNKNOWN}),
        (b"nNPHEo140#", {"tracking": False, "parked": True, "at_home": True, "pier_side": PierSide.UNKNOWN}),
        (b"nIEW140#", {"tracking": False, "parking": True, "slewing": True, "pier_side": PierSide.WEST}),
        (b"nphEW140#", {"tracking": False, "homing": True, "slewing": True, "pier_side": PierSide.WEST}),
        (
            b"NpG(zaR/EW142#",
            {"guiding": True, "rate": TrackingRate.LUNAR, "pier_side": PierSide.WEST, "error": 2},
        ),
        (b"NpRertszw,KT14?#", {"error": 15}),
    ],
)
def test_flags_of_the_firmware_are_understood(reply: bytes, status: Status | dict[str, Any]) -> None:
    expected = status if isinstance(status, Status) else replace(NO_GOTO, **status)
    assert whole(codec.STATUS, reply) == expected


@pytest.mark.parametrize(
    "reply",
    [
        b"#",
        b"NpE#",
        b"NET140#",
        b"NpPET140#",
        b"NNpET140#",
        b"NpQET140#",
        b"NpEX140#",
        b"NpET1x0#",
        b"NpET14@#",
        b"12:34:56#",
        b"+12*34:56#",
        b"10.28b#",
    ],
)
def test_what_is_no_status_is_refused(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.STATUS.read(reply, False)


@pytest.mark.parametrize(
    ("digit", "reason"),
    [
        (b"1", Refusal.BELOW_HORIZON),
        (b"2", Refusal.LIMIT),
        (b"4", Refusal.PARKED),
        (b"5", Refusal.BUSY),
        (b"6", Refusal.LIMIT),
        (b"7", Refusal.OTHER),
        (b"8", Refusal.BUSY),
    ],
)
def test_slews_and_syncs_are_refused_with_a_reason(digit: bytes, reason: Refusal) -> None:
    slew = whole(codec.SLEW, digit)
    sync = whole(codec.SYNC, b"E" + digit + b"#")
    assert slew == sync
    assert slew.refusal
    assert slew.reason is reason


def test_slews_and_syncs_are_taken_up() -> None:
    assert whole(codec.SLEW, b"0") == Answer()
    assert whole(codec.SYNC, b"N/A#") == Answer()


@pytest.mark.parametrize("reply", [b"E0#", b"Ex#", b"+12*34:56#", b"M31 EX GAL MAG 3.5 SZ178.0'#"])
def test_what_is_no_answer_to_a_sync_is_refused(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.SYNC.read(reply, False)


def test_the_bare_digit_of_an_old_firmware_is_a_refused_sync() -> None:
    assert codec.SYNC.read(b"1", False) is None
    read = codec.SYNC.read(b"1", True)
    assert read is not None
    assert read.value.reason is Refusal.PARKED


@pytest.mark.parametrize(
    ("reply", "reason"),
    [
        (b"009#", Refusal.PARKED),
        (b"010#", Refusal.BUSY),
        (b"012#", Refusal.OTHER),
        (b"018#", Refusal.PARKED),
        (b"020#", Refusal.LIMIT),
        (b"022#", Refusal.BUSY),
    ],
)
def test_a_refused_order_tells_why(reply: bytes, reason: Refusal) -> None:
    answer = whole(codec.PARK, reply)
    assert answer.refusal
    assert answer.reason is reason


@pytest.mark.parametrize("reply", [b"100#", b"125#"])
def test_an_order_taken_up_has_no_reason(reply: bytes) -> None:
    assert whole(codec.PARK, reply) == Answer()


@pytest.mark.parametrize(("reply", "answer"), [(b"1", Answer()), (b"0", Answer("0")), (b"10", Answer())])
def test_a_firmware_that_knows_no_reasons_is_understood_when_time_is_out(
    reply: bytes, answer: Answer
) -> None:
    assert codec.TRACKING_ON.read(reply, False) is None
    read = codec.TRACKING_ON.read(reply, True)
    assert read is not None
    assert read.value == answer


@pytest.mark.parametrize("reply", [b"2", b"1x#", b"1999#", b"1:09#"])
def test_an_order_answered_by_something_else_is_refused(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.UNPARK.read(reply, False)


def test_sides_and_the_clock() -> None:
    assert whole(codec.PIER_SIDE, b"E#") is PierSide.EAST
    assert whole(codec.PIER_SIDE, b"N#") is PierSide.UNKNOWN
    assert whole(codec.DESTINATION_SIDE, b"1") is PierSide.WEST
    assert whole(codec.CLOCK_UNSET, b"1") is True
    for command, reply in ((codec.PIER_SIDE, b"T#"), (codec.DESTINATION_SIDE, b"3")):
        with pytest.raises(Unreadable):
            command.read(reply, False)


@given(st.floats(0.0, 359.9999999), st.floats(-90.0, 90.0))
def test_targets_keep_their_fractions(ra_deg: float, dec_deg: float) -> None:
    ra = ra_from_text(codec.set_ra(ra_deg).sent[3:-1])
    dec = dec_from_text(codec.set_dec(dec_deg).sent[3:-1])
    assert abs(half_turn_deg(ra.deg - ra_deg)) * 3600.0 <= 0.00076
    assert abs(dec.deg - dec_deg) * 3600.0 <= 0.00051
    assert len(codec.set_ra(ra_deg).sent) == len(b":SrHH:MM:SS.SSSS#")
    assert len(codec.set_dec(dec_deg).sent) == len(b":SdsDD*MM:SS.SSS#")


@given(st.floats(-180.0, 180.0), st.integers(0, 4))
def test_fine_longitudes_come_back(deg: float, decimals: int) -> None:
    east_deg = longitude_from_text(degrees_to_fine_text(-deg, decimals, digits=3))
    assert abs(half_turn_deg(east_deg - deg)) * 3600.0 <= 0.51 / 10**decimals


def test_fractions_carry() -> None:
    assert ra_to_fine_text(359.9999999, 2) == b"00:00:00.00"
    assert degrees_to_fine_text(-0.99999999, 3) == b"-01*00:00.000"
    assert degrees_to_fine_text(-1e-9, 3) == b"+00*00:00.000"
    assert degrees_to_fine_text(-0.5, 0) == b"-00*30:00"
    with pytest.raises(ValueError, match="can't be written"):
        degrees_to_fine_text(90.01, 3)


def test_pulses_are_as_long_as_the_firmware_takes() -> None:
    assert codec.pulse(Direction.WEST, 750).sent == b":Mgw0750#"
    assert codec.pulse(Direction.NORTH, codec.LONGEST_PULSE_MS).sent == b":Mgn16399#"
    for duration_ms in (0, codec.LONGEST_PULSE_MS + 1):
        with pytest.raises(ValueError, match="can't be ordered"):
            codec.pulse(Direction.NORTH, duration_ms)
