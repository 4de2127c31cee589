"""Ways by waypoints: through each of them, without a step in place or rate, and no further."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from itertools import pairwise

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mountnav.ephemeris import Path, SolarSystemBody, Waypoint
from mountnav.ephemeris.path import MOST_WAYPOINTS
from mountnav.errors import BadRequest
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.ephemeris.samples import SITE

BEGIN = datetime(2026, 11, 26, 20, tzinfo=UTC)


def at(seconds: float, lon: float, lat: float) -> Waypoint:
    return Waypoint(BEGIN + timedelta(seconds=seconds), lon, lat)


places = st.tuples(st.floats(0.0, 359.99), st.floats(-90.0, 90.0))
ways = st.lists(st.tuples(st.floats(1.0, 500.0), places), min_size=2, max_size=9)


@pytest.mark.long
@given(ways, st.floats(0.0, 1.0))
def test_it_goes_through_each_waypoint_and_never_jumps(
    steps: list[tuple[float, tuple[float, float]]], part: float
) -> None:
    seconds, points = 0.0, []
    for length, (lon, lat) in steps:
        seconds += length
        points.append(at(seconds, lon, lat))
    assume(
        all(
            separation_arcsec(Icrs(a.lon_deg, a.lat_deg), Icrs(b.lon_deg, b.lat_deg)) < 360_000
            for a, b in pairwise(points)
        )
    )
    path = Path(tuple(points))
    for point in points:
        assert separation_arcsec(path.icrs(point.utc, SITE), Icrs(point.lon_deg, point.lat_deg)) < 0.01
    span = (points[-1].utc - points[0].utc).total_seconds()
    middle = points[0].utc + timedelta(seconds=span * part)
    for utc in (middle, *(point.utc for point in points[1:-1])):
        near = [
            path.icrs(min(max(utc + timedelta(milliseconds=ms), points[0].utc), points[-1].utc), SITE)
            for ms in (-1, 0, 1)
        ]
        assert separation_arcsec(near[0], near[2]) < 8_000.0


def test_two_waypoints_are_an_even_motion_on_a_great_circle() -> None:
    path = Path((at(0, 350.0, 10.0), at(100, 30.0, 60.0)))
    whole = separation_arcsec(Icrs(350.0, 10.0), Icrs(30.0, 60.0))
    for seconds in (0, 13, 50, 99, 100):
        place = path.icrs(BEGIN + timedelta(seconds=seconds), SITE)
        assert separation_arcsec(Icrs(350.0, 10.0), place) == pytest.approx(whole * seconds / 100, abs=0.01)
        assert separation_arcsec(place, Icrs(30.0, 60.0)) == pytest.approx(
            whole * (1 - seconds / 100), abs=0.01
        )


def test_rates_have_no_step_at_a_waypoint() -> None:
    path = Path((at(0, 10.0, 0.0), at(700, 11.0, 0.5), at(1000, 12.0, 0.2), at(2000, 12.5, -1.0)))
    for seconds in (700, 1000):
        knot = BEGIN + timedelta(seconds=seconds)
        before, here, after = (path.icrs(knot + timedelta(milliseconds=ms), SITE) for ms in (-10, 0, 10))
        assert (here.ra_deg - before.ra_deg) == pytest.approx(after.ra_deg - here.ra_deg, abs=1e-7)
        assert (here.dec_deg - before.dec_deg) == pytest.approx(after.dec_deg - here.dec_deg, abs=1e-7)


def test_a_coarse_list_of_the_moons_places_is_joined_well() -> None:
    moon = SolarSystemBody("moon")
    times = [BEGIN + timedelta(minutes=10 * step) for step in range(20)]
    places_then = [moon.icrs(utc, SITE) for utc in times]
    path = Path(tuple(Waypoint(utc, p.ra_deg, p.dec_deg) for utc, p in zip(times, places_then, strict=True)))
    for minutes in (25, 77, 131):
        utc = BEGIN + timedelta(minutes=minutes)
        assert separation_arcsec(path.icrs(utc, SITE), moon.icrs(utc, SITE)) < 0.2


def test_a_way_over_the_horizon_and_over_the_zenith() -> None:
    air = Air(pressure_hpa=1000.0)
    path = Path((at(0, 90.0, 70.0), at(60, 270.0, 70.0)), "altaz", air)
    utc = BEGIN + timedelta(seconds=30)
    assert icrs_to_observed(path.icrs(utc, SITE), utc, SITE, air).alt_deg == pytest.approx(90.0, abs=1e-3)


@pytest.mark.parametrize(
    ("points", "says"),
    [
        ((at(0, 1, 1),), "2 to"),
        ((at(0, 1, 1), at(0, 2, 2)), "no later"),
        ((at(5, 1, 1), at(0, 2, 2)), "no later"),
        ((at(0, 0, 0), at(9, 180, 0)), "which way round"),
        ((at(0, 0, 0), at(9, 150, 0)), "which way round"),
        ((at(0, 0, float("nan")), at(9, 1, 0)), "no place"),
        ((at(0, 0, 91.0), at(9, 1, 0)), "no place"),
        ((at(0, 0, 0), at(40 * 86400, 1, 0)), "30 days"),
        ((Waypoint(datetime(2026, 1, 1), 0, 0), at(9, 1, 0)), "time zone"),
        (tuple(at(n, 0, 0) for n in range(MOST_WAYPOINTS + 1)), "2 to"),
    ],
)
def test_what_is_no_way_is_refused(points: tuple[Waypoint, ...], says: str) -> None:
    with pytest.raises(BadRequest, match=says):
        Path(points)


def test_it_ends_at_its_last_waypoint() -> None:
    path = Path((at(0, 1, 1), at(9, 2, 2)))
    with pytest.raises(BadRequest, match="ends at"):
        path.icrs(BEGIN + timedelta(seconds=9.5), SITE)
    with pytest.raises(BadRequest, match="begins at"):
        path.icrs(BEGIN - timedelta(seconds=0.5), SITE)
