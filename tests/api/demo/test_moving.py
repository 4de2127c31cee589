"""The demo's comet and satellite: where they were meant to be, for whoever reads their elements."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from api.demo.moving import COMET, SATELLITE, comet_elements, orbit_of, satellite_lines
from mountnav.ephemeris.any_text import read_elements
from mountnav.ephemeris.elements import GM_SUN_AU3_DAY2, two_body
from mountnav.ephemeris.ephemeris import sky_rates
from mountnav.ephemeris.satellite import EarthSatellite
from mountnav.ephemeris.small_body import SmallBody
from mountnav.ephemeris.tle import read_tle
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Site

SITE, AIR = Site(48.93, 22.27, 700.0), Air()
TIMES = [datetime(2026, 11, 26, 22, 0, tzinfo=UTC), datetime(2027, 6, 3, 9, 30, 12, tzinfo=UTC)]


@pytest.mark.parametrize("utc", TIMES)
@pytest.mark.parametrize("site", [SITE, Site(-33.0, -70.0, 2400.0)])
def test_the_comet_stands_where_it_was_meant_and_moves(utc: datetime, site: Site) -> None:
    (elements,) = read_elements(comet_elements(utc, site, AIR, alt_deg=50.0, az_deg=200.0))
    comet = SmallBody(elements)
    assert COMET in comet.name
    seen = icrs_to_observed(comet.icrs(utc, site), utc, site, AIR)
    assert seen.alt_deg == pytest.approx(50.0, abs=0.1)
    assert seen.az_deg == pytest.approx(200.0, abs=0.2)
    rates = sky_rates(comet, utc, site)
    assert 0.5 < rates.total_arcsec_s < 3.0
    assert comet.sigma_arcsec(utc) < 600.0


@pytest.mark.parametrize("utc", TIMES)
def test_the_satellite_culminates_when_and_where_it_was_meant(utc: datetime) -> None:
    lines = satellite_lines(utc, SITE, in_s=120.0, alt_deg=60.0, az_deg=140.0)
    (elements,) = read_tle(lines)
    satellite = EarthSatellite(elements)
    assert satellite.name == SATELLITE
    heights = []
    for second in range(0, 300, 5):
        at = utc + timedelta(seconds=second)
        heights.append(icrs_to_observed(satellite.icrs(at, SITE), at, SITE, AIR).alt_deg)
    best = int(np.argmax(heights))
    assert abs(5 * best - 120) <= 15
    assert heights[best] == pytest.approx(60.0, abs=2.0)
    top = utc + timedelta(seconds=120)
    assert 300.0 < sky_rates(satellite, top, SITE).total_arcsec_s < 1500.0


@given(
    q_au=st.floats(0.3, 1.3),
    e=st.floats(0.01, 0.9),
    angles=st.tuples(st.floats(0.05, 3.0), st.floats(0.0, 6.2), st.floats(0.0, 6.2)),
    days=st.floats(-150.0, 150.0),
)
@settings(max_examples=60, deadline=None)
def test_an_orbit_is_found_again_from_a_place_and_a_velocity(
    q_au: float, e: float, angles: tuple[float, float, float], days: float
) -> None:
    inclination, node, peri = angles
    place, velocity = two_body(q_au, e, inclination, node, peri, days)
    # two_body answers along the axes of the equator: back to those of the ecliptic
    from mountnav.ephemeris.elements import OBLIQUITY_RAD

    c, s = np.cos(OBLIQUITY_RAD), np.sin(OBLIQUITY_RAD)
    back = np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
    found = orbit_of(back @ place, back @ velocity, GM_SUN_AU3_DAY2)
    assert found.eccentricity == pytest.approx(e, abs=1e-7)
    assert found.semi_latus == pytest.approx(q_au * (1.0 + e), rel=1e-7)
    assert found.inclination == pytest.approx(inclination, abs=1e-7)
    assert np.cos(found.node - node) == pytest.approx(1.0, abs=1e-9)
    assert np.cos(found.peri - peri) == pytest.approx(1.0, abs=1e-7)
