"""Fields brought to position angles, in virtual time, judged by how the simulated camera truly stands."""

from __future__ import annotations

import asyncio
import random
from datetime import timedelta

import pytest

from benchmarks.aiming import true_place
from mountnav.devices import PierSide
from mountnav.errors import BadRequest, Cancelled, DeviceRefused, NotReached, Refusal, TargetNotReached
from mountnav.navigation.aim_points import PixelPoint
from mountnav.navigation.camera import apart_deg
from mountnav.navigation.rotating import FieldAngle
from mountnav.navigation.rotator import RotatorRules
from mountnav.simulation.machine import Machine
from mountnav.simulation.rotator_mechanics import RotatorBehavior
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time

GERMAN = Machine(mounting="german")
PLAIN = RotatorBehavior()
FREE = RotatorRules(0.0, 360.0)


def moves(rig: VirtualRig) -> bool:
    assert rig.rotates is not None
    return rig.rotates.moving


def wrong_deg(rig: VirtualRig, wanted_deg: float, modulo_deg: float = 360.0) -> float:
    return abs(apart_deg(rig.turned_deg, wanted_deg, modulo_deg))


@pytest.mark.long
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("ha_deg", [20.0, -20.0])
@pytest.mark.parametrize("wanted_deg", [0.0, 123.4, 359.0])
def test_a_target_is_centered_with_a_position_angle(sense: int, ha_deg: float, wanted_deg: float) -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(ha_deg, 35.0)
        report = await rig.navigator.center(target, angle=FieldAngle(wanted_deg))
        assert wrong_deg(rig, wanted_deg) <= 0.55
        assert rig.off_arcsec(target) <= report.tolerance_arcsec + 3.0
        rotation = report.rotation
        assert rotation is not None
        assert abs(rotation.off_deg) <= 0.5
        assert rotation.sense == sense
        assert apart_deg(rotation.after_deg, rig.turned_deg) == pytest.approx(0.0, abs=0.05)

    in_virtual_time(work, machine=GERMAN, rotates=RotatorBehavior(sense=sense), rotator_rules=FREE)


def test_a_slit_is_brought_to_the_target_along_an_angle() -> None:
    slit = PixelPoint("slit", 2200.0, 400.0, turned_deg=30.0)

    async def work(rig: VirtualRig) -> None:
        target = rig.up(25.0, 20.0)
        report = await rig.navigator.center(target, at="slit", angle=FieldAngle(75.0))
        # the slit's own direction, and the target on it
        assert wrong_deg(rig, 45.0) <= 0.55
        assert rig.rotates is not None
        there = true_place(
            rig.mechanics, rig.sky.through, rig.rotates.camera_deg(), (2200.0, 400.0), rig.clock.utc()
        )
        assert separation_arcsec(there, target) <= report.tolerance_arcsec + 3.0

    in_virtual_time(work, machine=GERMAN, rotates=PLAIN, rotator_rules=FREE, points=(slit,))


def test_either_way_is_the_nearer_one() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        # it stands at about 33°, and 200° is 167° away
        report = await rig.navigator.center(rig.up(20.0, 30.0), angle=FieldAngle(200.0, either_way=True))
        assert wrong_deg(rig, 20.0) <= 0.55
        assert report.rotation is not None
        assert sum(abs(turn.by_deg) for turn in report.rotation.turns) < 60.0

    in_virtual_time(work, rotates=PLAIN, rotator_rules=RotatorRules(-180.0, 180.0, sense=1))


def test_the_safe_way_round_is_taken_where_the_short_one_is_not_allowed() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        # from 33° + 10° back to 3°: by −40°, over the limit at 0°, or by 320° within the cables
        report = await rig.navigator.center(rig.up(20.0, 30.0), angle=FieldAngle(3.0))
        assert wrong_deg(rig, 3.0) <= 0.55
        assert min(rig.rotates.travel) >= -0.6
        assert any("the long way round" in words for words in report.notes)

    in_virtual_time(
        work, rotates=PLAIN, rotator_rules=RotatorRules(0.0, 360.0, sense=1), rotator_starts_deg=10.0
    )


def test_an_angle_that_the_cables_don_t_allow_is_refused_and_nothing_turns() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        with pytest.raises(DeviceRefused, match="outside of the cable limits") as told:
            await rig.navigator.center(rig.up(20.0, 30.0), angle=FieldAngle(240.0))
        assert told.value.reason is Refusal.LIMIT
        assert rig.rotates.orders == []
        # standing on its head it may
        await rig.navigator.center(rig.up(20.0, 30.0), angle=FieldAngle(240.0, either_way=True))
        assert wrong_deg(rig, 60.0) <= 0.55

    in_virtual_time(
        work, rotates=PLAIN, rotator_rules=RotatorRules(0.0, 90.0, sense=1), rotator_starts_deg=45.0
    )


def test_without_a_rotator_the_angle_is_told_or_refused() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 30.0)
        with pytest.raises(DeviceRefused, match="there is no rotator"):
            await rig.navigator.center(target, angle=FieldAngle(90.0))
        stands = (await rig.navigator.look()).solution.rotation_deg
        report = await rig.navigator.center(target, angle=FieldAngle(stands, 2.0))
        assert report.rotation is not None
        assert report.rotation.turns == ()

    in_virtual_time(work)


def test_a_rotator_that_does_nothing_is_named() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(TargetNotReached, match="did not move") as told:
            await rig.navigator.rotate(FieldAngle(120.0))
        assert told.value.reason is NotReached.STUCK

    in_virtual_time(work, rotates=RotatorBehavior(ignores=True), rotator_rules=FREE)


def test_a_camera_that_does_not_follow_is_named() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(TargetNotReached, match="does the camera sit on it") as told:
            await rig.navigator.rotate(FieldAngle(120.0))
        assert told.value.reason is NotReached.STUCK

    in_virtual_time(work, rotates=RotatorBehavior(slips=1.0), rotator_rules=FREE)


def test_a_camera_that_slips_is_brought_there_and_told() -> None:
    async def work(rig: VirtualRig) -> None:
        rotation = await rig.navigator.rotate(FieldAngle(100.0))
        assert wrong_deg(rig, 100.0) <= 0.55
        assert any("a slip" in words for words in rotation.notes)

    in_virtual_time(work, rotates=RotatorBehavior(slips=0.2), rotator_rules=RotatorRules(sense=1))


def test_play_is_taken_up_by_another_small_turn() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.rotate(FieldAngle(100.0))
        await rig.navigator.rotate(FieldAngle(60.0))
        assert wrong_deg(rig, 60.0) <= 0.55

    in_virtual_time(work, rotates=RotatorBehavior(backlash_deg=1.5), rotator_rules=RotatorRules(sense=1))


def test_a_stated_sense_that_is_wrong_is_named_and_put_right() -> None:
    async def work(rig: VirtualRig) -> None:
        rotation = await rig.navigator.rotate(FieldAngle(80.0))
        assert wrong_deg(rig, 80.0) <= 0.55
        assert any("set sense = -1" in words for words in rotation.notes)
        # from now on it goes the right way at once
        again = await rig.navigator.rotate(FieldAngle(150.0))
        assert len(again.turns) == 1

    in_virtual_time(work, rotates=RotatorBehavior(sense=-1), rotator_rules=RotatorRules(sense=1))


def test_a_stop_stops_the_rotator_too() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        turning = asyncio.ensure_future(rig.navigator.rotate(FieldAngle(200.0)))
        while not moves(rig):
            await rig.clock.sleep(0.5)
        await rig.navigator.stop()
        with pytest.raises(Cancelled):
            await turning
        assert not moves(rig)
        stood = rig.rotates.count_deg
        await rig.clock.sleep(60.0)
        assert rig.rotates.count_deg == stood
        # a look after it isn't doubted for a camera that stands somewhere on its way
        await rig.navigator.look()

    in_virtual_time(work, rotates=PLAIN, rotator_rules=RotatorRules(sense=1))


def test_work_that_is_cancelled_leaves_the_rotator_at_rest() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        turning = asyncio.ensure_future(rig.navigator.rotate(FieldAngle(200.0)))
        while not moves(rig):
            await rig.clock.sleep(0.5)
        turning.cancel()
        with pytest.raises(asyncio.CancelledError):
            await turning
        assert not moves(rig)

    in_virtual_time(work, rotates=PLAIN, rotator_rules=RotatorRules(sense=1))


@pytest.mark.long
def test_on_a_flip_the_field_turns_with_it() -> None:
    async def work(rig: VirtualRig) -> None:
        # a target that crosses the meridian while it is tracked
        target = rig.up(-1.0, 20.0)
        report = await rig.navigator.center(target, angle=FieldAngle(70.0))
        assert report.side is PierSide.WEST
        await rig.clock.sleep(timedelta(hours=1).total_seconds())
        flipped = await rig.navigator.flip(target)
        assert flipped.side is PierSide.EAST
        assert wrong_deg(rig, 70.0) <= 0.55
        assert rig.off_arcsec(target) <= flipped.tolerance_arcsec + 3.0
        assert flipped.rotation is not None
        assert sum(turn.by_deg for turn in flipped.rotation.turns) % 360.0 == pytest.approx(180.0, abs=2.0)

    in_virtual_time(work, machine=GERMAN, rotates=PLAIN, rotator_rules=FREE)


@pytest.mark.long
def test_a_field_that_can_t_turn_with_the_flip_is_told() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(-1.0, 20.0)
        await rig.navigator.center(target, angle=FieldAngle(210.0))
        assert wrong_deg(rig, 210.0) <= 0.55
        await rig.clock.sleep(timedelta(hours=1).total_seconds())
        flipped = await rig.navigator.flip(target)
        assert flipped.side is PierSide.EAST
        assert wrong_deg(rig, 30.0) <= 0.55
        assert any("didn't turn with the flip" in words for words in flipped.notes)

    in_virtual_time(
        work,
        machine=GERMAN,
        rotates=PLAIN,
        rotator_rules=RotatorRules(-45.0, 45.0, sense=1),
    )


@pytest.mark.long
def test_a_flip_without_an_angle_turns_nothing() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        target = rig.up(-1.0, 20.0)
        await rig.navigator.center(target)
        await rig.clock.sleep(timedelta(hours=1).total_seconds())
        await rig.navigator.flip(target)
        assert rig.rotates.orders == []

    in_virtual_time(work, machine=GERMAN, rotates=PLAIN, rotator_rules=FREE)


def test_a_count_that_was_lost_is_not_turned_by_until_somebody_has_looked() -> None:
    async def work(rig: VirtualRig) -> None:
        assert rig.rotates is not None
        await rig.navigator.rotate(FieldAngle(90.0))
        # switched off over the day: it counts from 0 now
        await rig.navigator.close()
        rig.rotates.set_count(0.0)
        await rig.navigator.open()
        orders = len(rig.rotates.orders)
        with pytest.raises(DeviceRefused, match="its count was lost") as told:
            await rig.navigator.rotate(FieldAngle(30.0))
        assert told.value.reason is Refusal.UNTRUSTED
        assert len(rig.rotates.orders) == orders
        await rig.navigator.rotate(FieldAngle(30.0), trust_count=True)
        assert wrong_deg(rig, 30.0) <= 0.55

    in_virtual_time(work, machine=GERMAN, rotates=PLAIN, rotator_rules=RotatorRules(sense=1))


def test_after_a_turn_looks_are_not_doubted_for_the_camera_s_angle() -> None:
    async def work(rig: VirtualRig) -> None:
        for ha_deg in (15.0, 25.0, 35.0):
            await rig.navigator.center(rig.up(ha_deg, 30.0))
        known = rig.navigator.learned.normal
        assert known is not None
        assert known.camera_angle_deg is not None
        await rig.navigator.rotate(FieldAngle(170.0))
        turned = rig.navigator.learned.normal
        assert turned is not None
        assert turned.camera_angle_deg is not None
        assert rig.rotates is not None
        assert apart_deg(turned.camera_angle_deg, rig.rotates.camera_deg()) == pytest.approx(0.0, abs=1.0)
        # no sync is refused for it
        report = await rig.navigator.center(rig.up(30.0, 10.0))
        assert not any("turned by" in words for words in report.notes)

    in_virtual_time(work, machine=GERMAN, rotates=PLAIN, rotator_rules=RotatorRules(sense=1))


@pytest.mark.parametrize("wrong", [FieldAngle(float("nan")), FieldAngle(1e9), FieldAngle(10.0, -1.0)])
def test_what_is_no_angle_is_refused(wrong: FieldAngle) -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(BadRequest):
            await rig.navigator.rotate(wrong)
        assert rig.camera.frames == 0

    in_virtual_time(work, rotates=PLAIN, rotator_rules=FREE)


SEEDS = [*range(6), *(pytest.param(one, marks=pytest.mark.long) for one in range(6, 40))]


@pytest.mark.long
@pytest.mark.parametrize("seed", SEEDS)
def test_random_rotators_come_to_random_angles_and_keep_their_cables(seed: int) -> None:
    chance = random.Random(f"rotating {seed}")
    least = chance.uniform(-360.0, 180.0)
    most = least + chance.choice([360.0, 360.0, chance.uniform(60.0, 360.0)])
    starts = chance.uniform(least, most)
    behavior = RotatorBehavior(
        rate_deg_s=chance.uniform(1.0, 10.0),
        step_deg=chance.choice([0.01, 0.1, 0.25]),
        sense=chance.choice([1, -1]),
        backlash_deg=chance.choice([0.0, 0.0, 1.0]),
    )
    stated = chance.choice([None, behavior.sense, -behavior.sense])
    zero = chance.uniform(0.0, 360.0)

    async def work(rig: VirtualRig) -> None:
        rotates = rig.rotates
        assert rotates is not None
        await rig.navigator.center(rig.up(chance.choice([-25.0, 25.0]), chance.uniform(-10.0, 60.0)))
        for _ in range(3):
            wanted = FieldAngle(chance.uniform(0.0, 360.0), 0.6, chance.random() < 0.3)
            needs = [
                behavior.sense * (wanted.position_angle_deg - rig.turned_deg + turn) + rotates.travel[-1]
                for turn in range(-720, 721, 180 if wanted.either_way else 360)
            ]
            ends = [one % 360.0 + 360.0 * turns for one in needs for turns in range(-3, 3)]
            possible = any(least + 2.0 <= one <= most - 2.0 for one in ends)
            if any(least - 1.0 <= one <= most + 1.0 for one in ends) and not possible:
                continue  # at the very edge of its limits
            seen = rig.navigator.rotator is not None and rig.navigator.rotator.sense_seen
            if possible and not seen and stated == -behavior.sense:
                # it may be refused by the sense that is stated wrongly; it says that nobody has seen it
                try:
                    await rig.navigator.rotate(wanted)
                except DeviceRefused as refusal:
                    told_why = str(refusal)
                else:
                    told_why = "no solve has shown"
                assert "no solve has shown" in told_why
                continue
            if possible:
                await rig.navigator.rotate(wanted)
                assert wrong_deg(rig, wanted.position_angle_deg, wanted.modulo_deg) <= 0.7
                continue
            with pytest.raises(DeviceRefused) as told:
                await rig.navigator.rotate(wanted)
            assert told.value.reason is Refusal.LIMIT
        # its own count never left the cable limits, by which way round ever
        assert min(rotates.travel) >= least - 1.0
        assert max(rotates.travel) <= most + 1.0

    in_virtual_time(
        work,
        machine=GERMAN,
        rotates=behavior,
        rotator_rules=RotatorRules(least, most, sense=stated),
        rotator_starts_deg=starts,
        turned_deg=zero,
    )
