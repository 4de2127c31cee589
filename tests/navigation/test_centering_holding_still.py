"""A target that is called centered stays so: play is taken up before, and a tube that swings is told."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime, timedelta

import pytest

from mountnav.devices import MountReading
from mountnav.errors import SyncRefused, TargetNotReached
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.navigation.centering import agree, shows_rest
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.solution import MOVED_KEY
from tests.navigation.sync_rig import look_of, solution_at
from tests.navigation.virtual_rig import ERRORS, POLICY, START, VirtualRig, in_virtual_time


def worst_arcsec(rig: VirtualRig, target: Icrs, seconds: int = 30) -> float:
    """How far off the tube comes within so many seconds of tracking from now."""
    now = rig.clock.utc()
    later = [rig.mechanics.truth(now + timedelta(seconds=one)) for one in range(seconds + 1)]
    return max(separation_arcsec(place, target) for place in later)


@pytest.mark.long
@pytest.mark.parametrize("exposure_s", [5.0, 1.0])
def test_play_is_taken_up_before_a_target_counts_as_centered(exposure_s: float) -> None:
    # slews to the east end against the turn of the sky: tracking takes 12 s to take up 180″ of play
    errors = replace(ERRORS, backlash_arcsec=180.0)

    async def work(rig: VirtualRig) -> None:
        for ha_deg in (30.0, 22.0, 14.0, 6.0):
            target = rig.up(ha_deg, 20.0)
            report = await rig.navigator.center(target)
            assert worst_arcsec(rig, target) <= report.tolerance_arcsec + 5.0

    in_virtual_time(work, errors=errors, policy=replace(POLICY, exposure_s=exposure_s))


@pytest.mark.long
@pytest.mark.parametrize("swing_s", [9.0, 13.0, 23.0])
def test_a_tube_that_swings_in_the_wind_is_told_and_centered_when_it_is_calm(swing_s: float) -> None:
    async def work(rig: VirtualRig) -> None:
        truth, calm_utc = rig.mechanics.truth, START + timedelta(seconds=600)

        def swinging(utc: datetime | None = None) -> Icrs:
            utc = utc or rig.clock.utc()
            swing = 60.0 * math.sin((utc - START).total_seconds() * math.tau / swing_s)
            return displaced(truth(utc), swing if utc < calm_utc else 0.0, 0.0)

        rig.mechanics.truth = swinging  # type: ignore[method-assign]
        target = rig.up(-20.0, 30.0)
        with pytest.raises((TargetNotReached, SyncRefused), match="keep still"):
            await rig.navigator.center(target, tolerance_arcsec=40.0)
        await rig.clock.sleep(600.0)
        await rig.navigator.center(target)
        assert worst_arcsec(rig, target) <= POLICY.tolerance_arcsec + 5.0

    in_virtual_time(work)


def test_two_round_images_of_each_star_show_no_rest() -> None:
    """A tube that jumped while it was exposed: each image is round, and the solution lies between them."""
    place, now = Icrs(10.0, 20.0), START
    reading = MountReading(Apparent(10.0, 20.0, now), now)
    found = look_of(place, reading, reading, now, solution_at(place, 0.0), "look")
    quality = SkyQuality(50, StarImages.WELL_SAMPLED, 3.0, 0.0, None, 100.0, 5.0, 0.0, 100.0, 0.0)
    verdict = replace(found.verdict, quality=quality)
    still = replace(found, verdict=verdict, exposure_s=10.0)
    assert shows_rest(still, 20.0, 10.0)
    apart = {MOVED_KEY: 12.0 / still.solution.scale_arcsec_px}
    jumped = replace(still, verdict=replace(verdict, numbers=apart))
    assert not shows_rest(jumped, 20.0, 10.0)
    assert agree(still, still, 20.0)
    assert not agree(still, jumped, 20.0)
