"""Our driver against our own Alpaca server: a whole observatory behind, every guard of it in force."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from drivers.generic.mount import GenericMount
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import Skill, SlewOutcome, SyncOutcome
from mountnav.errors import DeviceRefused
from mountnav.settings.observatory import Settings
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from tests.settings_text import SERVICE_AND_SITE

TOML = (
    SERVICE_AND_SITE
    + """
[alpaca]
discovery = false
[[telescope]]
id = "ours"
camera = { kind = "simulated", width_px = 100, height_px = 100 }
limits = { sun_cone_deg = 0.0 }
[telescope.mount]
url = "fake+lx200://?dialect=onstep"
mounting = "german"
slew_rate_deg_s = 25.0
acceleration_deg_s2 = 8.0
"""
)


@asynccontextmanager
async def behind_ours(options: str = "") -> AsyncIterator[GenericMount]:
    # here alone a driver's test needs the faces
    from api.http.app import create_app
    from api.http.serving import bind, make_server

    app = create_app(Settings.parse(TOML))
    server = make_server(app, log_level="warning")
    with bind("127.0.0.1", 0) as listener:
        port = listener.getsockname()[1]
        task = asyncio.create_task(server._serve([listener]))
        try:
            while not server.started:
                assert not task.done(), task
                await asyncio.sleep(0.02)
            app.state.service.observatory.telescope("ours").mechanics.acceleration_deg_s2 = 150.0
            url = f"alpaca+http://127.0.0.1:{port}/telescope/0?poll_s=0.2&backoff_s=0.2{options}"
            mount = open_mount(url, site=Site(47.0, 11.0))
            assert isinstance(mount, GenericMount)
            await mount.open()
            try:
                yield mount
            finally:
                await mount.close()
        finally:
            server.should_exit = True
            await task


@pytest.fixture(autouse=True)
def _own_journal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(tmp_path / "journal.sqlite"))


def two_hours_west(dec_deg: float = 30.0, ha_deg: float = 30.0) -> Apparent:
    utc = utc_now()
    icrs = hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), Site(47.0, 11.0), Air())
    return icrs_to_apparent(icrs, utc)


def apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))


@pytest.mark.long
async def test_our_driver_and_our_server_agree() -> None:
    async with behind_ours() as mount:
        assert mount.report is not None
        assert "ITelescopeV4" in mount.report.identity
        assert mount.epoch == "apparent"
        assert {Skill.PARK, Skill.UNPARK, Skill.TRACK, Skill.PIER_SIDE} <= mount.skills
        there = two_hours_west()
        assert await mount.slew(there) is SlewOutcome.ARRIVED
        assert apart_arcsec((await mount.reading()).place, there) < 30.0
        result = await mount.sync(Apparent(there.ra_deg, there.dec_deg + 0.1, utc_now()))
        assert result.outcome in (SyncOutcome.SEEN, SyncOutcome.LATE)
        with pytest.raises(DeviceRefused):
            await mount.slew(two_hours_west(-60.0))
        await mount.stop()
        # the last of its repeated stops may still be carried out over there
        async with asyncio.timeout(30.0):
            while (await mount.reading()).slewing is True:
                await asyncio.sleep(0.1)
        assert await mount.park() is SlewOutcome.ARRIVED
        assert (await mount.reading()).parked
        with pytest.raises(DeviceRefused):
            await mount.slew(there)
        await mount.unpark()
        assert (await mount.reading()).parked is False
