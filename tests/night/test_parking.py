"""The park that a night orders: in rain past everybody, at dawn when nobody works, again after a silence."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import timedelta

import pytest

from mountnav.errors import Cancelled
from mountnav.journal.records import Entry
from mountnav.night.events import Act, Decision, Why, Word
from mountnav.night.memory import NightNotes, remembered
from mountnav.night.parking import AGAIN_S, NightParking, Preempt
from mountnav.simulation.virtual_time import VirtualClock
from tests.night.conftest import EVENING, RULES, NightRig, make_night, virtually

PARKS = replace(RULES, when_unsafe="park", park_at_end=True)
MORNING = EVENING + timedelta(hours=10)


async def begun(clock: VirtualClock, make_way: Preempt | None = None) -> NightRig:
    """A night that runs, its tube somewhere up."""
    rig = await make_night(clock=clock, rules=PARKS, make_way=make_way)
    await rig.navigator.slew(rig.up(-20.0, 30.0))
    await rig.session.say(Word.START)
    return rig


@asynccontextmanager
async def someone_slews(rig: NightRig) -> AsyncIterator[asyncio.Task[object]]:
    """A scheduler's slew that takes a minute."""
    rig.mechanics.slew_rate_deg_s = 0.5
    slew: asyncio.Task[object] = asyncio.ensure_future(rig.navigator.slew(rig.up(25.0, 30.0)))
    while not rig.mechanics.slewing():
        await rig.clock.sleep(0.5)
    yield slew
    with contextlib.suppress(asyncio.CancelledError, Cancelled):
        await slew


async def ticks(rig: NightRig, seconds: float) -> None:
    """Time passes, as the runner lets it."""
    for _ in range(int(seconds / 5.0)):
        await rig.session.tick()
        await rig.clock.sleep(5.0)


def parkings(rig: NightRig) -> list[str]:
    """What was told of parking."""
    return [kind for kind, _ in rig.events if kind.startswith("night-park")]


def test_rain_stops_whoever_works() -> None:
    async def night(clock: VirtualClock) -> None:
        rig: NightRig
        asked = 0

        async def make_way() -> None:
            nonlocal asked
            asked += 1
            slewing.cancel()
            await rig.navigator.stop()
            with contextlib.suppress(asyncio.CancelledError, Cancelled):
                await slewing

        rig = await begun(clock, make_way)
        async with someone_slews(rig) as slewing:
            rig.mechanics.slew_rate_deg_s = 10.0
            await rig.session.say(Word.UNSAFE, "rain")
            assert rig.mechanics.parked
            assert (asked, slewing.cancelled()) == (1, True)
        await ticks(rig, 60.0)
        assert parkings(rig) == []
        assert rig.mount.received[-1] == "park"

    virtually(night)


def test_rain_waits_for_nobody_who_can_not_be_stopped_and_parks_then() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        async with someone_slews(rig) as slewing:
            await rig.session.say(Word.UNSAFE, "rain")
            assert parkings(rig) == ["night-park-waits"]
            while not slewing.done():
                await ticks(rig, 5.0)
        await ticks(rig, 300.0)
        assert rig.mechanics.parked
        assert parkings(rig) == ["night-park-waits", "night-parked"]

    virtually(night)


def test_what_is_safe_again_is_not_parked_late() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        async with someone_slews(rig):
            await rig.session.say(Word.UNSAFE, "rain")
            await rig.session.say(Word.SAFE)
        await ticks(rig, 300.0)
        assert "park" not in rig.mount.received

    virtually(night)


@pytest.mark.long
@pytest.mark.parametrize("then", ["still rain", "safe", "tomorrow"])
def test_a_park_that_is_owed_outlives_the_service(then: str) -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        async with someone_slews(rig):
            await rig.session.say(Word.UNSAFE, "rain")
        assert not rig.mechanics.parked
        if then == "tomorrow":
            await clock.sleep(86400.0)
        # killed before somebody's slew had ended
        rig.again(PARKS, remembered(rig.journal.entries))
        await rig.session.begin()
        if then == "safe":
            await rig.session.say(Word.SAFE)
        await ticks(rig, 60.0)
        assert rig.mechanics.parked is (then == "still rain")
        # done once is done
        await rig.navigator.unpark()
        rig.again(PARKS, remembered(rig.journal.entries))
        await rig.session.begin()
        await ticks(rig, 60.0)
        assert not rig.mechanics.parked

    virtually(night)


def test_a_journal_that_hangs_leaves_no_telescope_in_the_rain() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        gone, note = asyncio.Event(), rig.journal.note

        async def slow_note(entry: Entry) -> None:
            await gone.wait()
            await note(entry)

        rig.journal.note = slow_note  # type: ignore[method-assign]
        saying = asyncio.ensure_future(rig.session.say(Word.UNSAFE, "rain"))
        async with asyncio.timeout(300.0):
            while not rig.mechanics.parked:
                await clock.sleep(1.0)
        gone.set()
        await saying

    virtually(night)


def test_an_operator_who_ends_the_night_has_taken_over() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        async with someone_slews(rig):
            await rig.session.say(Word.UNSAFE, "rain")
            await rig.session.say(Word.STOP)
        await ticks(rig, 300.0)
        assert "park" not in rig.mount.received

    virtually(night)


def test_a_silent_mount_is_parked_when_it_is_heard_again() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        rig.mount.cut(1.0, "silent")
        await rig.session.say(Word.UNSAFE, "rain")
        assert parkings(rig) == ["night-park-waits"]
        assert not rig.mechanics.parked
        await ticks(rig, 120.0)
        assert rig.mechanics.parked
        assert parkings(rig) == ["night-park-waits", "night-parked"]

    virtually(night)


def test_a_mount_that_was_away_may_stand_anywhere_and_is_not_parked() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        rig.mount.cut(60.0)
        await rig.session.say(Word.UNSAFE, "rain")
        await ticks(rig, 120.0)
        assert parkings(rig) == ["night-park-waits", "night-park-failed"]
        (failed,) = [facts for kind, facts in rig.events if kind == "night-park-failed"]
        assert "can't be trusted" in str(failed["problem"])
        assert not rig.mechanics.parked

    virtually(night)


@pytest.mark.long
def test_dawn_waits_for_whoever_works_but_not_for_ever() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, rules=PARKS)
        while rig.session.state.running or not rig.told():
            if rig.navigator.activity == "idle":
                holding = asyncio.ensure_future(held(rig, 1200.0))
            await rig.session.tick()
            await clock.sleep(60.0)
        assert parkings(rig) == ["night-park-waits"]
        assert not rig.mechanics.parked
        await holding
        await ticks(rig, 120.0)
        assert rig.mechanics.parked

    async def held(rig: NightRig, seconds: float) -> None:
        async with rig.navigator.work("flats"):
            await rig.clock.sleep(seconds)

    async def longer(clock: VirtualClock) -> None:
        rig = await make_night(clock=clock, rules=PARKS)
        holding = asyncio.ensure_future(held(rig, 40_000.0))
        while "night-park-failed" not in parkings(rig):
            await ticks(rig, 60.0)
        assert parkings(rig) == ["night-park-waits", "night-park-failed"]
        holding.cancel()
        await asyncio.gather(holding, return_exceptions=True)
        await ticks(rig, 120.0)
        assert not rig.mechanics.parked

    virtually(night, MORNING)
    virtually(longer, MORNING)


RAIN, DAWN = Decision(Act.PARK, Why.UNSAFE), Decision(Act.PARK, Why.DAYLIGHT)


def parking_of(rig: NightRig, make_way: Preempt | None = None) -> NightParking:
    """One by itself, beside the session."""
    notes = NightNotes("east", rig.journal, rig.clock, lambda kind, data: None)
    return NightParking(rig.navigator, "east", notes, lambda kind, data: None, rig.clock, make_way)


@pytest.mark.long
def test_the_end_of_rain_takes_nothing_from_the_morning_nor_an_evening_from_the_rain() -> None:
    async def night(clock: VirtualClock, owed: Decision, other: Decision, end: Decision) -> None:
        rig = await begun(clock)
        parking = parking_of(rig)
        async with someone_slews(rig):
            await parking.park(owed, "")
        parking.decided(other)
        await clock.sleep(AGAIN_S)
        await parking.again()
        assert rig.mechanics.parked
        await rig.navigator.unpark()
        async with someone_slews(rig):
            await parking.park(owed, "")
        parking.decided(end)
        await clock.sleep(AGAIN_S)
        await parking.again()
        assert not rig.mechanics.parked

    safe, begin = Decision(Act.GO_ON, Why.SAFE), Decision(Act.BEGIN, Why.DARK)
    virtually(lambda clock: night(clock, DAWN, safe, begin))
    virtually(lambda clock: night(clock, RAIN, begin, safe))


def test_rain_at_dawn_stays_rain_and_a_fault_of_ours_is_no_end() -> None:
    async def night(clock: VirtualClock) -> None:
        rig = await begun(clock)
        asked = 0

        async def make_way() -> None:
            nonlocal asked
            asked += 1
            if asked == 3:
                raise RuntimeError("a fault of ours")

        parking = parking_of(rig, make_way)
        async with someone_slews(rig):
            await parking.park(RAIN, "")
            await parking.park(DAWN, "")
            assert asked == 2
        await clock.sleep(AGAIN_S)
        with pytest.raises(RuntimeError):
            await parking.again()
        assert not rig.mechanics.parked
        await clock.sleep(AGAIN_S)
        await parking.again()
        assert (asked, rig.mechanics.parked) == (4, True)

    virtually(night)
