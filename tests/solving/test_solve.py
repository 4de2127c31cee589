"""The way of one frame through solve(): what each step does, and what it leaves undone."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.measuring.measure import measure
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Reason
from mountnav.solving.solve import SolveSettings, solve

OPTICS = SimulatedOptics(640, 480, 6.0, rotation_deg=12.0, faint_stars_deg2=150.0, sky_adu_s=10.0)
CENTER = Icrs(83.2, 21.4)
NEAR = Hint(center=Icrs(83.0, 21.5), radius_deg=1.0, scale_low_arcsec_px=5.8, scale_high_arcsec_px=6.2)


@pytest.fixture(scope="module")
def frame() -> Frame:
    """A frame without a hint of its own."""
    utc = datetime(2026, 11, 21, 20, tzinfo=UTC)
    drawn = draw_frame(CENTER, OPTICS, embedded_catalog(), exposure_s=10.0, mid_exposure_utc=utc, seed=(3,))
    return replace(drawn, hint=Hint())


def test_a_frame_is_found_and_its_times_add_up(frame: Frame) -> None:
    verdict = solve(frame, embedded_catalog(), hint=NEAR)
    assert verdict.solution is not None
    assert separation_arcsec(verdict.solution.center, CENTER) < 1.0
    assert verdict.times.total_s == pytest.approx(verdict.times.measure_s + verdict.times.identify_s)
    assert not verdict.notes
    assert not verdict.moved


@pytest.mark.long
def test_fast_and_in_full_the_center_is_the_same(frame: Frame) -> None:
    fast = solve(frame, embedded_catalog(), hint=NEAR)
    full = solve(frame, embedded_catalog(), hint=NEAR, settings=SolveSettings(glance=False))
    assert fast.solution is not None
    assert full.solution is not None
    assert "at a glance" in fast.detail
    assert "at a glance" not in full.detail
    assert separation_arcsec(fast.solution.center, full.solution.center) < 0.5


@pytest.mark.long
def test_measurements_that_are_given_are_neither_calibrated_nor_made_again(frame: Frame) -> None:
    measurements = measure(frame)
    verdict = solve(frame, embedded_catalog(), hint=NEAR, measurements=measurements)
    assert verdict.solution is not None
    assert verdict.measured == len(measurements)
    assert verdict.times.measure_s == 0.0
    assert len(verdict.seen_px) == len(measurements)


def test_without_a_date_the_stars_of_today_are_taken_and_a_note_says_so(frame: Frame) -> None:
    verdict = solve(replace(frame, mid_exposure_utc=None), embedded_catalog(), hint=NEAR)
    assert verdict.solution is not None
    assert verdict.notes == ("the date is unknown, so stars were taken at today's places",)


def test_a_frame_without_a_hint_or_an_index_is_refused_before_it_is_measured(frame: Frame) -> None:
    verdict = solve(frame, embedded_catalog())
    assert verdict.reason is Reason.NO_HINT
    assert verdict.detail.startswith(frame.source)
    assert (verdict.measured, verdict.times.measure_s) == (0, 0.0)


def test_a_wrong_hint_is_reported_with_the_solution(frame: Frame) -> None:
    off = replace(NEAR, center=Icrs(84.6, 21.4), radius_deg=0.8)
    verdict = solve(frame, embedded_catalog(), hint=off)
    assert verdict.solution is not None
    assert [one.about for one in verdict.contradictions] == ["center"]


def test_a_frame_that_cant_be_measured_is_a_verdict_not_an_error(frame: Frame) -> None:
    empty = replace(frame, pixels=np.full((480, 640), np.nan, dtype=np.float32))
    verdict = solve(empty, embedded_catalog(), hint=NEAR)
    assert verdict.reason is Reason.BAD_FRAME
    assert verdict.times.total_s == verdict.times.measure_s > 0.0
