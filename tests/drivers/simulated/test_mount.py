"""The mount without a wire does what a driver promises, and fails as a driver fails."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from typing import Any

import pytest

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from mountnav.devices import PierSide, Skill, SlewOutcome, SlewState, SyncOutcome
from mountnav.errors import Busy, DeviceMissing, DeviceRefused, DeviceSilent, Refusal
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.virtual_time import VirtualClock, for_all_modules, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.testing.check_mount import check_mount

HERE, AIR = Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7)
GERMAN = Machine(mounting="german", lowest_altitude_deg=5.0, meridian_limits_deg=(10.0, 10.0))
Life = Callable[[SimulatedMount, VirtualClock], Coroutine[Any, Any, None]]


def up(clock: VirtualClock, ha_deg: float, dec_deg: float) -> Apparent:
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, clock()), HERE, AIR), clock())


def lived(
    life: Life,
    behavior: MountBehavior | None = None,
    machine: Machine | None = None,
    errors: PointingErrors | None = None,
) -> SimulatedMount:
    """Let a mount live through something, in virtual time."""
    clock = VirtualClock()
    mechanics = Mechanics(HERE, AIR, errors or PointingErrors(), machine=machine or GERMAN, clock=clock)
    mount = SimulatedMount(mechanics, clock, behavior)

    async def opened() -> None:
        await mount.open()
        await life(mount, clock)
        await mount.close()

    with for_all_modules(clock):
        run_virtually(opened(), clock)
    return mount


@pytest.mark.parametrize(
    "behavior",
    [
        MountBehavior(),
        MountBehavior(epoch="icrs", ra_step_arcsec=15.0, dec_step_arcsec=1.0),
        MountBehavior(ra_step_arcsec=19.8, dec_step_arcsec=19.8, tells_motion=False),
    ],
    ids=["plain", "icrs in steps", "tells little"],
)
@pytest.mark.parametrize("mounting", ["german", "fork"])
def test_it_conforms(behavior: MountBehavior, mounting: Any) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        await mount.slew(place_of(mount, up(clock, 30.0, 30.0)))
        await check_mount(mount)

    machine = replace(GERMAN, mounting=mounting, meridian_limits_deg=None)
    mount = lived(life, behavior, machine)
    assert {"slew", "sync", "stop", "park", "unpark", "track"} <= set(mount.received)


def place_of(mount: SimulatedMount, place: Apparent) -> Apparent | Icrs:
    from mountnav.sky.chain import apparent_to_icrs

    return apparent_to_icrs(place) if mount.epoch == "icrs" else place


@pytest.mark.parametrize(
    ("behavior", "outcome"),
    [("normal", SyncOutcome.SEEN), ("late", SyncOutcome.LATE), ("ignore", SyncOutcome.IGNORED)],
)
def test_syncs_come_to_what_the_mechanics_make_of_them(behavior: Any, outcome: SyncOutcome) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        mount.mechanics.sync_behavior, mount.mechanics.sync_late_s = behavior, 2.0
        here = (await mount.reading()).place
        assert isinstance(here, Apparent)
        result = await mount.sync(displaced(here, 300.0, 400.0))
        assert result.outcome is outcome
        assert mount.received == ["sync"]

    lived(life)


def test_a_sync_that_is_refused_raises() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        mount.mechanics.sync_behavior = "refuse"
        with pytest.raises(DeviceRefused):
            await mount.sync((await mount.reading()).place)

    lived(life)


def test_a_sync_that_comes_after_it_was_given_up_is_told() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        heard: list[str] = []
        mount.listen(lambda what, _: heard.append(what))
        mount.mechanics.sync_behavior, mount.mechanics.sync_late_s = "late", 8.0
        here = (await mount.reading()).place
        assert isinstance(here, Apparent)
        assert (await mount.sync(displaced(here, 300.0, 400.0))).outcome is SyncOutcome.IGNORED
        await clock.sleep(8.0)
        await mount.reading()
        assert "sync-late" in heard

    lived(life)


@pytest.mark.long
def test_a_blocked_axis_stalls_the_slew_and_the_mount_is_stopped() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        slew = asyncio.create_task(mount.slew(up(clock, 60.0, 0.0)))
        await clock.sleep(3.0)
        mount.mechanics.stick("dec")
        assert await slew is SlewOutcome.STALLED
        assert mount.slew_state is SlewState.STALLED
        assert "stop" in mount.received
        # the stop has ended the order: freed, it doesn't set out again by itself
        mount.mechanics.unstick("dec")
        assert not mount.mechanics.slewing()

    lived(life)


@pytest.mark.parametrize(("trouble", "error"), [("missing", DeviceMissing), ("silent", DeviceSilent)])
def test_a_lost_link_ends_the_slew_and_stops_the_mount_when_it_is_back(
    trouble: Any, error: type[Exception]
) -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        heard: list[str] = []
        mount.listen(lambda what, _: heard.append(what))
        slew = asyncio.create_task(mount.slew(up(clock, 80.0, 0.0)))
        await clock.sleep(3.0)
        mount.cut(12.0, trouble)
        with pytest.raises(error):
            await slew
        with pytest.raises((DeviceMissing, DeviceSilent)):
            await mount.reading()
        await clock.sleep(20.0)
        assert not mount.mechanics.slewing()
        assert not mount.trusted
        assert [what for what in heard if what in ("link-lost", "link-back", "untrusted")] == [
            "link-lost",
            "untrusted",
            "link-back",
            "untrusted",
        ]
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(up(clock, 40.0, 0.0))
        assert refused.value.reason is Refusal.UNTRUSTED
        # a sync that is seen makes it count again
        assert (await mount.sync((await mount.reading()).place)).outcome is SyncOutcome.SEEN
        assert await mount.slew(up(clock, 40.0, 0.0)) is SlewOutcome.ARRIVED

    lived(life)


def test_a_short_silence_is_no_loss() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        heard: list[str] = []
        mount.listen(lambda what, _: heard.append(what))
        mount.cut(4.0, "silent")
        await clock.sleep(10.0)
        await mount.reading()
        assert mount.trusted
        assert heard == ["link-silent", "link-back"]

    lived(life)


def test_a_reboot_is_noticed_unasked_and_the_position_counts_no_more() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        heard: list[str] = []
        mount.listen(lambda what, _: heard.append(what))
        await mount.slew(up(clock, 40.0, 20.0))
        mount.reboot(4.0)
        await clock.sleep(10.0)
        assert "untrusted" in heard
        off_arcsec = separation_arcsec(mount.mechanics.truth(), Icrs(0.0, 90.0))
        assert off_arcsec > 3600.0
        assert (await mount.reading()).place.dec_deg == pytest.approx(90.0, abs=0.1)

    lived(life)


def test_it_says_no_below_its_horizon_and_moves_nothing() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        with pytest.raises(DeviceRefused) as refused:
            await mount.slew(up(clock, 179.0, 0.0))
        assert refused.value.reason is Refusal.BELOW_HORIZON
        assert mount.received == []

    lived(life)


def test_a_stop_ends_a_slew_and_a_second_order_is_refused() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        slew = asyncio.create_task(mount.slew(up(clock, 80.0, 0.0)))
        await clock.sleep(3.0)
        with pytest.raises(Busy):
            await mount.slew(up(clock, 10.0, 0.0))
        await mount.stop()
        assert await slew is SlewOutcome.STOPPED
        assert not mount.mechanics.slewing()

    lived(life)


def test_who_cancels_a_slew_leaves_the_mount_stopped() -> None:
    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        slew = asyncio.create_task(mount.slew(up(clock, 80.0, 0.0)))
        await clock.sleep(3.0)
        slew.cancel()
        with pytest.raises(asyncio.CancelledError):
            await slew
        await clock.sleep(5.0)
        assert not mount.mechanics.slewing()

    lived(life)


def test_readings_and_orders_go_in_steps() -> None:
    behavior = MountBehavior(ra_step_arcsec=15.0, dec_step_arcsec=60.0)

    async def life(mount: SimulatedMount, clock: VirtualClock) -> None:
        place = (await mount.reading()).place
        assert place.ra_deg * 3600.0 / 15.0 == pytest.approx(round(place.ra_deg * 3600.0 / 15.0), abs=1e-6)
        assert place.dec_deg * 60.0 == pytest.approx(round(place.dec_deg * 60.0), abs=1e-6)
        assert mount.resolution_arcsec == 60.0

    lived(life, behavior)


def test_a_german_mount_tells_its_side_and_may_tell_the_wrong_one() -> None:
    async def sides(mount: SimulatedMount, clock: VirtualClock) -> None:
        told = []
        for ha_deg in (30.0, -30.0):
            await mount.slew(up(clock, ha_deg, 20.0))
            told.append((await mount.reading()).pier_side)
        expected = [PierSide.EAST, PierSide.WEST]
        assert told == (expected[::-1] if mount.behavior.side_swapped else expected)
        assert Skill.PIER_SIDE in mount.skills

    lived(sides)
    lived(sides, MountBehavior(side_swapped=True))
