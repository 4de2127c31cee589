"""The driver against the fake over real wires: pseudo-terminals and TCP."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.lx200.fake.base import FakeLx200
from drivers.wire.exchange import Patience
from mountnav.clock import utc_now
from mountnav.devices import Epoch, SlewOutcome, SyncOutcome
from mountnav.errors import BadRequest, Busy, DeviceMissing, DeviceRefused, DeviceSilent
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.mounts import lx200_mount

PATIENCE = Patience(deadline_s=2.0, try_s=0.4, quiet_s=0.05)
# no heartbeat: these tests count what was said
QUICK = Timing(poll_s=0.05, start_grace_s=0.5, rest_s=0.2, sync_wait_s=0.6, late_s=0.5, heartbeat_s=0.0)


def fake_at_zenith(
    *, slew_rate_deg_s: float = 20.0, short: bool = False, faults: list[Fault] | None = None
) -> FakeLx200:
    mechanics = Mechanics(
        Site(49.6, 36.9),
        Air(),
        PointingErrors(),
        slew_rate_deg_s=slew_rate_deg_s,
        acceleration_deg_s2=40.0,
    )
    return FakeLx200(mechanics, short=short, faults=faults or [])


@asynccontextmanager
async def opened(
    fake: FakeLx200,
    timing: Timing = QUICK,
    *,
    tcp: bool = False,
    patience: Patience = PATIENCE,
    epoch: Epoch | None = None,
) -> AsyncIterator[GenericMount]:
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        mount = lx200_mount(bench.address, timing=timing, patience=patience, epoch=epoch)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def beside(place: Apparent | Icrs, ra_deg: float, dec_deg: float) -> Apparent:
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


async def read_often(mount: GenericMount, times: int) -> None:
    for _ in range(times):
        await mount.reading()


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.long)])
async def test_conforms(tcp: bool) -> None:
    async with opened(fake_at_zenith(), tcp=tcp) as mount:
        await check_mount(mount)


async def test_reading_is_where_the_fake_believes_to_point() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        reading = await mount.reading()
        assert isinstance(reading.place, Apparent)
        believed = fake.mechanics.reported(reading.utc)
        assert separation_arcsec(reading.place, believed) < 10.0
        assert reading.slewing is False
        assert mount.resolution_arcsec == 15.0


async def test_opening_moves_syncs_and_sets_nothing() -> None:
    fake = fake_at_zenith()
    async with opened(fake):
        pass
    assert {command[:2] for command in fake.heard} == {b"\x06", b":G", b":D"}


async def test_short_format_is_toggled_once() -> None:
    fake = fake_at_zenith(short=True)
    async with opened(fake) as mount:
        assert fake.heard.count(b":U#") == 1
        assert mount.resolution_arcsec == 15.0


async def test_slew_arrives_where_asked() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        target = beside((await mount.reading()).place, 12.345, -7.654)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert separation_arcsec(fake.mechanics.reported(), replace(target, utc=utc_now())) < 10.0


async def test_sync_moves_the_belief_not_the_tube() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        target = beside((await mount.reading()).place, 0.5, -0.25)
        await mount.sync(target)
        after = (await mount.reading()).place
        assert isinstance(after, Apparent)
        assert separation_arcsec(after, target) < 15.0


async def test_stop_ends_a_slew() -> None:
    fake = fake_at_zenith(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        target = beside((await mount.reading()).place, 40.0, -20.0)
        slew = asyncio.create_task(mount.slew(target))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        with pytest.raises(Busy):
            await mount.slew(target)
        await mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not fake.mechanics.slewing()


async def test_stop_is_not_queued_behind_a_reply_that_does_not_come() -> None:
    fake = fake_at_zenith(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        target = beside((await mount.reading()).place, 40.0, -20.0)
        slew = asyncio.create_task(mount.slew(target))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        fake.faults.append(Fault("lose", on=b":G", times=2))
        asked = len(fake.heard)
        while fake.heard[asked:].count(b":GR#") + fake.heard[asked:].count(b":GD#") < 1:
            await asyncio.sleep(0.01)
        before = len(fake.heard)
        stop = asyncio.create_task(mount.stop())
        while len(fake.heard) == before:
            await asyncio.sleep(0.005)
        assert fake.heard[before] == b":Q#"
        await stop
        assert await slew is SlewOutcome.STOPPED


async def test_below_the_horizon_is_refused_in_the_mounts_words() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused, match="Object below horizon"):
            await mount.slew(Apparent((await mount.reading()).place.ra_deg, -80.0, utc_now()))
        # the refusal was read to its end: the next question gets its own answer
        assert (await mount.reading()).slewing is False
        assert not fake.mechanics.slewing()


@pytest.mark.long
@pytest.mark.parametrize("kind", ["lose", "cut", "garble", "late"])
@pytest.mark.parametrize("on", [b":GR", b":GD"])
async def test_one_bad_answer_never_shows(kind: str, on: bytes) -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        before = await mount.reading()
        # later than one try, within the deadline: it comes when another question is out
        fake.faults.append(Fault(kind, on=on, delay_s=0.7))  # type: ignore[arg-type]
        for _ in range(6):
            now = await mount.reading()
            assert isinstance(now.place, Apparent)
            assert isinstance(before.place, Apparent)
            assert separation_arcsec(now.place, before.place) < 30.0


async def test_an_answer_later_than_the_deadline_is_nobodys() -> None:
    fake = fake_at_zenith()
    short = Patience(deadline_s=0.3, try_s=0.3, quiet_s=0.05)
    async with opened(fake, patience=short) as mount:
        before = (await mount.reading()).place
        fake.faults.append(Fault("late", on=b":GR", delay_s=0.7))
        with pytest.raises(DeviceSilent):
            await mount.reading()
        for _ in range(20):
            try:
                place = (await mount.reading()).place
            except DeviceSilent:
                continue
            assert abs(place.dec_deg - before.dec_deg) < 0.01
            assert abs(place.ra_deg - before.ra_deg) < 0.01
            break
        else:
            pytest.fail("never answered again")


async def test_a_flipped_bit_is_never_published() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        before = (await mount.reading()).place
        for byte in range(9):
            for bit in (0, 6):
                fake.faults[:] = [Fault("garble", on=b":GR", byte=byte, bit=bit)]
                after = (await mount.reading()).place
                assert isinstance(after, Apparent)
                # a digit of the seconds or of the lowest minute can't be told from a little motion
                assert abs(after.ra_deg - before.ra_deg) * 3600.0 < 200.0, (byte, bit)


async def test_lost_answer_to_a_slew_is_not_sent_again() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        fake.faults.append(Fault("lose", on=b":MS"))
        target = beside((await mount.reading()).place, 5.0, -5.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert fake.heard.count(b":MS#") == 1


async def test_lost_answer_to_a_sync_that_took_is_seen_in_the_readings() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        fake.faults.append(Fault("lose", on=b":CM"))
        result = await mount.sync(beside((await mount.reading()).place, 0.1, -0.1))
        assert result.outcome is SyncOutcome.SEEN
        assert fake.heard.count(b":CM#") == 1


async def test_lost_answer_to_a_sync_that_was_ignored_is_told() -> None:
    fake = fake_at_zenith()
    fake.mechanics.sync_behavior = "ignore"
    async with opened(fake) as mount:
        fake.faults.append(Fault("lose", on=b":CM"))
        with pytest.raises(DeviceSilent):
            await mount.sync(beside((await mount.reading()).place, 0.1, -0.1))
        assert fake.heard.count(b":CM#") == 1


async def test_a_slew_that_was_ignored_stalls() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        fake.faults.append(Fault("deaf", on=b":MS"))
        target = beside((await mount.reading()).place, 5.0, -5.0)
        assert await mount.slew(target) is SlewOutcome.STALLED


async def test_a_cancelled_slew_is_stopped() -> None:
    fake = fake_at_zenith(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        slew = asyncio.create_task(mount.slew(beside((await mount.reading()).place, 40.0, -20.0)))
        while not fake.mechanics.slewing():
            await asyncio.sleep(0.01)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        while fake.mechanics.slewing():
            await asyncio.sleep(0.01)


async def test_a_slew_that_takes_too_long_is_stopped() -> None:
    fake = fake_at_zenith(slew_rate_deg_s=0.5)
    async with opened(fake, replace(QUICK, slew_timeout_s=0.5)) as mount:
        target = beside((await mount.reading()).place, 40.0, -20.0)
        assert await mount.slew(target) is SlewOutcome.STALLED
        assert not fake.mechanics.slewing()


async def test_a_dead_line_is_silent_with_advice() -> None:
    fake = fake_at_zenith(faults=[Fault("lose", times=10**9)])
    with FakeOnPty(fake) as bench, pytest.raises(DeviceSilent, match="baud"):
        await lx200_mount(bench.address, timing=QUICK, patience=replace(PATIENCE, greeting_s=2.0)).open()


async def test_a_missing_port_lists_those_that_exist(tmp_path: Path) -> None:
    mount = lx200_mount(str(tmp_path / "ttyNone"))
    with pytest.raises(DeviceMissing, match="ports"):
        await mount.open()
    with pytest.raises(DeviceMissing):
        await mount.reading()


async def test_an_unreachable_host_is_missing() -> None:
    with FakeOnTcp(fake_at_zenith()) as bench:
        address = bench.address
    with pytest.raises(DeviceMissing, match="host"):
        await lx200_mount(address).open()


async def test_a_port_that_vanishes_and_comes_back(tmp_path: Path) -> None:
    fake = fake_at_zenith()
    link = tmp_path / "mount"
    with FakeOnPty(fake, link) as bench:
        mount = lx200_mount(bench.address, timing=QUICK, patience=PATIENCE)
        await mount.open()
        await mount.reading()
    with pytest.raises(DeviceMissing):
        await mount.reading()
    with FakeOnPty(fake, link):
        assert (await mount.reading()).slewing is False
        await mount.close()


async def test_a_cut_connection_is_opened_again() -> None:
    with FakeOnTcp(fake_at_zenith()) as bench:
        mount = lx200_mount(bench.address, timing=QUICK, patience=PATIENCE)
        await mount.open()
        bench.hang_up()
        with pytest.raises(DeviceMissing):
            await read_often(mount, 100)
        assert (await mount.reading()).slewing is False
        await mount.close()


async def test_a_second_program_is_kept_off_the_port() -> None:
    fake = fake_at_zenith()
    with FakeOnPty(fake) as bench:
        first, second = (
            lx200_mount(bench.address, timing=QUICK, patience=PATIENCE),
            lx200_mount(bench.address, timing=QUICK, patience=PATIENCE),
        )
        await first.open()
        with pytest.raises(DeviceMissing, match="lock"):
            await second.open()
        await first.close()


async def test_other_kind_of_place_is_refused() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        heard = len(fake.heard)
        with pytest.raises(BadRequest, match="convert"):
            await mount.slew(Icrs(10.0, 20.0))
        assert len(fake.heard) == heard
    async with opened(fake, epoch="icrs") as mount:
        assert isinstance((await mount.reading()).place, Icrs)
        with pytest.raises(BadRequest):
            await mount.sync(Apparent(10.0, 20.0, datetime(2026, 1, 1, tzinfo=UTC)))


async def test_a_reading_given_up_leaves_nothing_behind() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        before = (await mount.reading()).place
        fake.faults.append(Fault("late", on=b":GR", delay_s=0.2))
        heard = len(fake.heard)
        reading = asyncio.create_task(mount.reading())
        while len(fake.heard) == heard:
            await asyncio.sleep(0.005)
        reading.cancel()
        with pytest.raises(asyncio.CancelledError):
            await reading
        for _ in range(5):
            now = (await mount.reading()).place
            assert isinstance(now, Apparent)
            assert isinstance(before, Apparent)
            assert separation_arcsec(now, before) < 30.0


def test_a_timed_pulse_moves_and_ends() -> None:
    clock = FastClock(speed=0.0)
    mechanics = Mechanics(Site(49.6, 36.9), Air(), PointingErrors(), clock=clock)
    fake = FakeLx200(mechanics, clock=clock, monotonic=clock.monotonic)
    before = mechanics.reported()
    assert fake.feed(b":Mgs0400#") == b""
    clock.on(0.2)
    assert 1.0 < (before.dec_deg - mechanics.reported().dec_deg) * 3600.0 < 2.0
    clock.on(10.0)
    assert (before.dec_deg - mechanics.reported().dec_deg) * 3600.0 == pytest.approx(3.008, abs=0.01)


def test_unknown_commands_are_answered_by_silence() -> None:
    fake = fake_at_zenith()
    assert fake.feed(b"#:XYZ##") == b""
    assert fake.feed(b":G") == b""
    assert fake.feed(b"c#") == b"24#"
    assert fake.unknown == [b":XYZ#"]
