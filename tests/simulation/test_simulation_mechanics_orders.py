"""What a fake telescope does on order besides slews: pulses, rates, stations, syncs, clock and site."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import astropy.units as u
import pytest
from astropy.time import Time
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import TRACKING_DEG_S, PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

NO_AIR = Air(0.0)
NONE = PointingErrors()
SITE = Site(48.93, 22.27, 700.0)


def at(mechanics: Mechanics, clock, hours_west: float, dec_deg: float) -> Apparent:
    lst_deg = sidereal_time_deg(clock(), mechanics.site)
    return Apparent((lst_deg - 15.0 * hours_west) % 360.0, dec_deg, clock())


def settle(mechanics: Mechanics, clock) -> None:
    for _ in range(1000):
        if not mechanics.slewing():
            return
        clock.on(1.0)
    pytest.fail("it never comes to rest")


# -- pulses --------------------------------------------------------------------------------------


@settings(deadline=None)
@given(
    st.sampled_from("nsew"),
    st.floats(1e-4, 0.02),
    st.floats(1e-3, 20.0),
    st.sampled_from("nsew"),
    st.floats(0.0, 25.0),
)
def test_pulses_are_exact_also_two_at_once(direction, rate, duration_s, second, wait_s) -> None:
    clock = FastClock(0.0, datetime(2026, 11, 21, 22, tzinfo=UTC))
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    begin = clock()
    start = {axis: mechanics.axis_angle(axis) for axis in ("ha", "dec")}
    assert mechanics.pulse(direction, rate, duration_s)
    clock.on(wait_s)
    if (second in "ns") != (direction in "ns"):  # on the other axis the first one goes on
        assert mechanics.pulse(second, rate / 2.0, duration_s)
    assert not mechanics.slewing()
    clock.on(60.0)
    assert not mechanics.guiding()
    passed_s = (clock() - begin).total_seconds()
    wanted = {"ha": SIDEREAL_DEG_S * passed_s, "dec": 0.0}
    wanted["dec" if direction in "ns" else "ha"] += rate * duration_s * (1 if direction in "nw" else -1)
    if (second in "ns") != (direction in "ns"):
        sign = 1 if second in "nw" else -1
        wanted["dec" if second in "ns" else "ha"] += rate / 2.0 * duration_s * sign
    for axis in ("ha", "dec"):
        assert mechanics.axis_angle(axis) - start[axis] == pytest.approx(wanted[axis], abs=1e-9)


def test_a_pulse_lasts_as_long_as_it_is_told(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    assert mechanics.pulse("e", SIDEREAL_DEG_S / 2.0, 2.0)
    begin = clock()
    assert mechanics.guiding(begin + timedelta(seconds=1.99))
    assert not mechanics.guiding(begin + timedelta(seconds=2.01))
    middle = begin + timedelta(seconds=1.0)
    assert mechanics.axis_velocity("ha", middle) == pytest.approx(SIDEREAL_DEG_S / 2.0)
    assert mechanics.axis_velocity("ha", begin + timedelta(seconds=3.0)) == SIDEREAL_DEG_S
    assert mechanics.tracking


def test_a_new_pulse_takes_the_place_of_the_old_one(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    start = mechanics.axis_angle("dec")
    mechanics.pulse("n", 0.004, 10.0)
    clock.on(3.0)
    mechanics.pulse("n", 0.004, 2.0)
    clock.on(20.0)
    assert mechanics.axis_angle("dec") - start == pytest.approx(0.004 * 5.0, abs=1e-9)


def test_no_pulse_during_a_slew_and_none_when_parked(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    mechanics.slew(at(mechanics, clock, 2.0, 20.0))
    clock.on(1.0)
    assert not mechanics.pulse("n", 0.004, 1.0)
    mechanics.park()
    settle(mechanics, clock)
    assert not mechanics.pulse("n", 0.004, 1.0)


# -- rates ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", list(TRACKING_DEG_S))
def test_it_tracks_at_the_rate_that_is_set(clock, rate: TrackingRate) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    mechanics.rate = rate
    assert mechanics.rate is rate
    clock.on(1.0)
    angle = mechanics.axis_angle("ha")
    clock.on(1000.0)
    assert (mechanics.axis_angle("ha") - angle) / 1000.0 == pytest.approx(TRACKING_DEG_S[rate], rel=1e-9)
    # a day of the Sun, a turn of the stars, the Moon's 13.2 degrees a day
    per_day = {"sidereal": 360.98565, "solar": 360.0, "lunar": 348.274, "king": 360.8856}[rate.value]
    assert TRACKING_DEG_S[rate] * 86400.0 == pytest.approx(per_day, abs=0.001)


def test_a_slew_at_another_rate_still_ends_on_its_target(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    mechanics.track_at(0.001, 0.002)
    target = at(mechanics, clock, 4.0, 10.0)
    mechanics.slew(target)
    begin = clock()
    arrival = next(
        when for k in range(10**5) if not mechanics.slewing(when := begin + timedelta(milliseconds=10 * k))
    )
    assert separation_arcsec(mechanics.reported(arrival), Apparent(target.ra_deg, 10.0, arrival)) < 0.5
    assert mechanics.axis_velocity("ha", arrival + timedelta(seconds=1)) == pytest.approx(0.001)
    assert mechanics.axis_velocity("dec", arrival + timedelta(seconds=1)) == pytest.approx(0.002)
    mechanics.tracking = False
    clock.on(100.0)
    assert mechanics.axis_velocity("dec") == 0.0


# -- stations ------------------------------------------------------------------------------------


def test_parking_and_unparking(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=Machine(mounting="german"), clock=clock)
    assert not mechanics.parked
    mechanics.park()
    assert mechanics.parking
    assert mechanics.slewing()
    settle(mechanics, clock)
    assert mechanics.parked
    assert not mechanics.parking
    assert not mechanics.tracking
    assert mechanics.at_home
    assert mechanics.axis_angle("ha") == pytest.approx(90.0, abs=1e-9)
    assert mechanics.axis_angle("dec") == pytest.approx(90.0, abs=1e-9)
    axes, place = mechanics.axes(), mechanics.reported()
    assert mechanics.slew(at(mechanics, clock, 1.0, 10.0)) is Refusal.PARKED
    assert mechanics.refusal(place) is Refusal.PARKED
    assert mechanics.sync(place) is Refusal.PARKED
    assert mechanics.home() is Refusal.PARKED
    mechanics.tracking = True
    mechanics.move("n", 1.0)
    mechanics.stop()
    mechanics.park()
    clock.on(100.0)
    assert mechanics.parked
    assert mechanics.axes() == axes
    mechanics.unpark()
    assert not mechanics.parked
    assert not mechanics.tracking
    assert mechanics.slew(at(mechanics, clock, 1.0, 10.0)) is None


def test_a_stop_ends_parking(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=Machine(park_axes_deg=(-60.0, 0.0)), clock=clock)
    mechanics.park()
    clock.on(3.0)
    mechanics.stop()
    assert not mechanics.parking
    settle(mechanics, clock)
    clock.on(100.0)
    assert not mechanics.parked


def test_the_park_position_may_be_set_and_is_where_it_believes_to_be(clock) -> None:
    machine = Machine(tracks_after_unpark=True)
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=machine, clock=clock)
    mechanics.slew(at(mechanics, clock, -3.0, 20.0))
    settle(mechanics, clock)
    mechanics.sync(at(mechanics, clock, -3.1, 20.5))
    mechanics.set_park()
    ha_deg, dec_deg = mechanics.axes().ha_axis_deg, mechanics.axes().dec_axis_deg
    mechanics.slew(at(mechanics, clock, 1.0, 50.0))
    settle(mechanics, clock)
    mechanics.park()
    settle(mechanics, clock)
    assert mechanics.parked
    assert mechanics.axes().ha_axis_deg == pytest.approx(ha_deg, abs=1e-6)
    assert mechanics.axes().dec_axis_deg == pytest.approx(dec_deg, abs=1e-6)
    mechanics.unpark()
    assert mechanics.tracking


def test_the_park_position_may_be_set_by_its_axes(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=Machine(mounting="german"), clock=clock)
    mechanics.set_park((100.0, 120.0))
    mechanics.park()
    settle(mechanics, clock)
    assert mechanics.parked
    assert (mechanics.axis_angle("ha"), mechanics.axis_angle("dec")) == pytest.approx((100.0, 120.0))
    assert mechanics.pier_side() is PierSide.WEST
    mechanics.set_park((90.0, 90.0))
    assert mechanics.parked


def test_it_may_be_found_parked(clock) -> None:
    machine = Machine(mounting="german", starts_at="park", park_axes_deg=(90.0, 0.0))
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=machine, clock=clock)
    clock.on(50.0)
    assert mechanics.parked
    assert not mechanics.tracking
    assert mechanics.axes().dec_axis_deg == 0.0


def test_homing_with_a_sensor_puts_the_belief_right(clock) -> None:
    for sensor in (True, False):
        machine = Machine(mounting="german", home_sensor=sensor)
        mechanics = Mechanics(SITE, NO_AIR, NONE, machine=machine, clock=clock)
        seen = mechanics.reported()
        mechanics.sync(Apparent(seen.ra_deg + 20.0, seen.dec_deg - 10.0, clock()))
        assert mechanics.home() is None
        assert mechanics.homing
        settle(mechanics, clock)
        assert mechanics.at_home
        assert not mechanics.homing
        mechanics.slew(at(mechanics, clock, 1.0, 30.0))
        settle(mechanics, clock)
        miss = separation_arcsec(mechanics.reported(), Apparent(mechanics.reported().ra_deg, 30.0, clock()))
        assert miss < 0.5
        truly_dec = mechanics.axes().dec_axis_deg
        assert (abs(truly_dec - 30.0) < 0.001) is sensor


def test_home_is_left_by_tracking_or_a_pulse(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=Machine(mounting="german"), clock=clock)
    mechanics.home()
    settle(mechanics, clock)
    assert mechanics.pulse("s", 0.05, 4.0)
    clock.on(6.0)
    assert not mechanics.at_home
    assert not mechanics.homing
    mechanics.home()
    settle(mechanics, clock)
    mechanics.tracking = True
    clock.on(60.0)
    assert not mechanics.at_home
    assert not mechanics.homing


def test_homing_that_is_stopped_changes_no_belief(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=Machine(home_sensor=True), clock=clock)
    seen = mechanics.reported()
    mechanics.sync(Apparent(seen.ra_deg + 20.0, seen.dec_deg - 10.0, clock()))
    mechanics.home()
    clock.on(2.0)
    mechanics.stop()
    settle(mechanics, clock)
    shift = mechanics.reported().dec_deg - mechanics.axes().dec_axis_deg
    clock.on(1000.0)
    assert mechanics.reported().dec_deg - mechanics.axes().dec_axis_deg == pytest.approx(shift, abs=0.01)
    assert not mechanics.homing


# -- syncs ---------------------------------------------------------------------------------------


def test_a_sync_may_be_ignored_refused_or_late(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    mechanics.slew(at(mechanics, clock, 1.0, 30.0))
    settle(mechanics, clock)
    before = mechanics.reported()
    there = Apparent(before.ra_deg + 1.0, 31.0, clock())
    mechanics.sync_behavior = "ignore"
    assert mechanics.sync(there) is None
    assert mechanics.reported() == before
    mechanics.sync_behavior = "refuse"
    assert mechanics.sync(there) is Refusal.OTHER
    assert mechanics.reported() == before
    mechanics.sync_behavior, mechanics.sync_late_s = "late", 7.0
    ordered = clock()
    assert mechanics.sync(there) is None
    assert mechanics.reported() == before
    truth = mechanics.truth()
    clock.on(6.9)
    assert mechanics.reported().dec_deg == pytest.approx(before.dec_deg, abs=1e-4)
    clock.on(0.2)
    assert separation_arcsec(mechanics.reported(), Apparent(there.ra_deg, 31.0, clock())) < 0.5
    assert mechanics.truth(ordered) == truth
    mechanics.sync_behavior = "normal"
    back = Apparent(before.ra_deg, before.dec_deg, clock())
    assert mechanics.sync(back) is None
    assert separation_arcsec(mechanics.reported(), back) < 0.01


def test_a_sync_takes_the_place_of_one_that_is_still_to_come(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    before = mechanics.reported()
    mechanics.sync_behavior = "late"
    mechanics.sync(Apparent(before.ra_deg + 3.0, before.dec_deg, clock()))
    mechanics.sync_behavior = "normal"
    clock.on(1.0)
    now = Apparent(before.ra_deg + 1.0, before.dec_deg, clock())
    mechanics.sync(now)
    clock.on(60.0)
    assert separation_arcsec(mechanics.reported(), Apparent(now.ra_deg, now.dec_deg, clock())) < 0.5


def test_a_clock_set_meanwhile_outlives_a_late_sync(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    mechanics.sync_behavior = "late"
    mechanics.sync(at(mechanics, clock, 1.0, 40.0))
    clock.on(1.0)
    mechanics.set_believed_utc(clock() + timedelta(seconds=90))
    clock.on(60.0)
    assert mechanics.reported().dec_deg == pytest.approx(40.0, abs=0.01)
    assert mechanics.believed_utc() == clock() + timedelta(seconds=90)


def test_a_sync_beyond_reach_is_refused(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=Machine(sync_reach_deg=6.0), clock=clock)
    seen = mechanics.reported()
    assert mechanics.sync(Apparent(seen.ra_deg, seen.dec_deg - 6.5, clock())) is Refusal.OTHER
    assert mechanics.reported() == seen
    assert mechanics.sync(Apparent(seen.ra_deg, seen.dec_deg - 5.5, clock())) is None


# -- clock and site ------------------------------------------------------------------------------


@pytest.mark.long
def test_a_minute_on_the_clock_is_fifteen_minutes_of_arc_in_the_report_alone(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    before, truth = mechanics.reported(), mechanics.truth()
    mechanics.set_believed_utc(clock() + timedelta(seconds=60.0))
    assert mechanics.believed_utc() == clock() + timedelta(seconds=60.0)
    off_deg = half_turn_deg(mechanics.reported().ra_deg - before.ra_deg)
    assert off_deg * 60.0 == pytest.approx(60.0 * SIDEREAL_DEG_S * 60.0, abs=1e-3)
    assert mechanics.truth() == truth
    assert mechanics.reported().utc == clock()
    # what it is sent to is reported where it stands, and truly missed by as much
    target = at(mechanics, clock, 0.0, 0.0)
    mechanics.slew(target)
    settle(mechanics, clock)
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 0.0, clock())) < 0.5
    # sidereal time by astropy: the true hour angle of the axes is that of a minute ago
    lst = Time(clock()).sidereal_time("apparent", SITE.longitude_deg * u.deg).deg
    true_ra = (lst - mechanics.axes().ha_axis_deg) % 360.0
    assert half_turn_deg(true_ra - target.ra_deg) * 60.0 == pytest.approx(-15.04, abs=0.05)


def test_a_wrong_site_is_a_wrong_right_ascension(clock) -> None:
    mechanics = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    before, truth = mechanics.reported(), mechanics.truth()
    wrong = Site(SITE.latitude_deg, -SITE.longitude_deg, SITE.height_m)
    mechanics.set_believed_site(wrong)
    assert mechanics.believed_site == wrong
    assert mechanics.site == SITE
    off_deg = half_turn_deg(mechanics.reported().ra_deg - before.ra_deg)
    assert off_deg == pytest.approx(-2.0 * SITE.longitude_deg, abs=0.001)
    assert mechanics.truth() == truth


def test_its_clock_drifts(clock) -> None:
    machine = Machine(clock_offset_s=2.0, clock_drift_ppm=50.0)
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=machine, clock=clock)
    assert (mechanics.believed_utc() - clock()).total_seconds() == pytest.approx(2.0)
    clock.on(86_400.0)
    assert (mechanics.believed_utc() - clock()).total_seconds() == pytest.approx(2.0 + 4.32, abs=1e-5)
    mechanics.set_believed_utc(clock())
    assert mechanics.believed_utc() == clock()
    clock.on(1000.0)
    assert (mechanics.believed_utc() - clock()).total_seconds() == pytest.approx(0.05, abs=1e-5)


# -- encoders ------------------------------------------------------------------------------------


def test_encoders_count_in_steps_and_the_truth_does_not(clock) -> None:
    machine = Machine(encoder_arcsec=90.0)
    mechanics = Mechanics(SITE, NO_AIR, NONE, machine=machine, clock=clock)
    exact = Mechanics(SITE, NO_AIR, NONE, clock=clock)
    for k in range(40):
        step_deg = 90.0 / 3600.0
        for axis in ("ha", "dec"):
            counts = mechanics.axis_angle(axis) / step_deg
            assert counts == pytest.approx(round(counts), abs=1e-9)
            assert abs(mechanics.axis_angle(axis) - exact.axis_angle(axis)) <= step_deg / 2.0 + 1e-12
        assert separation_arcsec(mechanics.truth(), exact.truth()) == 0.0
        assert separation_arcsec(mechanics.reported(), exact.reported()) <= 45.0 * 1.42
        clock.on(1.0 + k)
