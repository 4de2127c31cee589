"""Our INDI client over a real `indiserver`: the own driver of each mount on the fake of that mount."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.generic.mount import GenericMount
from drivers.indi.codec import messages
from drivers.nexstar.fake import FakeNexstar
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import Skill, SlewOutcome, SlewState, SyncOutcome
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi.real_server import IndiServer
from tests.drivers.ioptron import german_fakes
from tests.drivers.lx200.german_fakes import beside, german
from tests.drivers.nexstar.test_fake_synscan_indi import fake_heq5
from tests.drivers.skywatcher import quick_fakes

SITE = Site(49.6, 36.9)
NEAR_ARCSEC = 60.0
"""The drivers' own errors: INDI 1.9.9 converts equinoxes wrongly by 13″, and some write whole minutes."""
OPTIONS = "poll_s=0.1&heartbeat_s=0.5&set_site=yes&set_clock=yes"


def celestron() -> FakeNexstar:
    now = utc_now()
    return FakeNexstar(
        Mechanics(
            SITE,
            Air(),
            PointingErrors(),
            machine=Machine(mounting="german"),
            slew_rate_deg_s=60.0,
            acceleration_deg_s2=120.0,
            start=Apparent((sidereal_time_deg(now, SITE) - 40.0) % 360.0, 30.0, now),
        )
    )


def ioptron(dialect: str) -> Any:
    return german_fakes.fake_of(german_fakes.mechanics_of(slew_rate_deg_s=60.0), dialect=dialect)


@dataclass(frozen=True)
class Real:
    """A driver, its device, the fake of its mount; `syncs_itself` if the mount hears nothing of a sync."""

    driver: str
    device: str
    fake: Callable[[], Any]
    tcp: bool = False
    options: str = ""
    syncs_itself: bool = False


def lx200(driver: str, device: str, dialect: str, **more: Any) -> Real:
    return Real(driver, device, partial(german, dialect), **more)


# these two write declinations in whole minutes of arc
COARSE = "resolution_arcsec=60"
REAL = {
    one.driver: one
    for one in (
        lx200("indi_lx200_OnStep", "LX200 OnStep", "onstep"),
        lx200("indi_lx200basic", "LX200 Basic", "basic"),
        lx200("indi_lx200classic", "LX200 Classic", "classic"),
        lx200("indi_lx200autostar", "LX200 Autostar", "autostar"),
        lx200("indi_lx200gps", "LX200 GPS", "lx200gps"),
        lx200("indi_lx200_16", "LX200 16", "lx200-16"),
        lx200("indi_lx200_10micron", "10micron", "10micron"),
        lx200("indi_lx200am5", "ZWO AM5", "am5"),
        lx200("indi_lx200gemini", "Losmandy Gemini", "gemini"),
        lx200("indi_lx200ap", "AstroPhysics", "ap"),
        lx200("indi_lx200ap_gtocp2", "AstroPhysics GTOCP2", "ap-gtocp2", tcp=True),
        lx200("indi_lx200fs2", "Astro-Electronic FS-2", "fs2"),
        lx200("indi_lx200ss2000pc", "SkySensor2000PC", "ss2000pc"),
        lx200("indi_ioptronHC8406", "iOptron HC8406", "hc8406"),
        lx200("indi_lx200gotonova", "GotoNova", "gotonova", options=COARSE),
        lx200("indi_lx200zeq25", "ZEQ25", "zeq25", options=COARSE),
        lx200("indi_lx200_TeenAstro", "LX200 TeenAstro", "teenastro"),
        lx200("indi_lx200pulsar2", "Pulsar2", "pulsar2"),
        lx200("indi_rainbow_telescope", "Rainbow", "rainbow", tcp=True),
        Real("indi_ioptronv3_telescope", "iOptronV3", partial(ioptron, "v3")),
        Real("indi_ieq_telescope", "iEQ", partial(ioptron, "v2")),
        Real("indi_celestron_gps", "Celestron GPS", celestron),
        Real("indi_synscan_telescope", "SynScan", fake_heq5),
        Real(
            "indi_eqmod_telescope",
            "EQMod Mount",
            partial(quick_fakes.quick, "eq6", SITE),
            syncs_itself=True,
        ),
    )
}


async def told_its_line(server: IndiServer, real: Real, address: str) -> None:
    """As an operator does in INDI's control panel; to connect is left to our mount."""
    panel = server.device(real.device)
    has = panel.get
    await panel.client.open()
    assert await panel.client.until(lambda: bool(has("DEVICE_PORT") or has("CONNECTION_MODE")), 30.0)
    mode = "CONNECTION_TCP" if real.tcp else "CONNECTION_SERIAL"
    if has("CONNECTION_MODE") is not None:
        await panel.set_switches("CONNECTION_MODE", {mode: True})
    # a driver that fails would go on to every other port of the machine
    for name in ("DEVICE_AUTO_SEARCH", "DEVICE_LAN_SEARCH"):
        if has(name) is not None:
            panel.client.send(messages.new_switches(real.device, name, {"INDI_DISABLED": True}))
    if real.tcp:
        assert await panel.client.until(lambda: has("DEVICE_ADDRESS") is not None, 30.0)
        parts = urlsplit(address)
        where = {"ADDRESS": str(parts.hostname), "PORT": str(parts.port)}
        order, asking = messages.new_texts(real.device, "DEVICE_ADDRESS", where), "DEVICE_ADDRESS"
    else:
        assert await panel.client.until(lambda: has("DEVICE_PORT") is not None, 30.0)
        order, asking = messages.new_texts(real.device, "DEVICE_PORT", {"PORT": address}), "DEVICE_PORT"
    poll = messages.new_numbers(real.device, "POLLING_PERIOD", {"PERIOD_MS": 250.0})
    await panel.ordered(poll, order, asking=asking, echo=asking)
    await panel.client.close()


@asynccontextmanager
async def served(real: Real, home: Path) -> AsyncIterator[tuple[Mechanics, GenericMount]]:
    fake = real.fake()
    server = IndiServer((real.driver,), home)
    with FakeOnTcp(fake) if real.tcp else FakeOnPty(fake) as bench:
        await server.start()
        try:
            await told_its_line(server, real, bench.address)
            url = f"indi://127.0.0.1:{server.port}/{quote(real.device)}?{OPTIONS}&{real.options}"
            mount = open_mount(url.rstrip("&"), site=SITE)
            assert isinstance(mount, GenericMount)
            await mount.open()
            try:
                yield fake.mechanics, mount
            finally:
                await mount.close()
        finally:
            await server.kill()


async def off_arcsec(mount: GenericMount, place: Apparent) -> float:
    """How far what the mount says lies from a place."""
    here = (await mount.reading()).place
    return separation_arcsec(Icrs(here.ra_deg, here.dec_deg), Icrs(place.ra_deg, place.dec_deg))


@pytest.mark.long
@pytest.mark.parametrize("driver", REAL)
async def test_it_slews_syncs_and_stops(tmp_path: Path, driver: str) -> None:
    real = REAL[driver]
    async with served(real, tmp_path / "home") as (mechanics, mount):
        if not mount.trusted:
            mount.trust()
        if (await mount.reading()).parked:
            await mount.unpark()
        if Skill.TRACK in mount.skills:
            await mount.set_tracking(True)
        target = beside(mechanics.reported(), -8.1234, -5.4321)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert await off_arcsec(mount, target) < NEAR_ARCSEC
        assert separation_arcsec(mechanics.reported(), target) < NEAR_ARCSEC

        here = (await mount.reading()).place
        shifted = beside(Apparent(here.ra_deg, here.dec_deg, utc_now()), 0.1, 0.05)
        tube = mechanics.axes()
        assert (await mount.sync(shifted)).outcome is SyncOutcome.SEEN
        assert await off_arcsec(mount, shifted) < NEAR_ARCSEC
        assert abs(mechanics.axes().dec_axis_deg - tube.dec_axis_deg) < 1e-3
        if not real.syncs_itself:
            assert separation_arcsec(mechanics.reported(), shifted) < NEAR_ARCSEC

        mechanics.slew_rate_deg_s = 2.0
        far = beside(mechanics.reported(), 5.0, -14.0)
        slewing = asyncio.create_task(mount.slew(far))
        async with asyncio.timeout(30.0):
            while mount.slew_state is not SlewState.UNDER_WAY:
                await asyncio.sleep(0.02)
        await mount.stop()
        assert await slewing is SlewOutcome.STOPPED
        rests = mechanics.axes()
        await asyncio.sleep(0.2)
        # at rest, or as fast as the sky
        assert abs(mechanics.axes().dec_axis_deg - rests.dec_axis_deg) < 1e-3
        assert separation_arcsec(mechanics.reported(), far) > 3600.0
