"""A rotator behind a real `indiserver`, with `indi_simulator_rotator` as the rotator."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from drivers.generic.rotator import GenericRotator
from drivers.indi.codec import messages
from drivers.registry import open_rotator
from mountnav.errors import BadSettings, Cancelled, DeviceMissing, DeviceRefused
from tests.drivers.indi.real_server import IndiServer

ROTATOR = "Rotator Simulator"


@pytest.fixture
async def server(tmp_path: Path) -> AsyncIterator[IndiServer]:
    one = IndiServer(("indi_simulator_rotator",), tmp_path / "home")
    await one.start()
    try:
        yield one
    finally:
        await one.kill()


def rotator_of(server: IndiServer, options: str = "") -> GenericRotator:
    made = open_rotator(f"indi://127.0.0.1:{server.port}/Rotator%20Simulator?{options}".rstrip("?"))
    assert isinstance(made, GenericRotator)
    return made


@pytest.fixture
async def rotator(server: IndiServer) -> AsyncIterator[GenericRotator]:
    one = rotator_of(server)
    await one.open()
    yield one
    await one.close()


async def test_opening_turns_nothing(rotator: GenericRotator) -> None:
    stands = await rotator.reading()
    assert stands.mechanical_deg == 0.0
    assert stands.moving is False
    assert rotator.reversed is False
    assert not [one for one in rotator.wire_log.entries() if b"newNumberVector" in one.data]


async def test_a_turn_is_seen_to_its_end(rotator: GenericRotator) -> None:
    # the simulator turns by 10° each second
    came = await rotator.turn(25.0)
    assert came.mechanical_deg == pytest.approx(25.0, abs=0.05)
    assert came.moving is False
    assert (await rotator.turn(-5.0)).mechanical_deg == pytest.approx(355.0, abs=0.05)


async def test_a_stop_ends_it_on_the_way(rotator: GenericRotator) -> None:
    turning = asyncio.ensure_future(rotator.turn(120.0))
    async with asyncio.timeout(30.0):
        while not (await rotator.reading()).moving:
            await asyncio.sleep(0.05)
    await rotator.stop()
    with pytest.raises(Cancelled):
        await turning
    stands = await rotator.reading()
    assert not stands.moving
    assert stands.mechanical_deg < 115.0


async def test_whether_its_driver_counts_reversed_is_seen(
    server: IndiServer, rotator: GenericRotator
) -> None:
    other = server.device(ROTATOR)
    await other.bring_up(may_connect=True, needed=("ROTATOR_REVERSE",))
    await other.set_switches("ROTATOR_REVERSE", {"INDI_ENABLED": True, "INDI_DISABLED": False})
    await other.client.close()
    await rotator.reading()
    assert rotator.reversed is True


async def test_a_server_that_comes_back_is_connected_again(
    server: IndiServer, rotator: GenericRotator
) -> None:
    await server.kill()
    with pytest.raises(DeviceMissing):
        await rotator.reading()
    await server.start()
    async with asyncio.timeout(60.0):
        while True:
            try:
                stands = await rotator.reading()
                break
            except DeviceMissing:
                await asyncio.sleep(0.1)
    # it was switched on anew: its count says nothing
    assert stands.mechanical_deg == 0.0


async def test_a_device_that_is_no_rotator_is_refused(tmp_path: Path) -> None:
    server = IndiServer(("indi_simulator_focus",), tmp_path / "home")
    await server.start()
    made = open_rotator(f"indi://127.0.0.1:{server.port}/Focuser%20Simulator?timeout_s=2")
    try:
        with pytest.raises(DeviceRefused, match="ABS_ROTATOR_ANGLE"):
            await made.open()
    finally:
        await made.close()
        await server.kill()


async def test_another_program_s_turn_is_seen(server: IndiServer, rotator: GenericRotator) -> None:
    other = server.device(ROTATOR)
    await other.bring_up(may_connect=True, needed=("ABS_ROTATOR_ANGLE",))
    other.client.send(messages.new_numbers(ROTATOR, "ABS_ROTATOR_ANGLE", {"ANGLE": 90.0}))
    async with asyncio.timeout(30.0):
        while not (await rotator.reading()).moving:
            await asyncio.sleep(0.05)
    await other.client.close()


def test_wrong_options_are_told() -> None:
    with pytest.raises(BadSettings, match="did you mean step_deg"):
        open_rotator("indi://host/Rotator?step=1")
    with pytest.raises(BadSettings, match="has no rotators"):
        open_rotator("lx200+tcp://host:4030")


async def test_a_server_that_dies_in_a_turn_and_comes_back_leaves_it_stopped(
    server: IndiServer, rotator: GenericRotator
) -> None:
    turning = asyncio.ensure_future(rotator.turn(170.0))
    async with asyncio.timeout(30.0):
        while not (await rotator.reading()).moving:
            await asyncio.sleep(0.05)
    links = rotator.links
    await server.kill()
    await server.start()
    with pytest.raises(DeviceMissing, match="it was stopped at"):
        await turning
    # it was switched on anew: who turns it must know that its count is another
    assert rotator.links > links
    assert not (await rotator.reading()).moving
