"""Ways that are right are gone to their end: rates and ends are judged by the way that the mount is on."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.centerings import lived
from mountnav.devices import PierSide, SlewOutcome
from mountnav.mount.axis_rates import RatesSeen
from mountnav.pointing.limits import Limits
from mountnav.pointing.limits.detours import legs_to
from mountnav.pointing.limits.postures import Standing, Way
from mountnav.pointing.limits.scene import Scene
from mountnav.simulation.machine import Machine
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import HourAngle, Icrs, Site
from tests.mount.mount_rig import AIR, NIGHT, SITE, Rig, run

LIMITS = Limits(20.0, margin_deg=0.5, rate_ratio=(0.8, 1.25))
STAYS = Machine(mounting="german", side_rule="stay", meridian_limits_deg=(60.0, 60.0), starts_at="zenith")


def east(ha_deg: float, dec_deg: float) -> Standing:
    return Standing("german", PierSide.EAST, ha_deg, dec_deg)


def west(ha_deg: float, dec_deg: float) -> Standing:
    return Standing("german", PierSide.WEST, ha_deg, dec_deg)


def test_a_mount_that_stays_and_turns_one_axis_only_isnt_taken_for_one_that_changes_slowly() -> None:
    # it stays on its side, and the place would lie on the way to the other one too, half done
    ways = [Way(east(0.0, 49.0), east(39.0, 49.0)), Way(east(0.0, 49.0), west(219.0, 131.0))]
    seen = RatesSeen()
    scene = Scene(LIMITS, NIGHT, SITE)
    for ha_deg in (4.0, 9.0, 14.0, 19.0, 24.0):
        before, now = ([east(one, 49.15), west(one + 180.0, 130.85)] for one in (ha_deg - 4.0, ha_deg))
        assert seen.unlike(ways, before, now, scene) is None
    assert seen.reckoned(LIMITS) == LIMITS


def test_one_that_does_change_with_one_axis_first_is_still_seen() -> None:
    ways = [Way(east(0.0, 49.0), east(39.0, 49.0)), Way(east(0.0, 49.0), west(219.0, 131.0))]
    before, now = ([east(one, 49.0), west(one + 180.0, 131.0)] for one in (45.0, 50.0))
    unlike = RatesSeen().unlike(ways, before, now, Scene(LIMITS, NIGHT, SITE))
    assert unlike is not None
    assert unlike.ratio < 0.1


@pytest.mark.long
@pytest.mark.parametrize(("seed", "targets"), [(831027, 2), (831040, 1), (910025, 2)])
def test_targets_that_physics_allows_are_centered(seed: int, targets: int) -> None:
    # the first is a mute German mount that was stopped after 7 of 39 degrees along one axis, and for which
    # ways of such rates, low over the pole, were reckoned with from then on; the last one foretells its side
    # and doesn't tell the present one, where a change of sides leads under the limit
    outcome = lived(seed, targets=targets)
    assert [one.why for one in outcome.trials if one.result == "FAILED"] == []
    assert [*outcome.wrong_syncs, *outcome.beyond, *outcome.unclosed] == []


@pytest.mark.long
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_by_the_pole_refraction_does_not_make_a_right_way_a_wrong_one(sign: float) -> None:
    # 15' from the pole refraction alone turns the axis by 3 degrees, past the end that the place says
    limits = replace(LIMITS, past_meridian_deg=(12.35, 10.13))
    machine = replace(STAYS, slew_rate_deg_s=4.64, acceleration_deg_s2=3.47, meridian_limits_deg=(9.3, 8.0))
    places = [(20.0, 89.0), (152.5, 89.72), (160.4, 89.67), (166.0, 89.75), (150.0, 89.7), (168.0, 89.72)]

    async def work(rig: Rig) -> None:
        rig.mount.restore_side_proof({"mount": rig.mount.name})
        for ha_deg, dec_deg in places:
            assert await rig.mount.slew(rig.place(sign * ha_deg, dec_deg)) is SlewOutcome.ARRIVED

    rig = run(work, limits=limits, machine=machine, mounting="german")
    assert [facts for what, facts in rig.told if what == "limit-stop"] == []


def test_the_last_leg_of_a_way_round_leaves_time_to_track() -> None:
    # 161 s from the limit past the meridian on the side that it may keep: the last leg was refused after the
    # others had been made, and the same way was planned again
    site = Site(38.5, -100.0, 700.0)
    limits = replace(LIMITS, past_meridian_deg=(5.68, 6.12))

    def at(ha_deg: float, dec_deg: float) -> Icrs:
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, NIGHT), site, AIR)

    start, target = at(-11.7, 12.6), at(5.44, 2.1)
    legs = legs_to(limits, start, target, NIGHT, site, AIR, "german", PierSide.WEST)
    assert len(legs) >= 2
    side: PierSide | None = PierSide.WEST
    for number, (begin, end) in enumerate(zip((start, *legs), legs, strict=False), start=1):
        check = limits.check_slew(
            begin,
            end,
            NIGHT,
            site,
            AIR,
            mounting="german",
            side=side,
            track_for_s=None if number == len(legs) else 0.0,
        )
        side = check.sides[0] if len(check.sides) == 1 else None
