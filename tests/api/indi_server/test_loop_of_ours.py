"""Both ends ours: the driver that is a client of INDI servers drives the INDI server of the service."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import pytest_asyncio

from api.access.callers import Caller, Face, Role
from api.indi_server.server import IndiServer
from api.orders.vocabulary import SetParkOrder
from api.service import Service
from drivers.generic.mount import GenericMount
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import Direction, Skill, SlewOutcome, SyncOutcome
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.coordinates import Apparent
from tests.api.indi_server.face_rig import SITE, apart_arcsec, indi_observatory, mechanics_of, up_now

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.long]


@asynccontextmanager
async def driven(server: IndiServer) -> AsyncIterator[GenericMount]:
    host, port = server.address
    mount = open_mount(f"indi://{host}:{port}/east?poll_s=0.05", site=SITE)
    assert isinstance(mount, GenericMount)
    await mount.open()
    try:
        yield mount
    finally:
        await mount.close()


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[tuple[Service, GenericMount]]:
    folder = tmp_path_factory.mktemp("indi")
    async with indi_observatory(folder) as (service, server), driven(server) as mount:
        yield service, mount


async def test_a_mount_is_driven_through_both_ends(rig: tuple[Service, GenericMount]) -> None:
    service, mount = rig
    mechanics = mechanics_of(service)
    assert mount.report is not None
    assert mount.report.problems == ()
    assert mount.report.site_off_arcsec is not None
    assert mount.report.site_off_arcsec < 1.0
    assert {Skill.PARK, Skill.UNPARK, Skill.HOME, Skill.TRACK, Skill.GUIDE} <= mount.skills
    assert Skill.SET_SITE not in mount.skills
    there = up_now(2.0, 45.0)
    assert await mount.slew(there) is SlewOutcome.ARRIVED
    assert apart_arcsec(mechanics.reported(utc_now()), there) < 2.0
    assert apart_arcsec((await mount.reading()).place, there) < 5.0
    aside = Apparent(there.ra_deg, there.dec_deg + 0.2, utc_now())
    assert (await mount.sync(aside)).outcome is SyncOutcome.SEEN
    assert apart_arcsec(mechanics.reported(utc_now()), aside) < 5.0
    # all of it was ordered of the one core
    assert [job.kind for job in service.jobs.all()][:2] == ["sync-to", "slew"]


async def test_what_the_core_refuses_is_refused_with_its_words(rig: tuple[Service, GenericMount]) -> None:
    service, mount = rig
    before, jobs = mechanics_of(service).reported(utc_now()), len(service.jobs.all())
    with pytest.raises(DeviceRefused, match="altitude") as caught:
        await mount.slew(up_now(-100.0, -20.0))
    assert caught.value.reason is Refusal.BELOW_HORIZON
    # nothing moved, and no job was made
    assert apart_arcsec(mechanics_of(service).reported(utc_now()), before) < 5.0
    assert len(service.jobs.all()) == jobs
    far = Apparent(before.ra_deg, before.dec_deg - 10.0, utc_now())
    with pytest.raises(DeviceRefused, match="more than"):
        await mount.sync(far)


async def test_parked_tracking_and_pulses_through_both_ends(rig: tuple[Service, GenericMount]) -> None:
    service, mount = rig
    # so that the way there is short
    here = await service.dispatcher.order(
        Caller("a scheduler", Role.OPERATE, Face.REST), "east", SetParkOrder()
    )
    await here.ended.wait()
    await mount.set_tracking(False)
    assert (await mount.reading()).tracking is False
    await mount.set_tracking(True)
    assert (await mount.reading()).tracking is True
    await mount.guide(Direction.NORTH, 0.2)
    await mount.guide(Direction.EAST, 0.2)
    assert await mount.park() is SlewOutcome.ARRIVED
    assert (await mount.reading()).parked is True
    with pytest.raises(DeviceRefused, match="parked"):
        await mount.slew(up_now(2.0, 45.0))
    await mount.unpark()
    assert (await mount.reading()).parked is False
