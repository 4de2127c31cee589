"""Frame, solve and rate with real pixels: a body drawn as it moves, stars trailed as they would be."""

from __future__ import annotations

from collections.abc import Coroutine
from datetime import timedelta
from typing import Any

import numpy as np
import pytest

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.camera import SimulatedCamera
from mountnav.catalog.embedded import embedded_catalog
from mountnav.ephemeris import SkyRatesTarget
from mountnav.frames import Frame
from mountnav.journal.memory import MemoryJournal
from mountnav.navigation.equipment import equip
from mountnav.navigation.follow_report import FollowReport
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.rates_seen import RateFault as Named
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.rate_faults import RateFault
from mountnav.simulation.trails import MovingBody
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import HourAngle
from mountnav.sky.sphere import separation_arcsec
from tests.navigation.rated_mount import RatedMount
from tests.navigation.virtual_rig import AIR, SITE, START

OPTICS = SimulatedOptics(width_px=1000, height_px=800, scale_arcsec_px=4.0, rotation_deg=33.0, parity=-1)
POLICY = CenteringPolicy(
    exposure_s=2.0, settle_s=0.5, scale_arcsec_px=4.0, timeout_s=900.0, tolerance_arcsec=10.0
)


class InItsTime(SimulatedCamera):
    """Exposes in virtual time; keeps its frames."""

    def __init__(self, mechanics: Mechanics, clock: VirtualClock, body: MovingBody) -> None:
        super().__init__(
            mechanics.truth,
            OPTICS,
            embedded_catalog(),
            seed=7,
            clock=clock,
            bodies=[body],
            tube_angle_deg=mechanics.tube_angle_deg,
        )
        self._time = clock
        self.frames: list[Frame] = []

    async def expose(self, exposure_s: float) -> Frame:
        middle = self._time.utc() + timedelta(seconds=exposure_s / 2.0)
        await self._time.sleep(exposure_s + 0.3)
        frame = self._draw(exposure_s, middle, len(self.frames))
        self.frames.append(frame)
        return frame


def peak_px(frame: Frame) -> float:
    """How far from the frame's middle the brightest pixel near it is."""
    middle_y, middle_x = (OPTICS.height_px - 1) / 2.0, (OPTICS.width_px - 1) / 2.0
    y0, x0 = int(middle_y) - 20, int(middle_x) - 20
    near = frame.pixels[y0 : y0 + 41, x0 : x0 + 41]
    y, x = np.unravel_index(int(np.argmax(near)), near.shape)
    return float(np.hypot(x0 + x - middle_x, y0 + y - middle_y))


@pytest.mark.long
@pytest.mark.parametrize(("fault", "named"), [(None, None), (RateFault(dec_factor=-1.0), Named.SIGN_DEC)])
def test_a_drawn_body_stays_in_the_middle_and_drawn_stars_name_the_fault(
    fault: RateFault | None, named: Named | None
) -> None:
    clock = VirtualClock(START)
    errors = PointingErrors(ih_arcsec=300.0, id_arcsec=-200.0, me_arcsec=60.0, ma_arcsec=-50.0)
    mechanics = Mechanics(SITE, AIR, errors, clock=clock)
    if fault is not None:
        mechanics.fail_rates(fault)
    begin = hour_angle_to_icrs(HourAngle(-20.0, 25.0, START), SITE, AIR)
    target = SkyRatesTarget(begin, 3.0, 2.0, START, START + timedelta(hours=1), "a drawn body")
    camera = InItsTime(mechanics, clock, MovingBody(lambda utc: target.icrs(max(utc, START), SITE), 5.0))

    async def work() -> tuple[FollowReport, float]:
        navigator = Navigator(
            equip(
                name="rig",
                mount=RatedMount(mechanics, clock, MountBehavior()),
                camera=camera,
                catalog=embedded_catalog(),
                site=SITE,
                air=AIR,
                policy=POLICY,
                listen=lambda *_: None,
                journal=MemoryJournal(),
                clock=clock,
                mounting="fork",
            )
        )
        await navigator.open()
        try:
            report = await navigator.follow(
                target, until_utc=clock.utc() + timedelta(minutes=6), look_every_s=30.0
            )
            off = separation_arcsec(mechanics.truth(report.ended_utc), target.icrs(report.ended_utc, SITE))
            return report, off
        finally:
            await navigator.close()

    running: Coroutine[Any, Any, tuple[FollowReport, float]] = work()
    report, off = run_virtually(running, clock)
    assert report.fault is named, report.notes
    assert off <= 11.0
    assert mechanics.beside_arcsec_s == (0.0, 0.0)
    assert report.judgement is not None
    assert report.judgement.verdict == "right", report.judgement.words
    # the body itself is where the frame's middle is, within three pixels
    assert peak_px(camera.frames[-1]) <= 3.0
