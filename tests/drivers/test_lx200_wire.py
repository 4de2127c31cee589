"""The driver against the fake over real wires: pseudo-terminals and TCP."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest

from drivers.bench import FakeOnPty, FakeOnTcp
from drivers.exchange import Patience
from drivers.lx200.fake import FakeLx200
from drivers.lx200.faults import Fault
from drivers.lx200.habits import Lx200Habits
from drivers.lx200.mount import Lx200Mount
from mountnav.errors import BadRequest, Busy, DeviceMissing, DeviceRefused, DeviceSilent
from mountnav.navigation.devices import SlewOutcome
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.coordinates import Air, Apparent, Icrs, Site, utc_now
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount

QUICK = Lx200Habits(
    patience=Patience(deadline_s=2.0, try_s=0.4, quiet_s=0.05), poll_s=0.05, start_grace_s=0.5
)


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
    fake: FakeLx200, habits: Lx200Habits = QUICK, *, tcp: bool = False
) -> AsyncIterator[Lx200Mount]:
    with FakeOnTcp(fake) if tcp else FakeOnPty(fake) as bench:
        mount = Lx200Mount(bench.address, habits=habits)
        await mount.open()
        try:
            yield mount
        finally:
            await mount.close()


def beside(place: Apparent | Icrs, ra_deg: float, dec_deg: float) -> Apparent:
    return Apparent((place.ra_deg + ra_deg) % 360.0, place.dec_deg + dec_deg, utc_now())


async def read_often(mount: Lx200Mount, times: int) -> None:
    for _ in range(times):
        await mount.reading()


@pytest.mark.parametrize("tcp", [False, True])
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
    assert fake.heard == [b"\x06", b":GR#", b":D#"]


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
    habits = replace(QUICK, patience=Patience(deadline_s=0.3, try_s=0.3, quiet_s=0.05))
    async with opened(fake, habits) as mount:
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


@pytest.mark.parametrize("byte", range(9))
@pytest.mark.parametrize("bit", [0, 2, 4, 6])
async def test_a_flipped_bit_is_never_published(byte: int, bit: int) -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        before = (await mount.reading()).place
        fake.faults.append(Fault("garble", on=b":GR", byte=byte, bit=bit))
        after = (await mount.reading()).place
        assert isinstance(after, Apparent)
        # a digit of the seconds or of the lowest minute can't be told from a little motion
        assert abs(after.ra_deg - before.ra_deg) * 3600.0 < 200.0


async def test_lost_answer_to_a_slew_is_not_sent_again() -> None:
    fake = fake_at_zenith()
    async with opened(fake) as mount:
        fake.faults.append(Fault("lose", on=b":MS"))
        target = beside((await mount.reading()).place, 5.0, -5.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert fake.heard.count(b":MS#") == 1


async def test_lost_answer_to_a_sync_is_told() -> None:
    fake = fake_at_zenith()
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
        await Lx200Mount(bench.address, habits=QUICK).open()


async def test_a_missing_port_lists_those_that_exist(tmp_path: Path) -> None:
    mount = Lx200Mount(str(tmp_path / "ttyNone"))
    with pytest.raises(DeviceMissing, match="ports"):
        await mount.open()
    with pytest.raises(DeviceMissing):
        await mount.reading()


async def test_an_unreachable_host_is_missing() -> None:
    with FakeOnTcp(fake_at_zenith()) as bench:
        address = bench.address
    with pytest.raises(DeviceMissing, match="host"):
        await Lx200Mount(address).open()


async def test_a_port_that_vanishes_and_comes_back(tmp_path: Path) -> None:
    fake = fake_at_zenith()
    link = tmp_path / "mount"
    with FakeOnPty(fake, link) as bench:
        mount = Lx200Mount(bench.address, habits=QUICK)
        await mount.open()
        await mount.reading()
    with pytest.raises(DeviceMissing):
        await mount.reading()
    with FakeOnPty(fake, link):
        assert (await mount.reading()).slewing is False
        await mount.close()


async def test_a_cut_connection_is_opened_again() -> None:
    with FakeOnTcp(fake_at_zenith()) as bench:
        mount = Lx200Mount(bench.address, habits=QUICK)
        await mount.open()
        bench.hang_up()
        with pytest.raises(DeviceMissing):
            await read_often(mount, 100)
        assert (await mount.reading()).slewing is False
        await mount.close()


async def test_a_second_program_is_kept_off_the_port() -> None:
    fake = fake_at_zenith()
    with FakeOnPty(fake) as bench:
        first, second = Lx200Mount(bench.address, habits=QUICK), Lx200Mount(bench.address, habits=QUICK)
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
    async with opened(fake, replace(QUICK, epoch="icrs")) as mount:
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


async def test_a_timed_pulse_moves_and_ends() -> None:
    fake = fake_at_zenith()
    before = fake.mechanics.reported()
    assert fake.feed(b":Mgs0200#") == b""
    while (due_in_s := fake.due_in_s()) is not None:
        await asyncio.sleep(due_in_s)
        fake.feed(b"")
    moved_arcsec = separation_arcsec(before, replace(fake.mechanics.reported(), utc=before.utc))
    assert moved_arcsec > 0.5
    assert fake.mechanics.reported().dec_deg < before.dec_deg


def test_unknown_commands_are_answered_by_silence() -> None:
    fake = fake_at_zenith()
    assert fake.feed(b"#:XYZ##") == b""
    assert fake.feed(b":G") == b""
    assert fake.feed(b"c#") == b"24#"
    assert fake.unknown == [b":XYZ#"]
