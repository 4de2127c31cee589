"""Rates beside the sidereal one: on both sides of the pier, in both hemispheres, and gotten wrong."""

from __future__ import annotations

import math
from datetime import timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.devices import PierSide, TrackingRate
from mountnav.errors import BadSettings
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.rate_faults import RateFault
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import icrs_to_apparent, sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Site
from mountnav.sky.sphere import half_turn_deg

NORTH, SOUTH = Site(48.93, 22.27, 700.0), Site(-30.17, -70.8, 2200.0)
NO_AIR = Air(pressure_hpa=0.0)
EAST, WEST = PierSide.EAST, PierSide.WEST
FORK = Machine()
GERMAN = Machine(mounting="german", meridian_limits_deg=(15.0, 15.0))
FLIPPING = Machine(mounting="german", meridian_limits_deg=(10.0, 0.2), at_limit="flip")
WAYS = [
    (site, machine, side)
    for site in (NORTH, SOUTH)
    for machine, side in ((FORK, None), (GERMAN, EAST), (GERMAN, WEST))
]


def a_mount(
    site: Site, machine: Machine, side: PierSide | None, hours_west: float = 0.4
) -> tuple[Mechanics, FastClock]:
    """One that tracks near the equator, a little west of the meridian, reached from a side."""
    clock = FastClock(0.0)
    mechanics = Mechanics(site, NO_AIR, PointingErrors(), machine=machine, clock=clock)
    slew(mechanics, clock, hours_west, side)
    return mechanics, clock


def slew(mechanics: Mechanics, clock: FastClock, hours_west: float, side: PierSide | None = None) -> None:
    ra_deg = (sidereal_time_deg(clock(), mechanics.site) - 15.0 * hours_west) % 360.0
    assert mechanics.slew(Apparent(ra_deg, 5.0, clock()), side) is None
    while mechanics.slewing():
        clock.on(1.0)
    clock.on(1.0)


def kept(mechanics: Mechanics, clock: FastClock, for_s: float = 200.0) -> tuple[float, float]:
    """The rates that the tube truly keeps among the stars: of apparent coordinates, ″/s."""
    clock.on(5.0)
    places = []
    for _ in range(2):
        places.append(icrs_to_apparent(mechanics.truth(), clock()))
        clock.on(for_s)
    one, two = places
    ra = half_turn_deg(two.ra_deg - one.ra_deg) * 3600.0 / for_s
    return ra, (two.dec_deg - one.dec_deg) * 3600.0 / for_s


def near(ra_arcsec_s: float, dec_arcsec_s: float):
    return pytest.approx((ra_arcsec_s, dec_arcsec_s), abs=1e-4)


@pytest.mark.parametrize(("site", "machine", "side"), WAYS)
def test_the_tube_keeps_the_rates_that_are_ordered(
    site: Site, machine: Machine, side: PierSide | None
) -> None:
    mechanics, clock = a_mount(site, machine, side)
    assert mechanics.beside_arcsec_s == (0.0, 0.0)
    assert kept(mechanics, clock) == near(0.0, 0.0)
    mechanics.track_beside(0.8, -0.3)
    assert mechanics.rate is TrackingRate.CUSTOM
    assert mechanics.beside_arcsec_s == pytest.approx((0.8, -0.3))
    assert kept(mechanics, clock) == near(0.8, -0.3)
    # a stop, a pulse and a motion by hand leave them
    mechanics.stop()
    mechanics.pulse("n", 0.004, 2.0)
    mechanics.move("w", 0.5)
    clock.on(3.0)
    mechanics.stop_move("w")
    assert kept(mechanics, clock) == near(0.8, -0.3)
    mechanics.track_beside(0.0, 0.0)
    assert mechanics.rate is TrackingRate.SIDEREAL
    assert kept(mechanics, clock) == near(0.0, 0.0)


@pytest.mark.parametrize(("site", "machine", "side"), WAYS)
def test_rates_set_during_a_slew_or_a_motion_hold_after_it(
    site: Site, machine: Machine, side: PierSide | None
) -> None:
    mechanics, clock = a_mount(site, machine, side)
    ra_deg = (sidereal_time_deg(clock(), site) - 11.0) % 360.0
    mechanics.slew(Apparent(ra_deg, 20.0, clock()), side)
    clock.on(0.5)
    mechanics.track_beside(-1.5, 0.7)
    assert mechanics.slewing()
    while mechanics.slewing():
        clock.on(0.5)
    assert kept(mechanics, clock) == near(-1.5, 0.7)
    mechanics.move("s", 0.2)
    clock.on(1.0)
    mechanics.track_beside(2.5, 0.1)
    mechanics.stop_move("s")
    assert kept(mechanics, clock) == near(2.5, 0.1)


def test_a_slew_to_the_other_side_and_a_flip_at_the_limit_keep_the_rates() -> None:
    mechanics, clock = a_mount(NORTH, GERMAN, EAST)
    mechanics.track_beside(0.5, 0.9)
    slew(mechanics, clock, 0.2, WEST)
    assert mechanics.pier_side() is WEST
    assert kept(mechanics, clock) == near(0.5, 0.9)
    flipping, clock = a_mount(NORTH, FLIPPING, WEST, -0.1)
    flipping.track_beside(0.5, 0.9)
    clock.on(900.0)
    assert flipping.pier_side() is EAST
    assert kept(flipping, clock) == near(0.5, 0.9)


def test_a_reboot_ends_the_rates_and_parking_does_not() -> None:
    mechanics, clock = a_mount(NORTH, Machine(tracks_at_boot=True), None)
    mechanics.track_beside(0.5, 0.9)
    mechanics.park()
    clock.on(100.0)
    assert mechanics.parked
    mechanics.unpark()
    mechanics.tracking = True
    assert mechanics.beside_arcsec_s == pytest.approx((0.5, 0.9))
    mechanics.reboot()
    assert mechanics.beside_arcsec_s == (0.0, 0.0)
    assert mechanics.axis_velocity("dec", clock() + timedelta(seconds=5)) == 0.0


def test_rates_are_bounded_by_the_slew_rate_and_must_be_numbers() -> None:
    mechanics, _ = a_mount(NORTH, Machine(slew_rate_deg_s=0.5), None)
    mechanics.track_beside(-90_000.0, 90_000.0)
    assert mechanics.beside_arcsec_s == pytest.approx((15.041 - 1800.0, 1800.0), abs=0.01)
    for wrong in (float("nan"), float("inf")):
        with pytest.raises(BadSettings):
            mechanics.track_beside(wrong, 0.0)
        with pytest.raises(BadSettings):
            mechanics.track_at(0.0, wrong)
    assert mechanics.beside_arcsec_s == pytest.approx((15.041 - 1800.0, 1800.0), abs=0.01)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (RateFault(ra_factor=-1.0), (-0.8, -0.3)),
        (RateFault(dec_factor=-1.0), (0.8, 0.3)),
        (RateFault(ra_factor=15.041, dec_factor=1.0), (12.0328, -0.3)),
        (RateFault(swapped=True), (-0.3, 0.8)),
        (RateFault(ra_factor=0.0, dec_factor=0.0), (0.0, 0.0)),
        (RateFault(dec_factor=0.0), (0.8, 0.0)),
    ],
)
@pytest.mark.parametrize(("site", "machine", "side"), WAYS)
def test_each_fault_spoils_what_the_tube_keeps_and_not_what_is_read_back(
    site: Site, machine: Machine, side: PierSide | None, fault: RateFault, expected: tuple[float, float]
) -> None:
    mechanics, clock = a_mount(site, machine, side)
    end = mechanics.fail_rates(fault)
    assert kept(mechanics, clock) == near(0.0, 0.0)  # a star is followed all the same
    mechanics.track_beside(0.8, -0.3)
    assert kept(mechanics, clock) == near(*expected)
    assert mechanics.beside_arcsec_s == pytest.approx((0.8, -0.3))
    end()
    assert kept(mechanics, clock) == near(0.8, -0.3)
    end()
    mechanics.fail_rates(fault)  # rates in force are spoilt as well
    assert kept(mechanics, clock) == near(*expected)


def test_dropped_rates_read_zero() -> None:
    mechanics, clock = a_mount(NORTH, FORK, None)
    mechanics.fail_rates(RateFault(0.0, 0.0, reads_zero=True))
    mechanics.track_beside(0.8, -0.3)
    assert mechanics.beside_arcsec_s == (0.0, 0.0)
    assert kept(mechanics, clock) == near(0.0, 0.0)


def test_rates_that_a_slew_or_a_flip_loses() -> None:
    mechanics, clock = a_mount(NORTH, GERMAN, EAST)
    end = mechanics.fail_rates(RateFault(lost_by_slew=True))
    mechanics.track_beside(0.8, -0.3)
    assert kept(mechanics, clock) == near(0.8, -0.3)
    slew(mechanics, clock, 0.6)
    assert mechanics.beside_arcsec_s == pytest.approx((0.8, -0.3))
    assert kept(mechanics, clock) == near(0.0, 0.0)
    mechanics.track_beside(0.8, -0.3)  # ordered again they hold
    assert kept(mechanics, clock) == near(0.8, -0.3)
    end()
    slew(mechanics, clock, 0.6)
    assert kept(mechanics, clock) == near(0.8, -0.3)
    mechanics.fail_rates(RateFault(lost_by_flip=True))
    slew(mechanics, clock, 0.7)
    assert kept(mechanics, clock) == near(0.8, -0.3)  # the same side
    slew(mechanics, clock, 0.5, WEST)
    assert kept(mechanics, clock) == near(0.0, 0.0)
    flipping, clock = a_mount(NORTH, FLIPPING, WEST, -0.1)
    flipping.fail_rates(RateFault(lost_by_flip=True))
    flipping.track_beside(0.8, -0.3)
    assert kept(flipping, clock) == near(0.8, -0.3)
    clock.on(900.0)
    assert flipping.pier_side() is EAST
    assert kept(flipping, clock) == near(0.0, 0.0)
    flipping.stop()
    assert kept(flipping, clock) == near(0.0, 0.0)


@pytest.mark.parametrize("site", [NORTH, SOUTH])
def test_an_unturned_declination_is_wrong_on_the_west_side_alone(site: Site) -> None:
    for side, sign in ((EAST, 1.0), (WEST, -1.0)):
        mechanics, clock = a_mount(site, GERMAN, side)
        mechanics.fail_rates(RateFault(unturned=True))
        mechanics.track_beside(0.8, -0.3)
        assert kept(mechanics, clock) == near(0.8, -0.3 * sign)


@pytest.mark.parametrize("side", [EAST, WEST])
def test_single_axes_that_follow_are_spoilt_alike(side: PierSide) -> None:
    mechanics, clock = a_mount(NORTH, GERMAN, side)
    north = 1.0 if side is EAST else -1.0

    def drive(ra_arcsec_s: float, dec_arcsec_s: float) -> None:
        mechanics.drive("ha", SIDEREAL_DEG_S - ra_arcsec_s / 3600.0, follows=True)
        mechanics.drive("dec", north * dec_arcsec_s / 3600.0, follows=True)

    drive(0.8, -0.3)
    assert kept(mechanics, clock) == near(0.8, -0.3)
    end = mechanics.fail_rates(RateFault(swapped=True))
    assert kept(mechanics, clock) == near(-0.3, 0.8)
    drive(1.8, -0.4)
    assert kept(mechanics, clock) == near(-0.4, 1.8)
    end()
    assert kept(mechanics, clock) == near(1.8, -0.4)
    mechanics.fail_rates(RateFault(ra_factor=-1.0))
    assert kept(mechanics, clock) == near(-1.8, -0.4)
    mechanics.halt("ha")
    mechanics.halt("dec")
    clock.on(2.0)
    assert (mechanics.axis_velocity("ha"), mechanics.axis_velocity("dec")) == (0.0, 0.0)
    mechanics.drive("ha", -0.5)  # not to follow the sky: not spoilt
    clock.on(2.0)
    assert mechanics.axis_velocity("ha") == -0.5


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from([NORTH, SOUTH]),
    st.floats(-1800.0, 1800.0),
    st.floats(-1800.0, 1800.0).filter(lambda rate: abs(rate) > 1.0),
)
def test_tracking_at_rates_of_its_own_ends_at_the_lowest_altitude(
    site: Site, ra_arcsec_s: float, dec_arcsec_s: float
) -> None:
    clock = FastClock(0.0)
    machine = Machine(lowest_altitude_deg=5.0, slew_rate_deg_s=8.0)
    mechanics = Mechanics(site, NO_AIR, PointingErrors(), machine=machine, clock=clock)
    mechanics.track_beside(ra_arcsec_s, dec_arcsec_s)
    begin = clock()
    # a turn of the axes ahead is where it looks for its limit; axes without ends of their own go on beyond
    turn_s = int(340.0 * 3600.0 / math.hypot(15.041 - ra_arcsec_s, dec_arcsec_s))
    within_s = min(20_000, turn_s)
    ends = next((k for k in range(0, within_s, 2) if not _follows(mechanics, begin, k)), None)
    for k in range(0, ends or within_s, 20):
        assert mechanics.true_observed(begin + timedelta(seconds=k)).alt_deg >= 4.9
    if ends is not None:
        assert mechanics.true_observed(begin + timedelta(seconds=ends)).alt_deg == pytest.approx(5.0, abs=1.2)


def _follows(mechanics: Mechanics, begin, after_s: float) -> bool:
    return mechanics.axis_velocity("dec", begin + timedelta(seconds=after_s + 0.5)) != 0.0
