"""Fields that an alt-azimuth mount turns, held by a rotator: judged by how the camera truly stands."""

from __future__ import annotations

import asyncio
from datetime import timedelta
from typing import Any

import pytest

from mountnav.ephemeris import SkyRatesTarget
from mountnav.navigation.camera import apart_deg
from mountnav.navigation.holding import HoldPlan
from mountnav.navigation.rotator import RotatorRules
from mountnav.simulation.mechanics import PointingErrors
from mountnav.simulation.rotator_mechanics import RotatorBehavior
from tests.navigation.rated_mount import RatedMount
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time

pytestmark = pytest.mark.long

MINUTES = 25.0
"""So long a field is held: it turns by some 10° in that time."""


def held(how: str, rules: RotatorRules, behavior: RotatorBehavior | None, **given: Any) -> dict[str, Any]:
    """Hold or follow a target south of the zenith; how the image stood meanwhile, and what was said."""

    async def work(rig: VirtualRig) -> dict[str, Any]:
        target = rig.up(-5.0, 30.0)
        await rig.navigator.center(target)
        stood: list[float] = []

        async def watch() -> None:
            await rig.clock.sleep(60.0)
            while True:
                stood.append(rig.turned_deg)
                await rig.clock.sleep(7.0)

        watching = asyncio.create_task(watch()) if rig.rotates is not None else None
        try:
            if how == "hold":
                await rig.navigator.hold(HoldPlan(for_s=60.0 * MINUTES, every_s=60.0))
            else:
                begins = rig.clock.utc()
                ends = begins + timedelta(minutes=MINUTES)
                moving = SkyRatesTarget(target, 0.05, -0.03, begins, ends + timedelta(minutes=5), "a comet")
                await rig.navigator.follow(moving, until_utc=ends)
        finally:
            if watching is not None:
                watching.cancel()
        count = 0.0 if rig.rotates is None else rig.rotates.camera_deg()
        return {
            "stood": stood,
            "said": [str(one["words"]) for one in rig.told("derotation")],
            "moving": rig.rotates is not None and rig.rotates.moving,
            "camera_deg": count,
        }

    return in_virtual_time(
        work,
        made=RatedMount,
        errors=PointingErrors(),
        altaz=True,
        rotates=behavior,
        rotator_rules=rules if behavior is not None else None,
        **given,
    )


def spread(stood: list[float]) -> float:
    return max(abs(apart_deg(one, stood[0])) for one in stood)


@pytest.mark.parametrize(("how", "sense"), [("hold", 1), ("hold", -1), ("follow", 1)])
def test_the_rotator_turns_with_the_field(how: str, sense: int) -> None:
    rules = RotatorRules(-180.0, 180.0, sense=sense)
    done = held(how, rules, RotatorBehavior(sense=sense))
    assert spread(done["stood"]) <= 0.2
    assert any("and the rotator with it" in words for words in done["said"])


def test_without_it_the_field_turns_and_that_is_told() -> None:
    done = held("follow", RotatorRules(), None)
    (words,) = done["said"]
    assert "no rotator" in words
    assert "px a minute" in words


def test_it_ends_at_the_limit_of_its_cables_and_says_so_beforehand() -> None:
    done = held("hold", RotatorRules(-3.0, 3.0, sense=1), RotatorBehavior())
    assert any("its cables allow that until" in words for words in done["said"])
    assert any("its cables allow no more" in words for words in done["said"])
    assert abs(apart_deg(done["camera_deg"], 33.0)) <= 3.1
    assert spread(done["stood"]) > 2.0


def test_one_that_does_not_turn_is_named_and_the_hold_goes_on() -> None:
    done = held("hold", RotatorRules(-180.0, 180.0, sense=1), RotatorBehavior(ignores=True))
    assert any("doesn't turn with the field" in words for words in done["said"])


def test_a_sense_that_nobody_knows_is_not_guessed() -> None:
    done = held("hold", RotatorRules(-180.0, 180.0), RotatorBehavior())
    assert any("isn't known yet" in words for words in done["said"])
    assert done["camera_deg"] == pytest.approx(33.0)


def test_a_stop_ends_the_turning_with_the_rest() -> None:
    async def work(rig: VirtualRig) -> None:
        await rig.navigator.center(rig.up(-5.0, 30.0))
        holding = asyncio.create_task(rig.navigator.hold(HoldPlan(for_s=3600.0, every_s=60.0)))
        await rig.clock.sleep(400.0)
        assert rig.rotates is not None
        turned_deg = rig.rotates.camera_deg()
        assert abs(apart_deg(turned_deg, 33.0)) > 0.5
        holding.cancel()
        await rig.navigator.stop()
        stood_deg = rig.rotates.camera_deg()
        await rig.clock.sleep(300.0)
        assert rig.rotates.camera_deg() == stood_deg
        assert not rig.rotates.moving

    in_virtual_time(
        work,
        errors=PointingErrors(),
        altaz=True,
        rotates=RotatorBehavior(),
        rotator_rules=RotatorRules(-180.0, 180.0, sense=1),
    )
