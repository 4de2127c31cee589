"""German mounts: a flip centers the target again, and the solved rotation checks the side."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest

from drivers.simulated.behavior import MountBehavior
from mountnav.devices import PierSide
from mountnav.errors import NotReached, OutsideLimits, SyncRefused, TargetNotReached
from mountnav.journal.records import EntryKind
from mountnav.pointing.limits import Limits
from mountnav.simulation.machine import Machine
from tests.navigation.virtual_rig import ERRORS, VirtualRig, in_virtual_time

GERMAN = Machine(mounting="german")
CONE = replace(ERRORS, ch_arcsec=600.0, np_arcsec=250.0)
LIMITS = Limits(min_altitude_deg=15.0)


@pytest.mark.long
def test_a_target_is_centered_anew_after_a_flip() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-3.0, 30.0)
        before = await rig.navigator.center(target)
        assert before.side is PierSide.WEST
        assert not before.flipped
        # an hour later it stands west of the meridian: the mount changes sides when it is sent there again
        await rig.clock.sleep(3600.0)
        after = await rig.navigator.flip(target)
        assert after.flipped
        assert after.side is PierSide.EAST
        # the sync from before was worth nothing: twice the cone error, and the target was centered again
        assert after.error_before_arcsec > 600.0
        assert rig.off_arcsec(target) < 31.0
        assert rig.told("flipped")
        assert any("changed sides" in note for note in after.notes)

    in_virtual_time(work, machine=GERMAN, errors=CONE, limits=LIMITS)


def test_a_flip_that_did_not_happen_is_told() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 30.0)
        await rig.navigator.center(target)
        with pytest.raises(TargetNotReached) as end:
            await rig.navigator.flip(target)
        assert end.value.reason is NotReached.SIDE
        assert rig.off_arcsec(target) < 31.0

    in_virtual_time(work, machine=GERMAN, errors=CONE, limits=LIMITS)


def test_the_side_is_verified_by_the_rotation_on_both_sides() -> None:
    async def work(rig: VirtualRig) -> None:
        seen = []
        for ha_deg in (-40.0, -30.0, -20.0, -10.0, 20.0, 40.0):
            report = await rig.navigator.center(rig.up(ha_deg, 30.0))
            seen.append((report.side, report.side_seen))
        # after some solves the camera's angle is known, and tells the side by itself
        assert seen[-3:] == [
            (PierSide.WEST, PierSide.WEST),
            (PierSide.EAST, PierSide.EAST),
            (PierSide.EAST, PierSide.EAST),
        ]

    in_virtual_time(work, machine=GERMAN, errors=CONE, limits=LIMITS)


def test_a_misreported_side_is_told_and_not_synced_on() -> None:
    async def work(rig: VirtualRig) -> None:
        for ha_deg in (-50.0, -40.0, -30.0, -20.0):
            await rig.navigator.center(rig.up(ha_deg, 30.0))
        rig.mount.behavior = replace(rig.mount.behavior, side_swapped=True)
        syncs = rig.mount.received.count("sync")
        target = rig.up(-35.0, 20.0)
        report = await rig.navigator.center(target)
        assert rig.off_arcsec(target) < 31.0
        assert report.side is PierSide.EAST
        assert report.side_seen is PierSide.WEST
        assert any("image's rotation" in note for note in report.notes)
        assert rig.mount.received.count("sync") == syncs

    in_virtual_time(work, machine=GERMAN, errors=CONE, limits=LIMITS, behavior=MountBehavior())


def test_limits_that_go_by_a_misreported_side_name_the_setting_that_mends_it() -> None:
    async def refused(rig: VirtualRig) -> None:
        rig.mount.behavior = replace(rig.mount.behavior, side_swapped=True)
        with pytest.raises(OutsideLimits, match=r"past the meridian .* set swap_sides"):
            await rig.navigator.center(rig.up(-50.0, 30.0))

    async def mended(rig: VirtualRig) -> float:
        # what that setting does, of a mount without a driver
        target = rig.up(-50.0, 30.0)
        await rig.navigator.center(target)
        return rig.off_arcsec(target)

    limits = replace(LIMITS, past_meridian_deg=(10.0, 10.0))
    in_virtual_time(refused, machine=GERMAN, errors=CONE, limits=limits)
    assert in_virtual_time(mended, machine=GERMAN, errors=CONE, limits=limits) < 31.0


@pytest.mark.long
def test_a_correction_between_frames_changes_no_sides() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-3.0, 30.0)
        await rig.navigator.center(target)
        await rig.clock.sleep(1800.0)
        look = await rig.navigator.look()
        sent = list(rig.mount.received)
        for by in ("offset", "sync"):
            with pytest.raises(SyncRefused, match="other side"):
                await rig.navigator.correct(look, by=by, target=target, key=by)
        assert rig.mount.received == sent
        report = await rig.navigator.flip(target)
        assert report.flipped
        await rig.navigator.correct(await rig.navigator.look(), by="offset", target=target)
        assert rig.off_arcsec(target) < 15.0

    in_virtual_time(work, machine=GERMAN, errors=CONE, limits=LIMITS)


@pytest.mark.long
@pytest.mark.parametrize("ha_deg", [-60.0, -17.0, 5.0, 38.0])
def test_near_the_pole_a_german_mount_centers_or_says_why(ha_deg: float) -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(ha_deg, 89.6)
        with contextlib.suppress(TargetNotReached):
            await rig.navigator.center(target, max_tries=8)
        (entry,) = rig.entries(EntryKind.CENTERING)
        if entry.facts["outcome"] == "centered":
            assert rig.off_arcsec(target) < 31.0
        else:
            assert entry.facts["reason"] == NotReached.POLE

    in_virtual_time(work, machine=GERMAN, limits=LIMITS)


def test_a_fork_at_89_9_is_centered_after_a_sync_below_the_pole() -> None:
    # 500″ of the declination's zero point are a hole round the pole; synced 10° below, it is gone
    async def work(rig: VirtualRig) -> None:
        target = rig.up(10.0, 89.9)
        report = await rig.navigator.center(target, max_tries=8, tolerance_arcsec=15.0)
        assert rig.off_arcsec(target) < 16.0
        assert report.tries[-1].why == "centered"

    in_virtual_time(work, errors=replace(ERRORS, id_arcsec=-900.0, ch_arcsec=60.0))
