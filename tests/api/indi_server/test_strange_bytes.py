"""What one client sends takes nobody's stop away, and no whole message that came with it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio

from api.access.callers import Caller, Face, Role
from api.indi_server.parser import Hearing
from api.indi_server.server import IndiServer
from api.orders.targets import ApparentTarget
from api.orders.vocabulary import SlewOrder
from api.service import Service
from drivers.indi.codec.messages import State
from mountnav.clock import utc_now
from tests.api.indi_server.face_rig import (
    apart_arcsec,
    coordinates,
    indi_observatory,
    mechanics_of,
    raw_client,
    switch,
    up_now,
)
from tests.waiting import until

pytestmark = pytest.mark.asyncio(loop_scope="module")
STOP = switch("TELESCOPE_ABORT_MOTION", "ABORT")
TRACK_OFF = switch("TELESCOPE_TRACK_STATE", "TRACK_OFF")
HUGE = (
    b"<newBLOBVector device='east' name='CCD1'><oneBLOB name='a' format='.f' size='%s'>QQ==</oneBLOB>"
    b"</newBLOBVector>" % (b"9" * 4301)
)
CUT = b"<newSwitchVector device='east' name='ON_COORD_SET'><oneSwitch name='TRA"
SCHEDULER = Caller("a scheduler", Role.OPERATE, Face.REST)
Rig = tuple[Service, IndiServer]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    async with indi_observatory(tmp_path_factory.mktemp("indi")) as rig:
        yield rig


async def slewing(service: Service) -> None:
    await until(lambda: service.jobs.running_on("east") is None, "nothing under way")
    far = up_now(-50.0 if mechanics_of(service).reported(utc_now()).ra_deg < 180.0 else 50.0, 30.0)
    order = SlewOrder(target=ApparentTarget(ra_deg=far.ra_deg, dec_deg=far.dec_deg))
    await service.dispatcher.order(SCHEDULER, "east", order)
    await until(lambda: mechanics_of(service).slewing(), "slewing")


@pytest.mark.long
@pytest.mark.parametrize("broken", [HUGE, CUT, b"</a>", b"<newNumberVector a='" + b">" * 17_000])
async def test_a_stop_counts_whatever_the_same_write_holds(rig: Rig, broken: bytes) -> None:
    service, server = rig
    await slewing(service)
    async with raw_client(server) as raw:
        await raw.say(broken + STOP)
        await until(lambda: not mechanics_of(service).slewing(), "at rest")
        await until(lambda: service.jobs.running_on("east") is None, "nothing under way")


async def test_orders_beside_a_value_that_is_none_are_carried_out(rig: Rig) -> None:
    _, server = rig
    async with raw_client(server) as raw:
        mark = len(raw.heard)
        await raw.say(TRACK_OFF, HUGE, switch("TELESCOPE_TRACK_STATE", "TRACK_ON"))
        await raw.until(lambda: len(raw.states("TELESCOPE_TRACK_STATE", mark)) >= 2, "answered twice")
        assert any("is not a length" in words for words in raw.words(mark))
        assert not raw.closed


async def test_what_is_whole_counts_before_and_after_a_gap_but_coordinates_after_it(rig: Rig) -> None:
    service, server = rig
    here = mechanics_of(service).reported(utc_now())
    async with raw_client(server) as raw:
        mark = len(raw.heard)
        await raw.say(
            TRACK_OFF + CUT + coordinates(up_now(10.0, 20.0)) + switch("TELESCOPE_TRACK_STATE", "TRACK_ON")
        )
        await raw.until(lambda: raw.closed, "closed")
        assert State.ALERT in raw.states("EQUATORIAL_EOD_COORD", mark)
        assert any("may have been ON_COORD_SET" in words for words in raw.words(mark))
        assert any("goodbye" in words for words in raw.words(mark))
        assert len(raw.states("TELESCOPE_TRACK_STATE", mark)) >= 2
    assert not mechanics_of(service).slewing()
    assert apart_arcsec(mechanics_of(service).reported(utc_now()), here) < 600.0


async def test_orders_that_came_before_a_stop_in_its_write_are_dropped(rig: Rig) -> None:
    service, server = rig
    here = mechanics_of(service).reported(utc_now())
    async with raw_client(server) as raw:
        mark = len(raw.heard)
        await raw.say(coordinates(up_now(10.0, 20.0)) + STOP + TRACK_OFF)
        await raw.until(lambda: bool(raw.told("TELESCOPE_TRACK_STATE", mark)), "the order behind it answered")
        assert any("a stop came first" in words for words in raw.words(mark))
    assert apart_arcsec(mechanics_of(service).reported(utc_now()), here) < 3600.0


ATTACK = b'<newNumberVector a="' + b">" * 15_500
SMALL = b"<a/>" * 16_000


@pytest.mark.long
async def test_attackers_keep_neither_the_loop_nor_a_stop(rig: Rig) -> None:
    """Ten attackers at once: the longest turn is a fraction of what one of their writes takes to read."""
    service, server = rig
    began = time.thread_time()
    for _ in range(4):
        Hearing().feed(SMALL)
    at_once_s = (time.thread_time() - began) / 4.0
    await slewing(service)

    async def attack(bytes_: bytes) -> None:
        _, writer = await asyncio.open_connection(*server.address)
        try:
            while True:
                writer.write(bytes_)
                await writer.drain()
                for _ in range(20):
                    writer.write(b">")
                    await asyncio.sleep(0.001)
        except OSError:
            pass
        finally:
            writer.close()

    longest_s = 0.0

    async def watch() -> None:
        nonlocal longest_s
        then = time.thread_time()
        while True:
            await asyncio.sleep(0)
            now = time.thread_time()
            longest_s, then = max(longest_s, now - then), now

    attackers = [asyncio.create_task(attack(kind)) for kind in (ATTACK, SMALL) * 5]
    watching = asyncio.create_task(watch())
    try:
        async with raw_client(server, asking=False) as raw:
            await raw.say(STOP)
            await until(lambda: not mechanics_of(service).slewing(), "at rest")
        await asyncio.sleep(0.3)
    finally:
        for task in (*attackers, watching):
            task.cancel()
        await asyncio.gather(*attackers, watching, return_exceptions=True)
    assert longest_s < 2.0 * at_once_s, (longest_s, at_once_s)
