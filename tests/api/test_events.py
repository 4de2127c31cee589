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


async def test_a_reader_that_is_far_behind_is_given_pieces_of_bounded_size() -> None:
    events = Events(1000)
    for number in range(1000):
        events.publish("step" if number % 5 else "other", {"n": number, "what": "x" * 1000})
    reader = events.reader(f"{events.run}-0", lambda event: event.kind == "step")
    heard: list[object] = []
    longest = 0
    while len(heard) < 800:
        piece = reader.at_hand()
        longest = max(longest, sum(len(event.wire) for event in piece))
        heard += [event.data["n"] for event in piece]
    assert heard == [number for number in range(1000) if number % 5]
    assert longest < 70_000
    assert reader.at_hand() == []


async def test_a_reader_passes_over_what_does_not_concern_it() -> None:
    events = Events(1000)
    for _ in range(999):
        events.publish("other", {"what": "x" * 1000})
    last = events.publish("step", {})
    assert events.reader(f"{events.run}-0", lambda event: event.kind == "step").at_hand() == [last]


async def test_a_reader_that_the_ring_passed_by_is_told_so_once_and_goes_on() -> None:
    events = Events(100)
    events.publish("step", {"n": 0})
    reader = events.reader(f"{events.run}-0")
    for number in range(1, 300):
        events.publish("step", {"n": number, "what": "x" * 5000})
    heard = reader.all_at_hand()
    assert [event.kind for event in heard].count("gap") == 1
    assert [event.data["n"] for event in heard[1:]] == list(range(200, 300))
