"""The solver that is told the truth: its numbers hold together, and its refusals are those of the script."""

from __future__ import annotations

import math
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from astropy.wcs import WCS

from drivers.simulated.truth_camera import TruthCamera
from mountnav.devices import PierSide
from mountnav.errors import BadFrame, BadSettings, Cancelled
from mountnav.frames import Frame, Hint
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.truth_frame import FrameTruth, truth_of
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, half_turn_deg, position_angle_deg, separation_arcsec
from mountnav.solution import Reason, Verdict
from mountnav.solving.settings import SolveSettings

HERE, AIR = Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7)
THERE = Icrs(83.8, 41.2)


def answered(
    script: SkyScript,
    *,
    center: Icrs = THERE,
    hint: Hint | None = None,
    number: int = 1,
    trail_arcsec: float = 0.0,
    at_min: float = 0.0,
    exposure_s: float = 5.0,
    rotation_deg: float = 37.0,
    through: SeenThrough | None = None,
    settings: SolveSettings | None = None,
) -> Verdict:
    clock = VirtualClock()
    through = through or SeenThrough()
    seen = SkySeen(script, clock, through)
    truth = FrameTruth(center, rotation_deg, trail_arcsec, number)
    utc = clock.utc() + timedelta(minutes=at_min)
    frame = truth.frame(through.width_px, through.height_px, exposure_s, utc, "frame")
    assert truth_of(frame) == truth
    return seen.verdict(frame, hint or Hint(center=center, radius_deg=2.0), settings or SolveSettings())


@pytest.mark.parametrize("parity", [1, -1])
@pytest.mark.parametrize("rotation_deg", [0.0, 37.0, 200.0])
def test_center_rotation_scale_and_parity_are_those_of_the_cards(parity: int, rotation_deg: float) -> None:
    through = SeenThrough(parity=parity, sigma_px=0.0)
    solution = answered(SkyScript(), rotation_deg=rotation_deg, through=through).solution
    assert solution is not None
    assert separation_arcsec(solution.center, THERE) < 1e-6
    # astropy judges: 1-based pixels, +y along the position angle, +x to the west of it as the sky is seen
    wcs = WCS(dict(solution.wcs))
    middle = ((through.width_px + 1) / 2.0, (through.height_px + 1) / 2.0)

    def place(dx: float, dy: float) -> Icrs:
        ra, dec = wcs.all_pix2world(middle[0] + dx, middle[1] + dy, 1)
        return Icrs(float(ra), float(dec))

    assert separation_arcsec(place(0.0, 0.0), THERE) < 1e-6
    up = position_angle_deg(THERE, place(0.0, 10.0))
    assert half_turn_deg(up - rotation_deg) == pytest.approx(0.0, abs=0.1)
    right = position_angle_deg(THERE, place(10.0, 0.0))
    assert half_turn_deg(right - up) == pytest.approx(-90.0 * parity, abs=0.1)
    assert separation_arcsec(THERE, place(10.0, 0.0)) == pytest.approx(20.0, rel=1e-3)
    assert solution.scale_arcsec_px == pytest.approx(2.0, rel=1e-3)
    # and our own way through the cards agrees with it
    ours = solution.icrs_at(middle[0] - 1.0 + 700.0, middle[1] - 1.0 - 400.0)
    assert separation_arcsec(ours, place(700.0, -400.0)) < 1e-3


def test_the_center_is_off_by_its_stated_sigma() -> None:
    pulls = []
    for number in range(600):
        solution = answered(SkyScript(seed=5), number=number).solution
        assert solution is not None
        pulls.append(separation_arcsec(solution.center, THERE) / solution.center_sigma_arcsec)
    # Rayleigh: the mean square of both coordinates together is 2
    assert np.mean(np.square(pulls)) == pytest.approx(2.0, rel=0.2)


def test_the_same_frame_gets_the_same_answer() -> None:
    script = SkyScript(seed=9, false_share=0.5)
    first, again = (answered(script, number=17).solution for _ in range(2))
    assert first is not None
    assert again is not None
    assert first.center == again.center


def test_clouds_come_and_go_as_the_script_says() -> None:
    script = SkyScript(clouds=(Cloud(10.0, 20.0), Cloud(30.0, 40.0, thin=True)))
    reasons = [answered(script, at_min=minute).reason for minute in (5.0, 10.0, 19.9, 20.0)]
    assert reasons == [None, Reason.CLOUD_OR_DEFOCUS, Reason.CLOUD_OR_DEFOCUS, None]
    thin = [answered(script, at_min=35.0, number=number) for number in range(200)]
    lost = sum(verdict.reason is Reason.CLOUD_OR_DEFOCUS for verdict in thin)
    assert 30 < lost < 90
    pairs = [verdict.solution.pairs for verdict in thin if verdict.solution is not None]
    clear = answered(script).solution
    assert clear is not None
    assert max(pairs) < clear.pairs
    assert script.clear_from(12.0) == 20.0
    assert script.clear_from(35.0) == 35.0


def test_wrong_solutions_look_good_and_are_told_to_the_judge_only() -> None:
    clock, wrong = VirtualClock(), []
    seen = SkySeen(SkyScript(seed=2, false_share=0.2), clock)
    for number in range(400):
        frame = FrameTruth(THERE, 37.0, 0.0, number).frame(3000, 2000, 5.0, clock.utc(), "frame")
        solution = seen.verdict(frame, Hint(center=THERE, radius_deg=2.0), SolveSettings()).solution
        assert solution is not None
        assert solution.false_probability < 1e-8
        if number in seen.false_frames:
            wrong.append(separation_arcsec(solution.center, THERE) / 3600.0)
        else:
            assert separation_arcsec(solution.center, THERE) < 5.0
    assert 50 < len(wrong) < 120
    assert min(wrong) > 0.05
    assert max(wrong) > 90.0


def test_a_poor_place_is_poor_each_time_and_some_give_in_to_a_longer_exposure() -> None:
    script = SkyScript(seed=1, poor_share=0.2)
    places = [Icrs(float(ra), float(dec)) for ra in range(5, 355, 10) for dec in range(-10, 70, 10)]
    poor = [one for one in places if answered(script, center=one).solution is None]
    assert 0.1 < len(poor) / len(places) < 0.3
    assert all(answered(script, center=one).reason is Reason.TOO_FEW_MEASUREMENTS for one in poor)
    longer = [one for one in poor if answered(script, center=one, exposure_s=20.0).solution is not None]
    assert 0 < len(longer) < len(poor)
    beside = displaced(poor[0], 0.0, 7200.0)
    assert any(answered(script, center=one).solution is not None for one in (beside, places[0]))


def test_trails_cost_accuracy_and_then_the_frame() -> None:
    sharp, trailed = answered(SkyScript()).solution, answered(SkyScript(), trail_arcsec=40.0).solution
    assert sharp is not None
    assert trailed is not None
    assert trailed.center_sigma_arcsec > 5.0 * sharp.center_sigma_arcsec
    assert answered(SkyScript(), trail_arcsec=900.0).reason is Reason.TOO_FEW_MEASUREMENTS


def test_where_the_hint_is_wrong_it_is_found_blind_or_not_at_all() -> None:
    hint = Hint(center=displaced(THERE, 0.0, 10 * 3600.0), radius_deg=2.0)
    found = answered(SkyScript(), hint=hint)
    assert found.solution is not None
    assert found.solution.mode.startswith("blind/")
    assert found.contradictions
    assert answered(SkyScript(), hint=hint, settings=SolveSettings(blind="never")).reason is Reason.NO_MATCH


def test_frames_with_pixels_are_not_its_business() -> None:
    with pytest.raises(BadFrame, match="carries no truth"):
        truth_of(Frame(np.zeros((4, 4))))


def test_the_camera_tells_the_truth_of_mid_exposure_and_the_rotation_of_the_side() -> None:
    clock = VirtualClock()
    errors = PointingErrors(ih_arcsec=300.0, ch_arcsec=200.0, ma_arcsec=-400.0)
    mechanics = Mechanics(HERE, AIR, errors, machine=Machine(mounting="german"), clock=clock)
    camera = TruthCamera(mechanics, clock, turned_deg=33.0)

    async def looks() -> list[Frame]:
        frames = []
        for side in (PierSide.EAST, PierSide.WEST):
            place = hour_angle_to_icrs(HourAngle(2.0, 20.0, clock()), HERE, AIR)
            mechanics.slew(icrs_to_apparent(place, clock()), side)
            await clock.sleep(120.0)
            frames.append(await camera.expose(10.0))
        return frames

    frames = run_virtually(looks(), clock)
    for frame, turned_deg in zip(frames, (33.0, 213.0), strict=True):
        assert frame.mid_exposure_utc is not None
        truth = truth_of(frame)
        assert separation_arcsec(truth.center, mechanics.truth(frame.mid_exposure_utc)) < 1e-6
        assert half_turn_deg(truth.rotation_deg - turned_deg) == pytest.approx(0.0, abs=1.0)
        assert truth.trail_arcsec < 1.0


def test_a_frame_taken_in_motion_is_trailed_and_an_aborted_one_is_none() -> None:
    clock = VirtualClock()
    mechanics = Mechanics(HERE, AIR, PointingErrors(), clock=clock)
    camera = TruthCamera(mechanics, clock)

    async def looks() -> float:
        mechanics.slew(
            icrs_to_apparent(hour_angle_to_icrs(HourAngle(60.0, 0.0, clock()), HERE, AIR), clock())
        )
        frame = await camera.expose(2.0)
        import asyncio

        pending = asyncio.create_task(camera.expose(100.0))
        await clock.sleep(1.0)
        await camera.abort()
        with pytest.raises(Cancelled):
            await pending
        return truth_of(frame).trail_arcsec

    assert run_virtually(looks(), clock) > 3600.0


def test_a_script_is_read_from_a_file_and_nonsense_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "night.toml"
    path.write_text(
        """
seed = 7
satellite_every = 10
[[clouds]]
from_min = 60
to_min = 95
[[incidents]]
at_min = 200
what = "reboot"
for_s = 5
""",
        encoding="utf-8",
    )
    script = SkyScript.from_toml(path)
    assert script.clouds == (Cloud(60, 95),)
    assert script.incidents[0].what == "reboot"
    for wrong in (
        "satelite_every = 10",
        "false_share = 2.0",
        '[[incidents]]\nat_min = 1\nwhat = "fire"',
        "x",
    ):
        path.write_text(wrong, encoding="utf-8")
        with pytest.raises(BadSettings, match=r"night\.toml"):
            SkyScript.from_toml(path)


def test_the_truth_of_the_axes_and_of_the_sky_agree() -> None:
    clock = VirtualClock()
    mechanics = Mechanics(HERE, AIR, PointingErrors(), machine=Machine(mounting="german"), clock=clock)
    for side, beyond in ((PierSide.EAST, False), (PierSide.WEST, True)):
        place = hour_angle_to_icrs(HourAngle(-20.0, 35.0, clock()), HERE, AIR)
        mechanics.slew(icrs_to_apparent(place, clock()), side)
        clock.now_s += 120.0
        ha_deg, dec_deg = mechanics.true_axes()
        seen = mechanics.true_hour_angle()
        assert (abs(half_turn_deg(dec_deg)) > 90.0) is beyond
        assert half_turn_deg(ha_deg - (180.0 if beyond else 0.0) - seen.ha_deg) == pytest.approx(
            0.0, abs=1e-9
        )
        altitude = math.degrees(
            math.asin(
                math.sin(math.radians(HERE.latitude_deg)) * math.sin(math.radians(seen.dec_deg))
                + math.cos(math.radians(HERE.latitude_deg))
                * math.cos(math.radians(seen.dec_deg))
                * math.cos(math.radians(seen.ha_deg))
            )
        )
        assert mechanics.true_observed().alt_deg == pytest.approx(altitude, abs=1e-9)
