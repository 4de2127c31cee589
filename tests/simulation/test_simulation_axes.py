"""The motion of one axis, for any start, target and limits."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.simulation.axes import AxisPath

angles = st.floats(-170, 170)
rates = st.floats(0.1, 10)
slow = st.floats(-0.01, 0.01)


@given(angles, st.floats(-8, 8), angles, slow, rates, rates, st.floats(0, 0.02))
def test_it_catches_any_target_without_jumps_and_within_its_limits(
    start, start_velocity, target, target_velocity, rate, acceleration, play
) -> None:
    path = AxisPath.resting(0.0, start, start_velocity, play)
    path = path.to_angle(0.0, target, target_velocity, rate, acceleration)
    end = path.pieces[-1].start_s
    assert path.steady_at(end + 1e-6)
    assert not path.steady_at(end / 2) or end == 0.0
    for later in (0.0, 1.0, 1000.0):
        assert path.angle_at(end + later) == pytest.approx(target + target_velocity * (end + later), abs=1e-8)
    for one, two in pairwise(path.pieces):
        # rounding grows with the time a leg takes
        assert one.angle_at(two.start_s) == pytest.approx(two.angle_deg, abs=1e-6)
        assert one.velocity_at(two.start_s) == pytest.approx(two.velocity_deg_s, abs=1e-6)
        assert abs(one.acceleration_deg_s2) in (0.0, acceleration)
    fastest = max(rate, abs(start_velocity - target_velocity)) + abs(target_velocity)
    for k in range(41):
        t_s = end * k / 40
        assert abs(path.velocity_at(t_s)) <= fastest + 1e-9
        assert -1e-9 <= path.driven_at(t_s) - path.angle_at(t_s) <= play + 1e-9


@pytest.mark.long
@given(angles, angles, rates, rates)
def test_from_rest_it_takes_the_time_of_a_trapezoid(start, target, rate, acceleration) -> None:
    path = AxisPath.resting(0.0, start, 0.0).to_angle(0.0, target, 0.0, rate, acceleration)
    way = abs(target - start)
    ramps_only = way < rate**2 / acceleration
    shortest = 2 * math.sqrt(way / acceleration) if ramps_only else way / rate + rate / acceleration
    assert path.pieces[-1].start_s == pytest.approx(shortest, abs=1e-6)


@pytest.mark.long
@given(st.lists(st.tuples(st.floats(0.01, 5), st.floats(-3, 3)), min_size=1, max_size=6), st.floats(0, 0.5))
def test_the_play_is_that_of_many_small_steps(orders, play) -> None:
    path, t_s = AxisPath.resting(0.0, 0.0, 0.0, play), 0.0
    for wait_s, velocity in orders:
        path = path.to_velocity(t_s, velocity, 2.0, steady=False)
        t_s += wait_s
    driven, n = 0.0, 4000
    for k in range(n + 1):
        angle = path.angle_at(t_s * k / n)
        driven = min(max(driven, angle), angle + play)
    assert path.driven_at(t_s) == pytest.approx(driven, abs=1e-4)


def test_already_there_it_stays() -> None:
    path = AxisPath.resting(0.0, 30.0, 0.004).to_angle(10.0, 30.04, 0.004, 4.0, 2.0)
    assert path.steady_at(10.001)
    assert path.angle_at(20.0) == pytest.approx(30.08)
