"""A link: a new exchange with each opening, and lost by a fault though its line is not."""

from __future__ import annotations

import asyncio

import pytest

from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing
from tests.drivers.wire.scripted_line import PLACE, SLEW, ScriptedLine, virtually

QUICK = Patience(deadline_s=0.3, try_s=0.1, quiet_s=0.05)


@virtually
async def test_a_link_that_a_task_lost_asks_nothing_until_it_is_opened_again() -> None:
    line, log = ScriptedLine([(0.0, b"1#")]), WireLog(kept=10)
    link = Link(line, QUICK, log)
    await link.open()
    losing = asyncio.ensure_future(link.lost())
    await asyncio.sleep(0)
    link.lose("its reader died")
    link.lose("a second reason")
    assert await losing == "its reader died"
    assert not link.usable
    with pytest.raises(DeviceMissing, match="its reader died"):
        await link.ask(PLACE)
    assert [entry.meaning for entry in log.entries()] == ["lost a line: its reader died"]
    await link.open()
    assert await link.ask(PLACE) == b"1"


@virtually
async def test_what_was_asked_before_it_was_opened_again_is_given_up() -> None:
    line = ScriptedLine([(0.1, b"1#")], [(0.0, b"2#")])
    link = Link(line, QUICK, WireLog(kept=10))
    await link.open()
    asking = asyncio.ensure_future(link.ask(SLEW))
    await asyncio.sleep(0.02)
    await link.open()
    with pytest.raises(DeviceMissing, match="the line was closed"):
        await asking
    assert await link.ask(PLACE) == b"2"
    assert (link.answers, link.troubles) == (1, 0)


@virtually
async def test_another_line_is_taken() -> None:
    first, second = ScriptedLine(), ScriptedLine([(0.0, b"1#")])
    link = Link(first, QUICK, WireLog(kept=10))
    link.take_line(second)
    await link.open()
    assert await link.ask(PLACE) == b"1"
    assert (first.opened, first.sent) == (0, [])
