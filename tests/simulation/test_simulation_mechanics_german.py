"""The fake German mount: sides, flips, limits, and what its geometry errors do on each side."""

from __future__ import annotations

import math
from datetime import timedelta
from itertools import pairwise

import erfa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import Refusal
from mountnav.simulation.geometry import perfect_direction, true_direction
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.posture import axes_at, flipped, side_for, side_of, within_reach
from mountnav.sky.chain import apparent_to_icrs, sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Icrs, Site
from mountnav.sky.sphere import offset_arcsec, separation_arcsec

NO_AIR = Air(0.0)
NONE = PointingErrors()
GERMAN = Machine(mounting="german", meridian_limits_deg=(12.0, 8.0))
EAST, WEST = PierSide.EAST, PierSide.WEST


def at(mechanics: Mechanics, clock, hours_west: float, dec_deg: float) -> Apparent:
    lst_deg = sidereal_time_deg(clock(), mechanics.site)
    return Apparent((lst_deg - 15.0 * hours_west) % 360.0, dec_deg, clock())


def arrive(mechanics: Mechanics, clock, target: Apparent, side: PierSide | None = None) -> None:
    assert mechanics.slew(target, side) is None
    while mechanics.slewing():
        clock.on(1.0)


def turn_about(vector, axis, angle):
    """Turn a vector about an axis by the right hand, as erfa does it: outside the simulation's own code."""
    return erfa.rxp(erfa.rv2m([-angle * a for a in axis]), vector)


@given(
    st.floats(-179.9, 179.9),
    st.floats(-89.9, 89.9),
    st.sampled_from([EAST, WEST]),
    st.floats(-89.0, 89.0),
)
def test_both_postures_look_at_the_place(ha_deg, dec_deg, side, latitude_deg) -> None:
    axes = axes_at(ha_deg, dec_deg, GERMAN, side, latitude_deg)
    assert -90.0 <= axes[0] <= 270.0
    assert side_of(axes[1], GERMAN) is side
    assert perfect_direction(*axes) == pytest.approx((ha_deg, dec_deg), abs=1e-9)
    other = flipped(axes, latitude_deg)
    assert side_of(other[1], GERMAN) is not side
    assert perfect_direction(*other) == pytest.approx((ha_deg, dec_deg), abs=1e-9)
    assert flipped(other, latitude_deg) == pytest.approx(axes, abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [48.93, -33.0])
@pytest.mark.parametrize("ha_deg", [-70.0, -20.0, 35.0, 80.0])
@pytest.mark.parametrize("dec_deg", [-25.0, 10.0, 60.0, -75.0])
@pytest.mark.parametrize("side", [EAST, WEST])
def test_the_tube_hangs_where_rotations_by_hand_leave_it(latitude_deg, ha_deg, dec_deg, side) -> None:
    """A tube turned about two axes by erfa, collimation and crooked axes included [POINTING §5]."""
    pole, meridian, west = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    ch_arcsec, np_arcsec = 900.0, 250.0
    ha_axis, dec_axis = axes_at(ha_deg, dec_deg, GERMAN, side, latitude_deg)
    arcsec = math.radians(1 / 3600)
    tube = turn_about(meridian, pole, ch_arcsec * arcsec)
    # east-west declination axis: turning about east raises the tube from the meridian to the pole
    tube = turn_about(tube, west, -math.radians(dec_axis))
    tube = turn_about(tube, meridian, -np_arcsec * arcsec)
    tube = turn_about(tube, pole, math.radians(ha_axis))
    expected = math.degrees(math.atan2(tube[1], tube[0])), math.degrees(math.asin(tube[2]))
    errors = PointingErrors(ch_arcsec=ch_arcsec, np_arcsec=np_arcsec)
    assert true_direction(ha_axis, dec_axis, errors, latitude_deg) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("term", ["ch", "np", "id", "ih", "me", "ma", "tf"])
@pytest.mark.parametrize("latitude_deg", [48.93, -33.0])
def test_ch_np_and_id_change_sign_with_the_side_and_the_others_do_not(term, latitude_deg) -> None:
    """[POINTING §5]: CH and NP flip with the pier side, ID beyond the pole; the others belong to the sky."""
    errors = PointingErrors(**{f"{term}_arcsec": 100.0})
    for ha_deg, dec_deg in ((-50.0, 40.0), (20.0, -20.0), (70.0, 65.0)):
        seen = []
        for side in (EAST, WEST):
            axes = axes_at(ha_deg, dec_deg, GERMAN, side, latitude_deg)
            h, d = true_direction(*axes, errors, latitude_deg)
            xi = ((h - ha_deg + 180.0) % 360.0 - 180.0) * 3600.0 * math.cos(math.radians(dec_deg))
            seen.append((xi, (d - dec_deg) * 3600.0))
        sign = -1.0 if term in ("ch", "np", "id") else 1.0
        assert max(map(abs, seen[0])) > 10.0
        assert seen[1] == pytest.approx([sign * part for part in seen[0]], abs=0.3)


def test_the_flip_shows_the_collimation_twice(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, PointingErrors(ch_arcsec=300.0), machine=GERMAN, clock=clock)
    offsets = []
    for side in (EAST, WEST):
        arrive(mechanics, clock, at(mechanics, clock, 0.1, 20.0), side)
        assert mechanics.pier_side() is side
        offsets.append(offset_arcsec(mechanics.truth(), apparent_to_icrs(mechanics.reported())))
    assert offsets[0].east_arcsec == pytest.approx(-300.0, abs=0.5)
    assert offsets[1].east_arcsec == pytest.approx(300.0, abs=0.5)


@pytest.mark.parametrize("latitude_deg", [48.93, -33.0])
def test_it_changes_sides_with_the_meridian_as_ascom_counts(clock, latitude_deg: float) -> None:
    site = Site(latitude_deg, 22.27)
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    for hours_west, side in ((-3.0, WEST), (3.0, EAST), (-0.1, WEST), (0.1, EAST)):
        target = at(mechanics, clock, hours_west, 15.0)
        assert mechanics.destination_side(target) is side
        arrive(mechanics, clock, target)
        assert mechanics.pier_side() is side
        assert abs(mechanics.axes().dec_axis_deg) > 90.0 if side is WEST else True
        assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 15.0, clock())) < 0.5
        assert separation_arcsec(apparent_to_icrs(mechanics.reported()), mechanics.truth()) < 0.05


def test_the_side_may_be_asked_for_or_kept(clock, site: Site) -> None:
    keeps = Machine(mounting="german", meridian_limits_deg=(12.0, 8.0), side_rule="stay")
    mechanics = Mechanics(site, NO_AIR, NONE, machine=keeps, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, -2.0, 30.0), WEST)
    assert mechanics.destination_side(at(mechanics, clock, 0.4, 30.0)) is WEST  # 6° past: within 8°
    assert mechanics.destination_side(at(mechanics, clock, 0.6, 30.0)) is EAST  # 9° past
    arrive(mechanics, clock, at(mechanics, clock, 0.4, 30.0))
    assert mechanics.pier_side() is WEST
    arrive(mechanics, clock, at(mechanics, clock, 0.4, 30.0), EAST)
    assert mechanics.pier_side() is EAST
    assert mechanics.refusal(at(mechanics, clock, 2.0, 30.0), WEST) is Refusal.LIMIT
    assert mechanics.refusal(at(mechanics, clock, 2.0, 30.0), EAST) is None


def test_a_flip_goes_over_the_pole_and_never_all_round(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 4.0, -30.0))
    mechanics.slew(at(mechanics, clock, -4.0, -30.0))
    begin = clock()
    steps = [mechanics.axes(begin + timedelta(seconds=0.5 * k)).dec_axis_deg for k in range(200)]
    assert all(b >= a for a, b in pairwise(steps))
    assert steps[-1] == pytest.approx(210.0, abs=0.01)


def test_tracking_ends_at_the_meridian_limit_at_the_very_instant(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, -0.1, 30.0))
    assert mechanics.pier_side() is WEST
    left_deg = 188.0 - mechanics.axis_angle("ha")
    limit = clock() + timedelta(seconds=left_deg / SIDEREAL_DEG_S)
    ahead = mechanics.truth(limit + timedelta(hours=1))  # foretold before it happens
    clock.on((limit - clock()).total_seconds() - 1.0)
    assert mechanics.tracking
    assert not mechanics.at_limit
    clock.on(1.1)
    assert not mechanics.tracking
    assert mechanics.at_limit
    assert not mechanics.slewing()
    assert mechanics.pier_side() is WEST
    assert mechanics.axis_angle("ha") == pytest.approx(188.0, abs=1e-6)
    clock.on((limit - clock()).total_seconds() + 3600.0)
    assert mechanics.truth() == ahead
    mechanics.tracking = True  # no way on
    assert not mechanics.tracking
    assert mechanics.axis_angle("ha") == pytest.approx(188.0, abs=1e-6)
    mechanics.move("e", 1.0)  # back is free
    clock.on(10.0)
    mechanics.stop()
    clock.on(5.0)
    assert mechanics.axis_angle("ha") < 180.0
    assert not mechanics.at_limit


def test_at_the_limit_a_custom_rate_in_declination_ends_too(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, -0.1, 30.0))
    mechanics.track_at(SIDEREAL_DEG_S, 0.0005)
    clock.on(10_000.0)
    assert mechanics.at_limit
    assert mechanics.axis_velocity("dec") == 0.0
    assert mechanics.axis_angle("dec") < 150.0  # north, through the pole


def test_stopping_or_switching_tracking_off_before_the_limit_takes_effect_now(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, -1.0, 30.0))
    mechanics.tracking = False
    clock.on(1.0)
    axes = mechanics.axes()
    clock.on(20_000.0)
    assert mechanics.axes() == axes
    assert not mechanics.at_limit


def test_flipping_at_the_limit_keeps_the_place(clock, site: Site) -> None:
    machine = Machine(mounting="german", meridian_limits_deg=(12.0, 1.0), at_limit="flip")
    mechanics = Mechanics(site, NO_AIR, NONE, machine=machine, clock=clock)
    target = at(mechanics, clock, -0.2, 30.0)
    arrive(mechanics, clock, target)
    clock.on(0.25 * 3600.0)
    assert mechanics.pier_side() is WEST
    for _ in range(200):
        clock.on(2.0)
        if mechanics.slewing():
            break
    assert mechanics.slewing()
    while mechanics.slewing():
        clock.on(1.0)
    assert mechanics.pier_side() is EAST
    assert mechanics.tracking
    assert not mechanics.at_limit
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 30.0, clock())) < 1.0
    clock.on(3600.0)
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 30.0, clock())) < 1.0


def test_tracking_ends_where_the_place_sets(clock, site: Site) -> None:
    machine = Machine(mounting="german", lowest_altitude_deg=10.0)
    mechanics = Mechanics(site, NO_AIR, NONE, machine=machine, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 4.0, 0.0))
    for _ in range(200):
        clock.on(60.0)
        if not mechanics.tracking:
            break
    assert not mechanics.tracking
    assert mechanics.at_limit
    ha_deg = math.radians(mechanics.axes().ha_axis_deg)
    sine = math.cos(math.radians(site.latitude_deg)) * math.cos(ha_deg)
    assert math.degrees(math.asin(sine)) == pytest.approx(10.0, abs=0.001)
    below = at(mechanics, clock, 5.5, 0.0)
    assert mechanics.refusal(below) is Refusal.BELOW_HORIZON
    assert mechanics.refusal(at(mechanics, clock, 1.0, 0.0)) is None


def test_a_careless_slew_ends_at_the_limit(clock, site: Site) -> None:
    fork = Machine(ha_limits_deg=(-60.0, 60.0), dec_limits_deg=(-30.0, 90.0))
    mechanics = Mechanics(site, NO_AIR, NONE, machine=fork, clock=clock)
    target = at(mechanics, clock, 5.0, -40.0)
    assert mechanics.refusal(target) is Refusal.LIMIT
    arrive(mechanics, clock, target)
    assert mechanics.axes().ha_axis_deg == pytest.approx(60.0, abs=1e-6)
    assert mechanics.axes().dec_axis_deg == pytest.approx(-30.0, abs=1e-6)
    assert mechanics.at_limit
    assert not mechanics.tracking
    arrive(mechanics, clock, at(mechanics, clock, 1.0, 20.0))
    assert not mechanics.at_limit
    assert mechanics.tracking


def test_a_fork_knows_no_side(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    assert mechanics.pier_side() is PierSide.UNKNOWN
    assert mechanics.destination_side(mechanics.reported()) is PierSide.UNKNOWN


def test_a_sync_keeps_the_side_and_the_flip_keeps_the_sync(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, -2.0, 30.0))
    shifted = at(mechanics, clock, -2.0, 30.5)
    assert mechanics.sync(shifted) is None
    assert mechanics.pier_side() is WEST
    assert separation_arcsec(mechanics.reported(), shifted) < 0.01
    target = at(mechanics, clock, 2.0, 40.0)
    arrive(mechanics, clock, target)
    assert mechanics.pier_side() is EAST
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 40.0, clock())) < 0.5
    # an offset of the declination axis changes its sign on the sky
    offset = offset_arcsec(mechanics.truth(), apparent_to_icrs(mechanics.reported()))
    assert offset.north_arcsec == pytest.approx(1800.0, abs=30.0)


@pytest.mark.parametrize("side", [EAST, WEST])
def test_north_is_north_on_both_sides(clock, site: Site, side: PierSide) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=GERMAN, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 0.1, 30.0), side)
    before = mechanics.reported().dec_deg
    mechanics.pulse("n", 0.01, 10.0)
    clock.on(11.0)
    assert mechanics.reported().dec_deg - before == pytest.approx(0.1, abs=1e-5)
    mechanics.move("s", 0.5)
    clock.on(4.0)
    mechanics.stop_move("s")
    clock.on(1.0)
    assert mechanics.reported().dec_deg - before == pytest.approx(0.1 - 2.0, abs=1e-3)
    mechanics.track_at(SIDEREAL_DEG_S, 0.001)
    assert mechanics.rate is TrackingRate.CUSTOM
    drifting = mechanics.reported().dec_deg
    clock.on(100.0)
    assert mechanics.reported().dec_deg - drifting == pytest.approx(0.1, abs=1e-4)


def test_reach_of_a_fork_counts_both_ways_round() -> None:
    fork = Machine(ha_limits_deg=(-300.0, 100.0))
    assert within_reach((120.0, 0.0), fork)  # as -240
    assert not within_reach((120.0, 0.0), Machine(ha_limits_deg=(-200.0, 100.0)))
    assert side_for(10.0, 0.0, fork, PierSide.UNKNOWN, 50.0) is PierSide.UNKNOWN


def test_a_fork_turns_back_the_long_way_at_its_stop(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=Machine(ha_limits_deg=(-170.0, 170.0)), clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 11.0, 80.0))
    target = at(mechanics, clock, -11.0, 80.0)
    mechanics.slew(target)
    middle = mechanics.axes(clock() + timedelta(seconds=40.0)).ha_axis_deg
    assert abs(middle) < 100.0
    while mechanics.slewing():
        clock.on(1.0)
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 80.0, clock())) < 0.5
    assert isinstance(mechanics.truth(), Icrs)
