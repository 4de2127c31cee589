"""The iOptron driver against the fake over real wires: pseudo-terminals and TCP, both command sets."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivers.fakes.bench import FakeOnPty, FakeOnTcp
from drivers.fakes.faults import Fault, Kind
from drivers.generic.mount import GenericMount
from drivers.ioptron.fake import FakeIoptron
from drivers.registry import open_mount
from mountnav.clock import utc_now
from mountnav.devices import SlewOutcome, SyncOutcome
from mountnav.errors import (
    BadRequest,
    BadSettings,
    Busy,
    DeviceError,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    Refusal,
)
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.testing.check_mount import check_mount
from tests.drivers.ioptron.german_fakes import (
    HERE,
    PATIENCE,
    QUICK,
    at_hour_angle,
    beside,
    fake_of,
    mechanics_of,
    opened,
)
from tests.drivers.mounts import ioptron_mount

BOTH = pytest.mark.parametrize("dialect", ["v3", "v2"])


async def begun(fake: FakeIoptron, mount: GenericMount) -> asyncio.Task[SlewOutcome]:
    """A long slew, seen moving."""
    target = beside((await mount.reading()).place, -40.0, -20.0)
    slew = asyncio.create_task(mount.slew(target))
    while not fake.mechanics.slewing():
        await asyncio.sleep(0.01)
    return slew


@pytest.mark.parametrize(
    ("dialect", "tcp"),
    [
        ("v3", False),
        pytest.param("v2", True, marks=pytest.mark.long),
        pytest.param("v3", True, marks=pytest.mark.long),
        pytest.param("v2", False, marks=pytest.mark.long),
    ],
)
async def test_conforms(dialect: str, tcp: bool) -> None:
    async with opened(fake_of(dialect=dialect, slew_rate_deg_s=300.0), tcp=tcp) as mount:
        await check_mount(mount)


@BOTH
async def test_opening_moves_syncs_and_sets_nothing(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    async with opened(fake, timing=replace(QUICK, heartbeat_s=0.0)) as mount:
        assert mount.report is not None
        assert f"command set {dialect}" in mount.report.identity
        assert mount.report.problems == ()
        assert mount.report.clock_off_s == pytest.approx(0.0, abs=0.6)
        assert mount.report.site_off_arcsec == pytest.approx(0.0, abs=1.0)
    point, clock = (b":GEP#", b":GUT#") if dialect == "v3" else (b":GEC#", b":GLT#")
    assert fake.heard[0] == b":MountInfo#"
    rates = {b":GTR#"} if dialect == "v3" else set()
    assert set(fake.heard) == {b":MountInfo#", b":GLS#", b":FW1#", b":GMT#", point, clock} | rates


@BOTH
async def test_the_command_set_may_be_named(dialect: str) -> None:
    async with opened(fake_of(dialect=dialect), dialect=dialect) as mount:
        assert (await mount.reading()).slewing is False


async def test_the_wrong_command_set_is_told() -> None:
    with FakeOnPty(fake_of(dialect="v2")) as bench, pytest.raises(DeviceError, match="dialect=v3 is set"):
        await ioptron_mount(bench.address, timing=QUICK, patience=PATIENCE, dialect="v3").open()


@BOTH
async def test_reading_is_where_the_fake_believes_to_point(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    async with opened(fake) as mount:
        reading = await mount.reading()
        assert isinstance(reading.place, Apparent)
        assert separation_arcsec(reading.place, fake.mechanics.reported(reading.utc)) < 0.1
        assert (reading.slewing, reading.tracking, reading.parked, reading.at_home) == (
            False,
            True,
            False,
            False,
        )


@BOTH
async def test_slew_arrives_where_asked(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    async with opened(fake) as mount:
        target = beside((await mount.reading()).place, 12.345, -7.654)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert separation_arcsec(fake.mechanics.reported(), replace(target, utc=utc_now())) < 0.5


@BOTH
async def test_stop_ends_a_slew(dialect: str) -> None:
    fake = fake_of(dialect=dialect, slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        slew = await begun(fake, mount)
        with pytest.raises(Busy):
            await mount.slew(beside(fake.mechanics.reported(), 1.0, 0.0))
        await mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not fake.mechanics.slewing()
        assert fake.mechanics.tracking


async def test_stop_is_not_queued_behind_a_reply_that_does_not_come() -> None:
    fake = fake_of(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        slew = await begun(fake, mount)
        fake.faults.append(Fault("lose", on=b":G", times=2))
        asked = len(fake.heard)
        while len(fake.heard) == asked:
            await asyncio.sleep(0.01)
        before = len(fake.heard)
        stop = asyncio.create_task(mount.stop())
        while len(fake.heard) == before:
            await asyncio.sleep(0.005)
        assert fake.heard[before] == b":Q#"
        await stop
        assert await slew is SlewOutcome.STOPPED


@BOTH
async def test_stop_ends_what_the_arrow_keys_began(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    async with opened(fake) as mount:
        fake.feed(b":mn#:mw#")
        await mount.stop()
        assert not fake.mechanics.slewing()
        # `:Q#` of the older set leaves arrow keys alone
        assert dialect == "v3" or {b":Q#", b":qR#", b":qD#"} <= set(fake.heard)


async def test_the_answers_of_many_stops_are_taken_for_no_consent() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        place = (await mount.reading()).place
        for _ in range(2):
            await asyncio.gather(mount.stop(), mount.reading(), mount.stop())
            with pytest.raises(DeviceRefused, match="slew"):
                await mount.slew(Apparent(place.ra_deg, -80.0, utc_now()))
        assert not fake.mechanics.slewing()


@BOTH
async def test_below_the_horizon_is_refused_with_its_height(dialect: str) -> None:
    fake = fake_of(dialect=dialect)
    async with opened(fake) as mount:
        with pytest.raises(DeviceRefused, match=r"-\d+\.\d° high, its limit is 0°") as refusal:
            await mount.slew(Apparent((await mount.reading()).place.ra_deg, -80.0, utc_now()))
        assert refusal.value.reason is Refusal.BELOW_HORIZON
        assert not fake.mechanics.slewing()


async def test_beyond_a_mechanical_limit_is_refused_for_that() -> None:
    machine = replace(mechanics_of().machine, ha_limits_deg=(0.0, 60.0))
    async with opened(fake_of(mechanics_of(machine))) as mount:
        with pytest.raises(DeviceRefused, match="mechanical") as refusal:
            await mount.slew(at_hour_angle(80.0, 45.0))
        assert refusal.value.reason is Refusal.LIMIT


async def test_a_parked_mount_refuses_for_that() -> None:
    fake = fake_of(slew_rate_deg_s=300.0)
    async with opened(fake) as mount:
        assert await mount.park() is SlewOutcome.ARRIVED
        moves = [command for command in fake.heard if command[:3] == b":MS"]
        for order in (
            mount.slew(at_hour_angle(30.0, 40.0)),
            mount.language.send_slew(at_hour_angle(30.0, 40.0), lambda: True),
            mount.sync(at_hour_angle(30.0, 40.0)),
            mount.set_tracking(True),
        ):
            with pytest.raises(DeviceRefused) as refusal:
                await order
            assert refusal.value.reason is Refusal.PARKED
        assert moves == [command for command in fake.heard if command[:3] == b":MS"]


@pytest.mark.parametrize("on", [b":GEP", b":GLS"])
async def test_one_bad_answer_never_shows(on: bytes) -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        before = (await mount.reading()).place
        kinds: tuple[Kind, ...] = ("lose", "cut", "garble", "double", "noise-before", "late")
        for kind in kinds:
            # later than one try, within the deadline: it comes when another question is out
            fake.faults.append(Fault(kind, on=on, delay_s=0.5, data=b"+0"))
            for _ in range(3):
                now = (await mount.reading()).place
                assert isinstance(now, Apparent)
                assert isinstance(before, Apparent)
                assert separation_arcsec(now, before) < 1.0


@pytest.mark.parametrize("byte", [0, 4])
async def test_a_flipped_bit_moves_a_published_place_little(byte: int) -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        before = (await mount.reading()).place
        assert isinstance(before, Apparent)
        for bit in (0, 6):
            fake.faults.append(Fault("garble", on=b":GEP", byte=byte, bit=bit))
            after = (await mount.reading()).place
            assert isinstance(after, Apparent)
            # a low digit that became another can't be told from a little motion
            assert separation_arcsec(after, before) <= QUICK.resting_arcsec + 40.0


async def test_lost_answers_to_orders_are_not_sent_again() -> None:
    fake = fake_of(slew_rate_deg_s=300.0)
    async with opened(fake) as mount:
        fake.faults += [Fault("lose", on=b":MS"), Fault("lose", on=b":CM"), Fault("lose", on=b":MP1")]
        target = beside((await mount.reading()).place, 5.0, -5.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        # its answer was lost, the readings show that it was taken up
        assert (await mount.sync(beside(target, 0.1, -0.1))).outcome is not SyncOutcome.IGNORED
        assert await mount.park() is SlewOutcome.ARRIVED
        for order in (b":MS1#", b":CM#", b":MP1#"):
            assert fake.heard.count(order) == 1


async def test_a_slew_that_was_ignored_stalls() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        fake.faults.append(Fault("deaf", on=b":MS"))
        assert await mount.slew(beside((await mount.reading()).place, 5.0, -5.0)) is SlewOutcome.STALLED


async def test_a_cancelled_slew_is_stopped() -> None:
    fake = fake_of(slew_rate_deg_s=1.0)
    async with opened(fake) as mount:
        slew = await begun(fake, mount)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        while fake.mechanics.slewing():
            await asyncio.sleep(0.01)


async def test_a_cut_connection_is_opened_again() -> None:
    with FakeOnTcp(fake_of()) as bench:
        mount = ioptron_mount(bench.address, timing=QUICK, patience=PATIENCE)
        told: list[str] = []
        mount.listen(lambda what, _facts: told.append(what))
        await mount.open()
        bench.hang_up()
        while "link-back" not in told:
            await asyncio.sleep(0.01)
        assert (await mount.reading()).slewing is False
        assert not mount.trusted
        await mount.close()


async def test_a_dead_line_is_silent_with_advice() -> None:
    fake = fake_of(faults=[Fault("lose", times=10**9)])
    with FakeOnPty(fake) as bench, pytest.raises(DeviceSilent, match="baud"):
        await ioptron_mount(bench.address, timing=QUICK, patience=replace(PATIENCE, greeting_s=2.0)).open()


async def test_nothing_at_all_at_the_other_end() -> None:
    with pytest.raises(DeviceMissing):
        await ioptron_mount("/dev/no-such-port", timing=QUICK, patience=PATIENCE).open()


async def test_other_kind_of_place_is_refused() -> None:
    fake = fake_of()
    async with opened(fake) as mount:
        with pytest.raises(BadRequest, match="convert"):
            await mount.slew(Icrs(10.0, 20.0))
        assert not any(command.startswith(b":S") for command in fake.heard)
    async with opened(fake, epoch="icrs") as mount:
        assert isinstance((await mount.reading()).place, Icrs)
        assert mount.report is not None
        assert any("icrs" in problem for problem in mount.report.problems)


async def test_a_url_makes_a_mount() -> None:
    with FakeOnTcp(fake_of(dialect="v2")) as bench:
        url = bench.address.replace("socket://", "ioptron+tcp://")
        mount = open_mount(f"{url}?timeout_s=2&epoch=icrs&dialect=v2", name="the pier", site=HERE)
        assert (mount.name, mount.epoch) == ("the pier", "icrs")
        await mount.open()
        assert (await mount.reading()).slewing is False
        await mount.close()


@pytest.mark.parametrize("option", ["speed=1", "epoch=J2000", "timeout_s=-1", "baud=x", "dialect=v4"])
def test_options_that_make_no_sense(option: str) -> None:
    with pytest.raises(BadSettings):
        open_mount(f"ioptron+serial:///dev/ttyUSB0?{option}")


def test_unknown_commands_are_answered_by_silence() -> None:
    fake = fake_of()
    assert fake.feed(b"#:XYZ##:GEC#") == b""
    assert fake.feed(b":Mount") == b""
    assert fake.feed(b"Info#") == b"0043"
    assert fake.feed(b":" * 100 + b"GPE#") == b"0"
    assert fake.unknown == [b":XYZ#", b":GEC#"]
    assert fake_of(model="0028").feed(b":MSH#") == b""
