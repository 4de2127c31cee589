"""Earth satellites: SGP4's own vectors, skyfield's places of sites, aberration, and elements that get old."""

from __future__ import annotations

import json
import math
import re
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sgp4.api import Satrec
from sgp4.exporter import export_omm
from skyfield.api import EarthSatellite as SkyfieldSatellite
from skyfield.api import Loader, wgs84

from mountnav.ephemeris import EarthSatellite, SatelliteElements, sky_rates
from mountnav.ephemeris.any_text import read_satellites
from mountnav.ephemeris.satellite import MOST_AGE_DAYS, _teme_to_gcrs
from mountnav.ephemeris.tle import checksum, read_tle
from mountnav.errors import BadRequest
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air
from mountnav.sky.iers import earth_orientation
from mountnav.sky.observer import direction, earth_barycentric_km, site_geocentric_km
from mountnav.sky.sphere import separation_arcsec
from mountnav.units import LIGHT_KM_S
from tests.ephemeris.samples import ISS, ISS_1, ISS_2, SITE, with_checksum

GEO_1 = with_checksum("1 40874U 15042A   24170.50000000 -.00000100  00000-0  00000+0 0  999")
GEO_2 = with_checksum("2 40874   0.0150  85.0000 0002000 100.0000 200.0000  1.00271000 3200")


def _verification() -> list[tuple[str, str, list[list[float]]]]:
    """Elements of SGP4's own verification and the vectors that its authors give for them."""
    package = files("sgp4")
    wanted: dict[str, list[list[float]]] = {}
    number = ""
    for line in (package / "tcppver.out").read_text(encoding="utf-8").splitlines():
        if found := re.fullmatch(r"\s*([0-9]+) xx\s*", line):
            number = found[1].zfill(5)
            wanted[number] = []
        elif number and re.match(r"\s+-?[0-9]", line):
            wanted[number].append([float(one) for one in line.split()[:7]])
    lines = [
        one for one in (package / "SGP4-VER.TLE").read_text(encoding="utf-8").splitlines() if one[:1] in "12"
    ]
    return [
        (first, second, wanted[first[2:7]]) for first, second in zip(lines[::2], lines[1::2], strict=True)
    ]


def test_the_places_are_those_of_sgp4s_own_verification() -> None:
    judged = refused = 0
    for first, second, rows in _verification():
        one = Satrec.twoline2rv(first[:69], second[:69])
        day = datetime(1949, 12, 31, tzinfo=UTC) + timedelta(
            days=(one.jdsatepoch - 2433281.5) + one.jdsatepochF
        )
        if day.year < 1972:
            continue
        told = {
            "name": first[2:7],
            "norad_id": one.satnum,
            "epoch_utc": day,
            "mean_motion_rev_day": one.no_kozai * 1440.0 / (2.0 * math.pi),
            "eccentricity": one.ecco,
            "inclination_deg": math.degrees(one.inclo),
            "node_deg": math.degrees(one.nodeo),
            "perigee_deg": math.degrees(one.argpo),
            "mean_anomaly_deg": math.degrees(one.mo),
            "bstar": one.bstar,
            "motion_dot_rev_day2": one.ndot * 1440.0 * 1440.0 / (2.0 * math.pi),
            "motion_ddot_rev_day3": one.nddot * 1440.0**3 / (2.0 * math.pi),
        }
        try:
            satellite = EarthSatellite(SatelliteElements(**told))
        except BadRequest:  # the last ones are there to be refused
            refused += 1
            continue
        for minutes, *vector in rows:
            try:
                found = satellite.teme_km(day, minutes * 60.0)
            except BadRequest:  # those that come down are told by an error there too
                continue
            assert np.allclose(found, vector[:3], atol=1e-4), (first[2:7], minutes)
            judged += 1
    assert judged > 500
    assert refused <= 3


@pytest.mark.parametrize("lines", [(ISS_1, ISS_2), (GEO_1, GEO_2)])
def test_from_a_site_it_stands_where_skyfield_has_it(lines: tuple[str, str], tmp_path: Path) -> None:
    loader = Loader(tmp_path)
    timescale = loader.timescale(builtin=True)
    satellite = EarthSatellite(read_tle("\n".join(lines))[0])
    other = SkyfieldSatellite(*lines, "x", timescale)
    here = wgs84.latlon(SITE.latitude_deg, SITE.longitude_deg, SITE.height_m)
    for hours in (0.0, 3.0, 10.0, 40.0, -30.0):
        utc = satellite.elements.epoch_utc + timedelta(hours=hours)
        earth = earth_orientation(utc)
        # skyfield's built-in table has no polar motion: it is given ours
        timescale.polar_motion_table = (
            np.array([0.0, 1e9]),
            np.array([earth.polar_x_arcsec] * 2),
            np.array([earth.polar_y_arcsec] * 2),
        )
        wanted = (other - here).at(timescale.from_datetime(utc)).position.km
        found = _teme_to_gcrs(utc, earth) @ satellite.teme_km(utc) - site_geocentric_km(utc, SITE)[0]
        assert np.linalg.norm(found - wanted) < 0.005


def test_light_time_is_allowed_for_as_the_chain_wants_it() -> None:
    """With the aberration of a star put on, the place is where light goes in the Earth's own frame."""
    satellite = EarthSatellite(read_tle(f"{GEO_1}\n{GEO_2}")[0])
    utc = satellite.elements.epoch_utc + timedelta(hours=5)
    matrix = _teme_to_gcrs(utc, earth_orientation(utc))
    here, moves = site_geocentric_km(utc, SITE)
    # seen from the Earth, which moves evenly for the 0.13 s: only the satellite and the observer move
    light_s = float(np.linalg.norm(matrix @ satellite.teme_km(utc) - here)) / LIGHT_KM_S
    vector = matrix @ satellite.teme_km(utc, -light_s) - here
    vector = vector / np.linalg.norm(vector) + moves / LIGHT_KM_S
    # the astrometric place with the whole aberration put on, as for a star
    star = satellite.vector_km(utc, SITE)
    star = star / np.linalg.norm(star)
    beta = (earth_barycentric_km(utc)[1] + moves) / LIGHT_KM_S
    apparent = star + beta - star * float(star @ beta)
    assert separation_arcsec(direction(apparent), direction(vector)) < 0.02
    # and left out it would be 20″
    geometric = matrix @ satellite.teme_km(utc) - here
    assert separation_arcsec(direction(geometric), direction(star)) > 5.0


def test_elements_get_old() -> None:
    station = EarthSatellite(read_tle(ISS)[0])
    epoch = station.elements.epoch_utc
    sigmas = [station.elements.sigma_km(epoch + timedelta(days=days)) for days in (0, 1, 2, 3)]
    assert sigmas == sorted(sigmas)
    assert sigmas[0] == pytest.approx(1.0)
    assert 2.0 < (station.ends_utc - epoch).total_seconds() / 86400.0 < 6.0
    with pytest.raises(BadRequest, match=r"elements are of 2024-06-18 12:43 UTC and good for .* days"):
        station.icrs(epoch + timedelta(days=8), SITE)
    with pytest.raises(BadRequest, match="begins at"):
        station.icrs(epoch - timedelta(days=8), SITE)
    high = EarthSatellite(read_tle(f"{GEO_1}\n{GEO_2}")[0])
    assert high.ends_utc - epoch > timedelta(days=MOST_AGE_DAYS - 1)
    assert high.sigma_arcsec(epoch) < 10.0 < station.sigma_arcsec(epoch)


def test_a_geostationary_satellite_stands_over_the_horizon() -> None:
    high = EarthSatellite(read_tle(f"{GEO_1}\n{GEO_2}")[0])
    epoch = high.elements.epoch_utc
    seen = [
        icrs_to_observed(high.icrs(epoch + timedelta(hours=h), SITE), epoch + timedelta(hours=h), SITE, Air())
        for h in (0, 7)
    ]
    assert abs(seen[0].alt_deg - seen[1].alt_deg) < 0.2
    assert sky_rates(high, epoch, SITE).ra_arcsec_s == pytest.approx(15.04, abs=0.3)


# -- texts ---------------------------------------------------------------------------------------------------


def _omm() -> dict[str, str]:
    return {key: str(value) for key, value in export_omm(Satrec.twoline2rv(ISS_1, ISS_2), "ISS").items()}


def _forms(told: dict[str, str]) -> dict[str, str]:
    tags = "".join(f"<{key}>{value}</{key}>" for key, value in told.items())
    return {
        "json": json.dumps([told]),
        "kvn": "CCSDS_OMM_VERS = 2.0\nCOMMENT of a test\n" + "\n".join(f"{k} = {v}" for k, v in told.items()),
        "csv": ",".join(told) + "\n" + ",".join(told.values()) + "\n",
        "xml": '<?xml version="1.0" encoding="UTF-8"?>\n<ndm xmlns:xsi="x"><omm id="CCSDS_OMM_VERS">'
        f"<header/><body><segment><metadata>{tags}</metadata></segment></body></omm></ndm>",
    }


@pytest.mark.parametrize("form", ["json", "kvn", "csv", "xml"])
def test_an_omm_is_the_same_in_all_forms(form: str) -> None:
    found = read_satellites(_forms(_omm())[form])
    two_lines = read_tle(ISS)[0]
    assert len(found) == 1
    assert found[0].norad_id == 25544
    assert found[0].international_id == "1998-067A"
    assert abs((found[0].epoch_utc - two_lines.epoch_utc).total_seconds()) < 1e-5
    utc = two_lines.epoch_utc + timedelta(hours=4)
    apart = EarthSatellite(found[0]).teme_km(utc) - EarthSatellite(two_lines).teme_km(utc)
    assert np.linalg.norm(apart) < 0.001


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("REF_FRAME", "ICRF", "REF_FRAME"),
        ("CENTER_NAME", "MARS", "CENTER_NAME"),
        ("TIME_SYSTEM", "TAI", "TIME_SYSTEM"),
        ("MEAN_ELEMENT_THEORY", "SGP4-XP", "MEAN_ELEMENT_THEORY"),
        ("EPHEMERIS_TYPE", "4", "type 4"),
        ("MEAN_MOTION", "NaN", "MEAN_MOTION"),
        ("MEAN_MOTION", "1e9", "mean motion"),
        ("ECCENTRICITY", "", "ECCENTRICITY"),
        ("ECCENTRICITY", "1.5", "eccentricity"),
        ("EPOCH", "yesterday", "EPOCH"),
        ("NORAD_CAT_ID", "x", "NORAD_CAT_ID"),
    ],
)
@pytest.mark.parametrize("form", ["json", "kvn", "csv", "xml"])
def test_another_theory_or_a_wrong_number_is_refused(form: str, key: str, value: str, says: str) -> None:
    with pytest.raises(BadRequest, match=says):
        read_satellites(_forms(_omm() | {key: value})[form])


def test_xml_with_entities_of_its_own_is_refused() -> None:
    bomb = '<!DOCTYPE omm [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>' + _forms(_omm())["xml"].split("?>")[1]
    with pytest.raises(BadRequest, match="entities"):
        read_satellites(bomb)


def test_two_and_three_lines() -> None:
    assert read_tle(ISS)[0].name == "ISS (ZARYA)"
    assert read_tle(f"0 ISS\n{ISS_1}\n{ISS_2}")[0].name == "ISS"
    assert read_tle(f"{ISS_1}\r\n{ISS_2}\r\n")[0].name == "satellite 25544"
    assert len(read_tle(f"{ISS}\n{ISS}{GEO_1}\n{GEO_2}")) == 3


def test_an_alpha_five_number() -> None:
    first = with_checksum("1 B1234" + ISS_1[7:68])
    second = with_checksum("2 B1234" + ISS_2[7:68])
    assert read_tle(f"{first}\n{second}")[0].norad_id == 111_234


@given(st.integers(0, 68), st.sampled_from("0123456789"), st.booleans())
def test_a_changed_digit_is_seen(place: int, digit: str, in_second: bool) -> None:
    lines = [ISS_1, ISS_2]
    line = lines[in_second]
    # letters, dots and blanks count as zeros in the checksum
    if line[place] == digit or (digit == "0" and not line[place].isdigit() and line[place] != "-"):
        return
    lines[in_second] = line[:place] + digit + line[place + 1 :]
    with pytest.raises(BadRequest):
        read_tle("\n".join(lines))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "no two-line"),
        (ISS_1, "end after the first line"),
        (f"{ISS_2}\n{ISS_1}", "second line without a first"),
        (f"{ISS_1}\n{GEO_2}", "different objects"),
        (f"{ISS_1[:68]}\n{ISS_2}", "letters"),
        (f"{ISS_1}\n{ISS_2[:60]}", "letters"),
        (f"{with_checksum(ISS_1[:62] + '4' + ISS_1[63:68])}\n{ISS_2}", "SGP4-XP"),
        (f"name\nname again\n{ISS_1}\n{ISS_2}", "neither a name"),
    ],
)
def test_what_are_no_elements_is_refused(text: str, says: str) -> None:
    with pytest.raises(BadRequest, match=says):
        read_tle(text)


def test_a_right_checksum_of_a_wrong_line_is_no_excuse() -> None:
    shifted = ISS_1[:20] + " " + ISS_1[20:67]
    with pytest.raises(BadRequest):
        read_tle(f"{shifted[:68]}{checksum(shifted)}\n{ISS_2}")


@pytest.mark.parametrize(
    "text", ["\n" * 49_000, " \n" * 24_000, "OBJECT_NAME," + "\n" * 49_000, "1 " * 24_000]
)
def test_a_long_text_of_nothing_is_refused_in_one_pass(text: str) -> None:
    """A time that grew with the square of its length would not end here."""
    for _ in range(20):
        with pytest.raises(BadRequest):
            read_satellites(text)
