"""A simulated camera turns with the tube: beyond the pole its picture stands on its head."""

from __future__ import annotations

import asyncio

import pytest

from drivers.simulated.camera import SimulatedCamera
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import utc_now
from mountnav.devices import PierSide
from mountnav.frames import Hint
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.optics import SimulatedOptics
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, HourAngle, Site
from mountnav.solving.solve import solve

SITE, AIR = Site(48.93, 22.27), Air()
OPTICS = SimulatedOptics(width_px=900, height_px=700, scale_arcsec_px=8.0, rotation_deg=12.0)


async def solved_rotation_deg(mechanics: Mechanics, ha_deg: float) -> float:
    utc = utc_now()
    place = hour_angle_to_icrs(HourAngle(ha_deg, 35.0, utc), SITE, AIR)
    assert mechanics.slew(icrs_to_apparent(place, utc)) is None
    async with asyncio.timeout(60):
        while mechanics.slewing():
            await asyncio.sleep(0.02)
    catalog = embedded_catalog()
    camera = SimulatedCamera(mechanics.truth, OPTICS, catalog, tube_angle_deg=mechanics.tube_angle_deg)
    frame = await camera.expose(0.5)
    verdict = solve(frame, catalog, hint=Hint(place, 2.0, 7.0, 9.0))
    assert verdict.solution is not None, verdict
    return verdict.solution.rotation_deg


async def test_the_other_side_of_the_pier_turns_it_by_half_a_turn() -> None:
    machine = Machine(mounting="german", slew_rate_deg_s=400.0, acceleration_deg_s2=4000.0)
    mechanics = Mechanics(SITE, AIR, PointingErrors(), machine=machine)
    west_of_meridian = await solved_rotation_deg(mechanics, 35.0)
    first = mechanics.pier_side()
    east_of_meridian = await solved_rotation_deg(mechanics, -35.0)
    assert {first, mechanics.pier_side()} == {PierSide.EAST, PierSide.WEST}
    assert west_of_meridian % 360.0 == pytest.approx(12.0, abs=0.6)
    assert (east_of_meridian - west_of_meridian) % 360.0 == pytest.approx(180.0, abs=1.0)
