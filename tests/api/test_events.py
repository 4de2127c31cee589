"""Events: each is seen once, in order, and a reader can go on where it was."""

from __future__ import annotations

import asyncio

from api.events import Event, Events


async def _take(events: Events, count: int, after: str | None = None) -> list[Event]:
    found: list[Event] = []
    async for event in events.follow(after):
        found.append(event)
        if len(found) == count:
            break
    return found


async def test_a_reader_without_an_id_hears_only_what_comes() -> None:
    events = Events(10)
    events.publish("old", {})
    reader = asyncio.create_task(_take(events, 2))
    await asyncio.sleep(0)
    events.publish("new", {"n": 1})
    events.publish("new", {"n": 2})
    assert [event.data["n"] for event in await reader] == [1, 2]


async def test_a_reader_goes_on_after_its_last_id() -> None:
    events = Events(10)
    published = [events.publish("step", {"n": n}) for n in range(5)]
    assert [event.id for event in await _take(events, 2, published[2].id)] == [
        one.id for one in published[3:]
    ]


async def test_what_the_ring_lost_is_told() -> None:
    events = Events(3)
    first = events.publish("step", {"n": 0})
    for n in range(1, 6):
        events.publish("step", {"n": n})
    gap, *rest = await _take(events, 4, first.id)
    assert gap.kind == "gap"
    assert "2 events" in str(gap.data["why"])
    assert [event.data["n"] for event in rest] == [3, 4, 5]


async def test_an_id_of_another_run_gets_a_gap_and_all_that_is_kept() -> None:
    events = Events(3)
    events.publish("step", {"n": 0})
    for strange in ("deadbeef-7", "nonsense", "-", "²-²", f"x-{'9' * 400}"):
        gap, kept = await _take(events, 2, strange)
        assert (gap.kind, kept.data["n"]) == ("gap", 0)


async def test_closing_ends_all_readers() -> None:
    events = Events(3)
    reader = asyncio.create_task(_take(events, 1))
    await asyncio.sleep(0)
    events.close()
    assert await reader == []


def test_nan_becomes_null() -> None:
    assert Events(1).publish("step", {"a": float("nan"), "b": float("inf"), "c": 1.0}).data == {
        "a": None,
        "b": None,
        "c": 1.0,
    }
