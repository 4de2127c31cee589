"""Mounts whose answers take their time: a slew ends soon after the mount stands.

Truth is the fake's mechanics: when it stands. What is allowed after that grows with the way of an answer: a
reading is confirmed by another one, and each takes its way there and back.
"""

from __future__ import annotations

import asyncio
import itertools
import random
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnTcp
from drivers.generic.mount import GenericMount
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Apparent, Icrs
from tests.api.indi_server.face_rig import indi_observatory, mechanics_of
from tests.drivers.alpaca.alpaca_server import HERE, AlpacaServer, FakeTelescope, quick_mechanics
from tests.drivers.far_wire import far
from tests.drivers.test_every_family import fake_of

pytestmark = pytest.mark.first  # they wait for mounts: not at the end, when nothing else is left to do

ALLOWED_S = 6.0
"""What a slew may last after the mount stands, on a line that takes no time, on a machine that is busy."""


async def slewed_after_standing_s(mount: GenericMount, mechanics: Mechanics) -> float:
    """Slew by 5°, and tell how long after the mount stood the slew was said to have ended."""
    loop = asyncio.get_running_loop()
    place = (await mount.reading()).place
    north_deg = -5.0 if place.dec_deg > 40.0 else 5.0
    target: Apparent | Icrs = (
        Apparent(place.ra_deg, place.dec_deg + north_deg, utc_now())
        if isinstance(place, Apparent)
        else Icrs(place.ra_deg, place.dec_deg + north_deg)
    )
    slew = asyncio.create_task(mount.slew(target))
    stood_s, moved = 0.0, False
    try:
        async with asyncio.timeout(240.0):
            while not slew.done():
                if mechanics.slewing():
                    moved, stood_s = True, loop.time()
                await asyncio.sleep(0.02)
        assert await slew is SlewOutcome.ARRIVED
    finally:
        slew.cancel()
    assert moved
    assert mount.trusted
    return loop.time() - stood_s


def jittered(seed: int, most_s: float) -> Callable[[], float]:
    drawn = random.Random(seed)
    return lambda: drawn.uniform(0.0, most_s)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(
    ("way", "most_s"),
    [
        (lambda: 0.1, 0.1),
        pytest.param(lambda: 0.2, 0.2, marks=pytest.mark.long),
        pytest.param(jittered(1, 0.5), 0.5, marks=pytest.mark.long),
        pytest.param(jittered(2, 2.0), 2.0, marks=pytest.mark.long),
        pytest.param(lambda: 2.0, 2.0, marks=pytest.mark.long),
    ],
)
async def test_an_alpaca_mount_that_is_far(version: int, way: Callable[[], float], most_s: float) -> None:
    mechanics = quick_mechanics(slew_rate_deg_s=5.0, acceleration_deg_s2=10.0)
    telescope = FakeTelescope(mechanics, version)
    with AlpacaServer({"telescope/0": telescope}) as server:
        mount = open_mount(server.url("telescope/0"), site=HERE)
        assert isinstance(mount, GenericMount)
        await mount.open()
        try:
            server.far = way
            after_s = await slewed_after_standing_s(mount, mechanics)
            assert after_s < ALLOWED_S + 8.0 * most_s
        finally:
            server.far = lambda: 0.0
            await mount.close()


@pytest.mark.long
async def test_all_members_are_asked_at_once() -> None:
    """While the answer to one is awaited all seven of a telescope without DeviceState have been asked."""
    telescope = FakeTelescope(quick_mechanics(), 3)
    with AlpacaServer({"telescope/0": telescope}) as server:
        mount = open_mount(server.url("telescope/0", "heartbeat_s=0"), site=HERE)
        await mount.open()
        try:
            asked, questions, all_there = len(server.asked), itertools.count(), threading.Barrier(7)

            def way_s() -> float:
                # none of the first seven gets there before all of them are on their way
                if next(questions) < 7:
                    all_there.wait(60.0)
                return 0.0

            server.far = way_s
            await mount.reading()
            assert not all_there.broken
            first = {member for _, member, _ in server.asked[asked : asked + 7]}
            assert {"slewing", "rightascension", "declination", "tracking", "atpark"} <= first
        finally:
            server.far = lambda: 0.0
            await mount.close()


@pytest.mark.long
@pytest.mark.parametrize(
    ("protocol", "dialect"),
    [
        ("lx200", "onstep"),
        ("lx200", "classic"),
        ("nexstar", "nexstar"),
        ("ioptron", "v3"),
        ("skywatcher", "eq6"),
    ],
)
async def test_a_serial_bridge_that_is_far(protocol: str, dialect: str) -> None:
    fake = fake_of(protocol, dialect)
    with FakeOnTcp(fake) as bench:
        port = int(bench.address.rpartition(":")[2])
        async with far("127.0.0.1", port, lambda: 0.25) as relayed:
            mount = open_mount(f"{protocol}+tcp://127.0.0.1:{relayed}", site=HERE)
            assert isinstance(mount, GenericMount)
            await mount.open()
            try:
                mount.trust()
                assert await slewed_after_standing_s(mount, fake.mechanics) < 2.0 * ALLOWED_S
            finally:
                await mount.close()


@pytest.mark.long
async def test_an_indi_server_that_is_far(tmp_path: Path) -> None:
    async with indi_observatory(tmp_path) as (service, server):
        host, port = server.address
        async with far(host, port, lambda: 0.25) as relayed:
            mount = open_mount(f"indi://127.0.0.1:{relayed}/east", site=HERE)
            assert isinstance(mount, GenericMount)
            await mount.open()
            try:
                mount.trust()
                assert await slewed_after_standing_s(mount, mechanics_of(service)) < 2.0 * ALLOWED_S
            finally:
                await mount.close()
