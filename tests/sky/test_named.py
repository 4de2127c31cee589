"""Objects by name: stars against the embedded catalog, bodies against astropy, names as people type them."""

from __future__ import annotations

import warnings
from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.iers import prepare
from mountnav.sky.kernel import SHIPPED_PATH
from mountnav.sky.named import NamedObject, named_objects, object_of_name, position_of_name, search
from mountnav.sky.planets import BODIES, position_of_body
from mountnav.sky.proper_motion import moved_to
from mountnav.sky.sphere import separation_arcsec

SITE = Site(47.0, 11.0, 500.0)
HIPPARCOS_YR = 1991.25
STARS = [one for one in named_objects() if one.kind == "star"]

# Tycho-2 with its supplement 1 has no star there, or the photocenter of a close pair
NOT_IN_TYCHO = {"Barnard's Star", "Keid", "Proxima Centauri"}
PAIRS = {"Alrakis", "Alula Australis", "Rigil Kentaurus", "Toliman", "Porrima", "Castor"}


def test_all_are_there() -> None:
    assert len(STARS) == 335
    assert [one.name for one in named_objects() if one.kind == "messier"] == [f"M{n}" for n in range(1, 111)]
    assert len({one.name for one in named_objects()}) == len(named_objects())


def test_stars_stand_where_tycho_saw_them() -> None:
    apart = {one.name: _nearest_arcsec(one) for one in STARS if one.name not in NOT_IN_TYCHO}
    assert {name for name, far in apart.items() if far > 0.6} <= PAIRS
    assert sorted(apart.values())[len(apart) // 2] < 0.05
    assert max(apart.values()) < 3.0


def _nearest_arcsec(one: NamedObject) -> float:
    """From the catalog's star of about that magnitude; both at the epoch of Hipparcos."""
    assert one.place is not None
    assert one.mag is not None
    here = moved_to(
        one.place,
        datetime(1991, 4, 2, 13, 30, tzinfo=UTC),
        epoch_yr=one.epoch_yr,
        pm_ra_cosdec_masyr=one.pm_ra_cosdec_masyr,
        pm_dec_masyr=one.pm_dec_masyr,
    )
    near = embedded_catalog().cone(here, 20.0 / 3600.0, epoch_yr=HIPPARCOS_YR)
    return min(
        (
            separation_arcsec(here, Icrs(float(ra), float(dec)))
            for ra, dec, mag in zip(near.ra_deg, near.dec_deg, near.mag, strict=True)
            if abs(float(mag) - one.mag) < 1.6
        ),
        default=999.0,
    )


@pytest.mark.parametrize("utc", [datetime(2026, 11, 22, 9, tzinfo=UTC), datetime(2035, 3, 2, 19, tzinfo=UTC)])
@pytest.mark.parametrize("name", BODIES)
def test_bodies_stand_where_astropy_has_them(name: str, utc: datetime) -> None:
    from astropy import units
    from astropy.coordinates import EarthLocation, SkyCoord, get_body, solar_system_ephemeris
    from astropy.time import Time

    prepare()
    earth = EarthLocation.from_geodetic(SITE.longitude_deg, SITE.latitude_deg, SITE.height_m * units.m)
    # the Earth too, which get_body takes from astropy's own formulas unless all of it is told
    with warnings.catch_warnings(), solar_system_ephemeris.set(str(SHIPPED_PATH)):
        warnings.simplefilter("ignore")  # of dubious years, as erfa calls those to come
        seen = get_body(name, Time(utc), earth)
        star = SkyCoord(ra=seen.ra, dec=seen.dec, frame=seen.frame.replicate_without_data()).icrs
    there = Icrs(float(star.ra.deg), float(star.dec.deg))
    # next to the Sun astropy bends the light of what stands before it too
    near_sun = name in ("sun", "mercury", "venus")
    assert separation_arcsec(there, position_of_body(name, utc, SITE)) < (0.5 if near_sun else 0.1)


def test_proper_motion_is_astropys() -> None:
    from astropy import units
    from astropy.coordinates import Distance, SkyCoord
    from astropy.time import Time

    star = object_of_name("Barnard's Star")
    assert star.place is not None
    begin = SkyCoord(
        ra=star.place.ra_deg * units.deg,
        dec=star.place.dec_deg * units.deg,
        distance=Distance(parallax=star.parallax_mas * units.mas),
        pm_ra_cosdec=star.pm_ra_cosdec_masyr * units.mas / units.yr,
        pm_dec=star.pm_dec_masyr * units.mas / units.yr,
        radial_velocity=0.0 * units.km / units.s,
        obstime=Time(HIPPARCOS_YR, format="jyear", scale="tdb"),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        then = begin.apply_space_motion(new_obstime=Time(datetime(2026, 11, 22, tzinfo=UTC)))
    here = star.icrs(datetime(2026, 11, 22, tzinfo=UTC), SITE)
    assert separation_arcsec(star.place, here) > 360.0
    assert separation_arcsec(here, Icrs(float(then.ra.deg), float(then.dec.deg))) < 0.01


@pytest.mark.parametrize("dec_deg", [90.0, 89.99999, -90.0, 0.0])
@pytest.mark.parametrize("ra_deg", [0.0, 359.999999, 123.0])
def test_a_star_moves_by_its_motion_wherever_it_stands(ra_deg: float, dec_deg: float) -> None:
    begin, years = Icrs(ra_deg, dec_deg), 26.0
    then = moved_to(
        begin,
        datetime(2026, 1, 1, 12, tzinfo=UTC),
        epoch_yr=2000.0,
        pm_ra_cosdec_masyr=3000.0,
        pm_dec_masyr=-4000.0 if dec_deg > 0.0 else 4000.0,
    )
    assert separation_arcsec(begin, then) == pytest.approx(5.0 * years, abs=0.02)
    assert 0.0 <= then.ra_deg < 360.0
    assert moved_to(begin, datetime(2026, 1, 1, tzinfo=UTC), epoch_yr=2000.0) == begin


@pytest.mark.parametrize("utc", [datetime(2026, 1, 1), datetime(1950, 1, 1, tzinfo=UTC)])
@pytest.mark.parametrize("name", ["Vega", "M31", "Mars"])
def test_an_instant_without_a_zone_or_far_away_is_refused(name: str, utc: datetime) -> None:
    with pytest.raises(BadRequest):
        object_of_name(name).icrs(utc, SITE)


@pytest.mark.parametrize(
    ("typed", "name"),
    [
        ("vega", "Vega"),
        ("  VEGA ", "Vega"),
        ("α Lyr", "Vega"),
        ("alpha lyr", "Vega"),
        ("HIP 91262", "Vega"),
        ("m31", "M31"),
        ("M 31", "M31"),
        ("Messier 31", "M31"),
        ("ngc224", "M31"),
        ("andromeda galaxy", "M31"),
        ("Alpha Cen", "Rigil Kentaurus"),
        ("barnards star", "Barnard's Star"),
        ("Jupiter", "Jupiter"),
        ("Alpha Lyrae", "Vega"),
        ("alf Lyr", "Vega"),
        ("α Canis Majoris", "Sirius"),
        ("\u00b5 Ursae Majoris", "Tania Australis"),
        ("ϵ Eri", "Ran"),
        ("π³ Orionis", "Tabit"),
        ("HIP 091262", "Vega"),
        ("NGC 0224", "M31"),
        ("M ٣١", "M31"),
        ("Ｍ３１", "M31"),
        ("Barnard’s\u200b Star", "Barnard's Star"),
    ],
)
def test_names_are_found_as_people_type_them(typed: str, name: str) -> None:
    assert object_of_name(typed).name == name
    assert search(typed, 3)[0].name == name


def test_an_unknown_name_is_refused_and_like_ones_are_told() -> None:
    with pytest.raises(BadRequest) as caught:
        position_of_name("Betelgeu", datetime(2026, 11, 22, tzinfo=UTC), SITE)
    assert "Betelgeuse" in (caught.value.advice or "")
    with pytest.raises(BadRequest):
        object_of_name("")


@pytest.mark.parametrize(
    "typed",
    ["M4.0", "M3,1", "HIP 9126.2", "M3/1", "M31+", "Mars 火", "Vegа", "Lyr", "Lyrae", "...", "\u200b"],
)
def test_what_is_nearly_a_name_is_not_taken_for_it(typed: str) -> None:
    # a number out of a table of floats is no other object
    with pytest.raises(BadRequest):
        object_of_name(typed)


def test_each_listed_designation_finds_its_object() -> None:
    for one in named_objects():
        for designation in one.aliases:
            assert designation in object_of_name(designation).aliases


@given(st.text(max_size=40), st.integers(1, 30))
def test_a_search_never_fails_and_keeps_its_count(text: str, count: int) -> None:
    found = search(text, count)
    assert len(found) <= count
    assert len(set(found)) == len(found)


def test_everything_found_has_a_place() -> None:
    utc = datetime(2026, 11, 22, 2, tzinfo=UTC)
    for one in named_objects():
        place = one.icrs(utc, SITE)
        assert 0.0 <= place.ra_deg < 360.0
        assert -90.0 <= place.dec_deg <= 90.0
