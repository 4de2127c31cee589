"""AtPark, AtHome, Slewing and the answers to orders tell of one state, at any moment."""

from __future__ import annotations

import asyncio

import pytest

from tests.api.alpaca.alpaca_observatory import AlpacaProbe, Running


async def value(probe: AlpacaProbe, member: str) -> object:
    found = await probe.ask("GET", member)
    assert found.number == 0, found
    return found.value


@pytest.mark.long
@pytest.mark.parametrize(("order", "there"), [("park", "atpark"), ("findhome", "athome")])
async def test_there_is_never_told_while_it_slews_and_the_next_order_is_taken(
    observatory: Running, order: str, there: str
) -> None:
    probe = observatory.probe
    if order == "findhome":
        await probe.slew_to(1.0, 30.0)
    assert (await probe.ask("PUT", order)).number == 0
    arrived, slewed = False, 0
    async with asyncio.timeout(60.0):
        while not arrived:
            await asyncio.sleep(0.05)
            states = await value(probe, "devicestate")
            assert isinstance(states, list)
            told = {one["Name"].lower(): one["Value"] for one in states}
            slewed += bool(told["slewing"])
            assert not (told["slewing"] and (told["atpark"] or told["athome"])), told
            assert not (told["atpark"] and told["tracking"]), told
            # asked one after the other as well: who sees it there sees it rest
            arrived = bool(await value(probe, there))
            if arrived:
                assert await value(probe, "slewing") is False
    assert slewed
    # nothing of the motion is left that would make the service busy
    if order == "park":
        assert (await probe.ask("PUT", "unpark")).number == 0
    else:
        assert (await probe.ask("PUT", "park")).number == 0
