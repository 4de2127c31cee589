"""Units against astropy's, and numbers as text."""

from datetime import UTC, datetime

import astropy.constants as c
import astropy.units as u
import pytest
from astropy.time import Time
from hypothesis import given
from hypothesis import strategies as st

from mountnav import units


def test_the_factors_are_astropys() -> None:
    expected = {
        "ARCSEC_PER_DEG": u.deg.to(u.arcsec),
        "ARCSEC_PER_RAD": u.rad.to(u.arcsec),
        "RAD_PER_ARCSEC": u.arcsec.to(u.rad),
        "MAS_PER_RAD": u.rad.to(u.mas),
        "RAD_PER_MAS": u.mas.to(u.rad),
        "DEG_PER_HOUR": u.hourangle.to(u.deg),
        "SKY_DEG2": u.spat.to(u.deg**2),
        "SECONDS_PER_HOUR": u.hour.to(u.s),
        "SECONDS_PER_DAY": u.day.to(u.s),
        "JULIAN_YEAR_DAYS": u.yr.to(u.day),
        "J2000_JD": Time("J2000.0").jd,
        "MJD_ZERO_JD": Time(0.0, format="mjd").jd,
        "UNIX_ZERO_JD": Time("1970-01-01T00:00:00", scale="utc").jd,
        "AU_KM": c.au.to_value(u.km),
        "LIGHT_KM_S": c.c.to_value(u.km / u.s),
    }
    ours = {name: value for name, value in vars(units).items() if name.isupper() and isinstance(value, float)}
    assert ours == pytest.approx(expected, rel=1e-14)


def test_a_julian_year_is_astropys_but_for_the_minute_of_tt() -> None:
    for when in (datetime(1955, 3, 1, tzinfo=UTC), datetime(2026, 11, 26, 3, 4, 5, 678, tzinfo=UTC)):
        assert units.julian_year(when) == pytest.approx(Time(when, scale="tt").jyear, abs=1e-9)


def test_the_scale_gives_the_focal_length_back() -> None:
    scale = units.pixel_scale_arcsec(3.76, 1000.0)
    assert scale == pytest.approx(0.7756, abs=1e-4)
    assert units.pixel_scale_arcsec(3.76, scale) == pytest.approx(1000.0)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (None, "an unknown time"),
        (0.0, "0 s"),
        (89.4, "89 s"),
        (90.0, "2 min"),
        (5369.0, "89 min"),
        (5370.0, "1 h 30 min"),
        (86_400.0, "24 h 00 min"),
    ],
)
def test_a_duration_is_written_for_a_person(seconds: float | None, text: str) -> None:
    assert units.duration_text(seconds) == text


@given(st.floats(-400.0, 400.0), st.integers(1, 5))
def test_sexagesimal_text_is_read_back_within_its_last_digit(value: float, decimals: int) -> None:
    text = units.sexagesimal_text(value, decimals, plus="+")
    whole, minutes, seconds = text[1:].split()
    assert float(minutes) < 60.0
    assert float(seconds) < 60.0
    read = int(whole) + int(minutes) / 60.0 + float(seconds) / 3600.0
    assert (-read if text[0] == "-" else read) == pytest.approx(value, abs=0.51 * 10.0**-decimals / 3600.0)


def test_right_ascension_begins_again_at_24_h() -> None:
    assert units.sexagesimal_text(23.9999999, 2, wrap=24) == "00 00 00.00"
