"""Where an axis rests that is told to stop now, against axes that speed up and brake by known laws."""

from __future__ import annotations

from datetime import timedelta

import pytest

from mountnav.devices import PierSide
from mountnav.mount.axis_rates import HEARD_AFTER_S, Braking
from mountnav.pointing.limits.postures import Standing
from tests.mount.mount_rig import NIGHT


def turned_deg(t_s: float, rate: float, acceleration: float) -> float:
    """So far an axis has turned since it set out."""
    ramp_s = min(t_s, rate / acceleration)
    return 0.5 * acceleration * ramp_s**2 + rate * (t_s - ramp_s)


def speed(t_s: float, rate: float, acceleration: float) -> float:
    return min(rate, acceleration * t_s)


@pytest.mark.parametrize("rate", [0.5, 4.1, 8.0])
@pytest.mark.parametrize("acceleration", [1.0, 2.4, 5.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("late_s", [0.0, 0.4, 0.9])
def test_it_rests_no_further_than_foretold_once_it_was_seen_to_speed_up(
    rate: float, acceleration: float, sign: float, late_s: float
) -> None:
    braking, begins_deg = Braking(), 350.0
    foretold: list[tuple[float, float]] = []
    for number in range(14):
        t_s = max(0.0, number - late_s)
        first_deg = (begins_deg + sign * turned_deg(t_s, rate, acceleration)) % 360.0
        stands = Standing("german", PierSide.EAST, first_deg, 40.0)
        rests = braking.rests_at_deg(NIGHT + timedelta(seconds=number), stands)
        if rests is not None:
            foretold.append((t_s, sign * (rests - first_deg)))
    assert len(foretold) >= 10
    for t_s, goes_deg in foretold:
        # the stop is heard later, and then it brakes
        heard_s = t_s + HEARD_AFTER_S
        faster = speed(heard_s, rate, acceleration)
        truly = turned_deg(heard_s, rate, acceleration) - turned_deg(t_s, rate, acceleration)
        truly += faster**2 / (2.0 * acceleration)
        if t_s > 2.0:
            assert goes_deg >= truly - 0.3
        if t_s > rate / acceleration + 2.0:  # the speeding up was seen whole, in looks of a second
            seen = max(0.3, min(acceleration, 0.4 * rate))
            assert goes_deg <= truly + rate**2 / (2.0 * seen)


def test_what_stands_or_jumps_rests_nowhere_else() -> None:
    braking = Braking()
    for number, first_deg in enumerate((10.0, 10.0, 10.01, 190.0, 190.01, 190.02)):
        stands = Standing("german", PierSide.EAST, first_deg, 40.0)
        assert braking.rests_at_deg(NIGHT + timedelta(seconds=number), stands) is None
