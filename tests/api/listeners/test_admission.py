"""Who is let in and who makes room: the rule by itself, without sockets."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import pytest

from api.listeners.admission import CHANCE_S, ConnectionRoom, ToldSeldom


@dataclass(eq=False)
class Here:
    address: str = "a"
    since_s: float = 0.0
    has_spoken: bool = False
    may_go: bool = True


def _full(*here: Here, each_address: int = 9, fresh: int = 2) -> ConnectionRoom[Here]:
    room: ConnectionRoom[Here] = ConnectionRoom(most=len(here), each_address=each_address, fresh=fresh)
    for one in here:
        assert room.take_in(one, 0.0).let_in
    return room


def test_who_never_spoke_goes_first_and_of_these_the_oldest() -> None:
    spoke, older, newer = Here(has_spoken=True), Here(since_s=1.0), Here(since_s=2.0)
    room = _full(spoke, newer, older)
    for goes in (older, newer):
        assert room.take_in(Here(since_s=90.0), 90.0).goes is goes
    assert len(room) == 3


def test_who_has_just_come_stays_while_there_is_a_little_room() -> None:
    room = _full(Here(), fresh=2)
    soon_s = CHANCE_S / 2
    assert [room.take_in(Here(since_s=soon_s), soon_s).goes for _ in range(2)] == [None, None]
    assert len(room) == 3
    assert room.take_in(Here(since_s=soon_s), soon_s).goes is not None
    assert room.take_in(Here(since_s=9.0), 9.0).goes is not None
    assert len(room) == 3


def test_nobody_is_let_in_where_all_are_busy() -> None:
    room = _full(Here(may_go=False), Here(may_go=False))
    taken = room.take_in(Here(), 9.0)
    assert (taken.let_in, taken.goes, taken.crowded, len(room)) == (False, None, True, 2)


def test_an_address_with_too_many_makes_room_for_itself() -> None:
    mine, others = [Here(), Here()], [Here("b"), Here("c")]
    room: ConnectionRoom[Here] = ConnectionRoom(most=5, each_address=2, fresh=1)
    for one in (*mine, *others):
        room.take_in(one, 0.0)
    assert room.take_in(Here(since_s=9.0), 9.0).goes in mine
    assert set(room) >= set(others)


def test_going_twice_counts_once() -> None:
    one, other = Here(), Here("b")
    room = _full(one, other)
    room.leave(one)
    room.leave(one)
    assert len(room) == 1
    assert list(room) == [other]


def test_a_warning_that_anybody_can_cause_is_told_once_a_minute_with_its_count(
    caplog: pytest.LogCaptureFixture,
) -> None:
    seldom = ToldSeldom(logging.getLogger("a test"))
    for second in range(125):
        seldom.tell(float(second), "too many from %s", "a")
    assert caplog.messages == [
        "too many from a",
        "too many from a (and 59 times since this was last told)",
        "too many from a (and 59 times since this was last told)",
    ]
