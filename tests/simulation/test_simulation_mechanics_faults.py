"""What goes wrong with a fake telescope: stuck axes, runaways, reboots; and axes driven one by one."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from mountnav.devices import TrackingRate
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent, sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

NO_AIR = Air(0.0)
NONE = PointingErrors()
RAW = Machine(mounting="german", starts_at="home", tracks_at_start=False)


def at(mechanics: Mechanics, clock, hours_west: float, dec_deg: float) -> Apparent:
    lst_deg = sidereal_time_deg(clock(), mechanics.site)
    return Apparent((lst_deg - 15.0 * hours_west) % 360.0, dec_deg, clock())


def settle(mechanics: Mechanics, clock) -> None:
    for _ in range(1000):
        if not mechanics.slewing():
            return
        clock.on(1.0)
    pytest.fail("it never comes to rest")


def misses_arcsec(mechanics: Mechanics, clock, target: Apparent) -> float:
    return separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, target.dec_deg, clock()))


def astray_deg(mechanics: Mechanics) -> float:
    return separation_arcsec(mechanics.truth(), apparent_to_icrs(mechanics.reported())) / 3600.0


# -- stuck and running away ----------------------------------------------------------------------


@pytest.mark.parametrize("axis", ["ha", "dec"])
def test_a_stuck_axis_stands_and_the_slew_goes_on_once_it_is_free(clock, site: Site, axis) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    target = at(mechanics, clock, 4.0, 10.0)
    mechanics.slew(target)
    clock.on(3.0)
    mechanics.stick(axis)
    stands = mechanics.axis_angle(axis)
    clock.on(100.0)
    assert mechanics.axis_angle(axis) == stands
    assert mechanics.axis_velocity(axis) == 0.0
    assert mechanics.slewing()
    assert misses_arcsec(mechanics, clock, target) > 3600.0
    mechanics.slew(target)
    clock.on(100.0)
    assert mechanics.axis_angle(axis) == stands
    mechanics.unstick(axis)
    clock.on(1.0)
    settle(mechanics, clock)
    assert misses_arcsec(mechanics, clock, target) < 0.5


def test_a_stuck_axis_may_be_stopped_but_does_not_track(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    mechanics.stick("ha")
    assert not mechanics.slewing()
    assert mechanics.tracking
    stands = mechanics.axis_angle("ha")
    clock.on(50.0)
    mechanics.slew(at(mechanics, clock, 4.0, 10.0))
    clock.on(50.0)
    assert mechanics.slewing()
    mechanics.stop()
    settle(mechanics, clock)
    assert mechanics.axis_angle("ha") == stands
    mechanics.unstick("ha")
    clock.on(1.0)
    before = mechanics.axis_angle("ha")
    clock.on(10.0)
    assert mechanics.axis_angle("ha") - before == pytest.approx(10.0 * SIDEREAL_DEG_S)


def test_tracking_put_off_while_it_is_stuck_is_off_when_it_has_arrived(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    mechanics.slew(at(mechanics, clock, 2.0, 30.0))
    clock.on(1.0)
    mechanics.stick("ha")
    mechanics.tracking = False
    clock.on(1.0)
    mechanics.unstick("ha")
    clock.on(1.0)
    settle(mechanics, clock)
    assert mechanics.axis_velocity("ha") == 0.0
    assert mechanics.axis_angle("ha") == pytest.approx(30.0, abs=0.2)


def test_a_stuck_axis_never_parks(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    mechanics.stick("dec")
    mechanics.park()
    clock.on(500.0)
    assert mechanics.parking
    assert not mechanics.parked
    mechanics.unstick("dec")
    clock.on(1.0)
    settle(mechanics, clock)
    assert mechanics.parked


def test_a_runaway_passes_its_target_until_a_stop_is_heeded(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    mechanics.run_away("dec", deaf_stops=2)
    target = at(mechanics, clock, 0.5, 40.0)
    mechanics.slew(target)
    clock.on(20.0)
    assert mechanics.axes().dec_axis_deg < 0.0
    for _ in range(2):
        mechanics.stop()
        clock.on(5.0)
        assert mechanics.slewing()
        assert mechanics.axis_velocity("dec") == -4.0
    mechanics.stop()
    clock.on(2.1)
    assert not mechanics.slewing()
    target = at(mechanics, clock, 0.5, 40.0)
    mechanics.slew(target)  # that was the end of the fault
    settle(mechanics, clock)
    assert misses_arcsec(mechanics, clock, target) < 0.5


def test_a_slew_may_begin_to_run_away_under_way_and_stops_may_be_ignored_alone(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    mechanics.slew(at(mechanics, clock, 3.0, 48.93))
    clock.on(3.0)
    mechanics.run_away("ha")
    clock.on(60.0)
    assert mechanics.axis_velocity("ha") == 4.0
    mechanics.stop()
    settle(mechanics, clock)
    mechanics.run_away("ha", past_target=False, deaf_stops=1)
    target = at(mechanics, clock, 3.0, 48.93)
    mechanics.slew(target)
    clock.on(1.0)
    mechanics.stop()
    settle(mechanics, clock)
    assert misses_arcsec(mechanics, clock, target) < 0.5


def test_a_runaway_ends_at_the_stop_of_the_axis(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=Machine(dec_limits_deg=(-20.0, 90.0)), clock=clock)
    mechanics.run_away("dec", deaf_stops=100)
    mechanics.slew(at(mechanics, clock, 0.5, 40.0))
    clock.on(100.0)
    assert mechanics.axis_angle("dec") == pytest.approx(-20.0, abs=1e-6)
    assert mechanics.at_limit


# -- power ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("coasts", [False, True])
def test_a_reboot_amid_a_slew_ends_it_and_forgets(clock, site: Site, coasts: bool) -> None:
    machine = Machine(mounting="german", remembers_clock=False, remembers_site=False)
    mechanics = Mechanics(site, NO_AIR, NONE, machine=machine, clock=clock)
    mechanics.sync(at(mechanics, clock, 0.3, 48.0))
    mechanics.rate = TrackingRate.LUNAR
    mechanics.slew(at(mechanics, clock, 4.0, 10.0))
    clock.on(4.0)
    earlier, was = clock(), mechanics.reported()
    clock.on(0.5)
    standing = mechanics.axis_velocity("ha")
    assert standing > 1.0
    mechanics.reboot(coasts=coasts)
    assert mechanics.boots == 1
    assert mechanics.slewing() is coasts
    clock.on(5.0)
    assert not mechanics.slewing()
    assert not mechanics.tracking
    assert mechanics.rate is TrackingRate.SIDEREAL
    assert mechanics.axis_velocity("ha") == 0.0
    # it takes itself to be at home, on the meridian of nowhere, at the turn of the century
    assert (mechanics.axis_angle("ha"), mechanics.axis_angle("dec")) == pytest.approx((90.0, 90.0))
    assert mechanics.at_home
    assert mechanics.believed_site == Site(0.0, 0.0)
    assert mechanics.believed_utc() == datetime(2000, 1, 1, 0, 0, 5, tzinfo=UTC)
    assert mechanics.reported().dec_deg == pytest.approx(90.0, abs=0.01)
    assert mechanics.reported(earlier) == was


def test_what_a_machine_remembers(clock, site: Site) -> None:
    machine = Machine(boots_believing="kept", remembers_sync=True, tracks_at_boot=True)
    mechanics = Mechanics(site, NO_AIR, NONE, machine=machine, clock=clock)
    mechanics.set_believed_utc(clock() + timedelta(seconds=9))
    mechanics.sync(at(mechanics, clock, 1.0, 40.0))
    clock.on(1.0)
    before = mechanics.reported()
    mechanics.reboot()
    assert separation_arcsec(mechanics.reported(), before) < 0.01
    assert mechanics.tracking
    assert mechanics.believed_utc() == clock() + timedelta(seconds=9)
    forgets = Mechanics(site, NO_AIR, NONE, machine=Machine(boots_believing="kept"), clock=clock)
    fresh = forgets.reported()
    forgets.sync(at(forgets, clock, 1.0, 40.0))
    forgets.reboot()
    assert separation_arcsec(forgets.reported(), fresh) < 0.01


@pytest.mark.parametrize("remembers", [True, False])
def test_being_parked_may_outlive_a_reboot(clock, site: Site, remembers: bool) -> None:
    machine = Machine(park_axes_deg=(-30.0, 10.0), remembers_park=remembers)
    mechanics = Mechanics(site, NO_AIR, NONE, machine=machine, clock=clock)
    mechanics.park()
    settle(mechanics, clock)
    truth = mechanics.truth()
    mechanics.reboot()
    assert mechanics.parked is remembers
    assert mechanics.truth() == truth
    wanted = (-30.0, 10.0) if remembers else (0.0, 90.0)
    assert (mechanics.axis_angle("ha"), mechanics.axis_angle("dec")) == pytest.approx(wanted)


def test_a_late_sync_is_lost_with_the_power(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=Machine(boots_believing="kept"), clock=clock)
    mechanics.sync_behavior = "late"
    before = mechanics.reported()
    mechanics.sync(at(mechanics, clock, 1.0, 40.0))
    mechanics.reboot()
    clock.on(60.0)
    assert mechanics.reported().dec_deg == pytest.approx(before.dec_deg, abs=1e-3)


def test_without_power_motion_ends_at_once(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=RAW, clock=clock)
    mechanics.drive("dec", -3.0)
    clock.on(5.0)
    stands = mechanics.axis_angle("dec")
    mechanics.power_loss()
    assert mechanics.axis_velocity("dec") == 0.0
    clock.on(5.0)
    assert mechanics.axis_angle("dec") == pytest.approx(stands)
    mechanics.reboot()
    assert mechanics.axis_angle("dec") == pytest.approx(90.0)  # the counts begin again


def test_marks_align_a_mount_that_a_sync_at_the_pole_turned_over(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    here = mechanics.reported()
    mechanics.sync(Apparent(here.ra_deg, here.dec_deg - 0.3, clock()))
    mechanics.slew(at(mechanics, clock, 0.0, 90.0))
    settle(mechanics, clock)
    # the tube is past the pole by now, and a sync on what it looks at can't tell
    mechanics.sync(icrs_to_apparent(mechanics.truth(), clock()))
    assert astray_deg(mechanics) < 0.001
    mechanics.slew(at(mechanics, clock, 0.0, 80.0))
    settle(mechanics, clock)
    assert astray_deg(mechanics) > 15.0
    mechanics.align()
    assert astray_deg(mechanics) < 0.001


# -- single axes ---------------------------------------------------------------------------------


def test_axes_are_driven_one_by_one(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=RAW, clock=clock)
    assert not mechanics.axis_moving("ha")
    assert not mechanics.tracking
    mechanics.drive("ha", SIDEREAL_DEG_S)
    clock.on(1.0)
    assert mechanics.axis_moving("ha")
    assert not mechanics.axis_moving("dec")
    mechanics.drive_to("dec", 30.0, 2.0)
    angle, place = mechanics.axis_angle("ha"), mechanics.reported()
    clock.on(40.0)
    assert mechanics.axis_angle("dec") == 30.0
    assert not mechanics.axis_moving("dec")
    assert mechanics.axis_angle("ha") - angle == pytest.approx(40.0 * SIDEREAL_DEG_S, abs=1e-9)
    assert half_turn_deg(mechanics.reported().ra_deg - place.ra_deg) != 0.0
    mechanics.drive("dec", 100.0)  # no faster than built
    clock.on(10.0)
    assert mechanics.axis_velocity("dec") == 4.0
    mechanics.halt("dec")
    assert mechanics.axis_moving("dec")
    clock.on(2.1)
    assert not mechanics.axis_moving("dec")
    mechanics.drive("dec", -1.0, acceleration_deg_s2=0.1)
    clock.on(5.0)
    assert mechanics.axis_velocity("dec") == pytest.approx(-0.5)
    mechanics.halt("dec", instant=True)
    assert not mechanics.axis_moving("dec")
    assert mechanics.axis_moving("ha")


def test_driven_at_the_sidereal_rate_it_keeps_its_place(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=RAW, clock=clock)
    mechanics.drive_to("dec", 20.0)
    clock.on(60.0)
    mechanics.drive("ha", SIDEREAL_DEG_S)
    clock.on(1.0)
    before = mechanics.reported()
    clock.on(1000.0)
    assert misses_arcsec(mechanics, clock, before) < 0.5


def test_counts_are_labeled_anew_and_the_tube_stays(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=RAW, clock=clock)
    truth, earlier = mechanics.truth(), clock()
    clock.on(1.0)
    mechanics.set_encoder("dec", 0.0)
    mechanics.set_encoder("ha", -45.0)
    assert mechanics.axis_angle("dec") == 0.0
    assert mechanics.axis_angle("ha") == -45.0
    assert mechanics.axis_angle("dec", earlier) == 90.0
    assert mechanics.truth(earlier) == truth
    mechanics.drive_to("dec", 10.0)
    clock.on(30.0)
    assert mechanics.axis_angle("dec") == pytest.approx(10.0)
    assert mechanics.reported().dec_deg == pytest.approx(10.0, abs=0.01)


def test_a_raw_drive_ends_tracking_also_of_the_other_axis(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    mechanics.drive("dec", 0.5)
    assert not mechanics.tracking
    clock.on(1.0)
    assert mechanics.axis_velocity("ha") == 0.0


def test_a_halt_may_go_unheeded(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, machine=RAW, clock=clock)
    mechanics.run_away("ha", past_target=False, deaf_stops=1)
    mechanics.drive("ha", 1.0)
    clock.on(2.0)
    mechanics.halt("ha", instant=True)
    clock.on(2.0)
    assert mechanics.axis_velocity("ha") == 1.0
    mechanics.halt("ha", instant=True)
    assert mechanics.axis_velocity("ha") == 0.0
