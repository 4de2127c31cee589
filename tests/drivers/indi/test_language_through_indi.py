"""Both ends ours, INDI in the middle: our client, the real server and driver, our fake mount on a wire."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty
from drivers.generic.mount import GenericMount
from drivers.indi.codec import messages
from drivers.lx200.fake.base import FakeLx200
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, SyncOutcome
from mountnav.errors import DeviceRefused, Refusal
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi.real_server import IndiServer

SITE = Site(48.93, 22.27, 700.0)
LX200 = "LX200 Classic"


def up_now(ha_deg: float, dec_deg: float) -> Apparent:
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc_now()), SITE, Air()), utc_now())


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


@asynccontextmanager
async def through_indi(home: Path) -> AsyncIterator[tuple[GenericMount, FakeLx200]]:
    mechanics = Mechanics(SITE, Air(), PointingErrors(), slew_rate_deg_s=20.0, acceleration_deg_s2=40.0)
    fake = FakeLx200(mechanics)
    server = IndiServer(("indi_lx200classic",), home)
    with FakeOnPty(fake) as bench:
        await server.start()
        try:
            other = server.device(LX200)
            await other.client.open()
            assert await other.client.until(lambda: other.get("DEVICE_PORT") is not None, 10.0)
            other.client.send(
                # or a driver that fails goes on to every other port of the machine
                messages.new_switches(
                    LX200, "DEVICE_AUTO_SEARCH", {"INDI_ENABLED": False, "INDI_DISABLED": True}
                ),
                messages.new_texts(LX200, "DEVICE_PORT", {"PORT": str(bench.address)}),
            )
            await other.told("DEVICE_PORT")
            await other.client.close()
            url = f"indi://127.0.0.1:{server.port}/LX200%20Classic?poll_s=0.2&resolution_arcsec=15"
            mount = open_mount(url, site=SITE)
            assert isinstance(mount, GenericMount)
            await mount.open()
            try:
                yield mount, fake
            finally:
                await mount.close()
        finally:
            await server.kill()


@pytest.mark.long
async def test_a_classic_mount_is_driven_through_indi(tmp_path: Path) -> None:
    async with through_indi(tmp_path / "home") as (mount, fake):
        there = up_now(-30.0, 40.0)
        assert await mount.slew(there) is SlewOutcome.ARRIVED
        # what counts is what the fake at the far end believes
        believed = fake.mechanics.reported(utc_now())
        assert apart_arcsec(believed, there) < 30.0
        assert apart_arcsec((await mount.reading()).place, believed) < 30.0
        aside = Apparent(there.ra_deg, there.dec_deg + 0.5, utc_now())
        assert (await mount.sync(aside)).outcome is SyncOutcome.SEEN
        assert apart_arcsec(fake.mechanics.reported(utc_now()), aside) < 30.0
        with pytest.raises(DeviceRefused) as caught:
            await mount.slew(up_now(180.0, 0.0))
        assert caught.value.reason is Refusal.BELOW_HORIZON
