"""A sync on the way home changes neither the past nor the home that the sensor finds."""

from __future__ import annotations

import pytest

from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.sphere import displaced


def test_a_sync_on_the_way_home_leaves_the_past_and_the_home_alone() -> None:
    clock = VirtualClock()
    machine = Machine(mounting="german", home_sensor=True)
    mechanics = Mechanics(Site(48.9, 22.3), Air(), PointingErrors(), machine=machine, clock=clock)
    before_utc = clock()
    before = mechanics.reported(before_utc)
    clock.now_s += 10.0
    mechanics.home()
    clock.now_s += 1.0
    mechanics.sync(displaced(mechanics.reported(), 0.0, -3600.0))
    assert mechanics.reported(before_utc) == before
    clock.now_s += 120.0
    assert mechanics.at_home
    assert mechanics.reported().dec_deg == pytest.approx(90.0, abs=1e-3)
