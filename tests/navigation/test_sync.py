"""Sync transactions over the real driver, judged by the truth: committed, refused, ignored, late, undone."""

from __future__ import annotations

import asyncio
import random
from dataclasses import replace
from datetime import timedelta
from typing import Any

import pytest

from mountnav.devices import MountReading, PierSide, SyncOutcome, SyncResult
from mountnav.errors import (
    DeviceError,
    DeviceRefused,
    JournalFailed,
    OffsetTooLarge,
    SolveFailed,
    SyncDoubt,
    SyncIgnored,
    SyncRefused,
)
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import CommandRecord, Entry, EntryKind
from mountnav.mount.kill_points import watching_kill_points
from mountnav.navigation.learned import Learned, LessonKind
from mountnav.navigation.reports import Look
from mountnav.navigation.sync import GuardedSync, SyncTrigger
from mountnav.navigation.sync_policy import SyncPolicy, SyncRule
from mountnav.navigation.sync_transaction import SyncUndone, UndoFailed, turned_over
from mountnav.pointing.model.in_force import Expected
from mountnav.pointing.offset import TooFarToSync
from mountnav.simulation.mechanics import PointingErrors
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, displaced, separation_arcsec
from mountnav.solution import MOVED_KEY
from tests.navigation.sync_rig import CAMERA_DEG, SCALE, HeardPointing, SureModel, SyncRig, rigged

ANYWHERE = SyncPolicy(confirm=False, min_pole_deg=0.0, max_turn_arcsec=1e9)
VERIFYING = SyncPolicy(verify=True, confirm=False)


async def pointed(rig: SyncRig, ha_deg: float = 20.0, dec_deg: float = 30.0) -> Look:
    await rig.slew(rig.up(ha_deg, dec_deg))
    return await rig.look()


# -- committed -------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", [(20.0, 30.0), (-40.0, -5.0), (60.0, 75.0), (-10.0, 89.0)])
@pytest.mark.parametrize("dialect", ["onstep", pytest.param("lx200gps", marks=pytest.mark.long)])
def test_a_sync_makes_the_mount_believe_the_truth(place: tuple[float, float], dialect: str) -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig, *place)
        before, segment = await rig.off_arcsec(), rig.mount.segment_id
        assert before > 500.0
        report = await rig.guard.commit(found, SyncTrigger.CENTERING, target="M13")
        assert report.outcome is SyncOutcome.SEEN
        assert await rig.off_arcsec() < 2.0 + rig.mount.resolution_arcsec
        assert rig.syncs == 1
        assert rig.mount.segment_id != segment
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        told, synced = pointing.segments[-1]
        assert told == rig.mount.segment_id
        assert synced is not None
        assert synced.seen == found.seen
        assert synced.segment_id == told
        (decision,), (end,) = rig.decisions(), rig.notes(EntryKind.SYNC)
        assert decision.utc < end.utc
        assert {"outcome", "seen_as"} & set(decision.facts) == set()
        assert end.facts["outcome"] == "committed"
        assert end.facts["offset_arcsec"] == pytest.approx(before, rel=0.05)
        assert end.cause.look_id == found.look_id
        (command,) = [one for one in rig.journal.commands if one.order == "sync"]
        assert decision.utc <= command.utc <= end.utc

    rigged(work, dialect=dialect, policy=ANYWHERE)


def test_a_decision_that_is_handed_on_is_not_judged_once_more() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        decision = rig.guard.consider(found, SyncTrigger.CENTERING)
        assert decision.allowed
        # judged now it would be refused: by the rule
        rig.guard.policy = SyncPolicy(rule=SyncRule.NEVER, confirm=False)
        with pytest.raises(SyncRefused):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        report = await rig.guard.commit(found, SyncTrigger.CENTERING, decision=decision)
        assert report.outcome is SyncOutcome.SEEN
        assert rig.syncs == 1

    rigged(work)


def test_a_decision_that_is_handed_on_does_not_hide_a_mount_that_moved_since() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        decision = rig.guard.consider(found, SyncTrigger.CENTERING)
        await rig.slew(rig.up(20.0, 31.0))
        with pytest.raises(SyncRefused) as refusal:
            await rig.guard.commit(found, SyncTrigger.CENTERING, decision=decision)
        assert refusal.value.doubts == (SyncDoubt.MOVED,)
        assert rig.syncs == 0

    rigged(work)


def test_a_frame_in_which_the_sky_moved_more_than_its_work_allows_is_not_synced_on() -> None:
    async def work(rig: SyncRig) -> None:
        found = replace(await pointed(rig), tolerance_arcsec=10.0)
        half_px = 10.0 / found.solution.scale_arcsec_px
        moved = replace(found, verdict=replace(found.verdict, numbers={MOVED_KEY: half_px}))
        assert moved.sky_moved_arcsec == pytest.approx(20.0)
        with pytest.raises(SyncRefused) as refusal:
            await rig.guard.commit(moved, SyncTrigger.ORDERED)
        assert refusal.value.doubts == (SyncDoubt.UNSURE,)
        assert rig.syncs == 0
        # a slew that corrects is looked at again: that is left open
        assert not rig.guard.consider(moved, SyncTrigger.CENTERING).against_the_sky
        # for a coarser work it is good enough, and its error is told
        coarse = replace(moved, tolerance_arcsec=30.0)
        assert rig.guard.consider(coarse, SyncTrigger.CENTERING).allowed
        assert coarse.sigma_arcsec == pytest.approx(10.0, abs=0.5)

    rigged(work)


def test_the_facts_of_a_sync_grow_in_the_order_in_which_things_happened() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        again = rig.look
        await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=again)
        (end,) = rig.notes(EntryKind.SYNC)
        names = list(end.facts)
        assert names[:3] == ["occasion", "target", "look_id"]
        order = ["confirmed_by", "segment_before", "seen_as", "verified_by", "outcome", "segment_after"]
        assert [name for name in names if name in order] == order
        assert end.facts["segment_before"] != end.facts["segment_after"] == rig.mount.segment_id

    rigged(work, policy=SyncPolicy(verify=True))


def test_a_frame_from_before_the_sync_never_doubles_it() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        await rig.guard.commit(found, SyncTrigger.ORDERED)
        with pytest.raises(SyncRefused) as refusal:
            await rig.guard.commit(found, SyncTrigger.ORDERED)
        assert refusal.value.doubts[0] is SyncDoubt.OLDER_THAN_MOVE
        assert rig.syncs == 1
        assert await rig.off_arcsec() < 2.0

    rigged(work)


@pytest.mark.long
def test_a_mount_that_was_moved_since_the_frame_is_not_synced() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        await rig.slew(rig.up(20.0, 31.0))
        decision = rig.guard.consider(found, SyncTrigger.CENTERING)
        assert SyncDoubt.OLDER_THAN_MOVE in decision.doubts
        assert SyncDoubt.OLDER_THAN_MOVE in decision.against_the_sky

        # by a hand at its buttons, which we are not told of
        found = await rig.look()
        place = rig.mechanics.reported()
        rig.mechanics.slew(replace(place, dec_deg=place.dec_deg + 0.2))
        await rig.clock.sleep(3.0)
        assert rig.guard.consider(found, SyncTrigger.CENTERING).allowed
        with pytest.raises(SyncRefused) as refusal:
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert refusal.value.doubts == (SyncDoubt.MOVED,)
        assert rig.syncs == 0

        # or told of late
        fresh = await rig.look()
        assert rig.guard.consider(fresh, SyncTrigger.ORDERED).allowed
        rig.guard.note_move(rig.clock.utc())
        assert rig.guard.consider(fresh, SyncTrigger.ORDERED).doubts == (SyncDoubt.OLDER_THAN_MOVE,)
        await rig.clock.sleep(200.0)
        assert SyncDoubt.TOO_OLD in rig.guard.consider(fresh, SyncTrigger.ORDERED).doubts

    rigged(work)


# -- refused by us -----------------------------------------------------------------------------------


def test_a_refusal_is_named_written_and_sends_nothing() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        with pytest.raises(SyncRefused, match="never sync") as refusal:
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert refusal.value.doubts == (SyncDoubt.POLICY_NEVER,)
        assert "sync.rule" in str(refusal.value.advice)
        assert rig.syncs == 0
        (row,) = rig.notes(EntryKind.REFUSAL)
        assert row.facts["doubts"] == ["policy-never"]
        assert rig.decisions() == []
        assert rig.told("sync-refused")[0]["doubts"] == ["policy-never"]
        # what is ordered by name doesn't ask for the rule
        await rig.guard.commit(await rig.look(), SyncTrigger.ORDERED)
        assert rig.syncs == 1

    rigged(work, policy=SyncPolicy(rule=SyncRule.NEVER, confirm=False))


def test_the_cap_on_the_size_is_the_old_error_too() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        with pytest.raises(OffsetTooLarge) as refusal:
            await rig.guard.commit(found, SyncTrigger.ORDERED)
        assert isinstance(refusal.value, TooFarToSync)
        assert isinstance(refusal.value, SyncRefused)
        assert refusal.value.slug == "offset-too-large"
        assert rig.syncs == 0

    rigged(work, policy=SyncPolicy(max_arcsec=120.0))


def test_counting_rules_over_a_night_and_a_restart() -> None:
    async def work(rig: SyncRig) -> None:
        for place, name, allowed in (
            ((20.0, 30.0), "one", True),
            ((20.0, 30.0), "one", False),
            ((40.0, 10.0), "two", True),
            ((20.0, 30.0), "one", False),
        ):
            found = await pointed(rig, *place)
            decision = rig.guard.consider(found, SyncTrigger.NIGHT, target=name)
            assert decision.allowed is allowed, decision
            if allowed:
                await rig.guard.commit(found, SyncTrigger.NIGHT, target=name)
        reborn = SyncRig(rig.clock, {"policy": rig.policy}).guard
        reborn.restore(rig.journal.entries)
        doubts = reborn.consider(found, SyncTrigger.NIGHT, target="one").doubts
        assert SyncDoubt.SAME_TARGET in doubts
        assert SyncDoubt.SAME_TARGET not in reborn.consider(found, SyncTrigger.NIGHT, target="three").doubts
        rig.clock.now_s += 24 * 3600.0
        assert SyncDoubt.SAME_TARGET not in rig.guard.consider(found, SyncTrigger.NIGHT, target="one").doubts

    rigged(work, policy=SyncPolicy(rule=SyncRule.PER_TARGET, confirm=False))


def test_first_of_night() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.guard.commit(await pointed(rig), SyncTrigger.NIGHT)
        found = await pointed(rig, 40.0, 10.0)
        assert rig.guard.consider(found, SyncTrigger.NIGHT).doubts == (SyncDoubt.NOT_FIRST,)
        assert rig.guard.consider(found, SyncTrigger.ORDERED).allowed

    rigged(work, policy=SyncPolicy(rule=SyncRule.FIRST_OF_NIGHT, confirm=False))


# -- false solutions ---------------------------------------------------------------------------------


@pytest.mark.long
def test_false_solutions_are_never_committed_and_teach_nothing() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.taught()
        await rig.guard.commit(await pointed(rig), SyncTrigger.CENTERING)
        await rig.guard.learn(await rig.look())
        pointing, chance = rig.pointing, random.Random(11)
        assert isinstance(pointing, HeardPointing)
        normal, looks, segments = rig.learned.normal, len(pointing.looks), len(pointing.segments)
        for _ in range(150):
            far = chance.choice([900.0, 2000.0, 5000.0, 20000.0, 300000.0])
            wrong = await rig.look(
                wrong=(chance.gauss(0.0, far), far * chance.choice([-1.0, 1.0])),
                turned_deg=chance.uniform(0.0, 360.0),
                scale_arcsec_px=SCALE * chance.uniform(0.95, 1.05),
                parity=chance.choice([1, -1]),
            )
            lesson = await rig.guard.learn(wrong)
            assert lesson.kind is LessonKind.REFUSED
            with pytest.raises(SyncRefused):
                await rig.guard.commit(wrong, SyncTrigger.CENTERING)
            # and no correction by offset either
            assert rig.guard.consider(wrong, SyncTrigger.CENTERING).against_the_sky
        assert rig.syncs == 1
        assert rig.learned.normal == normal
        assert len(pointing.looks) == looks
        assert len(pointing.segments) == segments
        # what the mount's geometry lets it drift in five minutes
        assert await rig.off_arcsec() < 15.0

    rigged(work)


def test_a_false_solution_with_all_the_right_numbers_is_where_the_model_says_it_cannot_be() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.taught()
        for wrong in ((400.0, 0.0), (0.0, -1500.0), (1500.0, 3000.0)):
            found = await rig.look(wrong=wrong)
            decision = rig.guard.consider(found, SyncTrigger.CENTERING)
            assert decision.doubts == (SyncDoubt.NOT_EXPECTED,), wrong
            assert "the model" in decision.why
        assert rig.guard.consider(await rig.look(wrong=(100.0, 0.0)), SyncTrigger.CENTERING).allowed

    errors = PointingErrors(ih_arcsec=-150.0)
    rigged(work, errors=errors, pointing=SureModel(Expected(Offset(130.0, 0.0), 15.0)))


def test_one_accepted_false_sync_poisons_nothing_for_long() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.taught()
        normal = rig.learned.normal
        await rig.slew(rig.up())
        # nothing is known of this pointing yet, and it looks perfect: it is believed
        false = await rig.look(wrong=(3000.0, 4000.0))
        await rig.guard.commit(false, SyncTrigger.ORDERED)
        assert await rig.off_arcsec() > 4000.0
        lessons = [await rig.guard.learn(await rig.look()) for _ in range(2)]
        assert {one.kind for one in lessons} == {LessonKind.REFUSED}
        assert rig.guard.consider(await rig.look(), SyncTrigger.CENTERING).doubts == (SyncDoubt.NOT_EXPECTED,)
        assert rig.told("zero-points-changed") == []
        # three true looks agree against the one false one
        await rig.guard.learn(await rig.look())
        assert len(rig.told("zero-points-changed")) == 1
        assert any("zero points have changed" in row.what for row in rig.notes(EntryKind.FAULT))
        await rig.guard.commit(await rig.look(), SyncTrigger.CENTERING)
        assert await rig.off_arcsec() < 3.0
        assert rig.learned.normal is not None
        assert normal is not None
        assert rig.learned.normal.scale_arcsec_px == normal.scale_arcsec_px
        assert rig.learned.normal.camera_angle_deg == pytest.approx(normal.camera_angle_deg, abs=0.5)

    rigged(work)


@pytest.mark.parametrize(
    ("shown", "doubt"),
    [
        ({"scale_arcsec_px": SCALE * 1.03}, SyncDoubt.SCALE),
        ({"parity": -1}, SyncDoubt.PARITY),
        ({"turned_deg": 20.0}, SyncDoubt.ROTATION),
        ({"turned_deg": 180.0}, SyncDoubt.WRONG_SIDE),
        ({"false_probability": 1e-6}, SyncDoubt.ODDS),
        ({"pairs": 3}, SyncDoubt.FEW_STARS),
    ],
)
def test_a_frame_unlike_those_before_is_refused(shown: dict[str, Any], doubt: SyncDoubt) -> None:
    async def work(rig: SyncRig) -> None:
        await rig.taught()
        found = await rig.look(**shown)
        for trigger in SyncTrigger:
            assert rig.guard.consider(found, trigger).doubts == (doubt,)

    rigged(work)


@pytest.mark.long
def test_both_sides_of_the_pier_show_one_camera() -> None:
    async def work(rig: SyncRig) -> None:
        sides = set()
        for ha_deg in (-50.0, 50.0, -20.0, 15.0):
            found = await pointed(rig, ha_deg, 40.0)
            sides.add(found.after.pier_side)
            assert await rig.guard.learn(found)
            assert rig.guard.consider(found, SyncTrigger.ORDERED).allowed
            if rig.learned.normal is not None:
                assert rig.guard.side_seen(found) is found.after.pier_side
        assert sides == {PierSide.EAST, PierSide.WEST}
        assert rig.learned.normal is not None
        assert rig.learned.normal.camera_angle_deg == pytest.approx(CAMERA_DEG, abs=0.5)

        lying = replace(found.after, pier_side=PierSide.WEST)
        misled = replace(found, before=lying, after=lying)
        assert rig.guard.consider(misled, SyncTrigger.RECOVERY).doubts == (SyncDoubt.WRONG_SIDE,)
        assert rig.guard.side_seen(misled) is PierSide.EAST

    rigged(work)


def test_looks_that_agree_on_a_place_too_far_off_make_the_position_count_no_more() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        await rig.taught()
        for number in range(3):
            assert rig.mount.trusted
            found = await rig.look()
            # what the sky has turned away from a mount that was pushed
            lost = replace(
                found, offset=Offset(9000.0, 10.0 * number), seen=displaced(found.believed, 9000.0, 0.0)
            )
            assert (await rig.guard.learn(lost)).kind is LessonKind.REFUSED
        assert not rig.mount.trusted
        # and then one look, however good, doesn't make it count again
        found = await rig.look()
        assert rig.guard.consider(found, SyncTrigger.CENTERING).doubts == (SyncDoubt.NOT_EXPECTED,)
        assert rig.guard.consider(found, SyncTrigger.RECOVERY).allowed
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        looks = len(pointing.looks)
        await rig.guard.learn(found)
        assert len(pointing.looks) == looks

    rigged(work)


# -- a second look before anything is known ----------------------------------------------------------

WARY = SyncPolicy()


def test_the_first_sync_is_confirmed_and_the_next_ones_need_it_no_more() -> None:
    async def work(rig: SyncRig) -> None:
        taken = 0

        async def again() -> Look:
            nonlocal taken
            taken += 1
            found = await rig.look()
            await rig.guard.learn(found)
            return found

        for place in ((20.0, 30.0), (35.0, 45.0), (50.0, 20.0), (60.0, 40.0)):
            await rig.slew(rig.up(*place))
            found = await again()
            taken -= 1
            await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=again)
            assert await rig.off_arcsec() < 3.0
        # before the camera was learned (three solves), and never again
        confirmed = [row.facts.get("confirmed_by") for row in rig.notes(EntryKind.SYNC)]
        assert confirmed == ["look-2", None, None, None]
        assert taken == 1

    rigged(work, policy=WARY)


def test_a_false_first_look_is_not_confirmed_and_never_sent() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        false = await rig.look(wrong=(2500.0, -1500.0))
        await rig.guard.learn(false)
        assert rig.guard.consider(false, SyncTrigger.CENTERING).allowed
        with pytest.raises(SyncRefused, match="apart") as refusal:
            await rig.guard.commit(false, SyncTrigger.CENTERING, look_again=rig.look)
        assert refusal.value.doubts == (SyncDoubt.NOT_EXPECTED,)
        with pytest.raises(SyncRefused, match="no second look"):
            await rig.guard.commit(false, SyncTrigger.CENTERING)

        async def clouds() -> Look:
            raise SolveFailed("clouds")

        with pytest.raises(SyncRefused, match="clouds"):
            await rig.guard.commit(false, SyncTrigger.ORDERED, look_again=clouds)
        # a second false one agrees with nothing either
        other = await rig.look(wrong=(-3000.0, 500.0))

        async def false_again() -> Look:
            return await rig.look(wrong=(1000.0, 4000.0))

        with pytest.raises(SyncRefused):
            await rig.guard.commit(other, SyncTrigger.CENTERING, look_again=false_again)
        assert rig.syncs == 0
        assert len(rig.notes(EntryKind.REFUSAL)) == 4
        assert rig.decisions() == []

    rigged(work, policy=WARY)


def test_a_second_look_is_asked_for_as_long_as_the_camera_is_unknown() -> None:
    async def work(rig: SyncRig) -> None:
        pointing = SureModel(Expected(Offset(-900.0, -300.0), 15.0))
        rig.guard.pointing = pointing
        found = await pointed(rig)
        with pytest.raises(SyncRefused, match="no second look"):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        rig.guard.pointing = HeardPointing()
        await rig.taught(3)
        rig.guard.pointing = pointing
        await rig.guard.commit(await pointed(rig), SyncTrigger.CENTERING)
        assert rig.syncs == 1

    rigged(work, policy=replace(WARY, confirm_above_arcsec=5.0))


def test_frames_of_a_night_confirm_each_other() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        for number in range(3):
            found = await rig.look()
            await rig.guard.learn(found)
            if number == 0:
                with pytest.raises(SyncRefused, match="no second look"):
                    await rig.guard.commit(found, SyncTrigger.NIGHT)
        await rig.guard.commit(found, SyncTrigger.NIGHT)
        assert rig.notes(EntryKind.SYNC)[0].facts["confirmed_by"] == "look-2"
        assert await rig.off_arcsec() < 3.0

    rigged(work, policy=WARY)


def test_a_small_sync_needs_no_second_look() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.guard.commit(await pointed(rig), SyncTrigger.ORDERED)
        assert rig.syncs == 1

    rigged(work, policy=WARY, errors=PointingErrors(id_arcsec=100.0))


# -- mounts that take syncs badly --------------------------------------------------------------------


def test_an_ignored_sync_is_named_and_remembered_for_the_night() -> None:
    async def work(rig: SyncRig) -> None:
        rig.mechanics.sync_behavior = "ignore"
        found = await pointed(rig)
        segments = len(rig.notes(EntryKind.SEGMENT))
        with pytest.raises(SyncIgnored):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert rig.syncs == 1
        assert rig.guard.prefers_offset
        (row,) = rig.notes(EntryKind.SYNC)
        assert row.facts["outcome"] == "ignored by the mount"
        assert len(rig.notes(EntryKind.SEGMENT)) == segments
        reborn = SyncRig(rig.clock, {}).guard
        reborn.restore(rig.journal.entries)
        assert reborn.prefers_offset
        rig.guard.reconnected()
        assert not rig.guard.prefers_offset
        rig.clock.now_s += 24 * 3600.0
        assert not reborn.prefers_offset

    rigged(work)


def test_a_refused_sync_is_raised_as_it_is() -> None:
    async def work(rig: SyncRig) -> None:
        rig.mechanics.sync_behavior = "refuse"
        found = await pointed(rig)
        before = await rig.off_arcsec()
        with pytest.raises(DeviceRefused):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert rig.guard.prefers_offset
        assert rig.notes(EntryKind.SYNC)[0].facts["outcome"] == "refused by the mount"
        assert await rig.off_arcsec() == pytest.approx(before, abs=2.0)

    rigged(work)


@pytest.mark.parametrize("late_s", [2.0, 5.0])
def test_a_late_sync_is_waited_for(late_s: float) -> None:
    async def work(rig: SyncRig) -> None:
        rig.mechanics.sync_behavior, rig.mechanics.sync_late_s = "late", late_s
        found = await pointed(rig)
        segment = rig.mount.segment_id
        report = await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert report.outcome is SyncOutcome.LATE
        assert await rig.off_arcsec() < 3.0
        assert not rig.guard.prefers_offset
        assert rig.mount.segment_id != segment

    rigged(work)


def test_a_sync_that_comes_later_than_it_is_waited_for_never_doubles_a_correction() -> None:
    async def work(rig: SyncRig) -> None:
        rig.mechanics.sync_behavior, rig.mechanics.sync_late_s = "late", 25.0
        found = await pointed(rig)
        with pytest.raises(SyncIgnored):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        # a look while it hangs in the air, and it comes before that is acted on
        between = await rig.look()
        await rig.clock.sleep(30.0)
        assert await rig.off_arcsec() < 3.0
        decision = rig.guard.consider(between, SyncTrigger.ORDERED)
        assert SyncDoubt.OLDER_THAN_MOVE in decision.doubts
        assert rig.syncs == 1
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        assert pointing.segments[-1][0] == rig.mount.segment_id
        # what is seen now is right, and nothing is to be corrected
        assert rig.guard.consider(await rig.look(), SyncTrigger.CENTERING).doubts == (
            SyncDoubt.NOT_OFF_ENOUGH,
        )

    rigged(work)


def test_a_lost_link_leaves_the_outcome_unknown() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)

        write = rig.line.write

        async def pulled(data: bytes) -> None:
            await write(data)
            if b":CM" in data:
                await asyncio.sleep(0.01)
                rig.line._lose("the cable was pulled")

        rig.line.write = pulled  # type: ignore[method-assign]
        with pytest.raises(DeviceError):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        (row,) = rig.notes(EntryKind.SYNC)
        assert row.facts["outcome"] == "unknown"
        assert rig.syncs == 1
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        assert pointing.segments[-1] == (rig.mount.segment_id, None)
        assert not rig.guard.prefers_offset
        assert SyncDoubt.OLDER_THAN_MOVE in rig.guard.consider(found, SyncTrigger.ORDERED).doubts

    rigged(work)


# -- verified, and taken back ------------------------------------------------------------------------


def test_a_verified_sync_is_committed_with_its_second_look() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=rig.look)
        (row,) = rig.notes(EntryKind.SYNC)
        assert row.facts["outcome"] == "committed"
        assert row.facts["verified_by"] == "look-2"
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        assert pointing.looks[-1].look_id == "look-2"
        assert await rig.off_arcsec() < 2.0

    rigged(work, policy=VERIFYING)


@pytest.mark.parametrize("dialect", [pytest.param("onstep", marks=pytest.mark.long), "lx200gps"])
@pytest.mark.parametrize("place", [(20.0, 30.0), (-40.0, 70.0), (10.0, 88.5)])
def test_a_contradicted_sync_is_taken_back(dialect: str, place: tuple[float, float]) -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up(*place))
        before = await rig.off_arcsec()
        false = await rig.look(wrong=(2500.0, -1500.0))
        with pytest.raises(SyncUndone, match="was undone") as undone:
            await rig.guard.commit(false, SyncTrigger.CENTERING, target="M1", look_again=rig.look)
        assert isinstance(undone.value, SyncRefused)
        assert rig.syncs == 2
        # the mount believes what it did before, not the truth
        assert await rig.off_arcsec() == pytest.approx(before, abs=3.0 + 2.0 * rig.mount.resolution_arcsec)
        (row,) = rig.notes(EntryKind.SYNC)
        assert row.facts["outcome"] == "undone"
        assert "contradiction" in row.facts
        assert rig.guard.prefers_offset
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        assert pointing.segments[-1] == (rig.mount.segment_id, None)
        assert [one for one in pointing.segments if one[1] is not None] == []
        # it counts as no sync
        assert row.facts["syncs_tonight"] == 0
        found = await rig.look()
        assert rig.guard._judge.context(found, SyncTrigger.NIGHT, "M1").counts.tonight == 0

    rigged(work, policy=replace(ANYWHERE, verify=True), dialect=dialect)


def test_a_sync_that_cannot_be_verified_is_taken_back() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        before = await rig.off_arcsec()

        async def clouds() -> Look:
            raise SolveFailed("clouds")

        with pytest.raises(SyncUndone, match="clouds"):
            await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=clouds)
        # clouds say nothing of how the mount takes syncs
        assert not rig.guard.prefers_offset
        assert await rig.off_arcsec() == pytest.approx(before, abs=3.0)

        async def the_same() -> Look:
            return found

        found = await rig.look()
        with pytest.raises(SyncUndone):
            await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=the_same)

    rigged(work, policy=VERIFYING)


def test_a_sync_that_cannot_be_taken_back_leaves_the_position_untrusted() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        false = await rig.look(wrong=(2500.0, -1500.0))

        async def look_and_turn_deaf() -> Look:
            rig.mechanics.sync_behavior = "ignore"
            return await rig.look()

        with pytest.raises(UndoFailed, match="could not be undone"):
            await rig.guard.commit(false, SyncTrigger.CENTERING, look_again=look_and_turn_deaf)
        assert not rig.mount.trusted
        (fault,) = [row for row in rig.notes(EntryKind.FAULT) if "undone" in row.what]
        assert fault.facts["contradiction"]
        assert rig.notes(EntryKind.SYNC)[0].facts["outcome"] == "undo failed"
        with pytest.raises(DeviceRefused):
            await rig.slew(rig.up(10.0, 20.0))
        # two frames that agree make it count again
        rig.mechanics.sync_behavior = "normal"
        await rig.guard.commit(await rig.look(), SyncTrigger.RECOVERY, look_again=rig.look)
        assert rig.mount.trusted
        assert await rig.off_arcsec() < 3.0

    rigged(work, policy=VERIFYING)


def test_a_look_that_could_be_chance_verifies_nothing() -> None:
    async def work(rig: SyncRig) -> None:
        async def weak() -> Look:
            return await rig.look(false_probability=1e-3)

        with pytest.raises(SyncUndone, match="can't be used") as undone:
            await rig.guard.commit(await pointed(rig), SyncTrigger.CENTERING, look_again=weak)
        assert undone.value.doubts == (SyncDoubt.ODDS,)
        assert rig.syncs == 2

    rigged(work, policy=VERIFYING)


def test_a_mount_that_took_the_sync_for_the_other_side_is_told_its_old_place() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        before = await rig.off_arcsec()
        assert found.after.pier_side is PierSide.EAST
        sync = rig.driver.sync

        async def turns_over(place: Any) -> SyncResult:
            rig.driver.sync = sync  # type: ignore[method-assign]
            result = await sync(place)
            return replace(result, read_back=replace(result.read_back, pier_side=PierSide.WEST))

        rig.driver.sync = turns_over  # type: ignore[method-assign]
        with pytest.raises(SyncUndone, match="east → west") as undone:
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert undone.value.doubts == (SyncDoubt.WRONG_SIDE,)
        assert await rig.off_arcsec() == pytest.approx(before, abs=3.0)

    rigged(work)


def test_a_sync_that_the_driver_had_given_up_begins_a_segment_when_it_shows() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        segment, sync = rig.mount.segment_id, rig.driver.sync

        async def impatient(place: Any) -> SyncResult:
            return replace(await sync(place), outcome=SyncOutcome.IGNORED)

        rig.driver.sync = impatient  # type: ignore[method-assign]
        report = await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert report.outcome is SyncOutcome.LATE
        assert rig.mount.segment_id != segment
        pointing = rig.pointing
        assert isinstance(pointing, HeardPointing)
        assert pointing.segments[-1][0] == rig.mount.segment_id
        assert pointing.segments[-1][1] is not None

    rigged(work)


def test_trust_that_a_wrong_sync_had_brought_is_taken_back_with_it() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        rig.mount.distrust("it was switched on just now")
        false = await rig.look(wrong=(2500.0, -1500.0))
        with pytest.raises(SyncUndone):
            await rig.guard.commit(false, SyncTrigger.RECOVERY, look_again=rig.look)
        assert not rig.mount.trusted

    rigged(work, policy=VERIFYING)


def test_an_undo_is_not_cut_short_by_a_cancel() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        before = await rig.off_arcsec()
        false = await rig.look(wrong=(2500.0, -1500.0))
        task = asyncio.create_task(rig.guard.commit(false, SyncTrigger.CENTERING, look_again=rig.look))

        def cancels(name: str) -> None:
            if name == "sync transaction: undo":
                task.cancel()

        with watching_kill_points(cancels), pytest.raises(asyncio.CancelledError):
            await task
        assert rig.syncs == 2
        assert await rig.off_arcsec() == pytest.approx(before, abs=3.0)
        (row,) = rig.notes(EntryKind.SYNC)
        assert (row.facts["outcome"], row.facts["undone"]) == ("interrupted", True)
        assert rig.mount.trusted

    rigged(work, policy=VERIFYING)


def test_an_undo_that_cannot_be_written_down_is_no_undo() -> None:
    disk = FullDisk()

    async def work(rig: SyncRig) -> None:
        await rig.slew(rig.up())
        false = await rig.look(wrong=(2500.0, -1500.0))

        def fills_up(name: str) -> None:
            if name == "sync transaction: undo":
                disk.full = True

        with watching_kill_points(fills_up), pytest.raises(UndoFailed, match="no space left"):
            await rig.guard.commit(false, SyncTrigger.CENTERING, look_again=rig.look)
        assert rig.syncs == 1
        assert not rig.mount.trusted

    rigged(work, policy=VERIFYING, journal=disk)


def test_a_sync_taken_for_the_other_posture_is_seen() -> None:
    place, utc = Icrs(1.0, 2.0), None

    def reading(side: PierSide | None) -> MountReading:
        return MountReading(place, utc, pier_side=side)  # type: ignore[arg-type]

    assert turned_over(reading(PierSide.EAST), reading(PierSide.EAST)) is None
    assert turned_over(reading(None), reading(PierSide.EAST)) is None
    assert turned_over(reading(PierSide.WEST), reading(PierSide.UNKNOWN)) is None
    assert "west → east" in str(turned_over(reading(PierSide.WEST), reading(PierSide.EAST)))


# -- lost mounts, cancelled work, a broken journal ---------------------------------------------------


def test_a_lost_mount_is_told_where_it_points() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.taught()
        await rig.slew(rig.up())
        truth = rig.mechanics.truth()
        rig.mechanics.sync(icrs_to_apparent(displaced(truth, 50 * 3600.0, -20 * 3600.0), rig.clock.utc()))
        await rig.clock.sleep(3.0)
        assert not rig.mount.trusted
        found = await rig.look()
        assert found.offset.total_arcsec > 40 * 3600.0
        with pytest.raises(TooFarToSync):
            await rig.guard.commit(found, SyncTrigger.CENTERING)
        assert (await rig.guard.learn(found)).kind is LessonKind.REFUSED
        await rig.guard.commit(found, SyncTrigger.RECOVERY)
        assert rig.mount.trusted
        assert await rig.off_arcsec() < 3.0

    rigged(work)


def test_work_that_is_cancelled_after_the_sync_leaves_a_row() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        looking = asyncio.Event()

        async def forever() -> Look:
            looking.set()
            await asyncio.Event().wait()
            raise AssertionError

        task = asyncio.create_task(rig.guard.commit(found, SyncTrigger.CENTERING, look_again=forever))
        await looking.wait()
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        (row,) = rig.notes(EntryKind.SYNC)
        assert row.facts["outcome"] == "interrupted"
        assert SyncDoubt.OLDER_THAN_MOVE in rig.guard.consider(found, SyncTrigger.ORDERED).doubts

    rigged(work, policy=VERIFYING)


class FullDisk(MemoryJournal):
    """A journal whose disk is full when it says so."""

    full = False

    async def note(self, entry: Entry) -> None:
        if self.full:
            raise JournalFailed("no space left")
        await super().note(entry)

    async def begin(self, command: CommandRecord) -> None:
        if self.full:
            raise JournalFailed("no space left")
        await super().begin(command)


def test_what_cannot_be_written_down_is_not_sent() -> None:
    disk = FullDisk()

    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        disk.full = True
        with pytest.raises(JournalFailed):
            await rig.guard.commit(found, SyncTrigger.ORDERED)
        assert rig.syncs == 0
        disk.full = False

        # it fills up while the sync is under way: what happened is told, and not hidden by the disk
        def fills_up(name: str) -> None:
            if name == "sync transaction: over":
                disk.full = True

        with watching_kill_points(fills_up):
            await rig.guard.commit(await rig.look(), SyncTrigger.ORDERED)
        assert await rig.off_arcsec() < 3.0
        assert "sync committed" in str(rig.told("journal-failed")[0]["lost"])

    rigged(work, journal=disk)


@pytest.mark.long
def test_the_process_may_end_at_each_step() -> None:
    """Never two syncs, and none that nobody decided on or that no row tells of."""
    steps: list[str] = []

    class Killed(BaseException):
        pass

    async def once(rig: SyncRig, at: int | None) -> None:
        found = await pointed(rig)
        reached: list[str] = []

        def watch(name: str) -> None:
            if name in ("sync end", "sync ended"):
                # the mount's book is closed by a task of its own
                return
            reached.append(name)
            if at is not None and len(reached) == at + 1:
                raise Killed(name)

        with watching_kill_points(watch):
            if at is None:
                await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=rig.look)
                steps.extend(reached)
            else:
                with pytest.raises(Killed):
                    await rig.guard.commit(found, SyncTrigger.CENTERING, look_again=rig.look)
        assert rig.syncs <= 1
        decided, begun = rig.decisions(), [one for one in rig.journal.commands if one.order == "sync"]
        assert len(begun) <= len(decided) <= 1
        assert rig.syncs <= len(begun)

    rigged(lambda rig: once(rig, None), policy=VERIFYING)
    assert len(steps) >= 8
    for number in range(len(steps)):
        rigged(lambda rig, number=number: once(rig, number), policy=VERIFYING)  # type: ignore[misc]


def test_a_camera_that_is_turned_is_learned_anew_and_told() -> None:
    async def work(rig: SyncRig) -> None:
        await rig.taught()
        assert len(rig.notes(EntryKind.LEARNED)) == 1
        for _ in range(4):
            assert (await rig.guard.learn(await rig.look(turned_deg=50.0))).kind is LessonKind.ASIDE
        last = await rig.look(turned_deg=50.0)
        assert rig.guard.consider(last, SyncTrigger.ORDERED).doubts == (SyncDoubt.ROTATION,)
        assert (await rig.guard.learn(last)).kind is LessonKind.NEW_NORMAL
        assert rig.guard.consider(last, SyncTrigger.ORDERED).allowed
        assert "33.0° → 83.0°" in str(rig.told("camera-changed")[0]["words"])
        reborn = SyncRig(rig.clock, {"learned": Learned(mounting="german")}).guard
        reborn.restore([replace(row, telescope="another") for row in rig.journal.entries])
        assert reborn.learned.normal is None
        reborn.restore(rig.journal.entries)
        assert reborn.learned.normal == rig.learned.normal

    # near the zenith, where the camera angle is what the errors leave of it
    rigged(work, errors=PointingErrors(id_arcsec=300.0))


def test_the_policy_and_the_model_may_be_exchanged() -> None:
    async def work(rig: SyncRig) -> None:
        found = await pointed(rig)
        guard: GuardedSync = rig.guard
        assert guard.consider(found, SyncTrigger.CENTERING).allowed
        guard.pointing = SureModel(Expected(Offset(9000.0, 0.0), 1.0))
        assert guard.consider(found, SyncTrigger.CENTERING).doubts == (SyncDoubt.NOT_EXPECTED,)
        guard.pointing = HeardPointing()
        guard.policy = SyncPolicy(min_altitude_deg=85.0)
        assert guard.consider(found, SyncTrigger.CENTERING).doubts == (SyncDoubt.TOO_LOW,)
        assert separation_arcsec(found.seen, rig.mechanics.truth()) < 30.0
        assert timedelta(0) < rig.clock.utc() - found.mid_exposure_utc

    rigged(work)
