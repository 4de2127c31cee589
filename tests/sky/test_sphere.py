"""Offsets, displacements and projections at the equator, at the poles and across the seam."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.wcs import WCS
from hypothesis import assume, given
from hypothesis import strategies as st

from mountnav.sky.coordinates import Apparent, GeometricHourAngle, HourAngle, Icrs, Observed
from mountnav.sky.sphere import (
    displaced,
    gnomonic,
    gnomonic_inverse,
    half_turn_deg,
    offset_arcsec,
    position_angle_deg,
    separation_arcsec,
    turn_deg,
)

UTC0 = datetime(2026, 11, 21, 22, tzinfo=UTC)

longitudes = st.one_of(
    st.floats(0.0, 360.0, exclude_max=True), st.sampled_from([0.0, 1e-9, 359.9999999, 180.0])
)
latitudes = st.one_of(st.floats(-90.0, 90.0), st.sampled_from([-90.0, -89.9999, 0.0, 89.5, 89.9999, 90.0]))
places = st.builds(Icrs, longitudes, latitudes)
steps = st.floats(-36000.0, 36000.0)


@given(places, places)
def test_separation_and_direction_are_astropys(a: Icrs, b: Icrs) -> None:
    first, second = (
        SkyCoord(a.ra_deg * u.deg, a.dec_deg * u.deg),
        SkyCoord(b.ra_deg * u.deg, b.dec_deg * u.deg),
    )
    oracle_arcsec = first.separation(second).arcsec
    assert separation_arcsec(a, b) == pytest.approx(oracle_arcsec, abs=1e-6)
    assume(1.0 < oracle_arcsec < 647999.0)
    assume(abs(a.dec_deg) < 89.99)
    turned = (position_angle_deg(a, b) - first.position_angle(second).deg + 180.0) % 360.0 - 180.0
    assert abs(turned) < 1e-5


@given(places, steps, steps)
def test_an_offset_leads_from_the_believed_place_to_the_seen_one(
    place: Icrs, east: float, north: float
) -> None:
    seen = displaced(place, east, north)
    offset = offset_arcsec(seen, place)
    assert offset.total_arcsec == pytest.approx(math.hypot(east, north), abs=1e-5)
    assert separation_arcsec(displaced(place, offset.east_arcsec, offset.north_arcsec), seen) < 1e-5
    assert 0.0 <= seen.ra_deg < 360.0
    assert -90.0 <= seen.dec_deg <= 90.0


@given(places, places)
def test_the_offset_of_any_two_places_is_their_separation(a: Icrs, b: Icrs) -> None:
    assert offset_arcsec(a, b).total_arcsec == pytest.approx(separation_arcsec(a, b), abs=1e-6)


@given(places)
def test_no_offset_from_oneself(place: Icrs) -> None:
    assert offset_arcsec(place, place).total_arcsec == 0.0
    assert separation_arcsec(displaced(place, 0.0, 0.0), place) < 1e-6


def test_ten_arcsec_at_declination_89_5_stay_ten() -> None:
    believed = Icrs(100.0, 89.5)
    seen = Icrs(100.0 + 10.0 / 3600.0 / math.cos(math.radians(89.5)), 89.5)
    offset = offset_arcsec(seen, believed)
    assert (seen.ra_deg - believed.ra_deg) * 3600.0 == pytest.approx(
        1146.0, abs=1.0
    )  # what Ekos would report
    assert offset.east_arcsec == pytest.approx(10.0, abs=1e-3)
    assert offset.total_arcsec == pytest.approx(10.0, abs=1e-3)


def test_east_and_north_are_positive() -> None:
    believed = Icrs(359.999, 10.0)
    assert offset_arcsec(Icrs(0.001, 10.0), believed).east_arcsec == pytest.approx(7.09, abs=0.01)
    assert offset_arcsec(Icrs(359.999, 10.001), believed).north_arcsec == pytest.approx(3.6)


def test_across_the_pole() -> None:
    there = displaced(Icrs(30.0, 89.9), 0.0, 1200.0)
    assert there.ra_deg == pytest.approx(210.0)
    assert there.dec_deg == pytest.approx(90.0 - (1200.0 - 360.0) / 3600.0)
    from_pole = displaced(Icrs(0.0, -90.0), 3600.0, 0.0)
    assert from_pole.dec_deg == pytest.approx(-89.0)


def test_east_is_a_smaller_hour_angle_and_a_larger_azimuth() -> None:
    ha = HourAngle(10.0, 0.0, UTC0)
    assert displaced(ha, 3600.0, 0.0).ha_deg == pytest.approx(9.0)
    assert offset_arcsec(HourAngle(9.0, 0.0, UTC0), ha).east_arcsec == pytest.approx(3600.0)
    geometric = displaced(GeometricHourAngle(179.5, 0.0, UTC0), -3600.0, 0.0)
    assert geometric.ha_deg == pytest.approx(-179.5)
    assert displaced(Observed(359.5, 0.0, UTC0), 3600.0, 0.0).az_deg == pytest.approx(0.5)


def test_the_kind_and_the_instant_are_kept() -> None:
    moved = displaced(Apparent(10.0, 20.0, UTC0), 5.0, 5.0)
    assert isinstance(moved, Apparent)
    assert moved.utc == UTC0


@pytest.mark.parametrize(
    "other", [Apparent(10.0, 20.0, UTC0), Observed(10.0, 20.0, UTC0), HourAngle(1.0, 2.0, UTC0)]
)
def test_kinds_never_mix(other: Apparent | Observed | HourAngle) -> None:
    for compare in (separation_arcsec, position_angle_deg, offset_arcsec):
        with pytest.raises(TypeError, match="different kinds"):
            compare(Icrs(10.0, 20.0), other)  # type: ignore[type-var]
    with pytest.raises(TypeError, match="different kinds"):
        separation_arcsec(HourAngle(1.0, 2.0, UTC0), GeometricHourAngle(1.0, 2.0, UTC0))  # type: ignore[type-var]


@given(st.floats(-1e6, 1e6))
def test_angles_are_brought_home(angle_deg: float) -> None:
    assert 0.0 <= turn_deg(angle_deg) < 360.0
    assert -180.0 < half_turn_deg(angle_deg) <= 180.0
    assert math.cos(math.radians(turn_deg(angle_deg) - angle_deg)) == pytest.approx(1.0)
    assert math.cos(math.radians(half_turn_deg(angle_deg) - angle_deg)) == pytest.approx(1.0)


@given(longitudes, latitudes, st.integers(0, 1000))
def test_gnomonic_is_astropys_tan(ra0_deg: float, dec0_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xi_deg, eta_deg = rng.uniform(-20.0, 20.0, 30), rng.uniform(-20.0, 20.0, 30)
    wcs = WCS(naxis=2)
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [ra0_deg, dec0_deg]
    wcs.wcs.crpix = [0.0, 0.0]
    wcs.wcs.cdelt = [1.0, 1.0]
    wcs.wcs.lonpole = 180.0  # at declination +90 exactly, FITS assumes 0 if nothing is said
    ra_deg, dec_deg = wcs.all_pix2world(xi_deg, eta_deg, 0)
    # 0-based pixels against CRPIX = 0: one degree on
    xi, eta = gnomonic(ra_deg, dec_deg, ra0_deg, dec0_deg)
    np.testing.assert_allclose(np.degrees(xi), xi_deg + 1.0, atol=1e-10)
    np.testing.assert_allclose(np.degrees(eta), eta_deg + 1.0, atol=1e-10)
    back_ra_deg, back_dec_deg = gnomonic_inverse(xi, eta, ra0_deg, dec0_deg)
    assert np.all((back_ra_deg >= 0.0) & (back_ra_deg < 360.0))
    off_deg = np.hypot(
        ((back_ra_deg - ra_deg + 180.0) % 360.0 - 180.0) * np.cos(np.radians(dec_deg)), back_dec_deg - dec_deg
    )
    assert np.all(off_deg < 1e-9)


def test_what_lies_behind_has_no_projection() -> None:
    xi, eta = gnomonic([0.0, 90.0, 180.0, 89.0], [0.0, 0.0, 0.0, 0.0], 0.0, 0.0)
    assert list(np.isnan(xi)) == [False, True, True, False]
    assert list(np.isnan(eta)) == [False, True, True, False]
