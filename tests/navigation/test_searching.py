"""Spiral searches in virtual time: found beside the target, bounded, and back where they began."""

from __future__ import annotations

import math

import pytest

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import SlewOutcome
from mountnav.errors import BadRequest, DeviceRefused, OutsideLimits, Refusal, SolveFailed
from mountnav.frames import Frame, Hint
from mountnav.navigation.searching import SearchBounds
from mountnav.pointing.limits import Limits
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SkySeen
from mountnav.simulation.truth_frame import truth_of
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_observed
from mountnav.sky.coordinates import Apparent, HourAngle, Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.settings import SolveSettings
from tests.navigation.virtual_rig import AIR, SITE, START, VirtualRig, in_virtual_time


class PoorRound:
    """A solver for which only what lies so far from a place has stars enough."""

    def __init__(self, inner: SkySeen) -> None:
        self.inner = inner
        self.poor: Icrs | None = None
        self.from_arcsec, self.to_arcsec = 0.0, 0.0

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        if self.poor is not None:
            off = separation_arcsec(truth_of(frame).center, self.poor)
            if not self.from_arcsec <= off <= self.to_arcsec:
                return Verdict(None, Reason.CATALOG_TOO_SHALLOW, "two stars", 2, Times(total_s=0.5))
        return await self.inner(frame, hint, settings)


async def with_poor(rig: VirtualRig, target: Icrs, from_arcsec: float, to_arcsec: float) -> PoorRound:
    solver = PoorRound(rig.sky)
    solver.poor, solver.from_arcsec, solver.to_arcsec = target, from_arcsec, to_arcsec
    rig.navigator._equipment.solve = solver
    return solver


BOUNDS = SearchBounds(radius_deg=3.0, step_share=0.7, most_looks=40, most_s=3600.0)


def test_it_ends_where_a_look_solves_and_centers() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 35.0)
        solver = await with_poor(rig, target, 2000.0, 1e6)
        rig.navigator._equipment.listen = _heal(rig, solver)
        report = await rig.navigator.spiral_search(target, BOUNDS)
        assert report.looks > 1
        assert report.found_arcsec > 2000.0
        assert report.centered.outcome == "centered"
        assert rig.off_arcsec(target) < 33.0

    in_virtual_time(work)


def _heal(rig: VirtualRig, solver: PoorRound):
    """Once something was solved the target itself can be seen, as when a cloud has passed."""

    def listen(kind: str, facts: dict[str, object]) -> None:
        rig.events.append((kind, facts))
        if kind == "search-step" and facts["solved"]:
            solver.poor = None

    return listen


def test_steps_are_a_share_of_the_field_and_stay_within_the_radius() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 35.0)
        await with_poor(rig, target, 1e9, 1e9)
        with pytest.raises(SolveFailed, match="nothing was solved in 9 looks"):
            await rig.navigator.spiral_search(target, SearchBounds(radius_deg=1.2, step_share=0.7))
        steps = rig.told("search-step")
        places = [Icrs(float(one["ra_deg"]), float(one["dec_deg"])) for one in steps]  # type: ignore[arg-type]
        # 2000 px of 2″ are 1.11°: steps of 0.78°
        assert separation_arcsec(places[0], places[1]) == pytest.approx(0.7 * 4000.0, abs=2.0)
        assert all(separation_arcsec(one, target) <= 1.2 * 3600.0 for one in places)
        assert len({(round(one.ra_deg, 3), round(one.dec_deg, 3)) for one in places}) == 9
        # and back, as far as it believes
        assert rig.off_arcsec(target) < 1500.0
        last = rig.told("slewing")[-1]
        assert separation_arcsec(Icrs(float(last["ra_deg"]), float(last["dec_deg"])), target) < 1.0  # type: ignore[arg-type]

    in_virtual_time(work)


@pytest.mark.long
@pytest.mark.parametrize(
    ("bounds", "most"),
    [(SearchBounds(radius_deg=5.0, most_looks=4), 4), (SearchBounds(radius_deg=5.0, most_s=150.0), 20)],
)
def test_it_is_bounded_in_looks_and_in_time(bounds: SearchBounds, most: int) -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 35.0)
        await with_poor(rig, target, 1e9, 1e9)
        began = rig.clock.monotonic_s()
        with pytest.raises(SolveFailed, match="nothing was solved"):
            await rig.navigator.spiral_search(target, bounds)
        assert len(rig.told("search-step")) <= most
        assert rig.clock.monotonic_s() - began < 400.0

    in_virtual_time(work)


def test_steps_beyond_the_limits_are_passed_over() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(0.5, -10.5)
        await with_poor(rig, target, 1e9, 1e9)
        with pytest.raises(SolveFailed, match="beyond the limits were passed over"):
            await rig.navigator.spiral_search(target, SearchBounds(radius_deg=1.2))
        assert 3 <= len(rig.told("search-step")) < 9
        with pytest.raises(OutsideLimits):
            await rig.navigator.spiral_search(rig.up(0.5, -20.0), SearchBounds(radius_deg=1.2))

    in_virtual_time(work, limits=Limits(min_altitude_deg=30.0))


class OwnLimit(SimulatedMount):
    """A mount that refuses what lies south of -12°, by a limit of its own."""

    reason = Refusal.LIMIT

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        if place.dec_deg < -12.0:
            raise DeviceRefused("the slew refused: limit", device="rig", reason=self.reason)
        return await super().slew(place)


class OwnHorizon(OwnLimit):
    """The same by a horizon of its own."""

    reason = Refusal.BELOW_HORIZON


@pytest.mark.parametrize("made", [OwnLimit, OwnHorizon])
def test_steps_that_the_mount_itself_refuses_are_passed_over(made: type[OwnLimit]) -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(0.5, -11.6)
        await with_poor(rig, target, 1e9, 1e9)
        with pytest.raises(SolveFailed, match=r"[3-6] looks .*3 step.s. beyond the limits were passed over"):
            await rig.navigator.spiral_search(target, SearchBounds(radius_deg=1.2))
        with pytest.raises(DeviceRefused):
            await rig.navigator.spiral_search(rig.up(0.5, -20.0), SearchBounds(radius_deg=1.2))

    in_virtual_time(work, made=made)


@pytest.mark.long
def test_a_target_that_has_set_meanwhile_is_told_and_nothing_is_sent_there() -> None:
    # half a degree above the limit and setting: in some minutes it is below
    setting = hour_angle_to_icrs(HourAngle(58.0, 12.0, START), SITE, AIR)
    lowest_deg = icrs_to_observed(setting, START, SITE, AIR).alt_deg - 0.5

    async def work(rig: VirtualRig) -> None:
        await with_poor(rig, setting, 1e9, 1e9)
        with pytest.raises(SolveFailed, match="nothing was solved") as failed:
            await rig.navigator.spiral_search(setting, SearchBounds(radius_deg=3.0, most_s=1200.0))
        assert "was not sent back" in str(failed.value.advice)

    in_virtual_time(work, limits=Limits(min_altitude_deg=lowest_deg))


def test_a_wide_search_by_a_small_field_begins_at_once() -> None:
    # some 10 billion steps: they were all made before the first slew
    bounds = SearchBounds(radius_deg=10.0, field_deg=0.001, step_share=0.2, most_looks=3)

    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 35.0)
        await with_poor(rig, target, 1e9, 1e9)
        with pytest.raises(SolveFailed, match="in 3 looks"):
            await rig.navigator.spiral_search(target, bounds)

    in_virtual_time(work)


def test_what_is_solved_at_once_is_no_search() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 35.0)
        report = await rig.navigator.spiral_search(target, BOUNDS)
        assert report.looks == 1
        assert rig.off_arcsec(target) < 33.0

    in_virtual_time(work)


def test_a_look_that_finds_no_stars_offers_it() -> None:
    async def work(rig: VirtualRig) -> None:
        target = rig.up(20.0, 35.0)
        await with_poor(rig, target, 1e9, 1e9)
        with pytest.raises(SolveFailed, match="order spiral-search"):
            await rig.navigator.look()
        assert not rig.told("slewing")

    in_virtual_time(work, script=SkyScript())


@pytest.mark.parametrize(
    "wrong",
    [
        {"radius_deg": 0.0},
        {"radius_deg": math.nan},
        {"radius_deg": 50.0},
        {"step_share": 0.0},
        {"field_deg": 0.0},
        {"most_looks": 0},
        {"most_s": 1e6},
    ],
)
def test_bounds_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadRequest):
        SearchBounds(**wrong)  # type: ignore[arg-type]
