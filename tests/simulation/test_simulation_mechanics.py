"""The fake telescope: what it believes, where it looks, how it moves."""

from __future__ import annotations

import math
import random
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime, timedelta
from itertools import pairwise
from pathlib import Path
from typing import Any

import astropy.units as u
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.time import Time

from mountnav.clock import utc_now
from mountnav.errors import BadSettings
from mountnav.simulation.geometry import perfect_direction, true_direction
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent, sidereal_time_deg
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Icrs, Site
from mountnav.sky.sphere import offset_arcsec, separation_arcsec

NO_AIR = Air(0.0)
NONE = PointingErrors()


def believed(mechanics: Mechanics, utc: datetime | None = None) -> Icrs:
    return apparent_to_icrs(mechanics.reported(utc))


def pointing_error_arcsec(mechanics: Mechanics, utc: datetime) -> tuple[float, float]:
    offset = offset_arcsec(mechanics.truth(utc), believed(mechanics, utc))
    return offset.east_arcsec, offset.north_arcsec


def at(mechanics: Mechanics, clock, hours_west: float, dec_deg: float) -> Apparent:
    lst_deg = sidereal_time_deg(clock(), mechanics.site)
    return Apparent((lst_deg - 15.0 * hours_west) % 360.0, dec_deg, clock())


def arrive(mechanics: Mechanics, clock, target: Apparent) -> None:
    mechanics.slew(target)
    while mechanics.slewing():
        clock.on(1.0)


@pytest.mark.parametrize(
    ("hours_west", "dec_deg"),
    [(-4.0, 10.0), (0.0, 48.0), (3.0, -15.0), (5.5, 80.0), (11.9, 89.9), (-1.0, -30.0)],
)
def test_without_errors_and_air_the_report_is_the_truth(clock, site: Site, hours_west, dec_deg) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    target = at(mechanics, clock, hours_west, dec_deg)
    arrive(mechanics, clock, target)
    for _ in range(5):
        assert separation_arcsec(believed(mechanics), mechanics.truth()) < 0.05
        assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, dec_deg, clock())) < 0.5
        clock.on(600.0)


def test_the_report_agrees_with_sidereal_time_minus_axis_angle(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 2.0, 35.0))
    plain_ra = (sidereal_time_deg(clock(), site) - mechanics.axes().ha_axis_deg) % 360.0
    plain = Apparent(plain_ra, mechanics.axes().dec_axis_deg, clock())
    assert separation_arcsec(plain, mechanics.reported()) < 0.8  # polar motion, diurnal aberration


def table_row(term: str, h: float, d: float, lat: float) -> tuple[float, float]:
    """[POINTING §5], typed in again: (ξ, η) of a term of one unit."""
    sh, ch, sd, cd, sl, cl = math.sin(h), math.cos(h), math.sin(d), math.cos(d), math.sin(lat), math.cos(lat)
    return {
        "ih": (cd, 0.0),
        "id": (0.0, 1.0),
        "ch": (1.0, 0.0),
        "np": (sd, 0.0),
        "me": (sh * sd, ch),
        "ma": (-ch * sd, sh),
        "tf": (cl * sh, cl * ch * sd - sl * cd),
    }[term]


@pytest.mark.parametrize("term", ["ih", "id", "ch", "np", "me", "ma", "tf"])
@pytest.mark.parametrize("size_arcsec", [-40.0, 60.0])
def test_each_term_alone_is_its_row_of_the_table(term: str, size_arcsec: float) -> None:
    errors = PointingErrors(**{f"{term}_arcsec": size_arcsec})
    for latitude_deg in (48.93, -33.0):
        for ha_deg in (-170.0, -75.0, -20.0, 0.0, 33.0, 120.0):
            for dec_deg in (-60.0, -5.0, 0.0, 40.0, 80.0):
                h, d = true_direction(ha_deg, dec_deg, errors, latitude_deg)
                xi = ((h - ha_deg + 180.0) % 360.0 - 180.0) * 3600.0 * math.cos(math.radians(dec_deg))
                eta = (d - dec_deg) * 3600.0
                row = table_row(term, *map(math.radians, (ha_deg, dec_deg, latitude_deg)))
                assert (xi, eta) == pytest.approx([size_arcsec * f for f in row], abs=0.15)


@pytest.mark.parametrize("term", ["ih", "id", "ch", "np", "me", "ma", "tf"])
def test_the_truth_carries_each_term(clock, site: Site, term: str) -> None:
    mechanics = Mechanics(site, NO_AIR, PointingErrors(**{f"{term}_arcsec": 100.0}), clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 2.2, 33.0))
    xi, eta = table_row(term, *map(math.radians, (33.0, 33.0, site.latitude_deg)))
    east, north = pointing_error_arcsec(mechanics, clock())
    # ξ counts hour angle, west positive; precession turns the direction of north by some arcminutes
    assert (east, north) == pytest.approx((-100.0 * xi, 100.0 * eta), abs=0.5)


def test_geometry_has_no_trouble_at_the_pole() -> None:
    errors = PointingErrors(
        ih_arcsec=900, ch_arcsec=300, np_arcsec=120, me_arcsec=200, ma_arcsec=-90, tf_arcsec=30
    )
    _, dec_deg = true_direction(40.0, 90.0, errors, 48.93)
    assert 89.7 < dec_deg < 90.0
    assert perfect_direction(40.0, 100.0) == pytest.approx((-140.0, 80.0))
    assert perfect_direction(-170.0, -100.0) == pytest.approx((10.0, -80.0))


@pytest.mark.long
def test_refraction_is_astropys(clock, site: Site) -> None:
    air = Air(930.0, 5.0, 0.7, 0.6)
    mechanics = Mechanics(site, air, NONE, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 3.0, 10.0))
    where = EarthLocation.from_geodetic(site.longitude_deg, site.latitude_deg, site.height_m)
    bare = AltAz(obstime=Time(clock()), location=where)
    through_air = AltAz(
        obstime=Time(clock()),
        location=where,
        pressure=930 * u.hPa,
        temperature=5 * u.deg_C,
        relative_humidity=0.7,
        obswl=0.6 * u.um,
    )

    def altaz(place: Icrs, frame: AltAz) -> SkyCoord:
        return SkyCoord(place.ra_deg, place.dec_deg, unit="deg").transform_to(frame)

    # the tube's observed direction is the believed one, taken without air
    seen, thought = altaz(mechanics.truth(), through_air), altaz(believed(mechanics), bare)
    assert seen.az.deg == pytest.approx(thought.az.deg, abs=0.05 / 3600.0)
    assert seen.alt.deg == pytest.approx(thought.alt.deg, abs=0.05 / 3600.0)
    lifted = (thought.alt - altaz(mechanics.truth(), bare).alt).to_value(u.arcsec)
    assert 30.0 < lifted < 200.0


def test_sync_removes_the_error_here_and_moves_nothing(clock, site: Site) -> None:
    errors = PointingErrors(ih_arcsec=300, id_arcsec=-200, ch_arcsec=60, me_arcsec=90, ma_arcsec=-70)
    mechanics = Mechanics(site, Air(930.0), errors, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 1.0, 40.0))
    before = mechanics.truth()
    earlier_report, earlier = mechanics.reported(), clock()
    assert separation_arcsec(before, believed(mechanics)) > 200.0
    clock.on(1.0)
    place = icrs_to_apparent(mechanics.truth(), clock())
    mechanics.sync(place)
    assert separation_arcsec(mechanics.reported(), place) < 0.01
    assert separation_arcsec(mechanics.truth(earlier), before) == 0.0
    assert mechanics.reported(earlier) == earlier_report  # the past keeps its belief
    # near by it still holds, far off it doesn't
    ra_deg, dec_deg = mechanics.reported().ra_deg, mechanics.reported().dec_deg
    arrive(mechanics, clock, Apparent(ra_deg + 1.0, dec_deg + 1.0, clock()))
    near = separation_arcsec(mechanics.truth(), believed(mechanics))
    arrive(mechanics, clock, Apparent(ra_deg + 60.0, 10.0, clock()))
    far = separation_arcsec(mechanics.truth(), believed(mechanics))
    assert near < 10.0 < far


def test_slew_is_monotone_and_ends_at_rest_on_the_target(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, slew_rate_deg_s=3.0, acceleration_deg_s2=1.0, clock=clock)
    clock.on(5.0)
    target = at(mechanics, clock, 3.0, 5.0)
    mechanics.slew(target)
    start = clock()
    assert mechanics.slewing()
    left = [
        separation_arcsec(mechanics.reported(start + timedelta(seconds=0.5 * k)), target) for k in range(60)
    ]
    assert all(b <= a + 0.02 for a, b in pairwise(left))
    # the longer way (45°) at 3°/s with 1°/s²: 45/3 + 3/1 = 18 s
    assert mechanics.slewing(start + timedelta(seconds=17.9))
    assert not mechanics.slewing(start + timedelta(seconds=18.1))
    end = clock.on(18.1)
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, target.dec_deg, end)) < 0.01
    later = mechanics.axes(end + timedelta(seconds=100))
    assert later.ha_axis_deg - mechanics.axes(end).ha_axis_deg == pytest.approx(100 * SIDEREAL_DEG_S)
    assert later.dec_axis_deg == mechanics.axes(end).dec_axis_deg


@pytest.mark.long
def test_twice_the_rates_take_half_the_time(clock, site: Site) -> None:
    durations = []
    for factor in (1.0, 2.0):
        mechanics = Mechanics(
            site, NO_AIR, NONE, slew_rate_deg_s=2 * factor, acceleration_deg_s2=factor**2, clock=clock
        )
        mechanics.slew(at(mechanics, clock, 2.0, 20.0))
        start = clock()
        steps = [k for k in range(100_000) if not mechanics.slewing(start + timedelta(milliseconds=10 * k))]
        durations.append(steps[0])
    assert durations[0] / durations[1] == pytest.approx(2.0, rel=0.01)


def test_the_shorter_way_round(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock, start=None)
    arrive(mechanics, clock, at(mechanics, clock, 11.5, 80.0))
    mechanics.slew(at(mechanics, clock, -11.5, 80.0))
    start = clock()
    middle = mechanics.axes(start + timedelta(seconds=2.5)).ha_axis_deg
    assert abs(middle) > 170.0
    assert -180.0 < middle <= 180.0


def test_answers_depend_on_the_instant_alone(clock, site: Site) -> None:
    errors = PointingErrors(
        ih_arcsec=50, me_arcsec=30, backlash_arcsec=25, periodic_amplitude_arcsec=12, tf_arcsec=9
    )
    mechanics = Mechanics(site, Air(930.0), errors, clock=clock)
    begin = clock()
    mechanics.slew(at(mechanics, clock, 2.0, 20.0))
    clock.on(4.0)
    mechanics.slew(at(mechanics, clock, -2.0, 60.0))  # before the first has ended
    clock.on(3.0)
    mechanics.stop()
    clock.on(7.0)
    mechanics.sync(at(mechanics, clock, 0.1, 33.0))
    mechanics.move("s", 0.5)
    clock.on(2.0)
    mechanics.stop_move("s")
    instants = [begin + timedelta(seconds=0.37 * k) for k in range(80)]
    asked = {t: (mechanics.truth(t), mechanics.reported(t), mechanics.slewing(t)) for t in instants}
    random.Random(1).shuffle(instants)
    clock.on(1000.0)
    for t in instants:
        assert (mechanics.truth(t), mechanics.reported(t), mechanics.slewing(t)) == asked[t]


def test_motion_has_no_jumps(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, PointingErrors(backlash_arcsec=60.0), clock=clock)
    begin = clock()
    mechanics.slew(at(mechanics, clock, 4.0, 10.0))
    clock.on(6.3)
    mechanics.slew(at(mechanics, clock, -1.0, 70.0))
    clock.on(1.1)
    mechanics.move("n", 1.0)
    clock.on(2.0)
    mechanics.stop()
    places = [mechanics.truth(begin + timedelta(seconds=0.05 * k)) for k in range(400)]
    steps = [separation_arcsec(a, b) for a, b in pairwise(places)]
    assert max(steps) < 4.0 * math.sqrt(2.0) * 3600.0 * 0.05 * 1.05


def test_backlash_depends_on_the_approach(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, PointingErrors(backlash_arcsec=40.0), clock=clock)
    target = at(mechanics, clock, 0.0, 30.0)
    errors = {}
    for name, from_dec in (("north", 20.0), ("south", 40.0)):
        arrive(mechanics, clock, Apparent(target.ra_deg, from_dec, clock()))
        arrive(mechanics, clock, Apparent(target.ra_deg, 30.0, clock()))
        clock.on(10.0)  # tracking takes up the play in hour angle
        errors[name] = pointing_error_arcsec(mechanics, clock())
    assert errors["north"] == pytest.approx((0.0, 0.0), abs=0.05)
    assert math.hypot(*errors["south"]) == pytest.approx(40.0, abs=0.05)
    assert errors["south"][1] > 39.0
    # a small step back stays within the play: the tube doesn't move
    before = mechanics.truth()
    arrive(mechanics, clock, Apparent(target.ra_deg, 30.0 + 30.0 / 3600.0, clock()))
    clock.on(10.0)
    assert separation_arcsec(before, mechanics.truth()) < 0.5


def test_play_in_hour_angle_is_taken_up_by_tracking(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, PointingErrors(backlash_arcsec=60.0), clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, -2.0, 48.93))  # eastwards
    slewed = mechanics.truth()
    clock.on(10.0)
    settled = mechanics.truth()
    assert separation_arcsec(slewed, settled) > 10.0
    clock.on(10.0)
    assert separation_arcsec(mechanics.truth(), settled) < 0.05


def test_periodic_error_swings_with_the_worm(clock, site: Site) -> None:
    errors = PointingErrors(periodic_amplitude_arcsec=15.0, periodic_period_s=400.0)
    mechanics = Mechanics(site, NO_AIR, errors, clock=clock, start=None)
    arrive(mechanics, clock, at(mechanics, clock, 0.0, 0.0))
    start = clock()
    swing = [pointing_error_arcsec(mechanics, start + timedelta(seconds=s))[0] for s in range(0, 801, 10)]
    assert max(swing) == pytest.approx(15.0, abs=0.1)
    assert min(swing) == pytest.approx(-15.0, abs=0.1)
    assert swing[:41] == pytest.approx(swing[40:], abs=0.05)


def test_stop_during_a_slew(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, slew_rate_deg_s=4.0, acceleration_deg_s2=2.0, clock=clock)
    target = at(mechanics, clock, 5.0, 10.0)
    mechanics.slew(target)
    clock.on(5.0)
    mechanics.stop()
    assert mechanics.slewing()
    clock.on(2.1)  # 4°/s at 2°/s²
    assert not mechanics.slewing()
    place = mechanics.reported()
    assert separation_arcsec(place, target) > 3600.0
    clock.on(60.0)
    assert separation_arcsec(mechanics.reported(), Apparent(place.ra_deg, place.dec_deg, clock())) < 0.05


def test_stop_at_rest_changes_nothing(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    clock.on(3.0)
    ahead = clock() + timedelta(seconds=50)
    place = mechanics.truth(ahead)
    mechanics.stop()
    assert mechanics.truth(ahead) == place


@pytest.mark.parametrize(
    ("direction", "east", "north"), [("n", 0, 1), ("s", 0, -1), ("e", 1, 0), ("w", -1, 0)]
)
def test_moving_by_hand(clock, site: Site, direction, east: int, north: int) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 0.0, 0.0))
    start = mechanics.reported()
    mechanics.move(direction, 0.01)
    assert mechanics.slewing()
    clock.on(10.0)
    mechanics.stop_move(direction)
    clock.on(1.0)
    assert not mechanics.slewing()
    offset = offset_arcsec(mechanics.reported(), Apparent(start.ra_deg, start.dec_deg, clock()))
    assert offset.east_arcsec == pytest.approx(360.0 * east, abs=1.0)
    assert offset.north_arcsec == pytest.approx(360.0 * north, abs=1.0)


def test_without_tracking_the_sky_passes(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    arrive(mechanics, clock, at(mechanics, clock, 0.0, 0.0))
    mechanics.tracking = False
    clock.on(1.0)
    before = mechanics.truth()
    clock.on(10.0)
    assert separation_arcsec(before, mechanics.truth()) == pytest.approx(150.41, abs=0.1)
    assert not mechanics.slewing()
    arrive(mechanics, clock, at(mechanics, clock, 0.0, 1.0))
    assert mechanics.tracking


def test_tracking_put_off_during_a_slew_ends_with_it(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    target = at(mechanics, clock, 1.0, 40.0)  # the hour angle axis has the longer way
    mechanics.slew(target)
    clock.on(1.0)
    mechanics.tracking = False
    while mechanics.slewing():
        clock.on(0.25)
    assert separation_arcsec(mechanics.reported(), Apparent(target.ra_deg, 40.0, clock())) < 5.0
    axes = mechanics.axes()
    clock.on(60.0)
    assert mechanics.axes() == axes


def test_asked_from_many_threads_while_ordered_about(site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE)

    def ask(_: int) -> float:
        return separation_arcsec(*(lambda t: (mechanics.truth(t), believed(mechanics, t)))(utc_now()))

    with ThreadPoolExecutor(4) as pool:
        answers = pool.map(ask, range(200))
        for k in range(100):
            mechanics.move("n" if k % 2 else "e", 1.0)
            mechanics.stop()
        assert max(answers) < 0.05


def test_believed_altitude(clock, site: Site) -> None:
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock)
    zenith = at(mechanics, clock, 0.0, site.latitude_deg)
    assert mechanics.believed_altitude_deg(zenith) == pytest.approx(90.0, abs=0.02)
    assert mechanics.believed_altitude_deg(mechanics.reported()) == pytest.approx(90.0, abs=0.02)
    assert mechanics.believed_altitude_deg(at(mechanics, clock, 0.0, 0.0)) == pytest.approx(41.07, abs=0.001)
    assert mechanics.believed_altitude_deg(at(mechanics, clock, 12.0, 0.0)) == pytest.approx(
        -41.07, abs=0.001
    )


def test_start_is_believed(clock, site: Site) -> None:
    start = Apparent(123.4, -7.0, clock())
    mechanics = Mechanics(site, NO_AIR, NONE, clock=clock, start=start)
    assert separation_arcsec(mechanics.reported(), start) < 0.001


@pytest.mark.parametrize("rates", [{"slew_rate_deg_s": 0.0}, {"acceleration_deg_s2": -1.0}])
def test_a_mount_that_cannot_move_is_refused(site: Site, rates: dict[str, Any]) -> None:
    with pytest.raises(BadSettings, match=next(iter(rates))):
        Mechanics(site, NO_AIR, NONE, **rates)


def test_errors_from_toml(tmp_path: Path) -> None:
    file = tmp_path / "errors.toml"
    file.write_text("ih_arcsec = 600\nma_arcsec = -44.2\n")
    assert PointingErrors.from_toml(file) == PointingErrors(ih_arcsec=600, ma_arcsec=-44.2)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("ih = 600", "unknown pointing error ih .*allowed: ih_arcsec"),
        ("ih_arcsec = '600'", "ih_arcsec = '600' is not a number"),
        ("ih_arcsec = true", "ih_arcsec = True"),
        ("me_arcsec = nan", "me_arcsec"),
        ("backlash_arcsec = -1", "backlash_arcsec"),
        ("periodic_period_s = 0", "periodic_period_s"),
        ("ih_arcsec = = 1", "can't read"),
    ],
)
def test_bad_errors_files_name_the_fault(tmp_path: Path, text: str, named: str) -> None:
    file = tmp_path / "errors.toml"
    file.write_text(text)
    with pytest.raises(BadSettings, match=named):
        PointingErrors.from_toml(file)
    with pytest.raises(BadSettings, match=r"none\.toml"):
        PointingErrors.from_toml(tmp_path / "none.toml")
