"""The Sky-Watcher driver against the fake motor controller over real wires: pseudo-terminals, TCP and UDP."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest

from drivers.fakes.bench import FakeOnPty
from drivers.fakes.faults import Fault
from drivers.registry import MountUrl
from drivers.skywatcher.codec import Axis, Board
from drivers.skywatcher.fake import BOARDS
from drivers.skywatcher.family import FAMILY
from mountnav.clock import utc_now
from mountnav.devices import Direction, PierSide, SlewOutcome, SyncOutcome, TrackingRate
from mountnav.errors import BadSettings, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Site
from mountnav.testing.check_mount import check_mount
from tests.drivers.mounts import skywatcher_mount
from tests.drivers.skywatcher.quick_fakes import (
    NORTH,
    PATIENCE,
    SETTINGS,
    SOUTH,
    TIMING,
    apart_arcsec,
    at,
    commands,
    mounted,
    quick,
)

ORDERS = "EFGHIJKLMS"


def moved(place: Apparent, ra_deg: float, dec_deg: float) -> Apparent:
    return replace(place, ra_deg=(place.ra_deg + ra_deg) % 360.0, dec_deg=place.dec_deg + dec_deg)


# -- connecting -----------------------------------------------------------------------------------


async def test_connecting_asks_and_changes_nothing() -> None:
    fake = quick("heq5")
    async with mounted(fake, trusted=False) as mount:
        assert commands(fake, ORDERS) == []
        assert mount.report is not None
        assert mount.report.identity.startswith("Sky-Watcher HEQ5, firmware 2.04, 9024000 counts")
        assert not mount.trusted
        reading = await mount.reading()
        assert reading.at_home
        assert reading.tracking is False
        assert reading.place.dec_deg == pytest.approx(90.0, abs=0.01)
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(at(NORTH, -30.0, 20.0))
        assert refused.value.reason is Refusal.UNTRUSTED
    assert commands(fake, ORDERS) == []


async def test_motors_that_run_at_connecting_are_told_and_left_running() -> None:
    fake = quick()
    for order in (
        b":F1\r",
        b":F2\r",
        b":G110\r",
        b":I16C0200\r",
        b":J1\r",
        b":G231\r",
        b":I2640000\r",
        b":J2\r",
    ):
        assert fake.feed(order) == b"=\r"
    told = len(commands(fake, ORDERS))
    async with mounted(fake, trusted=False) as mount:
        assert mount.report is not None
        first, second, energized = mount.report.problems
        assert "motor 1 runs forward at 15.04″/s" in first
        assert "it tracks (sidereal)" in first
        assert "motor 2 runs backward at" in second
        assert "energized already" in energized
        assert not mount.trusted
        reading = await mount.reading()
        assert reading.tracking is True
        assert reading.slewing is True
    assert len(commands(fake, ORDERS)) == told


async def test_an_altazimuth_mount_is_refused() -> None:
    fake = quick()
    fake.board = replace(BOARDS["eq6"], board=Board(2, 4, 0x90))
    with FakeOnPty(fake) as bench:
        mount = skywatcher_mount(bench.address, NORTH, patience=PATIENCE, timing=TIMING)
        with pytest.raises(DeviceRefused, match="Dobsonian"):
            await mount.open()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"guide_rate": "2"}, "guide_rate"),
        ({"guide_rate": "fast"}, "guide_rate"),
        ({"epoch": "icrs"}, "epoch"),
        ({"set_clock": "yes"}, "set_clock"),
        ({"warp": "9"}, "warp"),
    ],
)
def test_options_that_make_no_sense(options: dict[str, str], says: str) -> None:
    with pytest.raises(BadSettings, match=says):
        FAMILY.open_mount(MountUrl("skywatcher", "/dev/null", options), None, NORTH)


def test_without_a_site_there_is_no_sky() -> None:
    with pytest.raises(BadSettings, match="latitude and longitude"):
        FAMILY.open_mount(MountUrl("skywatcher", "udp://192.168.4.1:11880", {}), None, None)


def test_a_url_makes_a_mount() -> None:
    options = {"tracking_past_deg": "5", "guide_rate": "0.9", "timeout_s": "2"}
    mount = FAMILY.open_mount(MountUrl("skywatcher", "udp://192.168.4.1:11880", options), None, SOUTH)
    assert mount.name == "udp://192.168.4.1:11880"


# -- what every mount must do ---------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("wire", "dialect", "site"),
    [("pty", "eq6", NORTH), ("tcp", "star-adventurer-gti", NORTH), ("udp", "az-eq6", SOUTH)],
)
async def test_it_keeps_the_promises_of_a_mount(wire: str, dialect: str, site: Site) -> None:
    fake = quick(dialect, site)
    async with mounted(fake, wire) as mount:
        await mount.slew(at(site, -30.0, 0.3 * site.latitude_deg))
        await check_mount(mount)
    assert fake.unknown == []


PLACES = [
    (NORTH, "tcp", 40.0, -10.0, PierSide.EAST),
    (NORTH, "udp", -120.0, 89.5, PierSide.WEST),
    (SOUTH, "tcp", -50.0, 10.0, PierSide.WEST),
    (SOUTH, "pty", 170.0, -89.0, PierSide.EAST),
]


@pytest.mark.long
@pytest.mark.parametrize(("site", "wire", "ha_deg", "dec_deg", "side"), PLACES)
async def test_a_goto_ends_on_its_target_and_stays(
    site: Site, wire: str, ha_deg: float, dec_deg: float, side: PierSide
) -> None:
    fake = quick("eq6", site)
    async with mounted(fake, wire) as mount:
        target = at(site, ha_deg, dec_deg)
        assert await mount.destination_side(target) is side
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert apart_arcsec(fake.mechanics.reported(), target) < 2.0
        assert isinstance(reading.place, Apparent)
        assert apart_arcsec(reading.place, target) < 2.0
        assert reading.pier_side is side is fake.mechanics.pier_side()
        assert reading.tracking is True
        assert reading.slewing is False
        now = utc_now()
        later = fake.mechanics.reported(now + timedelta(minutes=10))
        assert apart_arcsec(later, fake.mechanics.reported(now)) < 2.0


@pytest.mark.long
async def test_it_flips_over_the_pole_and_never_below() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -5.0, 5.0))
        now = utc_now()
        slew = asyncio.create_task(mount.slew(at(NORTH, 5.0, 5.0)))
        assert await slew is SlewOutcome.ARRIVED
        took_s = (utc_now() - now).total_seconds()
        axes = [fake.mechanics.axes(now + timedelta(seconds=took_s * part / 50)) for part in range(51)]
        # the counterweight hangs at 90, and the declination axis passes the pole at 90
        assert all(-1.0 < one.ha_axis_deg < 181.0 for one in axes)
        assert all(4.0 < one.dec_axis_deg < 176.0 for one in axes)
        assert axes[-1].dec_axis_deg < 90.0 < axes[0].dec_axis_deg


async def test_what_cannot_be_reached_is_refused_before_anything_moves() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(at(NORTH, 0.0, -60.0))
        assert refused.value.reason is Refusal.BELOW_HORIZON
    assert commands(fake, ORDERS) == []


# -- sync -----------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_sync_stays_with_us_and_makes_the_position_count() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -40.0, 30.0))
        orders = len(commands(fake, ORDERS))
        before = (await mount.reading()).place
        assert isinstance(before, Apparent)
        result = await mount.sync(moved(before, 0.3, -0.2))
        assert result.outcome is SyncOutcome.SEEN
        assert len(commands(fake, ORDERS)) == orders
        # the fake still believes what it believed: the next goto lands beside it by the sync
        target = at(NORTH, -20.0, 30.0)
        assert await mount.slew(target) is SlewOutcome.ARRIVED
        assert apart_arcsec(fake.mechanics.reported(), moved(target, -0.3, 0.2)) < 2.0


async def test_near_the_pole_a_sync_that_would_twist_the_axes_is_refused() -> None:
    async with mounted(quick()) as mount:
        with pytest.raises(DeviceRefused, match="hour angle axis") as refused:
            await mount.sync(at(NORTH, 100.0, 89.6))
        assert refused.value.reason is Refusal.LIMIT


# -- stop -----------------------------------------------------------------------------------------


@pytest.mark.long
async def test_a_stop_passes_a_silence_and_ends_a_slew() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -30.0, 50.0))
        slew = asyncio.create_task(mount.slew(at(NORTH, 60.0, 0.0)))
        while not commands(fake, "J")[4:]:
            await asyncio.sleep(0.01)
        fake.add_fault(Fault("silence", for_s=0.5))
        await mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not any(motor.running for motor in fake.motors.values())
        # it had tracked: so it does again, by itself
        while (await mount.reading()).tracking is not True:
            await asyncio.sleep(0.05)
        here = fake.mechanics.reported()
        assert apart_arcsec(fake.mechanics.reported(utc_now() + timedelta(seconds=60)), here) < 1.0


@pytest.mark.long
async def test_a_stop_never_begins_to_track_what_did_not() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -30.0, 50.0))
        await mount.set_tracking(False)
        started = len(commands(fake, "J"))
        await mount.stop()
        await asyncio.sleep(3.0 * SETTINGS.settle_s)
        assert len(commands(fake, "J")) == started
        assert (await mount.reading()).tracking is False


@pytest.mark.long
async def test_stops_that_go_on_coming_keep_it_at_rest() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -30.0, 50.0))
        started = len(commands(fake, "J"))
        for _ in range(6):
            await mount.language.send_stop(0)
            await asyncio.sleep(0.4 * SETTINGS.settle_s)
        assert len(commands(fake, "J")) == started


async def test_each_stop_goes_out_in_a_write_of_its_own() -> None:
    # a real board spoils its answers when two commands come in one
    async with mounted(quick()) as mount:
        await mount.stop()
        writes = [entry.data for entry in mount.wire_log.entries() if entry.way == "driver->mount"]
        assert b":K1\r" in writes
        assert b":K2\r" in writes


# -- tracking, guiding, park ----------------------------------------------------------------------


@pytest.mark.long
async def test_tracking_at_other_rates() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -30.0, 0.0))
        for rate, arcsec_s in ((TrackingRate.LUNAR, 14.511), (TrackingRate.SOLAR, 15.0)):
            await mount.set_tracking(True, rate)
            now = utc_now() + timedelta(seconds=1)
            later = fake.mechanics.axes(now + timedelta(seconds=600)).ha_axis_deg
            assert (later - fake.mechanics.axes(now).ha_axis_deg) * 6.0 == pytest.approx(arcsec_s, abs=0.01)
        with pytest.raises(DeviceRefused) as refused:
            await mount.set_tracking(True, TrackingRate.KING)
        assert refused.value.reason is Refusal.UNSUPPORTED
        await mount.set_tracking(False)
        assert not fake.motors[Axis.HOUR_ANGLE].running


@pytest.mark.parametrize(
    ("site", "ha_deg"),
    [
        (NORTH, -30.0),
        pytest.param(NORTH, 30.0, marks=pytest.mark.long),
        pytest.param(SOUTH, -30.0, marks=pytest.mark.long),
    ],
)
async def test_guide_pulses_go_where_they_say(site: Site, ha_deg: float) -> None:
    fake = quick("eq6", site)
    async with mounted(fake) as mount:
        with pytest.raises(DeviceRefused) as refused:
            await mount.guide(Direction.NORTH, 0.1)
        assert refused.value.reason is Refusal.NOT_TRACKING
        await mount.slew(at(site, ha_deg, 0.0))
        for direction, sign in (
            (Direction.NORTH, 1.0),
            (Direction.SOUTH, -1.0),
            (Direction.EAST, 1.0),
            (Direction.WEST, -1.0),
        ):
            before = fake.mechanics.reported()
            await mount.guide(direction, 0.4)
            after = fake.mechanics.reported()
            east = (after.ra_deg - before.ra_deg) * 3600.0
            north = (after.dec_deg - before.dec_deg) * 3600.0
            along, across = (
                (north, east) if direction in (Direction.NORTH, Direction.SOUTH) else (east, north)
            )
            # half the sidereal rate for 0.4 s; this machine may hold it up
            assert 2.0 < sign * along < 30.0
            assert abs(across) < 0.5
            assert (await mount.reading()).tracking is True


@pytest.mark.long
async def test_a_guide_pulse_that_is_cancelled_ends_all_the_same() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -30.0, 0.0))
        for direction in (Direction.WEST, Direction.NORTH):
            said = len(fake.heard)
            pulse = asyncio.create_task(mount.guide(direction, 30.0))
            ordered = ":J2" if direction is Direction.NORTH else ":I1"
            while not any(command.decode().startswith(ordered) for command in fake.heard[said:]):
                await asyncio.sleep(0.01)
            pulse.cancel()
            with pytest.raises(asyncio.CancelledError):
                await pulse
        motors = fake.motors
        assert motors[Axis.HOUR_ANGLE].period == motors[Axis.HOUR_ANGLE].sidereal_period
        while motors[Axis.DECLINATION].running:
            await asyncio.sleep(0.01)


@pytest.mark.long
async def test_park_home_and_back() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.slew(at(NORTH, -30.0, 20.0))
        await mount.set_park()
        await mount.slew(at(NORTH, 30.0, 60.0))
        assert await mount.park() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert reading.parked is True
        assert reading.tracking is False
        assert reading.pier_side is PierSide.WEST
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(at(NORTH, -10.0, 20.0))
        assert refused.value.reason is Refusal.PARKED
        await mount.unpark()
        assert await mount.home() is SlewOutcome.ARRIVED
        reading = await mount.reading()
        assert reading.at_home is True
        assert reading.parked is False
        assert fake.mechanics.axes().dec_axis_deg == pytest.approx(90.0, abs=0.001)


async def test_a_parked_mount_that_somebody_else_moves_is_not_parked() -> None:
    fake = quick()
    async with mounted(fake) as mount:
        await mount.park()
        assert (await mount.reading()).parked is True
        fake.feed(b":G110\r")
        fake.feed(b":I1100000\r")
        fake.feed(b":J1\r")
        while (await mount.reading()).parked:
            await asyncio.sleep(0.02)


@pytest.mark.long
async def test_tracking_ends_where_the_counterweight_has_risen_too_far() -> None:
    fake = quick()
    settings = replace(SETTINGS, past_meridian_deg=0.5, tracking_past_deg=2.0 * SIDEREAL_DEG_S)
    async with mounted(fake, settings=settings) as mount:
        await mount.slew(at(NORTH, -2.0 * SIDEREAL_DEG_S, 20.0))
        while (await mount.reading()).tracking:
            await asyncio.sleep(0.1)
        assert "risen to its limit" in "".join(entry.meaning for entry in mount.wire_log.entries())


# -- when things go wrong -------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("wire", "fault"),
    [
        ("pty", Fault("lose", on=b":j", skip=3, times=2)),
        ("udp", Fault("late", on=b":j1", skip=3, times=2, delay_s=0.45)),
        ("pty", Fault("late", on=b":f", skip=5, times=1, delay_s=0.35)),
        ("udp", Fault("cut", on=b":j", skip=3, times=2)),
        ("pty", Fault("garble", on=b":j2", skip=3, times=2, byte=5, bit=1)),
        ("udp", Fault("double", on=b":j1", skip=3, times=3)),
        ("pty", Fault("lose", on=b":J", times=1)),
        ("udp", Fault("lose", on=b":H", times=1)),
        ("pty", Fault("garble", on=b":G", times=1)),
        ("udp", Fault("noise-before", on=b":f", skip=4, times=2, data=b"\xff\x00")),
    ],
    ids=lambda one: f"{one.kind}-{one.on.decode()[1:]}" if isinstance(one, Fault) else one,
)
async def test_a_bad_line_costs_time_and_nothing_else(wire: str, fault: Fault) -> None:
    fake = quick(faults=[replace(fault)])
    async with mounted(fake, wire) as mount:
        target = at(NORTH, -40.0, 60.0)
        seen: list[Apparent] = []
        slew = asyncio.create_task(mount.slew(target))
        while not slew.done():
            place = (await mount.reading()).place
            assert isinstance(place, Apparent)
            # between the pole and its target, with what it runs past by
            assert 59.0 < place.dec_deg <= 90.0
            seen.append(place)
            await asyncio.sleep(0.05)
        assert await slew is SlewOutcome.ARRIVED
        assert apart_arcsec(fake.mechanics.reported(), target) < 2.0
        assert fake.strikes


async def test_power_that_blinks_in_a_slew_is_noticed() -> None:
    fake = quick()
    told: list[tuple[str, Any]] = []
    async with mounted(fake) as mount:
        mount.listen(lambda what, facts: told.append((what, facts)))
        await mount.slew(at(NORTH, -40.0, 60.0))
        assert mount.trusted
        fake.add_fault(Fault("reboot", on=b":J1", after_s=0.3, for_s=0.2))
        outcome = await asyncio.gather(mount.slew(at(NORTH, 60.0, 0.0)), return_exceptions=True)
        assert outcome[0] is not SlewOutcome.ARRIVED
        await mount.reading()
        assert not mount.trusted
        assert "untrusted" in [what for what, _ in told]
        assert fake.motors[Axis.DECLINATION].initialized is False
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(at(NORTH, 60.0, 0.0))
        assert refused.value.reason is Refusal.UNTRUSTED


@pytest.mark.long
async def test_a_board_that_says_no_more_leaves_no_slew_running() -> None:
    fake = quick(faults=[Fault("silence", on=b":J1", for_s=1e9)])
    async with mounted(fake) as mount:
        with pytest.raises(DeviceSilent):
            await mount.slew(at(NORTH, -40.0, 60.0))
        while any(motor.running for motor in fake.motors.values()):
            await asyncio.sleep(0.02)
