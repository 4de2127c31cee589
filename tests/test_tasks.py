"""Tasks are begun in one place, and none dies unheard."""

from __future__ import annotations

import ast
import asyncio
from pathlib import Path

import pytest

from mountnav.tasks import Crew, begun, cancelled, waited_for

ROOT = Path(__file__).parents[1]
PLACE = Path("mountnav/tasks.py")
BEGINNERS = ("create_task", "ensure_future", "TaskGroup")


def test_no_other_place_begins_tasks() -> None:
    found = []
    for room in ("mountnav", "drivers", "api"):
        for path in sorted((ROOT / room).rglob("*.py")):
            if path.relative_to(ROOT) == PLACE:
                continue
            source = path.read_text()
            # most files don't even have the words: nothing to take apart
            if not any(word in source for word in BEGINNERS):
                continue
            for node in ast.walk(ast.parse(source)):
                name = getattr(node, "attr", getattr(node, "id", None))
                if name in BEGINNERS:
                    found.append(f"{path.relative_to(ROOT)}:{node.lineno}")  # type: ignore[attr-defined]
    assert found == []


async def dies() -> None:
    await asyncio.sleep(0)
    raise ValueError("5,000 digits")


async def lasts() -> None:
    await asyncio.Event().wait()


async def test_a_fault_is_told_at_once_and_a_cancellation_is_none() -> None:
    told: list[Exception] = []
    task = begun(dies(), "dies", died=told.append)
    await asyncio.wait({task})
    await asyncio.sleep(0)
    assert [type(one) for one in told] == [ValueError]
    cancelled = begun(lasts(), "lasts", died=told.append)
    cancelled.cancel()
    await asyncio.wait({cancelled})
    await asyncio.sleep(0)
    assert len(told) == 1


async def test_a_crew_falls_with_any_of_its_tasks() -> None:
    crew = Crew()
    last = crew.begin(lasts(), "lasts")
    crew.begin(dies(), "dies")
    with pytest.raises(ValueError, match="digits"):
        await crew.until(last)
    await crew.end()
    assert last.cancelled()


async def test_a_crew_goes_on_when_one_of_its_tasks_has_ended_well() -> None:
    crew, go = Crew(), asyncio.Event()
    last = crew.begin(waits(go), "waits")
    crew.begin(waits(None), "ends")
    waiting = waited_for(crew.until(last))
    for _ in range(5):
        await asyncio.sleep(0)
    assert not waiting.done()
    go.set()
    await waiting
    failing = Crew()
    last = failing.begin(lasts(), "lasts")
    waiting = waited_for(failing.until(last))
    await asyncio.sleep(0)
    failing.fail(RuntimeError("elsewhere"))
    with pytest.raises(RuntimeError, match="elsewhere"):
        await waiting
    await failing.end()


async def waits(go: asyncio.Event | None) -> None:
    if go is not None:
        await go.wait()


async def test_a_task_that_is_cancelled_has_ended_and_a_fault_that_it_had_is_raised() -> None:
    ended: list[str] = []

    async def works() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            ended.append("cleaned up")

    async def fails() -> None:
        raise ValueError("broken")

    task = waited_for(works())
    await asyncio.sleep(0)
    await cancelled(task)
    assert (task.cancelled(), ended) == (True, ["cleaned up"])
    failed = waited_for(fails())
    await asyncio.wait({failed})
    with pytest.raises(ValueError, match="broken"):
        await cancelled(failed)
    await cancelled(None)
