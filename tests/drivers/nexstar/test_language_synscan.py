"""The driver against a fake SynScan hand control: J2000, its own tracking modes, syncs only from nearby."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from drivers import registry
from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.nexstar.codec.dialect import Handset, Version
from drivers.nexstar.fake import SYNC_REACH_DEG, SYNSCAN_FAKES, FakeNexstar, make_fake
from drivers.nexstar.parking import Horizon
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, SyncOutcome
from mountnav.errors import BadRequest, DeviceRefused, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, sidereal_time_deg
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.mounts import nexstar_mount

HERE = Site(49.6, 36.9)
PATIENCE = Patience(deadline_s=2.0, try_s=0.25, quiet_s=0.02)
QUICK = Timing(poll_s=0.05, start_grace_s=0.3, rest_s=0.2, sync_wait_s=0.5, heartbeat_s=0.0)
HEQ5 = Handset(Version(4, 39, 5, synscan=True), None, 1)


def fake_in_the_west(**more: Any) -> FakeNexstar:
    now = utc_now()
    mechanics = Mechanics(
        HERE,
        Air(),
        PointingErrors(),
        machine=Machine(mounting="german"),
        slew_rate_deg_s=30.0,
        acceleration_deg_s2=200.0,
        start=Apparent((sidereal_time_deg(now, HERE) - 40.0) % 360.0, 30.0, now),
    )
    return FakeNexstar(mechanics, **{"handset": HEQ5, "sync_reach_deg": SYNC_REACH_DEG, **more})


@asynccontextmanager
async def opened(fake: FakeNexstar, *, tcp: bool = False, **more: Any) -> AsyncIterator[GenericMount]:
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        given = {"epoch": "icrs", "site": HERE, "patience": PATIENCE, "timing": QUICK, **more}
        mount = nexstar_mount(bench.address, **given)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.long)])
async def test_conforms(tcp: bool) -> None:
    fake = fake_in_the_west()
    async with opened(fake, tcp=tcp, park=Horizon(250.0, 40.0)) as mount:
        assert mount.report is not None
        assert mount.report.identity == "SynScan hand control 4.39.05, HEQ5"
        assert mount.report.problems == ()
        await check_mount(mount)
    assert fake.unknown == []
    # of the motors it is asked for nothing but speeds: a SynScan passes nothing else on
    assert {command[3] for command in fake.heard if command[:1] == b"P"} <= {0x24, 0x25}


async def test_its_places_are_j2000() -> None:
    fake = fake_in_the_west()
    async with opened(fake) as mount:
        reading = await mount.reading()
        believed = fake.mechanics.reported(reading.utc)
        assert isinstance(reading.place, Icrs)
        assert separation_arcsec(reading.place, apparent_to_icrs(believed)) < 1.0
        assert separation_arcsec(reading.place, Icrs(believed.ra_deg, believed.dec_deg)) > 300.0


async def test_whoever_takes_it_for_a_celestron_is_told() -> None:
    async with opened(fake_in_the_west(), epoch="apparent") as mount:
        assert mount.report is not None
        assert "its family usually speaks icrs" in mount.report.problems[0]


async def test_a_sync_from_far_off_is_seen_to_be_ignored() -> None:
    fake = fake_in_the_west()
    async with opened(fake) as mount:
        place = (await mount.reading()).place
        result = await mount.sync(Icrs(place.ra_deg, place.dec_deg + 8.0))
        assert result.outcome is SyncOutcome.IGNORED
        assert result.miss_arcsec == pytest.approx(8.0 * 3600.0, abs=60.0)
        result = await mount.sync(Icrs(place.ra_deg, place.dec_deg + 1.0))
        assert result.outcome is SyncOutcome.SEEN


async def test_a_stop_leaves_it_tracking() -> None:
    fake = fake_in_the_west()
    fake.mechanics.slew_rate_deg_s = 2.0
    async with opened(fake) as mount:
        place = (await mount.reading()).place
        slew = asyncio.create_task(mount.slew(Icrs(place.ra_deg, place.dec_deg + 30.0)))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        await mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert (await mount.reading()).tracking is True
    assert not [command for command in fake.heard if command[:1] == b"T"]
    # told twice [INDI synscan]
    stopped = fake.heard.index(b"M")
    assert fake.heard[stopped : stopped + 2] == [b"M", b"M"]


async def test_an_old_one_takes_no_sync_and_tells_no_side() -> None:
    made = fake_in_the_west().mechanics
    fake = make_fake("synscan-old", made, monotonic=asyncio.get_running_loop().time)
    async with opened(fake) as mount:
        reading = await mount.reading()
        assert reading.pier_side is None
        with pytest.raises(DeviceRefused, match="has no sync command") as refusal:
            await mount.sync(Icrs(reading.place.ra_deg, reading.place.dec_deg))
        assert refusal.value.reason is Refusal.UNSUPPORTED
    assert fake.unknown == []


async def test_a_model_told_the_wrong_way_round_is_read() -> None:
    # firmware 3.39 [INDI synscanlegacy]
    fake = fake_in_the_west(faults=[Fault("scramble", on=b"m", data=b"#\x01")])
    async with opened(fake) as mount:
        assert mount.report is not None
        assert mount.report.identity.endswith("HEQ5")


def test_fakes_by_name() -> None:
    made = fake_in_the_west().mechanics
    texts = [make_fake(dialect, made, monotonic=lambda: 0.0).feed(b"V") for dialect in SYNSCAN_FAKES.dialects]
    assert texts == [b"042705#", b"032400#"]
    with pytest.raises(BadRequest, match="synscan-9"):
        registry.make_fake("synscan", "synscan-9", made)
