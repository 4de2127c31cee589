"""Some sixty centerings of random observatories, judged by truth; `benchmarks.centerings` has a thousand."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest

from benchmarks.centerings import Outcome, lived
from benchmarks.judging import Place, standing, violations, way_is_clear, wrong_syncs
from benchmarks.worlds import AIR, WIRES, Observatory, World, built, drawn
from mountnav.devices import PierSide
from mountnav.simulation.mechanics import Machine
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Apparent, HourAngle
from mountnav.sky.sphere import displaced


def check(outcome: Outcome) -> None:
    assert [trial.why for trial in outcome.trials if trial.result == "FAILED"] == []
    assert outcome.wrong_syncs == []
    assert outcome.beyond == []
    assert outcome.unclosed == []


@pytest.mark.parametrize("first", [0, 4, pytest.param(8, marks=pytest.mark.long)])
def test_targets_all_over_the_sky_are_centered_or_refused_for_what_is_true(first: int) -> None:
    centered = 0
    for seed in range(first, first + 4):
        outcome = lived(seed)
        check(outcome)
        centered += sum(trial.result.startswith("centered") for trial in outcome.trials)
    assert centered >= 10


@pytest.mark.long
@pytest.mark.parametrize(
    "wire",
    [pytest.param(one, marks=pytest.mark.long if number % 2 else ()) for number, one in enumerate(WIRES)],
)
def test_the_same_through_the_real_drivers(wire: str) -> None:
    check(lived(100_001, wire, targets=1))


@pytest.mark.first
@pytest.mark.long
def test_two_dozen_more() -> None:
    for seed in range(1000, 1024):
        check(lived(seed))


# -- the judge can fail ------------------------------------------------------------------------------------


def world() -> World:
    calm = drawn(3)
    machine = Machine(mounting="german", meridian_limits_deg=(60.0, 60.0))
    limits = replace(calm.limits, min_altitude_deg=20.0, past_meridian_deg=(10.0, 10.0))
    return replace(calm, machine=machine, limits=limits, trusted=True, sun_up=False)


def place(made: Observatory, ha_deg: float, dec_deg: float) -> Apparent:
    now = made.clock.utc()
    return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, now), made.world.site, AIR), now)


def test_a_sync_beside_the_truth_is_found() -> None:
    clock = VirtualClock(world().start)

    async def life() -> list[float]:
        made = built(replace(world(), behavior=replace(world().behavior, epoch="apparent")), clock)
        await made.mount.open()
        truth = icrs_to_apparent(made.mechanics.truth(), clock.utc())
        await made.mount.sync(truth)
        await made.mount.sync(displaced(truth, 0.0, 600.0))
        await made.mount.close()
        return [off for _, off in wrong_syncs(made, made.world.start)]

    found = run_virtually(life(), clock)
    assert found == [pytest.approx(600.0, abs=5.0)]


def test_a_tube_beyond_a_limit_is_found_whatever_anybody_believes() -> None:
    clock = VirtualClock(world().start)

    async def life() -> dict[str, float]:
        made = built(world(), clock)
        began = clock.utc()
        north = 1.0 if made.world.site.latitude_deg > 0.0 else -1.0
        low = place(made, 80.0, -20.0 * north)
        assert not way_is_clear(
            made, hour_angle_to_icrs(HourAngle(80.0, -20.0 * north, began), made.world.site, AIR)
        )
        made.mechanics.slew(low)
        await clock.sleep(90.0)
        made.mechanics.slew(place(made, 40.0, 20.0 * north), PierSide.WEST)
        await clock.sleep(120.0)
        # a reboot makes the mount believe anything; where the tube was stays known
        made.mechanics.reboot()
        await clock.sleep(5.0)
        return {one.what: one.by_deg for one in violations(made, began, clock.utc())}

    found = run_virtually(life(), clock)
    assert found["altitude"] > 5.0
    assert found["meridian"] > 5.0


def test_a_target_stands_where_astronomy_says() -> None:
    clock = VirtualClock(world().start)
    made = built(world(), clock)
    utc = clock.utc()
    zenith = hour_angle_to_icrs(HourAngle(-1.0, made.world.site.latitude_deg, utc), made.world.site, AIR)
    nadir = hour_angle_to_icrs(HourAngle(179.0, -made.world.site.latitude_deg, utc), made.world.site, AIR)
    assert standing(made.world, zenith, utc, 600.0) is Place.INSIDE
    assert standing(made.world, nadir, utc, 600.0) is Place.OUTSIDE
    assert standing(made.world, zenith, utc + timedelta(hours=12), 600.0) is not Place.INSIDE
