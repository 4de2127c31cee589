"""Motion keys and custom rates of INDI clients: raw ones, and INDI's own programs."""

from __future__ import annotations

import asyncio
import shutil
from collections.abc import AsyncIterator
from datetime import timedelta
from pathlib import Path

import pytest

from api.indi_server.server import IndiServer
from api.service import Service
from drivers.indi.codec import messages
from drivers.indi.codec.messages import State
from mountnav.mount import RatesInForce
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from mountnav.sky.sphere import separation_arcsec
from tests.api.indi_server.face_rig import (
    OBSERVATORY,
    Raw,
    indi_observatory,
    mechanics_of,
    raw_client,
    switch,
    up_now,
)
from tests.waiting import until

SHORT = OBSERVATORY.replace("[indi_server]\n", "[indi_server]\nmove_axis_s = 3.0\noffset_rates_s = 2.0\n")
NS, WE = "TELESCOPE_MOTION_NS", "TELESCOPE_MOTION_WE"
STAR_ARCSEC_S = 3600.0 * SIDEREAL_DEG_S


@pytest.fixture
async def indi(tmp_path: Path) -> AsyncIterator[tuple[Service, IndiServer]]:
    async with indi_observatory(tmp_path, SHORT) as (service, server):
        telescope = service.observatory.telescope("east")
        await telescope.ready()
        await telescope.navigator.mount.slew(up_now(-20.0, 30.0))
        await service.dispatcher.watch("east").refresh()
        yield service, server


def moving(service: Service) -> bool:
    return service.observatory.telescope("east").navigator.mount.axis_moving


async def at_rest(service: Service) -> None:
    await until(lambda: not moving(service), "at rest")
    before = mechanics_of(service).truth()
    await asyncio.sleep(0.3)
    assert separation_arcsec(before, mechanics_of(service).truth()) < 5.0


def released(name: str, *elements: str) -> bytes:
    return messages.new_switches("east", name, dict.fromkeys(elements, False))


@pytest.mark.long
async def test_a_key_moves_while_it_is_pressed(indi: tuple[Service, IndiServer]) -> None:
    service, server = indi
    async with raw_client(server) as raw:
        before = mechanics_of(service).truth()
        await raw.say(switch("TELESCOPE_SLEW_RATE", "SLEW_FIND"), switch(NS, "MOTION_NORTH"))
        await raw.until(lambda: State.BUSY in raw.states(NS, 0), "told that it moves")
        await until(lambda: moving(service), "moving")
        await raw.say(released(NS, "MOTION_NORTH", "MOTION_SOUTH"))
        await raw.until(lambda: raw.states(NS, 0)[-1] is State.IDLE, "told that it has ended")
        await at_rest(service)
        assert mechanics_of(service).truth().dec_deg > before.dec_deg
        # to the west the right ascension grows less
        await raw.say(switch(WE, "MOTION_WEST"))
        await until(lambda: moving(service), "moving")
        await raw.say(switch("TELESCOPE_ABORT_MOTION", "ABORT"))
        await at_rest(service)


@pytest.mark.long
async def test_a_client_that_goes_leaves_nothing_moving(indi: tuple[Service, IndiServer]) -> None:
    service, server = indi
    async with raw_client(server) as raw:
        await raw.say(switch(NS, "MOTION_SOUTH"))
        await until(lambda: moving(service), "moving")
    await at_rest(service)


@pytest.mark.long
async def test_a_key_that_is_never_released_ends_by_its_time(indi: tuple[Service, IndiServer]) -> None:
    service, server = indi
    async with raw_client(server) as raw:
        await raw.say(switch("TELESCOPE_SLEW_RATE", "SLEW_GUIDE"), switch(NS, "MOTION_SOUTH"))
        await until(lambda: moving(service), "moving")
        await raw.until(lambda: any("not renewed within 3 s" in words for words in raw.words()), "told why")
        await at_rest(service)


@pytest.mark.long
async def test_one_clients_key_is_no_others(indi: tuple[Service, IndiServer]) -> None:
    service, server = indi
    async with raw_client(server) as raw, raw_client(server) as other:
        await raw.say(switch(NS, "MOTION_SOUTH"))
        await until(lambda: moving(service), "moving")
        mark = len(other.heard)
        await other.say(switch(NS, "MOTION_NORTH"))
        await other.until(lambda: State.ALERT in other.states(NS, mark), "refused")


@pytest.mark.long
async def test_custom_rates_by_indis_own_programs(indi: tuple[Service, IndiServer]) -> None:
    if shutil.which("indi_setprop") is None:
        pytest.skip("indi-bin is not installed")
    service, server = indi
    mount = service.observatory.telescope("east").navigator.mount
    assert "east.TELESCOPE_TRACK_MODE.TRACK_CUSTOM=Off" in await program(server, "indi_getprop", "-1")
    rates = f"east.TELESCOPE_TRACK_RATE.TRACK_RATE_RA;TRACK_RATE_DE={STAR_ARCSEC_S - 1.5};-0.75"
    await program(server, "indi_setprop", "-n", rates)
    assert mount.offset_rates_in_force is None
    await program(server, "indi_setprop", "-s", "east.TELESCOPE_TRACK_MODE.TRACK_CUSTOM=On")
    await until(lambda: mount.offset_rates_in_force is not None, "in force")
    force = mount.offset_rates_in_force
    assert force is not None
    # the right ascension of what lags behind the stars grows
    assert force.rates.ra_arcsec_s == pytest.approx(1.5, abs=1e-4)
    assert force.rates.dec_arcsec_s == pytest.approx(-0.75, abs=1e-4)
    # the program has gone, and nobody puts their end off
    await until(lambda: mount.offset_rates_in_force is None, "over")
    reading = await mount.reading()
    assert reading.tracking


async def set_rates(raw: Raw, service: Service) -> None:
    """As a client does, once."""
    await raw.say(
        messages.new_numbers(
            "east", "TELESCOPE_TRACK_RATE", {"TRACK_RATE_RA": STAR_ARCSEC_S, "TRACK_RATE_DE": 1.0}
        ),
        switch("TELESCOPE_TRACK_MODE", "TRACK_CUSTOM"),
    )
    mount = service.observatory.telescope("east").navigator.mount
    await until(lambda: mount.offset_rates_in_force is not None, "in force")


async def answer(raw: Raw, answered: int = 0) -> int:
    """Answer the pings that came, as INDI's own clients do; how many came in all."""
    asked = [event.uid for event in raw.heard if isinstance(event, messages.Pinged)]
    for uid in asked[answered:]:
        await raw.say(messages.ping_reply(uid))
    return len(asked)


@pytest.mark.long
async def test_custom_rates_are_put_off_while_the_client_answers(tmp_path: Path) -> None:
    longer = OBSERVATORY.replace("[indi_server]\n", "[indi_server]\noffset_rates_s = 8.0\n")
    async with indi_observatory(tmp_path, longer) as (service, server):
        telescope = service.observatory.telescope("east")
        await telescope.ready()
        mount = telescope.navigator.mount
        await mount.slew(up_now(-20.0, 30.0))
        async with raw_client(server, device="") as raw:
            await set_rates(raw, service)
            first = mount.offset_rates_in_force
            assert first is not None
            force: RatesInForce | None = first
            answered = 0
            while force is not None and force.ends_utc < first.ends_utc + timedelta(seconds=4.0):
                answered = await answer(raw, answered)
                await asyncio.sleep(0.1)
                force = mount.offset_rates_in_force
                assert force is not None
            # it hangs, and its connection stays
            await until(lambda: mount.offset_rates_in_force is None, "over")


@pytest.mark.long
@pytest.mark.parametrize("through_a_server", [False, True])
async def test_custom_rates_of_a_client_that_only_stays_end(
    indi: tuple[Service, IndiServer], through_a_server: bool
) -> None:
    service, server = indi
    mount = service.observatory.telescope("east").navigator.mount
    # an indiserver asks for a device of its own clients, and answers for them whether they live or not
    async with raw_client(server, device="east" if through_a_server else "") as raw:
        await set_rates(raw, service)
        answered = 0
        while mount.offset_rates_in_force is not None:
            await asyncio.sleep(0.05)
            if through_a_server:
                answered = await answer(raw, answered)
        # nobody else ended them
        assert not raw.closed


@pytest.mark.long
async def test_a_key_of_a_client_that_hangs_is_ended_before_its_time(tmp_path: Path) -> None:
    short = OBSERVATORY.replace("[indi_server]\n", "[indi_server]\nmove_axis_s = 60.0\nsilence_s = 1.0\n")
    async with indi_observatory(tmp_path, short) as (service, server):
        telescope = service.observatory.telescope("east")
        await telescope.ready()
        await telescope.navigator.mount.slew(up_now(-20.0, 30.0))
        async with raw_client(server) as raw:
            await raw.say(switch("TELESCOPE_SLEW_RATE", "SLEW_GUIDE"), switch(NS, "MOTION_SOUTH"))
            await until(lambda: moving(service), "moving")
            answered = 0
            for _ in range(20):
                await asyncio.sleep(0.1)
                answered = await answer(raw, answered)
                assert moving(service)
            await until(lambda: not moving(service), "at rest")
            await raw.until(lambda: any("answered nothing for 1 s" in words for words in raw.words()), "told")


async def program(server: IndiServer, name: str, *words: str) -> str:
    """One of INDI's own programs, to its end."""
    host, port = server.address
    running = await asyncio.create_subprocess_exec(
        *(name, "-h", host, "-p", str(port), *words),
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    async with asyncio.timeout(60):
        out, _ = await running.communicate()
    return out.decode()
