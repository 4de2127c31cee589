"""A mount that woke up somewhere else is told where it points; never by one frame, never below the ground."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import count

import pytest

from mountnav.catalog.stars import Catalog
from mountnav.clock import utc_now
from mountnav.devices import SyncOutcome
from mountnav.errors import BadFrame, Cancelled, MountMoved, OffsetTooLarge, OutsideLimits
from mountnav.frames import Frame, Hint
from mountnav.navigation.recovering import MOST_LOOKS, agreement_arcsec
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.solve import SolveSettings, solve
from tests.navigation.conftest import POLICY, SITE, MakeRig, Rig, up_now
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time


class FindsAnywhere:
    """What a search of the whole sky brings, without its index: the real solver, asked near the truth.

    Parameters
    ----------
    mechanics : Mechanics
    catalog : Catalog
    wrong_by_deg : float
        So far north of the truth is what it says with its second frame, twice as far with its third, ...
    """

    def __init__(self, mechanics: Mechanics, catalog: Catalog, *, wrong_by_deg: float = 0.0) -> None:
        self._mechanics = mechanics
        self._catalog = catalog
        self._wrong_by_deg = wrong_by_deg
        self.asked: list[tuple[Hint, SolveSettings]] = []

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        self.asked.append((hint, settings))
        assert frame.mid_exposure_utc is not None
        near = replace(hint, center=self._mechanics.truth(frame.mid_exposure_utc), radius_deg=1.0)
        verdict = await asyncio.to_thread(solve, frame, self._catalog, hint=near)
        assert verdict.solution is not None
        solution = replace(verdict.solution, mode="blind/cubic")
        if len(self.asked) > 1 and self._wrong_by_deg:
            north = float(solution.wcs["CRVAL2"]) + self._wrong_by_deg * (len(self.asked) - 1)
            solution = replace(solution, wcs={**solution.wcs, "CRVAL2": north})
        return replace(verdict, solution=solution)


def _wake_up_elsewhere(rig: Rig) -> None:
    """The mount believes to be 60° from where it looks, as after a lost clock or a wrong park position."""
    now = utc_now()
    truth = rig.mechanics.truth(now)
    believed = Icrs((truth.ra_deg + 75.0) % 360.0, truth.dec_deg - 30.0)
    assert 50.0 < separation_arcsec(truth, believed) / 3600.0 < 70.0
    rig.mechanics.sync(icrs_to_apparent(believed, now))


@pytest.mark.long
async def test_a_lost_mount_is_recovered_and_then_centers(make_rig: MakeRig) -> None:
    rig = await make_rig(solve=FindsAnywhere)
    _wake_up_elsewhere(rig)
    axes = rig.mechanics.axes()
    with pytest.raises(OffsetTooLarge):
        await rig.navigator.sync()
    assert "syncing" not in rig.kinds()

    report = await rig.navigator.recover()
    assert report.second.offset.total_arcsec > 50.0 * 3600.0
    assert report.second.blind
    assert report.first.look_id != report.second.look_id
    assert report.apart_arcsec < 5.0
    assert report.altitude_deg == pytest.approx(90.0, abs=1.0)
    assert report.believed_altitude_deg < 60.0
    # nothing moved: the hour angle axis tracked on, the other one stands
    assert "slewing" not in rig.kinds()
    assert rig.mechanics.axes().dec_axis_deg == axes.dec_axis_deg
    steps = [
        kind for kind in rig.kinds() if kind in {"recovering", "solved", "confirmed", "syncing", "synced"}
    ]
    assert steps[-6:] == ["recovering", "solved", "solved", "confirmed", "syncing", "synced"]
    believed = (await rig.navigator.look()).believed
    assert separation_arcsec(believed, rig.mechanics.truth()) < 30.0

    target = up_now()
    await rig.navigator.center(target)
    assert separation_arcsec(rig.mechanics.truth(), target) < 45.0

    first, second = report.first, report.second
    with pytest.raises(BadFrame, match="not exposed after"):
        agreement_arcsec(second, first, POLICY, 15.0)
    with pytest.raises(BadFrame, match="not exposed after"):
        agreement_arcsec(second, second, POLICY, 15.0)
    # what the mount says it moved is taken off what was seen; beyond the bound it counts as somebody's hand
    for motion_arcsec in (0.0, 40.0):
        there = replace(
            second,
            seen=displaced(first.seen, motion_arcsec, 0.0),
            believed=displaced(first.believed, motion_arcsec, 0.0),
        )
        assert agreement_arcsec(first, there, POLICY, 15.0) < 0.1
    with pytest.raises(MountMoved):
        agreement_arcsec(first, replace(second, believed=displaced(first.believed, 0.0, 50.0)), POLICY, 15.0)


@pytest.mark.long
async def test_two_frames_that_disagree_are_never_synced_on(make_rig: MakeRig) -> None:
    def second_frame_wrong(mechanics: Mechanics, catalog: Catalog) -> FindsAnywhere:
        return FindsAnywhere(mechanics, catalog, wrong_by_deg=0.02)

    rig = await make_rig(solve=second_frame_wrong)
    _wake_up_elsewhere(rig)
    with pytest.raises(OffsetTooLarge, match="72″ apart"):
        await rig.navigator.recover()
    assert "syncing" not in rig.kinds()
    # more than two were asked, and no two of them agreed
    assert rig.kinds().count("solved") == MOST_LOOKS


async def test_a_place_below_the_ground_is_never_synced_on(make_rig: MakeRig) -> None:
    # the settings name a site on the other side of the Earth: one of clock, site and frame must be wrong
    antipodes = replace(SITE, latitude_deg=-SITE.latitude_deg, longitude_deg=SITE.longitude_deg - 180.0)
    rig = await make_rig(solve=FindsAnywhere, site=antipodes)
    _wake_up_elsewhere(rig)
    with pytest.raises(OutsideLimits, match="at this hour at altitude -8"):
        await rig.navigator.recover()
    assert "syncing" not in rig.kinds()
    # one frame alone may be solved wrongly: it takes two that agree to say so
    assert rig.kinds().count("solved") == 2


@pytest.mark.parametrize("wrong", [Icrs(40.0, 89.0), Icrs(200.0, -80.0)], ids=["pole", "below the ground"])
def test_one_wrong_frame_at_the_pole_or_below_the_ground_ends_no_recovery(wrong: Icrs) -> None:
    async def work(rig: VirtualRig) -> None:
        rig.navigator.mount.distrust("it was switched off")
        solved, asked = rig.sky.verdict, count()

        def verdict(frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
            found = solved(frame, hint, settings)
            assert found.solution is not None
            if next(asked):
                return found
            cards = {**found.solution.wcs, "CRVAL1": wrong.ra_deg, "CRVAL2": wrong.dec_deg}
            return replace(found, solution=replace(found.solution, center=wrong, wcs=cards))

        rig.sky.verdict = verdict  # type: ignore[method-assign]
        report = await rig.navigator.recover()
        assert separation_arcsec(report.second.seen, rig.mechanics.truth()) < 60.0

    in_virtual_time(work)


def test_a_lost_mount_that_takes_its_sync_late_is_waited_for() -> None:
    async def work(rig: VirtualRig) -> None:
        rig.mechanics.sync_behavior, rig.mechanics.sync_late_s = "late", 23.0
        rig.navigator.mount.distrust("its link was lost")
        report = await rig.navigator.recover()
        assert report.outcome is SyncOutcome.LATE
        assert rig.navigator.mount.trusted

    in_virtual_time(work)


@pytest.mark.long
async def test_a_recovery_searches_everywhere_even_where_looks_must_not(make_rig: MakeRig) -> None:
    made: list[FindsAnywhere] = []

    def kept(mechanics: Mechanics, catalog: Catalog) -> FindsAnywhere:
        made.append(FindsAnywhere(mechanics, catalog))
        return made[0]

    rig = await make_rig(solve=kept, solving=SolveSettings(blind="never"))
    await rig.navigator.look()
    await rig.navigator.recover(0.1)
    assert [settings.blind for _, settings in made[0].asked] == ["never", "after", "after"]
    # both frames were asked with the mount's belief, the second one not with what the first one brought
    assert len({hint.center_source for hint, _ in made[0].asked}) == 1


def test_a_recovery_that_is_stopped_leaves_no_mount_tracking_that_it_switched_on() -> None:
    async def work(rig: VirtualRig) -> None:
        rig.navigator.mount.distrust("it was switched off")
        await rig.navigator.set_tracking(False)
        recovering = asyncio.ensure_future(rig.navigator.recover(60.0))
        while not rig.mechanics.tracking:
            await rig.clock.sleep(0.1)
        recovering.cancel()
        with pytest.raises((asyncio.CancelledError, Cancelled)):
            await recovering
        assert not rig.mechanics.tracking

    in_virtual_time(work)
