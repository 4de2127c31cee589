"""Axes moved by hand: bounded in speed and time, ended before a limit, and by whatever comes."""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Awaitable, Callable
from datetime import timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import Direction, MountAxis, OffsetRates
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceError,
    DeviceRefused,
    DeviceSilent,
    LimitKind,
    OutsideLimits,
)
from mountnav.journal.records import Outcome
from mountnav.mount import FollowingPolicy
from mountnav.pointing.limits import Limits
from mountnav.simulation.mechanics import Machine
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from tests.mount.following_rig import FollowingRig, run_following
from tests.mount.mount_rig import AIR, SITE

BRISK = Machine(acceleration_deg_s2=4.0)
Setting = Callable[[FollowingRig], Awaitable[None]]


async def south(rig: FollowingRig) -> None:
    await rig.mount.slew(rig.place(-20.0, 20.0))


def speeds(rig: FollowingRig) -> tuple[float, float]:
    """True speeds of both motors, beside tracking."""
    return rig.mechanics.axis_velocity("ha") - SIDEREAL_DEG_S, rig.mechanics.axis_velocity("dec")


def still(rig: FollowingRig) -> bool:
    return max(map(abs, speeds(rig))) < 1e-6 or (
        not rig.mechanics.tracking and abs(rig.mechanics.axis_velocity("dec")) < 1e-6
    )


def altitude_deg(rig: FollowingRig) -> float:
    return icrs_to_observed(rig.mechanics.truth(), rig.clock.utc(), SITE, AIR).alt_deg


@pytest.mark.parametrize(("axis", "rate"), [("primary", 1.0), ("secondary", -1.0)])
def test_an_axis_moves_for_its_time_and_ends_by_itself(axis: MountAxis, rate: float) -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        before = await rig.mount.reading()
        await rig.mount.move_axis(axis, rate, for_s=2.0)
        assert rig.mount.axis_moving
        await rig.clock.sleep(1.5)
        assert max(map(abs, speeds(rig))) == pytest.approx(1.0, abs=0.01)
        await rig.clock.sleep(3.0)
        assert still(rig)
        assert rig.mechanics.tracking
        assert not rig.mount.axis_moving
        after = await rig.mount.reading()
        ra_deg, dec_deg = after.place.ra_deg - before.place.ra_deg, after.place.dec_deg - before.place.dec_deg
        # east, and south: as it was told
        moved = ra_deg if axis == "primary" else dec_deg
        assert moved == pytest.approx(2.0 * rate, abs=0.3)
        assert abs(dec_deg if axis == "primary" else ra_deg) < 0.05

    rig = run_following(work, machine=BRISK)
    rows = [one for one in rig.journal.commands if one.order == "move-axis"]
    assert [one.facts["rate_deg_s"] for one in rows] == [rate, 0.0]
    assert all(rig.journal.ends[one.command_id].outcome is Outcome.DONE for one in rows)
    assert rig.guard.told[0] == "arm"
    assert rig.guard.told[-1] == "disarm"


def test_ordered_again_it_goes_on_and_nothing_more_is_sent() -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        for _ in range(20):
            await rig.mount.move_axis("secondary", 0.2, for_s=1.0)
            await rig.clock.sleep(0.5)
            assert rig.mount.axis_moving
        assert rig.following.ordered == [("secondary", 0.2, 0.0)]
        await rig.mount.move_axis("secondary", -0.2, for_s=1.0)
        assert rig.following.ordered[-1] == ("secondary", -0.2, 0.0)
        await rig.mount.move_axis("secondary", 0.0, for_s=1.0)
        assert still(rig)
        assert not rig.mount.axis_moving

    run_following(work, machine=BRISK)


def test_both_axes_move_and_each_has_its_own_time() -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        await rig.mount.move_axis("primary", 0.5, for_s=4.0)
        await rig.mount.move_axis("secondary", 0.5, for_s=1.0)
        await rig.clock.sleep(2.0)
        assert abs(speeds(rig)[1]) < 1e-6
        assert abs(speeds(rig)[0]) == pytest.approx(0.5, abs=0.01)
        await rig.clock.sleep(4.0)
        assert still(rig)
        assert not rig.mount.axis_moving

    run_following(work, machine=BRISK)


@pytest.mark.parametrize(
    ("axis", "rate", "for_s", "error"),
    [
        ("third", 1.0, 1.0, "no axis"),
        ("primary", math.nan, 1.0, "no motion"),
        ("primary", 1.0, math.inf, "no motion"),
        ("primary", 1.0, 0.0, "above 0"),
        ("primary", 1.0, 5.1, "at most 5 s"),
        ("primary", 4.1, 1.0, "at most 4°/s"),
        ("primary", 0.0001, 1.0, "doesn't move"),
    ],
)
def test_what_makes_no_sense_is_refused_and_nothing_is_sent(
    axis: MountAxis, rate: float, for_s: float, error: str
) -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        with pytest.raises(BadRequest, match=error):
            await rig.mount.move_axis(axis, rate, for_s=for_s)
        assert rig.following.ordered == []
        assert rig.guard.told == []
        assert not rig.mount.axis_moving

    run_following(work)


async def _parked(rig: FollowingRig) -> None:
    await rig.mount.park()


async def _untrusted(rig: FollowingRig) -> None:
    rig.mount.distrust("a test")


async def _no_guard(rig: FollowingRig) -> None:
    rig.guard.missing = True


@pytest.mark.parametrize("setting", [_parked, _untrusted, _no_guard])
def test_it_is_refused_where_it_must_not_move(setting: Setting) -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        await setting(rig)
        with pytest.raises(DeviceRefused):
            await rig.mount.move_axis("primary", 1.0, for_s=1.0)
        assert rig.following.ordered == []
        assert not rig.mount.axis_moving

    run_following(work)


def test_what_follows_is_not_moved_by_hand_and_what_is_moved_does_not_follow() -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        end = rig.clock.utc() + timedelta(seconds=600.0)
        await rig.mount.set_offset_rates(OffsetRates(0.1, 0.1), ends_utc=end)
        with pytest.raises(Busy, match="follows"):
            await rig.mount.move_axis("primary", 1.0, for_s=1.0)
        await rig.mount.end_offset_rates()
        await rig.mount.move_axis("primary", 1.0, for_s=1.0)
        with pytest.raises(Busy, match="by hand"):
            await rig.mount.set_offset_rates(OffsetRates(0.1, 0.1), ends_utc=end)
        with pytest.raises(Busy):
            await rig.mount.guide(Direction.NORTH, 0.5)
        with pytest.raises(Busy):
            await rig.mount.sync(rig.place(0.0, 0.0))

    run_following(work)


async def _stop(rig: FollowingRig) -> None:
    await rig.mount.stop()


async def _slew(rig: FollowingRig) -> None:
    await rig.mount.slew(rig.place(10.0, 30.0))


async def _park(rig: FollowingRig) -> None:
    await rig.mount.park()


async def _home(rig: FollowingRig) -> None:
    await rig.mount.home()


async def _rest(rig: FollowingRig) -> None:
    await rig.mount.set_tracking(False)


async def _track(rig: FollowingRig) -> None:
    await rig.mount.set_tracking(True)


async def _close(rig: FollowingRig) -> None:
    await rig.mount.close()


async def _distrust(rig: FollowingRig) -> None:
    rig.mount.distrust("it slipped")
    await rig.clock.sleep(4.0)


@pytest.mark.long
@pytest.mark.parametrize("order", [_stop, _slew, _park, _home, _rest, _track, _close, _distrust])
@pytest.mark.parametrize("native", [False, True])
def test_each_order_and_mishap_ends_it(order: Setting, native: bool) -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        await rig.mount.move_axis("primary", 1.0, for_s=5.0)
        await rig.mount.move_axis("secondary", 1.0, for_s=5.0)
        await rig.clock.sleep(0.5)
        await order(rig)
        assert not rig.mount.axis_moving
        assert rig.guard.until_utc is None
        assert max(map(abs, speeds(rig))) < 0.005

    run_following(work, machine=BRISK, native=native)


@pytest.mark.parametrize("fault", ["end-axis", "deaf-axis"])
def test_an_axis_that_cannot_be_ended_is_stopped(fault: str) -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        await rig.mount.move_axis("secondary", 0.5, for_s=1.0)
        rig.following.fails.add(fault)
        await rig.clock.sleep(60.0)
        assert still(rig)
        rig.following.fails.clear()
        await rig.clock.sleep(20.0)
        assert not rig.mount.axis_moving
        assert rig.mount.following_problem is None

    rig = run_following(work, machine=BRISK)
    told = [what for what, _ in rig.told if what.startswith("move-axis")]
    assert told[0] == "move-axis-not-ended"
    assert "move-axis-stopped" in told


def test_an_axis_of_which_nobody_knows_whether_it_moves_is_ended() -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        rig.following.fails.add("axis")
        with pytest.raises(DeviceSilent):
            await rig.mount.move_axis("primary", 1.0, for_s=1.0)
        await rig.clock.sleep(3.0)
        assert rig.following.ordered[-1] == ("primary", 0.0, 0.0)
        assert not rig.mount.axis_moving

    run_following(work)


def test_a_stop_while_it_is_ordered_wins() -> None:
    async def work(rig: FollowingRig) -> None:
        await south(rig)
        for after_s in (0.001, 0.01, 0.021, 0.03, 0.05):
            order = asyncio.ensure_future(rig.mount.move_axis("secondary", 1.0, for_s=3.0))
            await rig.clock.sleep(after_s)
            await rig.mount.stop()
            (came,) = await asyncio.gather(order, return_exceptions=True)
            assert came is None or isinstance(came, Cancelled)
            await rig.clock.sleep(1.5)
            assert abs(rig.mechanics.axis_velocity("dec")) < 1e-6
            assert not rig.mount.axis_moving

    run_following(work, machine=BRISK)


def test_a_key_that_is_held_down_ends_before_the_horizon_and_may_not_go_on() -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(0.0, 0.0))
        lowest, refused = 90.0, list[LimitKind]()
        for _ in range(80):
            try:
                await rig.mount.move_axis("secondary", -1.0, for_s=1.0)
            except OutsideLimits as refusal:
                refused.append(refusal.limit)
            await rig.clock.sleep(0.5)
            lowest = min(lowest, altitude_deg(rig))
        assert lowest >= 20.0
        assert lowest < 26.0
        assert set(refused) == {LimitKind.ALTITUDE}
        # away from it is allowed, and slower nearer to it
        await rig.mount.move_axis("secondary", 1.0, for_s=1.0)
        await rig.clock.sleep(4.0)
        await rig.mount.move_axis("secondary", -0.1, for_s=1.0)

    run_following(work, limits=Limits(20.0), machine=BRISK)


def test_what_moves_faster_than_it_was_told_is_ended_before_the_limit_by_its_readings() -> None:
    """It takes 0.2°/s for 2°/s: the prediction at the order was wrong, the watch isn't."""

    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(0.0, 0.0))
        move = rig.following.move_axis

        async def faster(axis: MountAxis, rate_deg_s: float) -> None:
            await move(axis, 5.0 * rate_deg_s)

        rig.following.move_axis = faster  # type: ignore[method-assign]
        lowest = 90.0
        for _ in range(50):
            with contextlib.suppress(OutsideLimits):
                await rig.mount.move_axis("secondary", -0.4, for_s=3.0)
            await rig.clock.sleep(0.5)
            lowest = min(lowest, altitude_deg(rig))
        # ended where it was told to be 1 s from the limit; at 2°/s it comes 3° too far at most
        assert lowest >= 20.0 - 2.0 * 2.0 - 1.0

    run_following(work, limits=Limits(20.0), machine=BRISK)


@pytest.mark.long
@pytest.mark.parametrize("ha_deg", [-15.0, 15.0])
@pytest.mark.parametrize("rate", [1.0, -1.0])
def test_a_german_mount_ends_before_its_counterweight_rises_too_far(ha_deg: float, rate: float) -> None:
    async def work(rig: FollowingRig) -> None:
        await rig.mount.slew(rig.place(ha_deg, 20.0))
        side = rig.mechanics.pier_side()
        angles, refused = [], []
        for _ in range(60):
            try:
                await rig.mount.move_axis("primary", rate, for_s=1.0)
            except OutsideLimits as refusal:
                refused.append(refusal.limit)
            await rig.clock.sleep(0.5)
            angles.append(rig.mechanics.axis_angle("ha"))
        assert min(angles) >= -5.0
        assert max(angles) <= 185.0
        assert rig.mechanics.pier_side() is side
        # that way the limit is 20° off, the other way it's 160°
        assert bool(refused) == (rate * ha_deg > 0.0)
        assert set(refused) <= {LimitKind.MERIDIAN}

    run_following(
        work,
        limits=Limits(15.0, past_meridian_deg=(5.0, 5.0)),
        machine=Machine(mounting="german", acceleration_deg_s2=4.0),
        mounting="german",
    )


@pytest.mark.long
@settings(max_examples=12, deadline=None)
@given(
    ha_deg=st.floats(-70.0, 70.0),
    dec_deg=st.floats(0.0, 70.0),
    primary=st.sampled_from([-4.0, -1.0, 0.0, 1.0, 4.0]),
    secondary=st.sampled_from([-4.0, -0.5, 0.5, 4.0]),
    tracks=st.booleans(),
)
def test_held_keys_never_lead_outside(
    ha_deg: float, dec_deg: float, primary: float, secondary: float, tracks: bool
) -> None:
    """Whatever is held down from wherever, on either side of the pier: the tube stays above 20°."""

    async def work(rig: FollowingRig) -> None:
        try:
            await rig.mount.slew(rig.place(ha_deg, dec_deg))
        except OutsideLimits:
            return
        if not tracks:
            await rig.mount.set_tracking(False)
        for _ in range(45):
            for axis, rate in (("primary", primary), ("secondary", secondary)):
                if rate:
                    with contextlib.suppress(OutsideLimits, DeviceError):
                        await rig.mount.move_axis(axis, rate, for_s=1.0)  # type: ignore[arg-type]
            await rig.clock.sleep(0.4)
            assert altitude_deg(rig) >= 20.0
            assert -10.0 <= rig.mechanics.axis_angle("ha") <= 190.0

    run_following(
        work,
        limits=Limits(20.0, past_meridian_deg=(10.0, 10.0), margin_deg=0.1),
        machine=Machine(mounting="german", acceleration_deg_s2=4.0),
        mounting="german",
        policy=FollowingPolicy(),
    )
