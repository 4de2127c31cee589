"""Holding still on a whole telescope in virtual time: it may see looks alone, and the tube's truth judges."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import Direction, Skill
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceRefused,
    MountMoved,
    SolveFailed,
    TargetNotReached,
)
from mountnav.guiding.dither import DitherPlan
from mountnav.journal.records import EntryKind
from mountnav.navigation.holding import (
    DitherReport,
    DitherWish,
    HoldPlan,
    HoldProgress,
    HoldReport,
)
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from tests.mount.following_rig import FollowingMount
from tests.navigation.virtual_rig import ERRORS, POLICY, START, VirtualRig, in_virtual_time

pytestmark = pytest.mark.long

CHEAP = replace(ERRORS, me_arcsec=500.0, periodic_amplitude_arcsec=10.0, periodic_period_s=480.0)
"""A polar axis 9′ off, and a worm that swings by 20″."""
QUICK = replace(POLICY, exposure_s=2.0)


def rms(offs: list[float]) -> float:
    return math.sqrt(float(np.mean(np.square(offs))))


class Watched:
    """Watches the tube while it holds."""

    def __init__(self, rig: VirtualRig, target: Icrs) -> None:
        self.rig, self.target = rig, target
        self.steps: list[HoldProgress] = []
        self.offs: list[float] = []

    def __call__(self, step: HoldProgress) -> None:
        self.steps.append(step)
        self.offs.append(self.rig.off_arcsec(self.target))


def uncorrected(rig: VirtualRig, target: Icrs, seconds: float) -> float:
    """How far off the tube comes in the root mean square if nobody corrects it from now on."""
    now = rig.clock.utc()
    times = [now + timedelta(seconds=float(one)) for one in np.linspace(0.0, seconds, 200)]
    return rms([separation_arcsec(rig.mechanics.truth(one), target) for one in times])


@pytest.mark.parametrize(
    ("made", "by", "play_arcsec"),
    [
        (SimulatedMount, None, 0.0),
        (SimulatedMount, None, 12.0),
        (FollowingMount, "rates", 0.0),
        (FollowingMount, "both", 0.0),
    ],
)
def test_a_cheap_mount_is_held_and_nothing_is_left_behind(
    made: type[SimulatedMount], by: Any, play_arcsec: float
) -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        alone = uncorrected(rig, target, 5400.0)
        assert alone > 15.0
        watched = Watched(rig, target)
        syncs = len(rig.told("synced"))
        plan = HoldPlan(target=target, for_s=5400.0, every_s=30.0, by=by)
        report = await rig.navigator.hold(plan, watched)
        assert isinstance(report, HoldReport)
        assert rms(watched.offs) < 0.3 * alone
        assert rms(watched.offs[60:]) < 1.5
        assert report.solved > 150
        assert report.by == (by or "pulses")
        assert report.known.period_s == pytest.approx(480.0, rel=0.03)
        if by == "rates":
            amplitude_arcsec = 10.0 * math.cos(math.radians(30.0))
            assert report.known.amplitudes_arcsec[0] == pytest.approx(amplitude_arcsec, abs=1.0)
            assert report.known.drift_east_arcsec_min is not None
        else:
            # this mount doesn't tell its guide rate: what it does by itself can't be told from what pulses do
            assert report.known.amplitudes_arcsec == ()
            assert report.known.drift_east_arcsec_min is None
        assert len(rig.told("synced")) == syncs, "never a sync in mid-series"
        assert rig.navigator.mount.offset_rates_in_force is None
        assert (await rig.mount.reading()).tracking is True
        assert rig.navigator.activity == "idle"

    in_virtual_time(work, errors=replace(CHEAP, backlash_arcsec=play_arcsec), policy=QUICK, made=made)


def test_without_a_target_it_holds_where_the_first_look_finds_it() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-20.0, 40.0))
        there = rig.mechanics.truth(rig.clock.utc())
        watched = Watched(rig, there)
        report = await rig.navigator.hold(HoldPlan(for_s=1800.0, every_s=20.0), watched)
        assert isinstance(report, HoldReport)
        assert separation_arcsec(report.target, there) < 3.0
        assert rms(watched.offs[30:]) < 3.0

    in_virtual_time(work, errors=replace(CHEAP, periodic_amplitude_arcsec=0.0), policy=QUICK)


def test_a_cancelled_hold_leaves_it_tracking_without_rates() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        stops = len(rig.told("stopped"))
        task = asyncio.ensure_future(rig.navigator.hold(HoldPlan(target=target, by="rates")))
        await rig.clock.sleep(900.0)
        assert rig.navigator.mount.offset_rates_in_force is not None
        with pytest.raises(Busy):
            await rig.navigator.look()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert rig.navigator.mount.offset_rates_in_force is None
        assert rig.mechanics.beside_arcsec_s == (0.0, 0.0)
        assert (await rig.mount.reading()).tracking is True
        assert len(rig.told("stopped")) == stops, "it isn't stopped: it tracks on"
        assert rig.navigator.activity == "idle"

    in_virtual_time(work, errors=CHEAP, policy=QUICK, made=FollowingMount)


def test_a_dither_within_a_hold_settles_by_looks_and_the_hold_goes_on_there() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        watched = Watched(rig, target)
        task = asyncio.ensure_future(rig.navigator.hold(HoldPlan(target=target, every_s=20.0), watched))
        await rig.clock.sleep(1500.0)
        assert rig.navigator.holds
        plan = DitherPlan("ring", 8.0, 4)
        for number in (1, 2, 3):
            report = await rig.navigator.dither(DitherWish(plan, settle_within=1.5))
            assert report.number == number
            east, north = plan.step(number)
            assert (report.east_arcsec, report.north_arcsec) == (east, north)
            there = displaced(target, east, north)
            assert rig.off_arcsec(there) < 2.5
            await rig.clock.sleep(300.0)
            assert rig.off_arcsec(there) < 2.5
            assert watched.steps[-1].dithered == (east, north)
        back = await rig.navigator.dither(DitherWish(plan, number=0))
        assert (back.east_arcsec, back.north_arcsec) == (0.0, 0.0)
        first = asyncio.ensure_future(rig.navigator.dither(DitherWish(plan)))
        await asyncio.sleep(0)
        with pytest.raises(Busy):
            await rig.navigator.dither(DitherWish(plan))
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        with pytest.raises(Cancelled, match="ended before"):
            await first

    in_virtual_time(work, errors=replace(CHEAP, periodic_amplitude_arcsec=2.0), policy=QUICK)


def test_a_dither_in_pixels_goes_by_the_solved_scale_and_alone_ends_by_itself() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        before = rig.mechanics.truth(rig.clock.utc())
        wish = DitherWish(DitherPlan("spiral", 5.0, 4), unit="px", number=3, settle_within=1.0)
        report = await rig.navigator.dither(wish)
        assert isinstance(report, DitherReport)
        # 2″ a pixel
        east, north = DitherPlan("spiral", 5.0, 4).step(3)
        assert (report.east_arcsec, report.north_arcsec) == pytest.approx((2.0 * east, 2.0 * north), rel=1e-3)
        moved = offset_arcsec(rig.mechanics.truth(rig.clock.utc()), before)
        assert moved.east_arcsec == pytest.approx(2.0 * east, abs=3.0)
        assert moved.north_arcsec == pytest.approx(2.0 * north, abs=3.0)
        assert not rig.navigator.holds
        assert rig.navigator.activity == "idle"

    in_virtual_time(work, policy=QUICK)


def test_a_dither_that_can_not_settle_says_so_and_the_hold_goes_on() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        task = asyncio.ensure_future(rig.navigator.hold(HoldPlan(target=target, every_s=10.0)))
        await rig.clock.sleep(600.0)
        with pytest.raises(TargetNotReached, match="did not settle"):
            await rig.navigator.dither(DitherWish(DitherPlan(), settle_within=1e-6, timeout_s=60.0))
        await rig.clock.sleep(60.0)
        assert not task.done()
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    in_virtual_time(work, policy=QUICK)


def test_clouds_are_waited_for_and_wrong_solutions_are_told_and_move_nothing() -> None:
    clouds = (Cloud(15.0, 25.0),)

    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        watched = Watched(rig, target)
        report = await rig.navigator.hold(HoldPlan(target=target, for_s=3600.0), watched)
        assert isinstance(report, HoldReport)
        fates = [step.fate for step in watched.steps]
        assert fates.count("not-solved") > 5
        assert max(watched.offs) < 40.0
        assert rms(watched.offs[-30:]) < 2.0
        if report.gated:
            assert any("not believed" in entry.what for entry in rig.entries(EntryKind.DECISION))

    in_virtual_time(
        work,
        errors=replace(CHEAP, periodic_amplitude_arcsec=0.0),
        policy=QUICK,
        script=SkyScript(seed=5, clouds=clouds, false_share=0.05),
    )


def test_half_an_hour_without_a_look_ends_it() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        with pytest.raises(SolveFailed, match="no look was solved for"):
            await rig.navigator.hold(HoldPlan(target=target))
        assert rig.clock.utc() - START > timedelta(seconds=600.0 + 1700.0)
        assert (await rig.mount.reading()).tracking is True

    in_virtual_time(work, policy=QUICK, script=SkyScript(clouds=(Cloud(10.0, 150.0),)))


def test_a_mount_that_somebody_slews_ends_the_hold() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        task = asyncio.ensure_future(rig.navigator.hold(HoldPlan(target=target)))
        await rig.clock.sleep(300.0)
        # by its handset: past this service
        reading = await rig.mount.reading()
        await rig.mount.slew(replace(reading.place, dec_deg=reading.place.dec_deg + 2.0))
        with pytest.raises(MountMoved, match="without a correction"):
            await task

    in_virtual_time(work, policy=QUICK)


def test_a_mount_that_does_not_track_is_not_held() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-30.0, 30.0))
        await rig.navigator.set_tracking(False)
        with pytest.raises(DeviceRefused, match="doesn't track"):
            await rig.navigator.hold(HoldPlan())

    in_virtual_time(work, policy=QUICK)


class Unskilled(SimulatedMount):
    """Takes neither pulses nor rates."""

    @property
    def skills(self) -> frozenset[Skill]:
        return super().skills - {Skill.GUIDE, Skill.OFFSET_RATES}


class OnlyPulses(SimulatedMount):
    """Takes no rates."""

    @property
    def skills(self) -> frozenset[Skill]:
        return super().skills - {Skill.OFFSET_RATES}


@pytest.mark.parametrize(("made", "by"), [(Unskilled, None), (OnlyPulses, "rates"), (OnlyPulses, "both")])
def test_what_the_mount_can_not_do_is_refused_before_anything(made: type[SimulatedMount], by: Any) -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(DeviceRefused, match="can't be corrected"):
            await rig.navigator.hold(HoldPlan(by=by))
        assert rig.navigator.activity == "idle"

    in_virtual_time(work, policy=QUICK, made=made)


class Reversed(SimulatedMount):
    """Does north pulses southward, as many do after a flip."""

    async def guide(self, direction: Direction, duration_s: float) -> None:
        other = {Direction.NORTH: Direction.SOUTH, Direction.SOUTH: Direction.NORTH}
        await super().guide(other.get(direction, direction), duration_s)


def test_reversed_pulses_are_named_and_do_no_more_harm() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        watched = Watched(rig, target)
        with pytest.raises(DeviceRefused, match="opposite of what it is told in declination"):
            await rig.navigator.hold(HoldPlan(target=target, play_arcsec=0.0), watched)
        assert max(watched.offs) < 60.0

    in_virtual_time(work, errors=replace(CHEAP, periodic_amplitude_arcsec=0.0), policy=QUICK, made=Reversed)


def test_frames_of_another_program_show_how_the_cameras_bend_apart() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        # as the other camera's frames are compared while it holds
        seen = await rig.navigator.look()
        holding = asyncio.ensure_future(rig.navigator.hold(HoldPlan(target=target, for_s=4800.0)))
        await rig.clock.sleep(100.0)
        began = rig.clock.utc()
        for _ in range(15):
            await rig.clock.sleep(280.0)
            latest = rig.navigator._holding
            assert latest is not None
            utc = rig.clock.utc()
            hours = (utc - began).total_seconds() / 3600.0
            main = displaced(rig.mechanics.truth(utc), 30.0 + 20.0 * hours, -10.0)
            latest.outside(replace(seen, seen=main, mid_exposure_utc=utc))
        report = await holding
        assert isinstance(report, HoldReport)
        bending = report.known.bending
        assert bending is not None
        assert bending.east.rate_per_h == pytest.approx(20.0, abs=max(4.0 * bending.east.sigma_per_h, 0.5))
        assert bending.east.sigma_per_h < 3.0
        assert report.known.rotation is not None

    in_virtual_time(work, errors=replace(CHEAP, periodic_amplitude_arcsec=0.0), policy=QUICK)


@pytest.mark.parametrize(
    "wrong",
    [
        {"every_s": 0.0},
        {"for_s": math.inf},
        {"period_s": math.nan},
        {"play_arcsec": -1.0},
        {"exposure_s": 0.0},
    ],
)
def test_a_plan_that_makes_no_sense_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadRequest):
        HoldPlan(**wrong)  # type: ignore[arg-type]
