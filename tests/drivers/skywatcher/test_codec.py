"""Sky-Watcher frames: numbers and replies as owners' mounts have them, and everything else refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.skywatcher import codec
from drivers.skywatcher.codec import (
    Axis,
    Board,
    Features,
    MotorStatus,
    Nack,
    number,
    number_text,
    read_features,
    read_status,
)
from drivers.wire.command import Command, Unreadable
from mountnav.errors import Refusal

FIRST, SECOND = Axis.HOUR_ANGLE, Axis.DECLINATION
NUMBERS = st.integers(0, 0xFFFFFF)


def whole(command: Command[Any], reply: bytes) -> Any:
    read = command.read(reply, False)
    assert read is not None
    assert read.length == len(reply)
    return read.value


def test_the_manufacturers_own_example_of_a_number() -> None:
    assert number_text(0x123456) == "563412"
    assert number("563412") == 0x123456


@given(NUMBERS)
def test_numbers_there_and_back(value: int) -> None:
    assert number(number_text(value)) == value


@pytest.mark.parametrize("value", [-1, 0x1000000])
def test_a_number_of_more_bits_is_refused(value: int) -> None:
    with pytest.raises(ValueError, match="24 bits"):
        number_text(value)


# what an owner's HEQ5 Pro answered, and what the numbers were found to mean
@pytest.mark.parametrize(
    ("command", "sent", "reply", "value"),
    [
        (codec.board(), b":e1\r", b"=020401\r", Board(2, 4, 1)),
        (codec.counts_per_turn(FIRST), b":a1\r", b"=00B289\r", 9_024_000),
        (codec.timer_hz(SECOND), b":b2\r", b"=A7FD00\r", 64_935),
        (codec.fast_ratio(FIRST), b":g1\r", b"=10\r", 16),
        (codec.fast_ratio(FIRST), b":g1\r", b"=100000\r", 16),
        (codec.position(FIRST), b":j1\r", b"=000080\r", 0x800000),
        (codec.status(FIRST), b":f1\r", b"=100\r", MotorStatus(False, False, False, False, False, False)),
        (codec.status(FIRST), b":f1\r", b"=611\r", MotorStatus(True, True, True, True, False, True)),
        (codec.features(FIRST), b":q1010000\r", b"=076000\r", Features(0x6007)),
        (codec.features(FIRST), b":q1010000\r", b"!0\r", Nack("0")),
        (codec.start(SECOND), b":J2\r", b"=\r", None),
        (codec.start(SECOND), b":J2\r", b"!4\r", Nack("4")),
        (codec.motion(FIRST, goto=False, fast=False, backward=True), b":G111\r", b"!2\r", Nack("2")),
        (codec.motion(FIRST, goto=True, fast=False, backward=False), b":G120\r", b"=\r", None),
        (codec.motion(FIRST, goto=False, fast=True, backward=False), b":G130\r", b"=\r", None),
    ],
)
def test_words_and_replies(command: Command[Any], sent: bytes, reply: bytes, value: object) -> None:
    assert command.sent == sent
    assert whole(command, reply) == value


def test_refusals_say_why() -> None:
    assert Nack("2").reason is Refusal.BUSY
    assert Nack("0").reason is Refusal.UNSUPPORTED
    assert "not stopped" in Nack("2").words
    assert "9" in Nack("9").words


def test_only_starting_must_not_be_sent_twice() -> None:
    orders = [
        codec.energize(FIRST),
        codec.set_position(FIRST, 1),
        codec.motion(FIRST, goto=True, fast=True, backward=False),
        codec.goto_by(FIRST, 1),
        codec.brake_by(FIRST, 1),
        codec.period(FIRST, 1),
        codec.slow_down(FIRST),
        codec.stop_hard(FIRST),
        codec.start(FIRST),
    ]
    assert [order.sent for order in orders if not order.repeatable] == [b":J1\r"]


QUESTIONS: list[tuple[Callable[[Axis], Command[Any]], bytes]] = [
    (codec.counts_per_turn, b"=00B289\r"),
    (codec.timer_hz, b"=A7FD00\r"),
    (codec.fast_ratio, b"=10\r"),
    (codec.status, b"=111\r"),
    (codec.position, b"=000080\r"),
    (codec.features, b"=076000\r"),
    (codec.start, b"=\r"),
]


@pytest.mark.parametrize(("make", "reply"), QUESTIONS)
def test_a_reply_cut_at_any_byte_is_not_whole(make: Callable[[Axis], Command[Any]], reply: bytes) -> None:
    for length in range(len(reply)):
        assert make(FIRST).read(reply[:length], False) is None
        assert make(FIRST).read(reply[:length], True) is None


@pytest.mark.parametrize(("make", "reply"), QUESTIONS)
def test_a_reply_takes_no_more_than_its_own_bytes(make: Callable[[Axis], Command[Any]], reply: bytes) -> None:
    read = make(FIRST).read(reply + b"=000080\r", False)
    assert read is not None
    assert read.length == len(reply)


@pytest.mark.parametrize(("make", "reply"), QUESTIONS)
def test_a_flipped_bit_is_refused_or_another_value_of_that_form(
    make: Callable[[Axis], Command[Any]], reply: bytes
) -> None:
    good = whole(make(FIRST), reply)
    for place in range(len(reply)):
        for bit in range(8):
            spoiled = reply[:place] + bytes([reply[place] ^ (1 << bit)]) + reply[place + 1 :]
            try:
                read = make(FIRST).read(spoiled, True)
            except Unreadable:
                continue
            # nothing whole, or one hex digit that became another: the same value never
            assert read is None or read.value != good


@given(st.binary(max_size=20))
def test_nothing_but_an_answer_is_one(noise: bytes) -> None:
    for make, _ in QUESTIONS:
        try:
            read = make(FIRST).read(noise, True)
        except Unreadable:
            continue
        if read is not None:
            assert noise[:1] in (b"=", b"!")
            assert noise[read.length - 1 : read.length] == b"\r"


@pytest.mark.parametrize(
    "reply", [b"=00B28\r", b"=00B2890\r", b"=00b289\r", b"=00B28G\r", b"=\r", b"=000000\r", b"!0\r", b"!3\r"]
)
def test_counts_of_another_form_or_range_are_refused(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.counts_per_turn(FIRST).read(reply, True)


@pytest.mark.parametrize("reply", [b"!1\r", b"!3\r", b"!\r", b"!22\r", b"=0\r", b"=000080\r"])
def test_an_order_that_arrived_damaged_is_told_from_a_refused_one(reply: bytes) -> None:
    with pytest.raises(Unreadable):
        codec.period(FIRST, 620).read(reply, True)


@given(st.builds(MotorStatus, *[st.booleans()] * 7))
def test_status_there_and_back(status: MotorStatus) -> None:
    assert read_status(status.text()) == status


def test_features_as_notes_on_three_mounts_have_them() -> None:
    assert read_features("0B6000").encoders is True
    assert read_features("076000").encoders is True
