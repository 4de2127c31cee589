"""Mounts that misbehave: each converges or ends with its name; judged by the simulator's truth."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from typing import Any

import pytest

from drivers.simulated.behavior import MountBehavior
from mountnav.devices import PierSide, SyncOutcome
from mountnav.errors import LimitKind, MountnavError, NotReached, OutsideLimits, TargetNotReached
from mountnav.journal.records import EntryKind, Outcome
from mountnav.mount.kill_points import watching_kill_points
from mountnav.navigation.policy import Approach, CorrectBy
from mountnav.navigation.reports import CenterReport, Correction
from mountnav.pointing.limits import Limits
from mountnav.simulation.machine import Machine
from mountnav.simulation.sky_script import SkyScript
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.navigation.virtual_rig import ERRORS, POLICY, VirtualRig, in_virtual_time

PLACES = [(-20.0, 30.0), (40.0, 5.0), (10.0, 85.0), (-50.0, 60.0)]


def centered(
    ha_deg: float,
    dec_deg: float,
    *,
    prepare: Callable[[VirtualRig], object] = lambda rig: None,
    asked: dict[str, Any] | None = None,
    **given: Any,
) -> tuple[CenterReport, float, VirtualRig]:
    """Center there; the report, and how far the tube truly looks from the target afterwards."""

    async def work(rig: VirtualRig) -> tuple[CenterReport, float, VirtualRig]:
        prepare(rig)
        target = rig.up(ha_deg, dec_deg)
        report = await rig.navigator.center(target, **(asked or {}))
        return report, rig.off_arcsec(target), rig

    return in_virtual_time(work, **given)


def syncs(behavior: str) -> Callable[[VirtualRig], object]:
    def prepare(rig: VirtualRig) -> None:
        rig.mechanics.sync_behavior = behavior  # type: ignore[assignment]

    return prepare


@pytest.mark.long
@pytest.mark.parametrize("correct_by", ["sync", "offset", "model"])
@pytest.mark.parametrize(("ha_deg", "dec_deg"), PLACES)
def test_each_way_of_correcting_centers(ha_deg: float, dec_deg: float, correct_by: str) -> None:
    report, off, rig = centered(ha_deg, dec_deg, asked={"correct_by": correct_by, "tolerance_arcsec": 15.0})
    assert off < 16.0
    assert report.error_after_arcsec <= 15.0
    # what the answer says of itself is true: the tube looked there, within some of its sigmas
    assert separation_arcsec(report.tries[-1].seen, report.target) == pytest.approx(report.error_after_arcsec)
    assert 0.0 < report.error_sigma_arcsec < 1.0
    assert report.expected_error_arcsec is not None
    assert [one.after_arcsec for one in report.tries[:-1]] == [one.error_arcsec for one in report.tries[1:]]
    assert report.tries[-1].correction is Correction.NONE
    assert report.tries[-1].why == "centered"
    used = {one.correction for one in report.tries[:-1]}
    # at 85° a sync would turn the hour angle of the whole sky by what may be the pole's error
    synced = correct_by == "sync" and dec_deg < 80.0
    assert used == ({Correction.SYNC} if synced else {Correction.OFFSET})
    assert rig.mount.received.count("sync") == (len(report.tries) - 1 if synced else 0)
    (entry,) = rig.entries(EntryKind.CENTERING)
    assert entry.facts["outcome"] == "centered"
    assert len(entry.facts["tries"]) == len(report.tries)


@pytest.mark.parametrize("behavior", ["ignore", "refuse", "late"])
def test_a_mount_that_is_not_told_is_centered_by_offset(behavior: str) -> None:
    report, off, rig = centered(-20.0, 30.0, prepare=syncs(behavior))
    assert off < 31.0
    assert report.tries[0].correction is Correction.OFFSET
    assert rig.mount.received.count("sync") == 1
    assert any("by offset from here on" in note for note in report.notes)
    if behavior != "refuse":
        assert report.tries[0].sync_outcome is SyncOutcome.IGNORED


@pytest.mark.long
@pytest.mark.parametrize("late_s", [4.0, 10.0, 14.0, 20.0, 26.0, 40.0])
@pytest.mark.parametrize(("ha_deg", "dec_deg"), [(-20.0, 30.0), (-36.0, 85.6)])
def test_a_sync_that_takes_hold_whenever_it_likes_does_no_harm(
    late_s: float, ha_deg: float, dec_deg: float
) -> None:
    def prepare(rig: VirtualRig) -> None:
        rig.mechanics.sync_behavior = "late"
        rig.mechanics.sync_late_s = late_s

    report, off, _ = centered(ha_deg, dec_deg, prepare=prepare)
    assert off < 31.0
    assert len(report.tries) <= 5


@pytest.mark.parametrize("behavior", ["normal", "ignore"])
@pytest.mark.parametrize("backlash_arcsec", [30.0, 120.0])
def test_backlash_is_worked_through(behavior: str, backlash_arcsec: float) -> None:
    errors = replace(ERRORS, backlash_arcsec=backlash_arcsec)
    _, off, _ = centered(
        30.0, 20.0, prepare=syncs(behavior), errors=errors, asked={"tolerance_arcsec": 10.0, "max_tries": 8}
    )
    assert off < 12.0


def test_the_last_leg_comes_from_one_side_when_that_is_wanted() -> None:
    report, off, rig = centered(
        30.0,
        20.0,
        errors=replace(ERRORS, backlash_arcsec=120.0),
        policy=replace(POLICY, approach=Approach.ALWAYS),
        asked={"tolerance_arcsec": 10.0},
    )
    assert off < 12.0
    assert len(report.tries) == 2
    assert all(one.approached for one in report.tries)
    assert rig.mount.received.count("slew") == 4


def test_steps_of_15_arcsec_are_in_the_budget() -> None:
    coarse = MountBehavior(ra_step_arcsec=15.0, dec_step_arcsec=15.0)
    report, off, _ = centered(-20.0, 30.0, behavior=coarse, asked={"tolerance_arcsec": 1.0})
    assert report.tolerance_asked_arcsec == 1.0
    assert report.tolerance_arcsec == pytest.approx(11.25)
    assert any("1″ was asked for" in note for note in report.notes)
    assert off < 13.0
    finer, _, _ = centered(-20.0, 30.0, behavior=coarse, asked={"tolerance_arcsec": 12.0})
    assert finer.tolerance_arcsec == 12.0
    assert not finer.notes


def test_a_large_cone_error_does_not_oscillate() -> None:
    errors = replace(ERRORS, ch_arcsec=1800.0, np_arcsec=600.0)
    for ha_deg, dec_deg in PLACES:
        report, off, _ = centered(ha_deg, dec_deg, errors=errors)
        assert off < 31.0
        errors_seen = [one.error_arcsec for one in report.tries]
        assert errors_seen == sorted(errors_seen, reverse=True)


def test_a_slipping_tube_ends_with_its_name() -> None:
    async def work(rig: VirtualRig) -> NotReached:
        truth = rig.mechanics.truth

        def loose(utc: datetime | None = None) -> Icrs:
            # each slew shakes the tube somewhere else: a mirror that is loose
            angle = 2.4 * rig.mount.received.count("slew")
            return displaced(truth(utc), 500.0 * math.sin(angle), 500.0 * math.cos(angle))

        rig.mechanics.truth = loose  # type: ignore[method-assign]
        with pytest.raises(TargetNotReached) as end:
            await rig.navigator.center(rig.up(-20.0, 30.0), correct_by="offset", max_tries=20)
        (entry,) = rig.entries(EntryKind.CENTERING)
        assert entry.facts["reason"] == str(end.value.reason)
        assert len(entry.facts["tries"]) <= 6
        return end.value.reason

    assert in_virtual_time(work) in (NotReached.SLIPPING, NotReached.WORSE)


def test_a_tube_that_does_not_follow_ends_with_its_name() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        await rig.navigator.slew(target)
        there = displaced(rig.mechanics.truth(rig.clock.utc()), 60.0, 0.0)
        rig.mechanics.truth = lambda utc=None: there  # type: ignore[method-assign]
        with pytest.raises(TargetNotReached) as end:
            await rig.navigator.center(target, correct_by="offset", max_tries=20)
        assert end.value.reason is NotReached.STUCK
        assert len(rig.entries(EntryKind.CENTERING)[0].facts["tries"]) <= 5

    in_virtual_time(work)


@pytest.mark.long
def test_false_solutions_move_and_sync_nothing_wrongly() -> None:
    for seed in range(12):
        script = SkyScript(seed=seed, false_share=0.15)

        async def work(rig: VirtualRig) -> None:
            for ha_deg, dec_deg in PLACES[:3]:
                target = rig.up(ha_deg, dec_deg)
                try:
                    await rig.navigator.center(target)
                except MountnavError:
                    continue
                assert rig.off_arcsec(target) < 31.0
            # no sync ever made the mount believe in a place where the tube did not look
            for command in rig.journal.commands:
                if command.order == "sync" and rig.journal.ends[command.command_id].outcome is Outcome.DONE:
                    look = next(one for one in rig.journal.looks if one.look_id == command.cause.look_id)
                    number = int(look.source.split()[-1])
                    assert number not in rig.sky.false_frames

        in_virtual_time(work, script=script)


@pytest.mark.long
def test_stale_frames_are_never_used() -> None:
    count = 0
    for seed in range(6):
        script = SkyScript(seed=seed, stale_share=0.4)
        report, off, rig = centered(-20.0, 30.0, script=script, policy=replace(POLICY, moved_retries=20))
        assert off < 31.0
        refused = {one.look_id for one in rig.journal.looks if one.reason == "bad-frame"}
        assert not refused & {one.look_id for one in report.tries}
        count += len(refused)
    assert count > 3


def test_a_target_outside_the_limits_is_refused_before_anything_moves() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(OutsideLimits):
            await rig.navigator.center(rig.up(175.0, 0.0))
        assert "slew" not in rig.mount.received
        assert rig.entries(EntryKind.REFUSAL)

    in_virtual_time(work)


def test_what_limit_comes_while_it_is_followed_is_told() -> None:
    asked = {"planned_s": 4 * 3600.0}
    report, _, _ = centered(40.0, 5.0, asked=asked)
    assert report.crossing is not None
    assert report.crossing.limit is LimitKind.ALTITUDE
    assert report.crossing.words in report.notes
    machine = Machine(mounting="german")
    limits = Limits(min_altitude_deg=15.0, past_meridian_deg=(5.0, 5.0))
    german, _, _ = centered(-20.0, 30.0, asked=asked, machine=machine, limits=limits)
    assert german.crossing is not None
    assert german.crossing.limit is LimitKind.MERIDIAN
    assert "change sides" in german.crossing.words
    assert german.side is PierSide.WEST


def test_the_policy_of_correcting_is_the_operators() -> None:
    report, _, rig = centered(-20.0, 30.0, policy=replace(POLICY, correct_by=CorrectBy.OFFSET))
    assert report.tries[0].correction is Correction.OFFSET
    assert "sync" not in rig.mount.received


def steps_of_a_centering() -> list[str]:
    """Every step that a centering comes by, in order."""
    names: list[str] = []

    async def work(rig: VirtualRig) -> None:
        target = rig.up(-20.0, 30.0)
        with watching_kill_points(names.append):
            await rig.navigator.center(target)

    in_virtual_time(work)
    return names


@pytest.mark.long
def test_cancelled_at_any_step_the_mount_stands_and_nothing_is_lost() -> None:
    names = steps_of_a_centering()
    assert {"centering begin", "look exposed", "slew sent", "sync sent"} <= set(names)
    for at in range(len(names)):

        async def work(rig: VirtualRig, at: int = at) -> None:
            target = rig.up(-20.0, 30.0)
            count = 0

            def cancel(name: str) -> None:
                nonlocal count
                count += 1
                if count == at + 1:
                    running.cancel()

            running = asyncio.ensure_future(rig.navigator.center(target))
            with watching_kill_points(cancel):
                try:
                    await running
                except asyncio.CancelledError:
                    pass
                else:
                    # the last steps come after the last thing that could be cancelled
                    assert at >= len(names) - 3
            assert rig.navigator.activity == "idle"
            assert not rig.mechanics.slewing()
            assert not rig.journal.in_flight
            assert rig.entries(EntryKind.CENTERING)

        in_virtual_time(work)
