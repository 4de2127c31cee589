"""Cable limits, legs and what solves show of a rotator: the pure part, and the way to its driver."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.simulated.rotator import simulated_rotator
from mountnav.errors import BadSettings, Cancelled, DeviceRefused, JournalFailed, Refusal, TargetNotReached
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import Entry
from mountnav.navigation.rotator import (
    LEG_DEG,
    CheckedRotator,
    RotatorRules,
    legs,
    nearest_within,
    within_limits,
)
from mountnav.simulation.rotator_mechanics import RotatorBehavior, RotatorMechanics
from mountnav.simulation.virtual_time import VirtualClock, run_virtually

Result = TypeVar("Result")
limits = st.tuples(st.floats(-360.0, 360.0), st.floats(10.0, 360.0)).map(lambda p: (p[0], p[0] + p[1]))
turns = st.floats(-720.0, 720.0)


# -- where to turn -------------------------------------------------------------------------------------------


@given(limits, st.floats(0.0, 1.0), turns, st.sampled_from([180.0, 360.0]))
def test_a_turn_ends_within_the_limits_by_the_shortest_way_that_does(
    both: tuple[float, float], share: float, by_deg: float, modulo_deg: float
) -> None:
    rules = RotatorRules(*both)
    stands_deg = both[0] + share * (both[1] - both[0])
    to_deg = nearest_within(stands_deg, by_deg, rules, modulo_deg)
    every = [stands_deg + by_deg + modulo_deg * number for number in range(-20, 21)]
    allowed = [one for one in every if both[0] <= one <= both[1]]
    if to_deg is None:
        # at the very edge rounding may decide otherwise
        assert all(min(one - both[0], both[1] - one) < 1e-6 for one in allowed)
        return
    assert both[0] - 1e-6 <= to_deg <= both[1] + 1e-6
    off_deg = (to_deg - stands_deg - by_deg) % modulo_deg
    assert min(off_deg, modulo_deg - off_deg) < 1e-6
    assert abs(to_deg - stands_deg) <= min(abs(one - stands_deg) for one in allowed or [to_deg]) + 1e-6


@given(limits, turns)
def test_a_reading_is_brought_between_the_limits_or_lies_in_the_gap(
    both: tuple[float, float], reading_deg: float
) -> None:
    rules = RotatorRules(*both)
    stands_deg = within_limits(reading_deg, rules)
    if stands_deg is None:
        beside = [(reading_deg - edge + 180.0) % 360.0 - 180.0 for edge in both]
        assert all(abs(one) > 0.4 for one in beside)
        return
    assert both[0] - 0.5 <= stands_deg <= both[1] + 0.5
    assert math.isclose(math.cos(math.radians(stands_deg - reading_deg)), 1.0, abs_tol=1e-9)


def test_at_the_seam_of_a_whole_turn_it_stands_where_it_stood() -> None:
    rules = RotatorRules(0.0, 360.0)
    assert within_limits(0.0, rules, near_deg=350.0) == 360.0
    assert within_limits(359.99, rules, near_deg=3.0) == pytest.approx(-0.01)


@given(turns, turns)
def test_legs_lead_there_and_each_is_less_than_half_a_turn(from_deg: float, to_deg: float) -> None:
    ends = legs(from_deg, to_deg)
    assert ends[-1] == pytest.approx(to_deg)
    for one, other in zip([from_deg, *ends], ends, strict=False):
        assert abs(other - one) <= LEG_DEG + 1e-6
        assert (other - one) * (to_deg - from_deg) >= -1e-6


@pytest.mark.parametrize(
    ("given_rules", "words"),
    [
        ({"least_deg": 10.0, "most_deg": 10.0}, "cable limits"),
        ({"least_deg": -200.0, "most_deg": 200.0}, "a turn apart"),
        ({"least_deg": math.nan}, "not angles"),
        ({"sense": 2}, "sense"),
        ({"tolerance_deg": 0.0}, "tolerance_deg"),
    ],
)
def test_rules_that_make_no_sense_are_refused(given_rules: dict[str, Any], words: str) -> None:
    with pytest.raises(BadSettings) as told:
        RotatorRules(**given_rules)
    assert words in str(told.value)


# -- the way to the driver ---------------------------------------------------------------------------------


@dataclass
class Rig:
    held: CheckedRotator
    mechanics: RotatorMechanics
    clock: VirtualClock
    journal: MemoryJournal
    events: list[tuple[str, dict[str, object]]] = field(default_factory=list)

    def seen(self) -> bool:
        """Whether a solve has shown its count since it was connected."""
        return self.held.seen

    def told(self, kind: str) -> list[dict[str, object]]:
        return [facts for one, facts in self.events if one == kind]


def with_rotator(
    work: Callable[[Rig], Coroutine[Any, Any, Result]],
    rules: RotatorRules | None = None,
    behavior: RotatorBehavior | None = None,
    *,
    starts_deg: float = 10.0,
    journal: MemoryJournal | None = None,
) -> Result:
    clock = VirtualClock(datetime(2026, 11, 21, 20, 0, tzinfo=UTC))

    async def run() -> Result:
        mechanics = RotatorMechanics(clock, behavior, starts_deg=starts_deg)
        kept = journal or MemoryJournal()
        events: list[tuple[str, dict[str, object]]] = []
        held = CheckedRotator(
            simulated_rotator(mechanics, clock),
            rules or RotatorRules(),
            "rig",
            clock,
            kept,
            lambda kind, facts: events.append((kind, facts)),
        )
        await held.open()
        try:
            return await work(Rig(held, mechanics, clock, kept, events))
        finally:
            await held.close()

    return run_virtually(run(), clock)


def test_a_long_turn_goes_the_way_that_is_meant() -> None:
    async def work(rig: Rig) -> None:
        turn = await rig.held.turn_to(340.0)
        assert turn.by_deg == pytest.approx(330.0, abs=0.1)
        # never backwards through 0, by which it would have been 30°
        assert min(rig.mechanics.travel) >= 10.0
        assert max(rig.mechanics.travel) == pytest.approx(340.0, abs=0.1)
        assert len(rig.mechanics.orders) == 3

    with_rotator(work)


def test_cables_that_allow_turns_through_zero_are_turned_through_it() -> None:
    async def work(rig: Rig) -> None:
        await rig.held.turn_to(-150.0)
        assert min(rig.mechanics.travel) == pytest.approx(-150.0, abs=0.1)
        assert await rig.held.standing_deg() == pytest.approx(-150.0, abs=0.1)
        await rig.held.turn_to(170.0)
        assert max(rig.mechanics.travel) == pytest.approx(170.0, abs=0.1)

    with_rotator(work, RotatorRules(-180.0, 180.0))


def test_one_that_goes_the_other_way_round_is_stopped() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(TargetNotReached, match="went the other way round"):
            await rig.held.turn_to(-30.0)
        # it would have turned by 320° the other way
        assert max(rig.mechanics.travel) < 30.0
        assert not rig.mechanics.moving

    with_rotator(work, RotatorRules(-180.0, 180.0), RotatorBehavior(way="never-through-zero"))


def test_beyond_the_limits_nothing_is_sent() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(DeviceRefused) as told:
            await rig.held.turn_to(200.0)
        assert told.value.reason is Refusal.LIMIT
        assert rig.mechanics.orders == []

    with_rotator(work, RotatorRules(0.0, 180.0))


def test_one_that_stands_beyond_its_limits_is_not_turned() -> None:
    async def work(rig: Rig) -> None:
        with pytest.raises(DeviceRefused, match="how its cables lie is not known"):
            await rig.held.turn_to(50.0)
        assert rig.mechanics.orders == []

    with_rotator(work, RotatorRules(0.0, 180.0), starts_deg=250.0)


def test_a_turn_is_written_down_before_it_is_sent() -> None:
    class Full(MemoryJournal):
        async def note(self, entry: Entry) -> None:
            raise JournalFailed("the disk is full")

    async def refused(rig: Rig) -> None:
        with pytest.raises(JournalFailed):
            await rig.held.turn_to(50.0)
        assert rig.mechanics.orders == []

    with_rotator(refused, journal=Full())

    async def written(rig: Rig) -> None:
        await rig.held.turn_to(50.0)
        rows = [one for one in rig.journal.entries if one.facts.get("about") == "rotator-turn"]
        assert [one.facts.get("outcome") for one in rows] == [None, "done"]
        assert rows[1].facts["came_deg"] == pytest.approx(50.0, abs=0.05)

    with_rotator(written)


def test_a_stop_ends_all_legs() -> None:
    async def work(rig: Rig) -> None:
        turning = asyncio.ensure_future(rig.held.turn_to(350.0))
        await rig.clock.sleep(20.0)
        await rig.held.stop()
        with pytest.raises(Cancelled):
            await turning
        await rig.clock.sleep(60.0)
        assert rig.mechanics.count_deg < 90.0
        assert not rig.held.turning

    with_rotator(work)


# -- what solves show --------------------------------------------------------------------------------------


def test_the_sense_is_seen_and_a_stated_one_that_is_wrong_is_named() -> None:
    async def learned(rig: Rig) -> None:
        assert rig.held.turned(20.0, -20.1) == ""
        assert rig.held.sense == -1
        assert "by a solve" in rig.journal.entries[-1].what

    with_rotator(learned)

    async def stated(rig: Rig) -> None:
        words = rig.held.turned(20.0, -20.0)
        assert "set sense = -1" in words
        assert rig.held.sense == -1

    with_rotator(stated, RotatorRules(sense=1))


def test_half_a_turn_teaches_no_sense() -> None:
    async def work(rig: Rig) -> None:
        assert rig.held.turned(180.2, -179.9) == ""
        assert rig.held.sense is None
        rig.held.turned(20.0, 20.0)
        assert rig.held.turned(-179.9, 180.0) == ""
        assert rig.held.sense == 1

    with_rotator(work)


def test_small_turns_teach_nothing() -> None:
    async def work(rig: Rig) -> None:
        assert rig.held.turned(1.0, -1.0) == ""
        assert rig.held.sense is None

    with_rotator(work)


def test_a_camera_that_does_not_follow_is_named() -> None:
    async def work(rig: Rig) -> None:
        assert "the image turned by +0.10°" in rig.held.turned(20.0, 0.1)
        assert "a slip" in rig.held.turned(20.0, 15.0)
        assert rig.held.turned(20.0, 20.4) == ""

    with_rotator(work)


def test_a_count_that_was_lost_is_seen_and_not_turned_by() -> None:
    async def work(rig: Rig) -> None:
        assert rig.held.turned(20.0, 20.0) == ""
        assert rig.held.shown(10.0, 50.0, 360.0) == ""
        assert rig.held.seen
        # switched off and on: it counts from 0 wherever it stands
        await rig.held.close()
        rig.mechanics.set_count(0.0)
        await rig.held.open()
        assert rig.seen() is False
        words = rig.held.shown(0.0, 50.0, 360.0)
        assert "its count was lost" in words
        with pytest.raises(DeviceRefused) as told:
            await rig.held.turn_to(40.0)
        assert told.value.reason is Refusal.UNTRUSTED
        assert rig.told("rotator-untrusted")
        # until somebody has looked at the cables
        rig.held.trust()
        assert rig.held.shown(0.0, 50.0, 360.0) == ""
        await rig.held.turn_to(40.0)

    with_rotator(work)


def test_a_count_that_was_lost_while_the_link_was_away_is_seen() -> None:
    async def work(rig: Rig) -> None:
        assert rig.held.turned(20.0, 20.0) == ""
        assert rig.held.shown(await rig.held.standing_deg(), 50.0, 360.0) == ""
        # its driver was started anew between two looks, and counts from 0: nobody opened it again by an order
        driver: Any = rig.held.rotator
        driver._language.usable = False
        rig.mechanics.set_count(0.0)
        assert "its count was lost" in rig.held.shown(await rig.held.standing_deg(), 50.0, 360.0)
        with pytest.raises(DeviceRefused) as told:
            await rig.held.turn_to(40.0)
        assert told.value.reason is Refusal.UNTRUSTED

    with_rotator(work)


def test_a_link_that_was_away_and_a_count_that_is_right_is_no_loss() -> None:
    async def work(rig: Rig) -> None:
        assert rig.held.turned(20.0, 20.0) == ""
        assert rig.held.shown(await rig.held.standing_deg(), 50.0, 360.0) == ""
        driver: Any = rig.held.rotator
        driver._language.usable = False
        assert rig.held.shown(await rig.held.standing_deg(), 50.3, 360.0) == ""
        await rig.held.turn_to(40.0)

    with_rotator(work)


def test_what_was_learned_outlives_the_service() -> None:
    journal = MemoryJournal()

    async def first(rig: Rig) -> None:
        rig.held.turned(20.0, -20.0)
        rig.held.shown(10.0, 50.0, 360.0)

    with_rotator(first, journal=journal)

    async def second(rig: Rig) -> None:
        rig.held.restore(journal.entries)
        assert rig.held.sense == -1
        assert rig.held.zero_deg == pytest.approx(60.0)
        # but it may have been switched off meanwhile
        assert not rig.held.seen
        assert rig.held.shown(20.0, 40.0, 360.0) == ""
        assert rig.held.seen

    with_rotator(second)


def test_a_driver_that_is_set_to_count_reversed_makes_what_was_learned_void() -> None:
    async def work(rig: Rig) -> None:
        driver: Any = rig.held.rotator
        driver._language.reversed = False
        await rig.held.standing_deg()
        rig.held.turned(20.0, 20.0)
        driver._language.reversed = True
        await rig.held.standing_deg()
        assert rig.held.sense is None
        assert rig.told("rotator-reversed")

    with_rotator(work)
