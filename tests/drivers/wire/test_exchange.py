"""An exchange: one question, one answer, one deadline, and never an old answer to a new question."""

from __future__ import annotations

import asyncio

import pytest

from drivers.wire.exchange import Exchange, Patience
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceSilent
from tests.drivers.wire.scripted_line import PLACE, SLEW, STOP, ScriptedLine, virtually

QUICK = Patience(deadline_s=0.6, try_s=0.1, quiet_s=0.05)


@virtually
async def test_what_lay_on_the_line_is_thrown_away_before_a_question() -> None:
    line = ScriptedLine([(0.0, b"new#")])
    line._arrive(b"old#")
    assert await Exchange(line, QUICK).ask(PLACE) == b"new"


@virtually
async def test_an_answer_comes_in_pieces() -> None:
    assert await Exchange(ScriptedLine([(0.0, b"1"), (0.02, b"2"), (0.04, b"#")]), QUICK).ask(PLACE) == b"12"


@virtually
async def test_a_question_that_changes_nothing_is_repeated_within_its_deadline() -> None:
    line = ScriptedLine([], [], [(0.0, b"3#")])
    exchange = Exchange(line, QUICK)
    assert await exchange.ask(PLACE) == b"3"
    assert line.sent == [b":GR#"] * 3
    assert (exchange.troubles, exchange.answers) == (2, 1)


@virtually
async def test_an_order_is_sent_once() -> None:
    line = ScriptedLine([], [(0.0, b"0#")])
    with pytest.raises(DeviceSilent, match="the slew"):
        await Exchange(line, QUICK).ask(SLEW)
    assert line.sent == [b":MS#"]


@virtually
async def test_a_late_answer_is_never_taken_for_that_of_the_next_question() -> None:
    # the answer to the order comes after the next question has been sent, right before its own
    line = ScriptedLine([(0.2, b"late#")], [(0.05, b"own#")])
    exchange = Exchange(line, QUICK)
    with pytest.raises(DeviceSilent):
        await exchange.ask(SLEW)
    assert await exchange.ask(PLACE) == b"own"


@virtually
async def test_of_two_answers_to_a_question_after_a_lost_one_the_last_counts() -> None:
    line = ScriptedLine([], [(0.06, b"late#"), (0.08, b"own#")])
    exchange = Exchange(line, QUICK)
    with pytest.raises(DeviceSilent):
        await exchange.ask(SLEW)
    assert await exchange.ask(PLACE) == b"own"


@virtually
async def test_a_caller_that_gives_up_leaves_the_line_owing() -> None:
    line = ScriptedLine([(0.1, b"old#")], [(0.04, b"own#")])
    exchange = Exchange(line, QUICK)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.02):
            await exchange.ask(PLACE)
    await asyncio.sleep(0.06)
    assert await exchange.ask(PLACE) == b"own"


@virtually
async def test_more_than_one_answer_is_garbled() -> None:
    with pytest.raises(DeviceGarbled, match="came after the answer"):
        await Exchange(ScriptedLine([(0.0, b"1#2#")]), QUICK).ask(SLEW)


@virtually
async def test_a_stop_goes_past_a_question_under_way() -> None:
    line = ScriptedLine([(0.08, b"1#")])
    exchange = Exchange(line, QUICK)
    asking = asyncio.ensure_future(exchange.ask(PLACE))
    await asyncio.sleep(0.01)
    await exchange.send_now(STOP)
    assert line.sent == [b":GR#", b":Q#"]
    assert await asking == b"1"


@virtually
async def test_after_its_end_nothing_goes_out() -> None:
    line = ScriptedLine()
    exchange = Exchange(line, QUICK)
    exchange.end()
    for sending in (exchange.ask(PLACE), exchange.send_now(STOP)):
        with pytest.raises(DeviceMissing, match="the line was closed"):
            await sending
    assert line.sent == []


@virtually
async def test_a_board_that_wakes_up_late_is_noticed() -> None:
    exchange = Exchange(ScriptedLine([], [(0.0, b"1#")]), QUICK)
    await exchange.ask(PLACE)
    assert exchange.woke_after_s is not None
    assert exchange.woke_after_s >= QUICK.try_s
    awake = Exchange(ScriptedLine([(0.0, b"1#")], [], [(0.0, b"1#")]), QUICK)
    await awake.ask(PLACE)
    await awake.ask(PLACE)
    assert awake.woke_after_s is None
