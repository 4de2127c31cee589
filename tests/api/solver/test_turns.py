"""Who solves next: looks before uploads, no telescope before the others, one place free of any storm."""

from __future__ import annotations

import asyncio
from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from api.solver.turns import Turns


class _Asked:
    """Those who asked, by name, and who of them holds a place."""

    def __init__(self, places: int) -> None:
        self.now_s = 0.0
        self.turns = Turns(places, now_s=lambda: self.now_s)
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self.began: list[str] = []

    async def ask(self, name: str, owner: str, *, first: bool) -> None:
        async def taken() -> None:
            await self.turns.take(owner, first=first)
            self.began.append(name)

        self._tasks[name] = asyncio.create_task(taken())
        await self.settled()

    async def leave(self, name: str) -> None:
        self._tasks[name].cancel()
        await self.settled()

    async def settled(self) -> None:
        for _ in range(4):
            await asyncio.sleep(0)


async def test_a_look_goes_before_all_uploads_that_wait_and_finds_a_place_that_they_never_get() -> None:
    asked = _Asked(2)
    for number in range(5):
        await asked.ask(f"upload {number}", f"stranger {number}", first=False)
    assert asked.began == ["upload 0"]
    await asked.ask("look", "east", first=True)
    assert asked.began == ["upload 0", "look"]
    await asked.ask("second look", "west", first=True)
    asked.turns.give_back("stranger 0", first=False, used_s=1.0)
    await asked.settled()
    assert asked.began[2] == "second look"


async def test_a_storm_of_one_telescope_leaves_a_place_and_the_next_turn_to_the_others() -> None:
    asked = _Asked(3)
    for number in range(10):
        await asked.ask(f"storm {number}", "east", first=True)
    assert asked.began == ["storm 0", "storm 1"]
    await asked.ask("calm", "west", first=True)
    assert asked.began[2] == "calm"
    # all are in use: whoever comes now goes before the storm all the same
    await asked.ask("late", "north", first=True)
    asked.turns.give_back("east", first=True, used_s=1.0)
    await asked.settled()
    assert asked.began[3] == "late"


async def test_time_is_shared_evenly_and_a_pause_saves_nothing_up() -> None:
    asked = _Asked(2)
    turns = asked.turns
    await asked.ask("other", "other", first=True)
    had: Counter[str] = Counter()
    for owner in ("slow", "fast"):
        for number in range(30):
            await asked.ask(f"{owner} {number}", owner, first=True)
    for _ in range(24):
        owner = asked.began[-1].split()[0]
        used_s = 3.0 if owner == "slow" else 1.0
        had[owner] += int(used_s)
        turns.give_back(owner, first=True, used_s=used_s)
        await asked.settled()
    assert abs(had["slow"] - had["fast"]) <= 3, had
    await asked.ask("newcomer 0", "newcomer", first=True)
    await asked.ask("newcomer 1", "newcomer", first=True)
    for _ in range(4):
        owner = asked.began[-1].split()[0]
        turns.give_back(owner, first=True, used_s=3.0)
        await asked.settled()
    assert {one.split()[0] for one in asked.began[-4:]} >= {"newcomer", "fast"}


_STEP = st.one_of(
    st.tuples(st.just("ask"), st.sampled_from("abc"), st.booleans()),
    st.tuples(st.just("leave"), st.integers(0, 30), st.booleans()),
    st.tuples(st.just("end"), st.integers(0, 30), st.floats(0, 100)),
)


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 5), st.lists(_STEP, max_size=40))
def test_whatever_is_asked_left_and_ended_no_place_is_lost_and_nobody_is_forgotten(
    places: int, steps: list[tuple[str, object, object]]
) -> None:
    async def run() -> None:
        asked = _Asked(places)
        owners: dict[str, tuple[str, bool]] = {}
        holding: list[str] = []
        waiting: list[str] = []
        for what, which, more in steps:
            if what == "ask":
                name = f"{len(owners)}"
                owners[name] = str(which), bool(more)
                waiting.append(name)
                await asked.ask(name, str(which), first=bool(more))
            elif what == "leave" and waiting:
                assert isinstance(which, int)
                await asked.leave(waiting.pop(which % len(waiting)))
            elif what == "end" and holding:
                assert isinstance(which, int)
                assert isinstance(more, float)
                owner, first = owners[holding.pop(which % len(holding))]
                asked.turns.give_back(owner, first=first, used_s=more)
                await asked.settled()
            for name in [one for one in waiting if one in asked.began]:
                waiting.remove(name)
                holding.append(name)
            assert asked.turns.held == len(holding) <= places
            assert asked.turns.waiting == len(waiting)
            assert sum(not owners[one][1] for one in holding) < places
            looks = [one for one in waiting if owners[one][1]]
            if looks and len(holding) < places:
                # a look waits beside a free place only where its own telescope holds all the others
                assert all(
                    sum(owners[one] == owners[look] for one in holding) == places - 1 for look in looks
                )
        while waiting or holding:
            assert holding, "somebody waits and nobody will end"
            owner, first = owners[holding.pop()]
            asked.turns.give_back(owner, first=first, used_s=1.0)
            await asked.settled()
            for name in [one for one in waiting if one in asked.began]:
                waiting.remove(name)
                holding.append(name)
        assert asked.turns.held == 0
        assert not asked.turns._accounts

    asyncio.run(run())


async def test_who_is_cancelled_as_the_place_is_given_passes_it_on() -> None:
    turns = Turns(2)
    await turns.take("a", first=True)
    await turns.take("b", first=True)
    third = asyncio.create_task(turns.take("c", first=True))
    fourth = asyncio.create_task(turns.take("d", first=True))
    await asyncio.sleep(0)
    turns.give_back("a", first=True, used_s=1.0)
    third.cancel()
    await asyncio.wait({third, fourth})
    assert third.cancelled()
    assert fourth.done()
    assert turns.held == 2
