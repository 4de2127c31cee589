"""MoveAxis and offsets of the tracking rate over Alpaca: what the standard wants, and that all of it ends."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from itertools import pairwise

import pytest

from mountnav.sky.coordinates import SIDEREAL_DEG_S
from tests.api.alpaca.alpaca_observatory import OBSERVATORY, AlpacaProbe, Running, running

pytestmark = pytest.mark.long

SHORT = OBSERVATORY.replace("[alpaca]", "[alpaca]\nsilence_s = 1.5\nmove_axis_s = 4.0\noffset_rates_s = 3.0")
PARKED, INVALID, NOT_IMPLEMENTED, OPERATION = 0x408, 0x401, 0x400, 0x40B


@pytest.fixture
async def short() -> AsyncIterator[Running]:
    """A service whose patience with silent clients is short."""
    async with running(SHORT) as found:
        yield found


@pytest.fixture
async def german(short: Running) -> AlpacaProbe:
    await short.probe.put("tracking", Tracking=True)
    await short.probe.slew_to(-2.0, 20.0)
    return short.probe


async def speed(german: AlpacaProbe, axis: int = 1) -> float:
    """The fastest that an axis is said to have, no more than 1 deg/s."""
    spans = await german.get("axisrates", Axis=axis)
    return max(float(span["Maximum"]) for span in spans if span["Maximum"] <= 1.0)


async def test_what_can_be_moved_is_told_in_the_standards_form(german: AlpacaProbe) -> None:
    assert [await german.get("canmoveaxis", Axis=axis) for axis in range(3)] == [True, True, False]
    for axis in (0, 1):
        spans = await german.get("axisrates", Axis=axis)
        assert spans
        assert all(set(span) == {"Minimum", "Maximum"} for span in spans)
        assert all(0.0 <= span["Minimum"] <= span["Maximum"] for span in spans)
        ordered = sorted(spans, key=lambda span: span["Minimum"])
        assert all(a["Maximum"] < b["Minimum"] for a, b in pairwise(ordered))
    assert await german.get("axisrates", Axis=2) == []
    assert await german.refused("GET", "axisrates", Axis=3) == INVALID
    assert await german.refused("PUT", "moveaxis", Axis=2, Rate=1.0) == NOT_IMPLEMENTED


async def test_a_motion_is_one_until_it_is_told_to_end(german: AlpacaProbe) -> None:
    fast = await speed(german)
    before = await german.get("declination")
    await german.put("moveaxis", Axis=1, Rate=fast)
    assert await german.get("slewing") is True
    assert await german.get("atpark") is False
    # a slew meanwhile is refused, and changes nothing
    place = {"RightAscension": await german.get("rightascension"), "Declination": 20.0}
    assert await german.refused("PUT", "slewtocoordinatesasync", **place) == OPERATION
    assert await german.get("slewing") is True
    await asyncio.sleep(0.5)
    await german.put("moveaxis", Axis=1, Rate=0.0)
    await german.until_rest()
    assert await german.get("declination") > before + 0.1 * fast
    assert await german.get("tracking") is True
    # once more is harmless
    await german.put("moveaxis", Axis=1, Rate=0.0)
    assert await german.get("slewing") is False
    before = await german.get("declination")
    await german.put("moveaxis", Axis=1, Rate=-fast)
    await asyncio.sleep(0.5)
    await german.put("moveaxis", Axis=1, Rate=0.0)
    await german.until_rest()
    assert await german.get("declination") < before


async def test_speeds_that_the_axis_hasnt_are_invalid_values(german: AlpacaProbe) -> None:
    most = max(span["Maximum"] for span in await german.get("axisrates", Axis=0))
    for rate in (most * 1.5, -most * 1.5, 1e9):
        assert await german.refused("PUT", "moveaxis", Axis=0, Rate=rate) == INVALID
    assert await german.get("slewing") is False


async def test_a_client_that_falls_silent_moves_nothing_any_more(german: AlpacaProbe) -> None:
    rate = await speed(german)
    await german.put("moveaxis", Axis=1, Rate=rate)
    other = german.as_client(7)
    async with asyncio.timeout(60):
        # the one that watches is another client, and keeps nothing up
        while (found := await other.ask("GET", "slewing")).number == 0 and found.value:
            await asyncio.sleep(0.05)
    assert found.number >= 0x500
    assert "silent for 1.5 s" in found.words
    assert await other.get("slewing") is False
    # who moved it is told as well, once
    assert await german.refused("GET", "slewing") >= 0x500
    assert await german.get("slewing") is False


async def test_a_client_that_lives_is_let_go_on_to_the_bound_and_no_further(german: AlpacaProbe) -> None:
    spans = await german.get("axisrates", Axis=1)
    await german.put("moveaxis", Axis=1, Rate=min(span["Maximum"] for span in spans))
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    async with asyncio.timeout(60):
        while (found := await german.ask("GET", "slewing")).number == 0 and found.value:
            await asyncio.sleep(0.05)
    assert "not renewed within 4 s" in found.words
    assert loop.time() - began_s > 3.5


async def test_abort_ends_it_and_is_no_failure(german: AlpacaProbe) -> None:
    await german.put("moveaxis", Axis=0, Rate=await speed(german, 0))
    await german.put("abortslew")
    await german.until_rest()
    await asyncio.sleep(1.0)
    assert await german.get("slewing") is False
    assert await german.get("tracking") is True


async def test_a_parked_telescope_moves_no_axis(german: AlpacaProbe) -> None:
    await german.put("park")
    await german.until("atpark", True)
    assert await german.refused("PUT", "moveaxis", Axis=0, Rate=0.1) in (PARKED, INVALID)
    assert await german.refused("PUT", "rightascensionrate", RightAscensionRate=0.01) == PARKED
    await german.put("unpark")
    await german.until("atpark", False)


# -- offsets -----------------------------------------------------------------------------------------


async def test_offsets_have_the_standards_units_and_signs(german: AlpacaProbe, short: Running) -> None:
    assert await german.get("cansetrightascensionrate") is True
    assert await german.get("cansetdeclinationrate") is True
    await german.put("declinationrate", DeclinationRate=2.5)
    await german.put("rightascensionrate", RightAscensionRate=0.1)
    assert await german.get("declinationrate") == pytest.approx(2.5)
    assert await german.get("rightascensionrate") == pytest.approx(0.1)
    assert await german.get("slewing") is False
    force = short.service.dispatcher.telescope("german").navigator.mount.offset_rates_in_force
    assert force is not None
    # 0.1 s of right ascension per sidereal second: 1.5 arcsec per 0.99727 s
    assert force.rates.ra_arcsec_s == pytest.approx(0.1 * 3600.0 * SIDEREAL_DEG_S)
    assert force.rates.dec_arcsec_s == pytest.approx(2.5)
    await german.put("rightascensionrate", RightAscensionRate=0.0)
    assert await german.get("declinationrate") == pytest.approx(2.5)
    await german.put("declinationrate", DeclinationRate=0.0)
    mount = short.service.dispatcher.telescope("german").navigator.mount
    assert mount.offset_rates_in_force is None


async def test_offsets_and_another_rate_exclude_each_other(german: AlpacaProbe) -> None:
    await german.put("declinationrate", DeclinationRate=1.0)
    await german.put("trackingrate", TrackingRate=1)
    assert await german.get("declinationrate") == 0.0
    assert await german.refused("PUT", "declinationrate", DeclinationRate=1.0) == OPERATION
    assert await german.refused("PUT", "rightascensionrate", RightAscensionRate=0.01) == OPERATION
    await german.put("rightascensionrate", RightAscensionRate=0.0)
    await german.put("trackingrate", TrackingRate=0)
    await german.put("declinationrate", DeclinationRate=1.0)


async def test_offsets_need_tracking_and_end_with_a_slew(german: AlpacaProbe) -> None:
    await german.put("declinationrate", DeclinationRate=1.0)
    await german.slew_to(-1.5, 22.0)
    assert await german.get("declinationrate") == 0.0
    await german.put("tracking", Tracking=False)
    assert await german.refused("PUT", "declinationrate", DeclinationRate=1.0) == OPERATION
    await german.put("tracking", Tracking=True)


async def test_offsets_of_a_client_that_is_heard_are_put_off_and_else_end(
    german: AlpacaProbe, short: Running
) -> None:
    mount = short.service.dispatcher.telescope("german").navigator.mount
    await german.put("declinationrate", DeclinationRate=1.0)
    first = mount.offset_rates_in_force
    assert first is not None
    for _ in range(45):
        await asyncio.sleep(0.1)
        assert await german.get("declinationrate") == pytest.approx(1.0)
    later = mount.offset_rates_in_force
    assert later is not None
    assert later.ends_utc > first.ends_utc
    async with asyncio.timeout(60):
        while mount.offset_rates_in_force is not None:
            await asyncio.sleep(0.05)


async def test_offsets_that_the_mount_cant_are_invalid_values(german: AlpacaProbe, short: Running) -> None:
    most = short.service.dispatcher.telescope("german").navigator.mount.most_offset_arcsec_s
    if most is None:
        pytest.skip("this mount doesn't say how much it takes")
    assert await german.refused("PUT", "declinationrate", DeclinationRate=2.0 * most.dec_arcsec_s) == INVALID
    assert await german.refused("PUT", "rightascensionrate", RightAscensionRate=1e6) == INVALID
