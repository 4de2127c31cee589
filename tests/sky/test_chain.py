"""The chain against astropy, there and back, and the sizes that POINTING §1 measured."""

from __future__ import annotations

import math
import random
import statistics
import warnings
from datetime import UTC, datetime, timedelta, timezone

import erfa
import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import TETE, AltAz, EarthLocation, HADec, SkyCoord
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.sky.chain import (
    apparent_to_hour_angle,
    apparent_to_icrs,
    hour_angle_to_apparent,
    hour_angle_to_icrs,
    hour_angle_to_observed,
    icrs_to_apparent,
    icrs_to_hour_angle,
    icrs_to_observed,
    observed_to_hour_angle,
    observed_to_icrs,
    sidereal_time_deg,
    slow_parts,
)
from mountnav.sky.coordinates import Air, Apparent, GeometricHourAngle, HourAngle, Icrs, Observed, Site
from mountnav.sky.sphere import separation_arcsec

SITE = Site(48.93, 22.27, 700.0)
SOUTH = Site(-30.24, -70.73, 2700.0)
AIR = Air(930.0, 5.0, 0.7, 0.6)
UTC0 = datetime(2026, 11, 21, 22, 0, 0, tzinfo=UTC)
INSTANTS = [
    UTC0,
    datetime(2016, 12, 31, 23, 59, 59, 500000, tzinfo=UTC),
    datetime(2001, 3, 4, 5, 6, 7, tzinfo=UTC),
]

places = st.builds(Icrs, st.floats(0.0, 360.0, exclude_max=True), st.floats(-89.99, 89.99))
instants = st.datetimes(datetime(1990, 1, 1), datetime(2027, 10, 1)).map(lambda t: t.replace(tzinfo=UTC))
sites = st.builds(Site, st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), st.floats(0.0, 4000.0))
airs = st.sampled_from([Air(), AIR, Air(600.0, -10.0, 0.2, 0.55)])


def sky(number: int, seed: int) -> list[Icrs]:
    rng = np.random.default_rng(seed)
    ra_deg = rng.uniform(0.0, 360.0, number)
    dec_deg = np.degrees(np.arcsin(rng.uniform(-1.0, 1.0, number)))
    return [Icrs(float(ra), float(dec)) for ra, dec in zip(ra_deg, dec_deg, strict=True)]


def as_skycoord(some: list[Icrs]) -> SkyCoord:
    return SkyCoord([p.ra_deg for p in some] * u.deg, [p.dec_deg for p in some] * u.deg)


def location(site: Site) -> EarthLocation:
    return EarthLocation.from_geodetic(
        site.longitude_deg * u.deg, site.latitude_deg * u.deg, site.height_m * u.m
    )


@pytest.mark.parametrize("utc", INSTANTS)
def test_apparent_places_are_astropys(utc: datetime) -> None:
    some = sky(200, 1)
    oracle = as_skycoord(some).transform_to(TETE(obstime=Time(utc)))
    for place, ra_deg, dec_deg in zip(some, oracle.ra.deg, oracle.dec.deg, strict=True):
        apparent = icrs_to_apparent(place, utc)
        assert separation_arcsec(apparent, Apparent(float(ra_deg), float(dec_deg), utc)) < 0.001


@pytest.mark.long
@pytest.mark.parametrize("utc", INSTANTS)
@pytest.mark.parametrize("site", [SITE, SOUTH])
@pytest.mark.parametrize("air", [Air(), AIR])
def test_observed_places_are_astropys(utc: datetime, site: Site, air: Air) -> None:
    some = sky(200, 2)
    frame_facts = {
        "obstime": Time(utc),
        "location": location(site),
        "pressure": air.pressure_hpa * u.hPa,
        "temperature": air.temperature_c * u.deg_C,
        "relative_humidity": air.relative_humidity,
        "obswl": air.wavelength_um * u.um,
    }
    altaz = as_skycoord(some).transform_to(AltAz(**frame_facts))
    hadec = as_skycoord(some).transform_to(HADec(**frame_facts))
    for i, place in enumerate(some):
        observed = icrs_to_observed(place, utc, site, air)
        assert (
            separation_arcsec(observed, Observed(float(altaz.az[i].deg), float(altaz.alt[i].deg), utc))
            < 0.001
        )
        angles = icrs_to_hour_angle(place, utc, site, air)
        assert (
            separation_arcsec(angles, HourAngle(float(hadec.ha[i].deg), float(hadec.dec[i].deg), utc)) < 0.001
        )


def test_the_inverse_is_astropys() -> None:
    for az_deg, alt_deg in [(10.0, 16.0), (123.0, 45.0), (250.0, 80.0), (359.0, 30.0)]:
        frame = AltAz(
            az_deg * u.deg,
            alt_deg * u.deg,
            obstime=Time(UTC0),
            location=location(SITE),
            pressure=930 * u.hPa,
            temperature=5 * u.deg_C,
            relative_humidity=0.7,
            obswl=0.6 * u.um,
        )
        oracle = SkyCoord(frame).icrs
        icrs = observed_to_icrs(Observed(az_deg, alt_deg, UTC0), SITE, AIR)
        # astropy undoes refraction once only: 0.002″ at 15°
        assert separation_arcsec(icrs, Icrs(float(oracle.ra.deg), float(oracle.dec.deg))) < 0.005


@pytest.mark.parametrize("utc", INSTANTS)
def test_sidereal_time_is_astropys(utc: datetime) -> None:
    oracle = Time(utc).sidereal_time("apparent", SITE.longitude_deg * u.deg).deg
    off_deg = (sidereal_time_deg(utc, SITE) - float(oracle) + 180.0) % 360.0 - 180.0
    assert abs(off_deg) * 3600.0 < 0.001


@given(places, instants)
def test_apparent_there_and_back(place: Icrs, utc: datetime) -> None:
    assert separation_arcsec(apparent_to_icrs(icrs_to_apparent(place, utc)), place) < 0.0005


@given(st.floats(0.0, 360.0, exclude_max=True), st.floats(5.0, 90.0), instants, sites, airs)
def test_observed_there_and_back(az_deg: float, alt_deg: float, utc: datetime, site: Site, air: Air) -> None:
    observed = Observed(az_deg, alt_deg, utc)
    icrs = observed_to_icrs(observed, site, air)
    assert separation_arcsec(icrs_to_observed(icrs, utc, site, air), observed) < 0.001
    angles = observed_to_hour_angle(observed, site)
    assert separation_arcsec(hour_angle_to_observed(angles, site), observed) < 1e-6
    assert separation_arcsec(hour_angle_to_icrs(angles, site, air), icrs) < 0.001


@given(places, instants, sites)
def test_below_the_horizon_the_chain_stays_finite(place: Icrs, utc: datetime, site: Site) -> None:
    observed = icrs_to_observed(place, utc, site, AIR)
    back = observed_to_icrs(observed, site, AIR)
    assert math.isfinite(observed.alt_deg)
    assert math.isfinite(back.ra_deg)
    assert -180.0 < icrs_to_hour_angle(place, utc, site, AIR).ha_deg <= 180.0


@given(places, instants, sites)
def test_geometric_hour_angle_there_and_back(place: Icrs, utc: datetime, site: Site) -> None:
    apparent = icrs_to_apparent(place, utc)
    angles = apparent_to_hour_angle(apparent, site)
    assert -180.0 < angles.ha_deg <= 180.0
    assert separation_arcsec(hour_angle_to_apparent(angles, site), apparent) < 1e-6


def test_without_air_the_two_hour_angles_differ_by_polar_motion_and_diurnal_aberration() -> None:
    differences_arcsec = []
    for place in sky(200, 3):
        geometric = apparent_to_hour_angle(icrs_to_apparent(place, UTC0), SITE)
        topocentric = icrs_to_hour_angle(place, UTC0, SITE, Air())
        same_kind = GeometricHourAngle(topocentric.ha_deg, topocentric.dec_deg, UTC0)
        differences_arcsec.append(separation_arcsec(geometric, same_kind))
    assert 0.1 < statistics.median(differences_arcsec) < max(differences_arcsec) < 0.7


def test_an_observed_hour_angle_is_not_taken_for_a_geometric_one() -> None:
    with pytest.raises(TypeError, match="hour_angle_to_icrs"):
        hour_angle_to_apparent(HourAngle(10.0, 20.0, UTC0), SITE)  # type: ignore[arg-type]


def test_the_price_of_an_epoch_mistake_is_1220_arcsec() -> None:
    distances_arcsec = []
    for place in sky(1500, 4):
        if icrs_to_observed(place, UTC0, SITE, Air()).alt_deg < 15.0:
            continue
        apparent = icrs_to_apparent(place, UTC0)
        distances_arcsec.append(separation_arcsec(Icrs(apparent.ra_deg, apparent.dec_deg), place))
    assert statistics.median(distances_arcsec) == pytest.approx(1220.0, abs=30.0)
    assert max(distances_arcsec) == pytest.approx(1381.0, abs=10.0)


def test_refraction_has_the_measured_size() -> None:
    lifts_arcsec = []
    for place in sky(1500, 5):
        bare = icrs_to_observed(place, UTC0, SITE, Air())
        if bare.alt_deg > 15.0:
            lifts_arcsec.append((icrs_to_observed(place, UTC0, SITE, AIR).alt_deg - bare.alt_deg) * 3600.0)
    assert min(lifts_arcsec) > 0.0
    assert statistics.median(lifts_arcsec) == pytest.approx(61.0, abs=8.0)
    assert max(lifts_arcsec) == pytest.approx(198.0, abs=8.0)


def test_a_clock_one_second_wrong_is_15_arcsec_at_the_equator() -> None:
    # hour angle zero, declination zero
    meridian = hour_angle_to_icrs(HourAngle(0.0, 0.0, UTC0), SITE, Air())
    late = icrs_to_hour_angle(meridian, UTC0 + timedelta(seconds=1), SITE, Air())
    assert late.ha_deg * 3600.0 == pytest.approx(15.041, abs=0.001)


def test_any_time_zone_is_the_same_instant() -> None:
    place = Icrs(100.0, 20.0)
    east = UTC0.astimezone(timezone(timedelta(hours=5, minutes=45)))
    here, there = icrs_to_apparent(place, UTC0), icrs_to_apparent(place, east)
    assert (here.ra_deg, here.dec_deg) == (there.ra_deg, there.dec_deg)


def test_naive_instants_are_refused_everywhere() -> None:
    naive = datetime(2026, 11, 21, 22)
    place = Icrs(1.0, 2.0)
    with pytest.raises(BadRequest, match="time zone"):
        icrs_to_apparent(place, naive)
    with pytest.raises(BadRequest):
        apparent_to_icrs(Apparent(1.0, 2.0, naive))
    with pytest.raises(BadRequest):
        icrs_to_observed(place, naive, SITE, AIR)
    with pytest.raises(BadRequest):
        hour_angle_to_icrs(HourAngle(1.0, 2.0, naive), SITE, AIR)
    with pytest.raises(BadRequest):
        observed_to_icrs(Observed(1.0, 2.0, naive), SITE, AIR)
    with pytest.raises(BadRequest):
        sidereal_time_deg(naive, SITE)


@pytest.mark.parametrize("year", [1975, 2028, 2035, 2099])
def test_outside_the_table_the_chain_goes_on_without_a_warning(year: int) -> None:
    utc = datetime(year, 6, 1, tzinfo=UTC)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        apparent = icrs_to_apparent(Icrs(10.0, 20.0), utc)
        observed = icrs_to_observed(Icrs(10.0, 20.0), utc, SITE, AIR)
    assert separation_arcsec(apparent_to_icrs(apparent), Icrs(10.0, 20.0)) < 0.001
    assert math.isfinite(observed.alt_deg)


def test_years_without_utc_or_ephemeris_are_a_wrong_clock() -> None:
    for year in (1970, 2100):
        with pytest.raises(BadRequest, match="clock"):
            icrs_to_apparent(Icrs(0.0, 0.0), datetime(year, 1, 1, tzinfo=UTC))


ARCSEC = np.radians(1.0 / 3600.0)


@pytest.mark.parametrize("year", [1972, 1990, 2026, 2063, 2099])
def test_it_is_what_the_series_give(year: int) -> None:
    chance = random.Random(year)
    for _ in range(60):
        tt1, tt2 = 2451544.5 + (year - 2000) * 365.25, chance.uniform(0.0, 365.0)
        got = slow_parts(tt1, tt2)
        heliocentric, barycentric = erfa.epv00(tt1, tt2)
        matrix = erfa.pnm06a(tt1, tt2)
        # an element of a rotation's matrix is off by no more than the rotation
        assert np.abs(got.matrix - matrix).max() < 2e-5 * ARCSEC
        s_rad = erfa.s06(tt1, tt2, *erfa.bpn2xy(matrix))
        assert abs(got.s_rad - s_rad) < 1e-7 * ARCSEC
        # 1.2e-5″ of aberration; of the way 20 km, of which no star's parallax tells
        assert np.abs(got.barycentric["v"] - barycentric["v"]).max() < 1e-8
        assert np.abs(got.barycentric["p"] - barycentric["p"]).max() < 1.3e-7
        assert np.abs(got.heliocentric - heliocentric["p"]).max() < 1.3e-7


def test_it_goes_on_without_a_step_over_a_full_hour() -> None:
    hour = 10.0 / 24.0
    before, after = (slow_parts(2461366.5, hour + off) for off in (-1e-9, 1e-9))
    assert np.abs(before.matrix - after.matrix).max() < 1e-6 * ARCSEC
    assert np.abs(before.barycentric["v"] - after.barycentric["v"]).max() < 1e-9


def test_the_split_of_the_date_does_not_matter() -> None:
    one, other = slow_parts(2461366.5, 0.3), slow_parts(2461367.0, -0.2)
    assert np.abs(one.matrix - other.matrix).max() < 1e-6 * ARCSEC
