"""Motion keys of LX200 apps: pressed, released, forgotten, and left behind by an app that died."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from api.planetarium.lx200_server import Lx200Server
from api.service import Service
from mountnav.sky.sphere import separation_arcsec
from tests.api.indi_server.face_rig import OBSERVATORY, mechanics_of, observatory, up_now
from tests.waiting import until

TOML = OBSERVATORY.replace("[lx200_server]\n", "[lx200_server]\nmove_axis_s = 4.0\nsilence_s = 1.5\n")


@dataclass
class Rig:
    service: Service
    lx200: Lx200Server

    @property
    def moving(self) -> bool:
        return self.service.observatory.telescope("east").navigator.mount.axis_moving

    async def say(self, *commands: bytes) -> None:
        """Commands in a connection of their own, as some apps have it; it is closed at once."""
        _, writer = await asyncio.open_connection(*self.lx200.address)
        writer.write(b"".join(commands))
        await writer.drain()
        await asyncio.sleep(0.05)
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()

    async def at_rest(self) -> None:
        await until(lambda: not self.moving, "at rest")
        before = mechanics_of(self.service).truth()
        await asyncio.sleep(0.3)
        assert separation_arcsec(before, mechanics_of(self.service).truth()) < 5.0


@pytest.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    async with observatory(tmp_path, TOML) as service:
        telescope = service.observatory.telescope("east")
        await telescope.ready()
        await telescope.navigator.mount.slew(up_now(-20.0, 30.0))
        await service.dispatcher.watch("east").refresh()
        server = Lx200Server(service)
        await server.start()
        try:
            yield Rig(service, server)
        finally:
            await server.stop()


@pytest.mark.long
async def test_a_key_moves_until_it_is_released(rig: Rig) -> None:
    before = mechanics_of(rig.service).truth()
    await rig.say(b":RM#:Mn#")
    await until(lambda: rig.moving, "moving")
    for _ in range(12):
        # the app asks for the position, each time by a connection of its own
        await rig.say(b":GD#")
        await asyncio.sleep(0.15)
        assert rig.moving
    await rig.say(b":Qn#")
    await rig.at_rest()
    assert mechanics_of(rig.service).truth().dec_deg > before.dec_deg
    jobs = [job for job in rig.service.jobs.all() if job.kind == "move-axis"]
    assert [str(job.state) for job in jobs] == ["succeeded"]


@pytest.mark.long
async def test_an_app_that_dies_moves_nothing_any_more(rig: Rig) -> None:
    await rig.say(b":RG#:Mw#")
    await until(lambda: rig.moving, "moving")
    await rig.at_rest()


@pytest.mark.long
async def test_a_key_that_is_never_released_ends_by_its_time(rig: Rig) -> None:
    await rig.say(b":RG#:Ms#")
    await until(lambda: rig.moving, "moving")
    asking = asyncio.create_task(_ask_on(rig))
    try:
        await rig.at_rest()
    finally:
        asking.cancel()
        await asyncio.gather(asking, return_exceptions=True)


async def _ask_on(rig: Rig) -> None:
    while True:
        await rig.say(b":GR#")
        await asyncio.sleep(0.3)


@pytest.mark.long
async def test_a_press_and_its_release_in_one_write_leave_nothing_moving(rig: Rig) -> None:
    await rig.say(b":Me#:Qe#")
    await asyncio.sleep(0.5)
    await rig.at_rest()


@pytest.mark.long
async def test_a_stop_ends_all_keys(rig: Rig) -> None:
    await rig.say(b":RG#:Mn#")
    await until(lambda: rig.moving, "moving")
    await rig.say(b":Mw#")
    await asyncio.sleep(0.3)
    await rig.say(b":Q#")
    await rig.at_rest()
    await asyncio.sleep(1.0)
    await rig.at_rest()
