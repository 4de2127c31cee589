"""Targets that move: how long things take is learned, and centering goes to where they will be."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.ephemeris import SkyRatesTarget, StarLike
from mountnav.errors import BadRequest, OutsideLimits
from mountnav.navigation.moving import MovingTarget, Pace
from mountnav.navigation.reports import CenterReport, SlewReport
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.navigation.virtual_rig import POLICY, SITE, START, VirtualRig, in_virtual_time


def mover(
    rig: VirtualRig, ra: float, dec: float, *, sigma: float = 0.0, minutes: float = 60.0
) -> SkyRatesTarget:
    """A target that passes over a place high in the east, at these rates on the sky."""
    return SkyRatesTarget(
        rig.up(-30.0, 30.0),
        ra,
        dec,
        rig.clock.utc(),
        rig.clock.utc() + timedelta(minutes=minutes),
        "a mover",
        sigma,
    )


@given(overhead=st.floats(1.0, 20.0), s_deg=st.floats(0.1, 2.0), way=st.floats(0.0, 120.0))
def test_the_time_of_slews_is_learned_from_those_that_were_made(
    overhead: float, s_deg: float, way: float
) -> None:
    pace = Pace()
    before = pace.slew_s(way * 3600.0)
    for one_deg in (1.0, 5.0, 20.0, 60.0, 0.1, 90.0, 40.0, 2.0):
        pace.slewed(one_deg * 3600.0, overhead + s_deg * one_deg)
    truly = overhead + s_deg * way
    assert abs(pace.slew_s(way * 3600.0) - truly) <= 0.5 + 0.1 * truly
    assert abs(pace.slew_s(way * 3600.0) - truly) <= abs(before - truly) + 0.5 + 0.1 * truly


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -5.0, 1e9])
def test_times_that_can_not_be_teach_nothing(wrong: float) -> None:
    pace = Pace()
    usual = pace.slew_s(3600.0), pace.until_exposed_s(1.0)
    pace.slewed(3600.0, wrong)
    pace.looked(wrong, 0.0)
    assert (pace.slew_s(3600.0), pace.until_exposed_s(1.0)) == usual


@given(rate=st.floats(-200.0, 200.0), slew_s_deg=st.floats(0.1, 1.0))
def test_the_place_ahead_is_where_the_target_is_then(rate: float, slew_s_deg: float) -> None:
    pace = Pace()
    for one_deg in (1.0, 10.0, 50.0):
        pace.slewed(one_deg * 3600.0, 2.0 + slew_s_deg * one_deg)
    clock = VirtualClock(START)
    begin = Icrs(80.0, 10.0)
    target = SkyRatesTarget(begin, rate, 0.0, clock.utc(), clock.utc() + timedelta(hours=4))
    moving = MovingTarget(target, site=SITE, clock=clock, pace=pace, exposure_s=4.0, settle_s=1.0)
    here = Icrs(60.0, 10.0)
    place = moving.ahead(here)
    takes_s = pace.slew_s(separation_arcsec(here, place)) + pace.until_exposed_s(1.0) + 2.0
    truly = target.icrs(clock.utc() + timedelta(seconds=takes_s), SITE)
    assert separation_arcsec(place, truly) < 1.0


def test_a_fast_target_is_centered_where_it_is_in_the_middle_of_the_exposure() -> None:
    async def work(rig: VirtualRig) -> tuple[CenterReport, SkyRatesTarget]:
        target = mover(rig, 1.2, -0.6)
        return await rig.navigator.center(target, tolerance_arcsec=8.0), target

    report, target = in_virtual_time(work)
    assert report.target_utc is not None
    assert report.target_name == "a mover"
    assert report.error_after_arcsec <= 8.0
    assert separation_arcsec(report.target, target.icrs(report.target_utc, SITE)) < 1e-6
    assert report.target_rates is not None
    assert report.target_rates.dec_arcsec_s == pytest.approx(-0.6, abs=1e-3)
    assert separation_arcsec(report.tries[-1].seen, report.target) == pytest.approx(
        report.error_after_arcsec, abs=1.0
    )


def test_a_target_that_stands_still_is_centered_as_a_star_is() -> None:
    def centered(like: bool) -> CenterReport:
        async def work(rig: VirtualRig) -> CenterReport:
            place = rig.up(-30.0, 30.0)
            return await rig.navigator.center(StarLike(place, "x") if like else place)

        return in_virtual_time(work)

    star, moving = centered(like=False), centered(like=True)
    assert [one.seen for one in star.tries] == [one.seen for one in moving.tries]
    assert star.error_after_arcsec == moving.error_after_arcsec
    assert (star.target_name, moving.target_name) == ("", "x")


def test_an_uncertain_target_widens_the_tolerance_and_is_told() -> None:
    async def work(rig: VirtualRig) -> tuple[CenterReport, CenterReport]:
        vague = await rig.navigator.center(mover(rig, 0.1, 0.1, sigma=20.0), tolerance_arcsec=15.0)
        lost = await rig.navigator.center(mover(rig, 0.1, 0.1, sigma=4000.0), tolerance_arcsec=15.0)
        return vague, lost

    vague, lost = in_virtual_time(work)
    assert vague.tolerance_arcsec == pytest.approx(25.0)
    assert vague.tolerance_asked_arcsec == 15.0
    assert any("uncertain by 20″" in note for note in vague.notes)
    assert not any("may not be in the frame" in note for note in vague.notes)
    assert lost.tolerance_arcsec == pytest.approx(45.0)
    assert any("may not be in the frame" in note for note in lost.notes)


def test_a_slew_goes_to_where_the_target_will_be_on_arrival() -> None:
    async def work(rig: VirtualRig) -> float:
        target = mover(rig, 40.0, 20.0)
        for _ in range(3):
            # how long its slews take is learned meanwhile
            report: SlewReport = await rig.navigator.slew(target)
        return separation_arcsec(report.reported, target.icrs(rig.clock.utc(), SITE))

    # half a second of its way, where it goes 45″ in one
    assert in_virtual_time(work) < 60.0


def test_a_place_beside_a_moving_target_is_reached() -> None:
    async def work(rig: VirtualRig) -> float:
        target = mover(rig, 0.5, 0.0)
        report = await rig.navigator.offset(600.0, -300.0, target)
        beside = displaced(target.icrs(rig.clock.utc(), SITE), 600.0, -300.0)
        return separation_arcsec(report.reported, beside)

    assert in_virtual_time(work) < 10.0


def test_a_target_whose_ephemeris_ends_too_soon_moves_nothing() -> None:
    async def work(rig: VirtualRig) -> tuple[str, list[str]]:
        target = mover(rig, 0.5, 0.0, minutes=0.02)
        with pytest.raises(BadRequest) as refused:
            await rig.navigator.center(target)
        return refused.value.what, rig.mount.received

    what, received = in_virtual_time(work)
    assert "ends" in what
    assert "slew" not in received


def test_a_moving_target_below_the_horizon_moves_nothing() -> None:
    async def work(rig: VirtualRig) -> list[str]:
        begins = rig.clock.utc()
        target = SkyRatesTarget(rig.up(180.0, 0.0), 1.0, 0.0, begins, begins + timedelta(hours=1))
        for order in (rig.navigator.center, rig.navigator.slew, rig.navigator.would_slew, rig.navigator.flip):
            with pytest.raises(OutsideLimits):
                await order(target)
        return rig.mount.received

    assert "slew" not in in_virtual_time(work)


def test_the_limit_on_the_way_of_a_moving_target_is_told() -> None:
    async def work(rig: VirtualRig) -> CenterReport:
        begins = rig.clock.utc()
        # goes down by 40′ a minute from 30° of altitude or so
        target = SkyRatesTarget(rig.up(40.0, 20.0), 0.0, -40.0, begins, begins + timedelta(hours=1))
        return await rig.navigator.center(target, planned_s=7200.0, tolerance_arcsec=400.0)

    report = in_virtual_time(work, policy=replace(POLICY, min_altitude_deg=15.0))
    assert report.crossing is not None
    still = in_virtual_time(lambda rig: rig.navigator.center(rig.up(40.0, 20.0), planned_s=3600.0))
    assert still.crossing is None
