"""Slow trends: the turn of a field, and two cameras that bend apart, against lines that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mountnav.guiding.trends import BendingSeen, TrendSeen


def test_a_rotation_is_told_across_the_full_turn_with_its_error() -> None:
    drawn, seen = np.random.default_rng(1), TrendSeen(360.0)
    for number in range(60):
        hours = number / 60.0
        seen.add(3600.0 * hours, (359.5 + 2.0 * hours + 0.01 * drawn.standard_normal()) % 360.0)
    trend = seen.trend()
    assert trend is not None
    assert abs(trend.rate_per_h - 2.0) < 4.0 * trend.sigma_per_h
    assert trend.sigma_per_h == pytest.approx(0.01 / math.sqrt(60.0) / 0.289, rel=0.3)


def test_too_little_is_no_trend() -> None:
    seen = TrendSeen()
    for number in range(3):
        seen.add(float(number), 1.0)
    seen.add(math.nan, 1.0)
    assert seen.trend() is None
    same = TrendSeen()
    for _ in range(10):
        same.add(5.0, 1.0)
    assert same.trend() is None


def test_bending_is_found_under_drift_and_corrections_that_both_cameras_see() -> None:
    drawn, seen = np.random.default_rng(2), BendingSeen()

    def both(t: float) -> float:
        return 5.0 * math.sin(t / 700.0) + 0.01 * t

    for number in range(400):
        t = 10.0 * number
        seen.guide_look(t, both(t) + 0.1 * drawn.standard_normal(), 0.0)
        if number % 12 == 6:
            middle = t - 47.0
            seen.main_frame(middle, both(middle) + 7.0 + 12.0 * middle / 3600.0, 3.0)
    bending = seen.bending()
    assert bending is not None
    assert bending.east.rate_per_h == pytest.approx(12.0, abs=4.0 * bending.east.sigma_per_h)
    assert bending.east.sigma_per_h < 0.5
    assert bending.north.rate_per_h == pytest.approx(0.0, abs=1e-6)


def test_a_main_frame_that_comes_before_the_next_guide_look_waits_for_it() -> None:
    seen = BendingSeen()
    for number in range(10):
        seen.guide_look(20.0 * number, 0.0, 0.0)
        seen.main_frame(20.0 * number + 10.0, 1.0, 2.0)
    seen.guide_look(200.0, 0.0, 0.0)
    bending = seen.bending()
    assert bending is not None
    assert bending.east.points == 10
    assert bending.east.now == pytest.approx(1.0)


def test_frames_without_looks_round_them_show_nothing() -> None:
    seen = BendingSeen(apart_s=60.0)
    for number in range(10):
        seen.guide_look(1000.0 * number, 0.0, 0.0)
        seen.main_frame(1000.0 * number + 500.0, 1.0, 2.0)
    assert seen.bending() is None
