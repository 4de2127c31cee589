"""The first night of a telescope that was set up by eye: one order, and every refusal leads to it."""

from __future__ import annotations

import math

import pytest

from benchmarks.worse_worlds import Outcome, lived
from drivers.simulated.behavior import MountBehavior
from mountnav.devices import PierSide
from mountnav.errors import OffsetTooLarge, SyncDoubt, SyncRefused
from mountnav.pointing.offset import TooFarToSync
from mountnav.simulation.machine import Machine
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time


def off(degrees: float, turn_deg: float) -> PointingErrors:
    turn = math.radians(turn_deg)
    return PointingErrors(
        ih_arcsec=3600.0 * degrees * math.cos(turn), id_arcsec=3600.0 * degrees * math.sin(turn)
    )


@pytest.mark.long
@pytest.mark.parametrize("turn_deg", [30.0, 150.0, 270.0])
@pytest.mark.parametrize("starts_at", ["home", "zenith"])
def test_a_new_german_mount_succeeds_by_one_order(turn_deg: float, starts_at: str) -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 40.0)
        with pytest.raises(TooFarToSync, match="first light") as refusal:
            await rig.navigator.center(target)
        assert SyncDoubt.TOO_FAR in refusal.value.doubts
        # what used to refer to each other in a circle names the way out
        with pytest.raises(SyncRefused, match="first light"):
            await rig.navigator.recover()
        assert "sync" not in rig.mount.received
        report = await rig.navigator.first_light()
        assert report.first.offset.total_arcsec > 2.0 * 3600.0
        assert rig.mount.received.count("sync") == 1
        truth = rig.mechanics.truth(report.last.mid_exposure_utc)
        assert separation_arcsec(report.last.seen, truth) < 5.0
        assert report.last.offset.total_arcsec < 60.0
        assert rig.navigator.learned.normal is not None
        await rig.navigator.center(target)
        assert rig.off_arcsec(target) < 31.0

    machine = Machine(mounting="german", starts_at=starts_at)  # type: ignore[arg-type]
    in_virtual_time(work, errors=off(4.5, turn_deg), machine=machine)


def test_a_mount_in_the_wrong_posture_is_found_out_by_a_small_move() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.slew(rig.up(-30.0, 40.0))
        # somebody has put the tube over by hand: it looks at the same place, on the other side of the pier
        turned_over(rig)
        with pytest.raises(SyncRefused, match="in the opposite direction") as refusal:
            await rig.navigator.first_light()
        assert SyncDoubt.WRONG_SIDE in refusal.value.doubts
        assert "sync" not in rig.mount.received

    in_virtual_time(work, errors=off(0.5, 20.0), machine=Machine(mounting="german"))


def turned_over(rig: VirtualRig) -> None:
    """Let the mount believe the other posture of the place at which it looks, by a sync in that posture."""
    mechanics = rig.mechanics
    before = mechanics.pier_side()
    other = PierSide.WEST if before is PierSide.EAST else PierSide.EAST
    place = icrs_to_apparent(mechanics.truth(), rig.clock.utc())
    with mechanics._order(moves=False) as order:
        from dataclasses import replace

        from mountnav.simulation.belief import Belief, believing
        from mountnav.simulation.posture import axes_at
        from mountnav.sky.sphere import half_turn_deg

        t_s, motion = order.t_s, order.motion
        belief: Belief = motion.belief_at(t_s)
        ha_deg, dec_deg = mechanics._encoders(motion, belief, t_s)
        wanted = axes_at(
            *belief.hour_angle(place, order.utc, t_s), mechanics.machine, other, belief.site.latitude_deg
        )
        turned = replace(
            belief,
            ha_sync_deg=half_turn_deg(wanted[0] - ha_deg),
            dec_sync_deg=half_turn_deg(wanted[1] - dec_deg),
        )
        order.motion = replace(motion, beliefs=believing(motion.beliefs, t_s, lambda one: turned))
    assert mechanics.pier_side() is other


def test_further_off_than_any_setting_up_is_refused_with_what_to_do() -> None:
    machine = Machine(mounting="german", starts_at="zenith")

    async def work(rig: VirtualRig) -> None:
        sent = list(rig.mount.received)
        with pytest.raises(OffsetTooLarge, match="clock, time zone and longitude"):
            await rig.navigator.first_light()
        assert rig.mount.received == sent

    in_virtual_time(work, errors=PointingErrors(ih_arcsec=20.0 * 3600.0), machine=machine)


@pytest.mark.long
def test_drawn_new_telescopes_come_to_their_targets() -> None:
    outcome = Outcome("new-telescope")
    for seed in (2, 3):
        lived("new-telescope", seed, outcome)
    assert not outcome.wrong
    assert not outcome.lost
    assert outcome.results["centered"] + outcome.results["by the way out"] + outcome.results["outside"] == 6


def test_a_german_mount_that_tells_no_side_finds_its_way_out_after_a_lost_link() -> None:
    """Nobody knows its posture from its words: recover names first light, which sees it by a small move."""

    async def work(rig: VirtualRig) -> None:
        target = rig.up(-30.0, 40.0)
        await rig.navigator.slew(rig.up(-30.0, 35.0))
        rig.navigator.mount.distrust("its link was lost")
        with pytest.raises(SyncRefused, match="first light"):
            await rig.navigator.recover()
        assert "sync" not in rig.mount.received
        await rig.navigator.first_light()
        assert rig.navigator.mount.trusted
        await rig.navigator.center(target)
        assert rig.off_arcsec(target) < 31.0

    in_virtual_time(
        work,
        errors=off(0.5, 20.0),
        machine=Machine(mounting="german"),
        behavior=MountBehavior(tells_side=False),
    )
