"""A stop goes out before every question that the port hasn't got yet, in whatever thread that waits."""

from __future__ import annotations

import asyncio
import os
import pty
from collections.abc import AsyncIterator

import pytest_asyncio

from drivers.wire.line import SerialLine


@pytest_asyncio.fixture
async def ends() -> AsyncIterator[tuple[SerialLine, int]]:
    """An opened line, and the descriptor of its other end."""
    ours, theirs = pty.openpty()
    line = SerialLine(os.ttyname(theirs))
    try:
        await line.open()
        yield line, ours
        await line.close()
    finally:
        os.close(ours)
        os.close(theirs)


async def test_a_stop_passes_a_question_that_a_thread_has_in_hand(ends: tuple[SerialLine, int]) -> None:
    line, ours = ends
    with line._writing:  # as while other bytes are just written
        question = asyncio.create_task(line.write(b":GR#"))
        await asyncio.sleep(0.05)  # time for its thread to wait for the port
        stop = asyncio.create_task(line.write_now(b":Q#"))
        await asyncio.sleep(0.05)
    await asyncio.gather(question, stop)
    assert os.read(ours, 100) == b":Q#:GR#"


async def test_a_stop_that_nobody_waits_for_any_more_is_written_and_holds_up_nothing(
    ends: tuple[SerialLine, int],
) -> None:
    line, ours = ends
    with line._writing:
        stop = asyncio.create_task(line.write_now(b":Q#"))
        await asyncio.sleep(0)
        stop.cancel()
        await asyncio.sleep(0)
    await line.write(b":GR#")
    assert os.read(ours, 100) == b":Q#:GR#"


async def test_a_stop_that_never_came_to_its_thread_holds_up_nothing(ends: tuple[SerialLine, int]) -> None:
    line, ours = ends
    line._stops_ordered += 1
    await line.write(b":GR#")
    assert os.read(ours, 100) == b":GR#"
