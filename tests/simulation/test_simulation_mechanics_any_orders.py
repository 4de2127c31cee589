"""Whatever is ordered, in whatever order: what must hold for every motion of the fake telescope."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide, TrackingRate
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Site
from mountnav.sky.sphere import separation_arcsec

SITE = Site(48.93, 22.27, 700.0)
ERRORS = PointingErrors(
    ih_arcsec=200, ch_arcsec=90, np_arcsec=50, me_arcsec=70, backlash_arcsec=20, periodic_amplitude_arcsec=8
)
FORK = Machine(slew_rate_deg_s=3.0, acceleration_deg_s2=1.5, dec_slew_rate_deg_s=5.0, encoder_arcsec=0.25)
GERMAN = Machine(
    mounting="german",
    slew_rate_deg_s=4.0,
    acceleration_deg_s2=2.0,
    meridian_limits_deg=(10.0, 5.0),
    dec_limits_deg=(-50.0, 230.0),
    lowest_altitude_deg=3.0,
)
FLIPPING = Machine(
    mounting="german",
    meridian_limits_deg=(10.0, 0.5),
    dec_limits_deg=(-90.0, 270.0),
    at_limit="flip",
    starts_at="home",
    home_sensor=True,
)

directions = st.sampled_from("nsew")
places = st.tuples(st.just("slew"), st.floats(-11.9, 11.9), st.floats(-60.0, 89.9))
orders = st.one_of(
    places,
    st.tuples(st.just("sync"), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
    st.tuples(st.just("move"), directions, st.floats(0.001, 9.0)),
    st.tuples(st.just("stop_move"), directions),
    st.tuples(st.just("pulse"), directions, st.floats(0.0005, 0.01), st.floats(0.001, 3.0)),
    st.tuples(st.sampled_from(["stop", "park", "unpark", "home", "set_park"])),
    st.tuples(st.just("tracking"), st.booleans()),
    st.tuples(st.just("rate"), st.sampled_from([TrackingRate.LUNAR, TrackingRate.SOLAR, TrackingRate.KING])),
    st.tuples(st.just("track_at"), st.floats(-0.01, 0.01), st.floats(-0.01, 0.01)),
    st.tuples(st.just("track_beside"), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0)),
    st.tuples(st.just("drive"), st.sampled_from(["ha", "dec"]), st.floats(-5.0, 5.0)),
    st.tuples(st.just("drive_to"), st.sampled_from(["ha", "dec"]), st.floats(-30.0, 90.0)),
    st.tuples(st.just("halt"), st.sampled_from(["ha", "dec"])),
    st.tuples(st.just("unstick"), st.sampled_from(["ha", "dec"])),
    st.tuples(st.just("run_away"), st.sampled_from(["ha", "dec"])),
)
faults = st.one_of(
    st.tuples(st.just("stick"), st.sampled_from(["ha", "dec"])),
    st.tuples(st.sampled_from(["reboot", "power_loss"])),
    st.tuples(st.just("set_encoder"), st.sampled_from(["ha", "dec"]), st.floats(-90.0, 90.0)),
    st.tuples(st.just("sync_behavior"), st.sampled_from(["normal", "ignore", "refuse", "late"])),
    st.tuples(st.just("slew_rate_deg_s"), st.floats(0.5, 8.0)),
)
waits = st.sampled_from([0.0, 0.2, 1.7, 9.0, 60.0, 3000.0])
faulty_courses = st.lists(st.tuples(st.one_of(orders, faults), waits), max_size=9)
courses = st.lists(st.tuples(orders, waits), max_size=9)
machines = st.sampled_from([FORK, GERMAN, FLIPPING])


def clock_at_rest() -> FastClock:
    return FastClock(0.0, datetime(2026, 11, 21, 22, tzinfo=UTC))


def place_at(mechanics: Mechanics, clock: FastClock, hours_west: float, dec_deg: float) -> Apparent:
    ra_deg = sidereal_time_deg(clock(), SITE) - 15.0 * hours_west
    return Apparent(ra_deg % 360.0, dec_deg, clock())


def give(mechanics: Mechanics, clock: FastClock, order: tuple[Any, ...]) -> None:
    what, *how = order
    if what == "slew":
        mechanics.slew(place_at(mechanics, clock, *how))
    elif what == "sync":
        seen = mechanics.reported()
        dec_deg = max(-89.0, min(89.0, seen.dec_deg + how[1]))
        mechanics.sync(Apparent((seen.ra_deg + how[0]) % 360.0, dec_deg, clock()))
    elif what in ("tracking", "rate", "sync_behavior", "slew_rate_deg_s"):
        setattr(mechanics, what, *how)
    else:
        getattr(mechanics, what)(*how)


def state(mechanics: Mechanics, utc: datetime) -> tuple[Any, ...]:
    return (
        mechanics.reported(utc),
        mechanics.truth(utc),
        mechanics.axes(utc),
        mechanics.slewing(utc),
        mechanics.guiding(utc),
        mechanics.pier_side(utc),
        mechanics.believed_utc(utc),
    )


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(machines, faulty_courses)
def test_the_past_never_changes_and_the_future_is_what_comes(machine, course) -> None:
    clock = clock_at_rest()
    mechanics = Mechanics(SITE, Air(930.0), ERRORS, machine=machine, clock=clock)
    seen: dict[datetime, tuple[Any, ...]] = {}
    for order, wait_s in course:
        give(mechanics, clock, order)
        foretold = clock() + timedelta(seconds=wait_s)
        before = state(mechanics, foretold)
        now = state(mechanics, clock())
        if wait_s:  # at the instant of an order the order holds
            for part in (0.1, 0.5, 0.9):
                utc = clock() + timedelta(seconds=part * wait_s)
                seen[utc] = state(mechanics, utc)
        clock.on(wait_s)
        assert state(mechanics, foretold) == before
        assert not wait_s or state(mechanics, clock() - timedelta(seconds=wait_s)) == now
    for utc, was in reversed(seen.items()):
        assert state(mechanics, utc) == was


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(machines, courses)
def test_no_axis_jumps_or_is_faster_than_built(machine, course) -> None:
    clock = clock_at_rest()
    mechanics = Mechanics(SITE, Air(930.0), ERRORS, machine=machine, clock=clock)
    begin, orders_at = clock(), []
    for order, wait_s in course:
        orders_at.append((clock() - begin).total_seconds())
        give(mechanics, clock, order)
        clock.on(wait_s)
    dt = 0.02
    spots = [at + k * dt for at in [*orders_at, 30.0] for k in range(40)]
    spots += [(clock() - begin).total_seconds() * k / 50.0 for k in range(51)]
    for axis in ("ha", "dec"):
        rate = mechanics._rates_deg_s[axis] + 0.01 + SIDEREAL_DEG_S  # the fastest custom rate comes on top
        acceleration = mechanics._accelerations_deg_s2[axis]
        path = mechanics._motion.last.ha.path if axis == "ha" else mechanics._motion.last.dec.path
        for spot in spots:
            one, two = path.velocity_at(spot), path.velocity_at(spot + dt)
            assert abs(one) <= rate + 1e-9
            assert abs(two - one) <= acceleration * dt + 1e-6
            step = path.angle_at(spot + dt) - path.angle_at(spot)
            assert abs(step) <= rate * dt + 1e-6


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(courses)
def test_no_axis_passes_its_limits(course) -> None:
    clock = clock_at_rest()
    mechanics = Mechanics(SITE, Air(), PointingErrors(), machine=GERMAN, clock=clock)
    begin = clock()
    for order, wait_s in course:
        if order[0] != "sync":  # that shifts the limits against the axes
            give(mechanics, clock, order)
        clock.on(wait_s)
    end_s = (clock() - begin).total_seconds() + 50_000.0
    for k in range(400):
        utc = begin + timedelta(seconds=end_s * (k / 400.0) ** 2)
        assert -10.0 - 1e-5 <= mechanics.axis_angle("ha", utc) <= 185.0 + 1e-5
        assert -50.0 - 1e-5 <= mechanics.axis_angle("dec", utc) <= 230.0 + 1e-5


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    machines,
    courses,
    st.floats(-5.9, 5.9),
    st.floats(0.0, 85.0),
    st.sampled_from([None, PierSide.EAST, PierSide.WEST]),
)
def test_a_slew_ends_on_its_target_whatever_came_before(machine, course, hours_west, dec_deg, side) -> None:
    clock = clock_at_rest()
    mechanics = Mechanics(SITE, Air(), PointingErrors(), machine=machine, clock=clock)
    for order, wait_s in course:
        give(mechanics, clock, order)
        clock.on(wait_s)
    mechanics.run_away("ha", past_target=False)
    mechanics.run_away("dec", past_target=False)
    mechanics.unpark()
    mechanics.rate = TrackingRate.SIDEREAL
    target = place_at(mechanics, clock, hours_west, dec_deg)
    if mechanics.refusal(target, side) is not None:
        return
    assert mechanics.slew(target, side) is None
    for _ in range(400):
        if not mechanics.slewing():
            break
        clock.on(1.0)
    assert not mechanics.slewing()
    assert mechanics.tracking
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, dec_deg, clock())) < 0.5
    if side is not None and machine.mounting == "german":
        assert mechanics.pier_side() is side


@pytest.mark.parametrize("rate_deg_s", [5e-324, 1e-150, 1e-12, 1e-9, 1e-6])
def test_an_axis_that_all_but_stands_has_no_setting_to_be_sought(rate_deg_s: float) -> None:
    # of velocities that no instant is fine enough for the search for the horizon never ended
    clock = clock_at_rest()
    machine = Machine(mounting="german", lowest_altitude_deg=3.0)
    mechanics = Mechanics(SITE, Air(), PointingErrors(), machine=machine, clock=clock)
    mechanics.tracking = True
    mechanics.track_at(-rate_deg_s, rate_deg_s)
    clock.on(3600.0)
    assert abs(mechanics.axis_velocity("dec")) <= rate_deg_s
