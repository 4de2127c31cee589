"""Mosaics in virtual time: each panel truly looked at, waits, limits told beforehand, resumed."""

from __future__ import annotations

import asyncio

import pytest

from drivers.simulated.mount import SimulatedMount
from mountnav.devices import SlewOutcome
from mountnav.errors import (
    BadRequest,
    Busy,
    DeviceRefused,
    NotReached,
    OutsideLimits,
    Refusal,
    TargetNotReached,
)
from mountnav.journal.records import EntryKind
from mountnav.navigation.camera import apart_deg
from mountnav.navigation.mosaicking import MosaicReport, MosaicWait, PanelEnd, PanelReport
from mountnav.navigation.rotator import RotatorRules
from mountnav.pointing.limits import Limits
from mountnav.simulation.rotator_mechanics import RotatorBehavior
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.patterns import Panel, mosaic, offsets
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.virtual_rig import VirtualRig, in_virtual_time

DWELL = MosaicWait("dwell", dwell_s=120.0)


def panels_round(center: Icrs, across: int = 2, down: int = 2, angle_deg: float = 0.0) -> tuple[Panel, ...]:
    return mosaic(
        center, across=across, down=down, width_deg=1.6, height_deg=1.1, position_angle_deg=angle_deg
    )


@pytest.mark.long
@pytest.mark.parametrize(("ha_deg", "dec_deg"), [(20.0, 35.0), (30.0, 84.0)])
def test_each_panel_is_looked_at_for_its_time(ha_deg: float, dec_deg: float) -> None:
    async def work(rig: VirtualRig) -> None:
        panels = panels_round(rig.up(ha_deg, dec_deg))
        off: list[float] = []

        def heard(report: PanelReport) -> None:
            if report.end is PanelEnd.CENTERED:
                off.append(rig.off_arcsec(report.panel.place))

        report = await rig.navigator.mosaic(panels, wait=DWELL, heard=heard)
        assert [one.end for one in report.panels] == [PanelEnd.DONE] * 4
        assert report.missing == ()
        assert len(off) == 4
        assert max(off) < 33.0
        for one in report.panels:
            assert one.left_utc is not None
            assert one.centered_utc is not None
            assert (one.left_utc - one.centered_utc).total_seconds() == pytest.approx(120.0, abs=0.1)
        (plan,) = rig.told("mosaic-plan")
        assert len(plan["panels"]) == 4  # type: ignore[arg-type]
        rows = [one.what for one in rig.entries(EntryKind.NOTE) if "panel" in one.what]
        assert len(rows) == 4

    in_virtual_time(work)


def test_the_camera_program_says_when_the_next_one_may_begin() -> None:
    async def work(rig: VirtualRig) -> None:
        panels = panels_round(rig.up(20.0, 35.0), 2, 1)
        with pytest.raises(BadRequest, match="no mosaic is under way"):
            rig.navigator.next_panel()
        centered = asyncio.Event()

        def heard(report: PanelReport) -> None:
            if report.end is PanelEnd.CENTERED:
                centered.set()

        running = asyncio.ensure_future(
            rig.navigator.mosaic(panels, wait=MosaicWait("next", signals=3), heard=heard)
        )
        await asyncio.sleep(1.0)
        with pytest.raises(BadRequest, match="no panel is waiting"):
            rig.navigator.next_panel()
        for panel in panels:
            await centered.wait()
            centered.clear()
            assert [rig.navigator.next_panel() for _ in range(2)] == [2, 1]
            await rig.clock.sleep(300.0)
            assert rig.off_arcsec(panel.place) < 60.0
            # others may not use it meanwhile
            with pytest.raises(Busy):
                await rig.navigator.look()
            assert rig.navigator.next_panel() == 0
        assert (await running).missing == ()
        assert rig.navigator.activity == "idle"

    in_virtual_time(work)


def test_a_program_that_says_nothing_any_more_ends_it_and_it_is_resumed() -> None:
    async def work(rig: VirtualRig) -> None:
        panels = panels_round(rig.up(20.0, 35.0), 3, 1)
        running = asyncio.ensure_future(rig.navigator.mosaic(panels, wait=MosaicWait("next", most_s=600.0)))
        while not rig.navigator.panel_waits:
            await rig.clock.sleep(1.0)
        rig.navigator.next_panel()
        with pytest.raises(TargetNotReached, match="from_panel = 2") as told:
            await running
        assert told.value.reason is NotReached.TIME
        report = await rig.navigator.mosaic(panels, wait=DWELL, from_panel=2)
        assert [one.end for one in report.panels] == [PanelEnd.LEFT_OUT, PanelEnd.DONE, PanelEnd.DONE]
        assert report.missing == ()

    in_virtual_time(work)


def test_panels_that_are_not_allowed_are_told_beforehand_and_left_out() -> None:
    async def work(rig: VirtualRig) -> MosaicReport:
        # the lower row is below the limit of 30°, the upper one above it
        center = rig.up(0.5, -11.0)
        report = await rig.navigator.mosaic(panels_round(center, 1, 2), wait=DWELL)
        assert [one.end for one in report.panels] == [PanelEnd.DONE, PanelEnd.NOT_ALLOWED]
        assert report.missing == (2,)
        (plan,) = rig.told("mosaic-plan")
        rows = plan["panels"]
        assert isinstance(rows, list)
        assert [one["allowed_now"] for one in rows] == [True, False]
        assert any("panel 2: altitude" in words for words in report.notes)
        return report

    in_virtual_time(work, limits=Limits(min_altitude_deg=30.0))


class OwnHorizon(SimulatedMount):
    """A mount that refuses what lies south of 35°, by a horizon of its own."""

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        if place.dec_deg < 35.0:
            raise DeviceRefused("the slew refused", device="rig", reason=Refusal.BELOW_HORIZON)
        return await super().slew(place)


def test_a_panel_below_the_mounts_own_horizon_is_left_out() -> None:
    async def work(rig: VirtualRig) -> None:
        report = await rig.navigator.mosaic(panels_round(rig.up(20.0, 35.0), across=1), wait=DWELL)
        assert [one.end for one in report.panels] == [PanelEnd.DONE, PanelEnd.NOT_ALLOWED]
        assert report.missing == (2,)

    in_virtual_time(work, made=OwnHorizon)


def test_if_none_is_allowed_nothing_moves_and_it_tells_when() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(OutsideLimits, match="comes within the limits at"):
            await rig.navigator.mosaic(panels_round(rig.up(-110.0, 10.0)), wait=DWELL)
        assert not rig.told("slewing")

    in_virtual_time(work)


def test_clouds_end_it_with_the_panel_to_begin_again_with() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(TargetNotReached, match="from_panel = 1"):
            await rig.navigator.mosaic(panels_round(rig.up(20.0, 35.0), 5, 1), wait=DWELL)

    in_virtual_time(work, script=SkyScript(clouds=(Cloud(0.0, 1e6, thin=False),)))


@pytest.mark.long
def test_with_a_rotator_each_panel_stands_as_it_must_to_fit() -> None:
    async def work(rig: VirtualRig) -> None:
        # near the pole the panels of one mosaic stand at very different angles
        panels = panels_round(rig.up(30.0, 82.0), 3, 1, angle_deg=40.0)
        angles = [panel.position_angle_deg for panel in panels]
        assert abs(apart_deg(angles[0], angles[-1])) > 10.0
        off: list[float] = []

        def heard(report: PanelReport) -> None:
            if report.end is PanelEnd.CENTERED:
                off.append(abs(apart_deg(rig.turned_deg, report.panel.position_angle_deg)))

        report = await rig.navigator.mosaic(
            panels, wait=DWELL, turned=True, angle_tolerance_deg=1.0, heard=heard
        )
        assert report.missing == (), report.panels
        assert max(off) < 1.1

    in_virtual_time(work, rotates=RotatorBehavior(), rotator_rules=RotatorRules(sense=1))


def test_a_pattern_of_offsets_is_looked_at_too() -> None:
    async def work(rig: VirtualRig) -> None:
        center = rig.up(20.0, 35.0)
        places: list[Icrs] = []

        def heard(report: PanelReport) -> None:
            if report.end is PanelEnd.CENTERED:
                places.append(rig.mechanics.truth(rig.clock.utc()))

        steps = [(0.0, 0.0), (600.0, 0.0), (0.0, 600.0)]
        await rig.navigator.mosaic(
            offsets(center, steps), wait=MosaicWait("dwell", dwell_s=10.0), tolerance_arcsec=10.0, heard=heard
        )
        assert separation_arcsec(places[0], places[1]) == pytest.approx(600.0, abs=22.0)
        assert separation_arcsec(places[1], places[2]) == pytest.approx(600.0 * 2**0.5, abs=22.0)

    in_virtual_time(work)


def test_a_stop_ends_the_waiting() -> None:
    async def work(rig: VirtualRig) -> None:
        running = asyncio.ensure_future(
            rig.navigator.mosaic(panels_round(rig.up(20.0, 35.0)), wait=MosaicWait("next"))
        )
        while not rig.navigator.panel_waits:
            await rig.clock.sleep(1.0)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        assert rig.navigator.activity == "idle"
        with pytest.raises(BadRequest):
            rig.navigator.next_panel()

    in_virtual_time(work)


@pytest.mark.parametrize(
    "wrong", [{"dwell_s": -1.0}, {"dwell_s": 1e6}, {"most_s": 0.0}, {"signals": 0}, {"signals": 10**6}]
)
def test_waits_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(BadRequest):
        MosaicWait(**wrong)  # type: ignore[arg-type]


def test_a_panel_that_isn_t_there_is_refused() -> None:
    async def work(rig: VirtualRig) -> None:
        with pytest.raises(BadRequest, match="1 to 4"):
            await rig.navigator.mosaic(panels_round(rig.up(20.0, 35.0)), wait=DWELL, from_panel=5)

    in_virtual_time(work)
