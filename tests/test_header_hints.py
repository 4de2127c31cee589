"""Hints and times from headers: the sane ones are read, the absurd ones passed over."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest
from astropy.wcs import WCS
from hypothesis import given
from hypothesis import strategies as st

from mountnav.header_hints import hint_from_header
from mountnav.header_times import exposure_s_from_header, mid_exposure_from_header

Header = dict[str, str | int | float | bool]


@pytest.mark.parametrize(
    ("cards", "ra_deg", "dec_deg"),
    [
        ({"RA": 83.82, "DEC": -5.39}, 83.82, -5.39),
        ({"RA": "05:35:17.0", "DEC": "-05:23:28"}, 83.8208, -5.3911),
        ({"OBJCTRA": "05 35 17", "OBJCTDEC": "-05 23 28"}, 83.8208, -5.3911),
        ({"RA": "5h35m17s", "DEC": "-5d23m28s"}, 83.8208, -5.3911),
        ({"RA": "83.82", "DEC": "-5.39"}, 83.82, -5.39),
        ({"OBJCTRA": "00 00 30", "OBJCTDEC": "-00 30 00"}, 0.125, -0.5),
        ({"RA": 654.476, "DEC": 30.0, "OBJCTRA": "21 38 00", "OBJCTDEC": "+30 30 00"}, 324.5, 30.5),
    ],
)
def test_places_in_every_usual_form(cards: Header, ra_deg: float, dec_deg: float) -> None:
    center = hint_from_header(cards, 100, 100).center
    assert center is not None
    assert center.ra_deg == pytest.approx(ra_deg, abs=1e-3)
    assert center.dec_deg == pytest.approx(dec_deg, abs=1e-3)


@pytest.mark.parametrize(
    "cards",
    [
        {},
        {"RA": 0.0, "DEC": 0.0},
        {"RA": 10.0},
        {"RA": 10.0, "DEC": 95.0},
        {"RA": float("nan"), "DEC": 3.0},
        {"RA": "25:00", "DEC": "high"},
        {"RA": "05:61:00", "DEC": "10:00:00"},
        {"RA": True, "DEC": True},
        {
            "CTYPE1": "RA---TAN",
            "CTYPE2": "DEC--TAN",
            "CRVAL1": 10.0,
            "CRVAL2": 5.0,
            "CDELT1": 1.0,
            "CDELT2": 1.0,
        },
    ],
)
def test_absurd_places_are_passed_over(cards: Header) -> None:
    assert hint_from_header(cards, 100, 100).center is None


@given(
    ra=st.floats(0.1, 359.9),
    dec=st.floats(-85, 85),
    crpix=st.tuples(st.floats(-500, 1500), st.floats(-500, 1500)),
    cd=st.tuples(st.floats(5e-4, 1e-3), st.floats(-2e-4, 2e-4)),
)
def test_a_wcs_is_evaluated_at_the_center_as_astropy_does(
    ra: float, dec: float, crpix: tuple[float, float], cd: tuple[float, float]
) -> None:
    cards: Header = {
        "CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CRVAL1": ra, "CRVAL2": dec, "CRPIX1": crpix[0],
        "CRPIX2": crpix[1], "CD1_1": -cd[0], "CD1_2": cd[1], "CD2_1": cd[1], "CD2_2": cd[0],
    }  # fmt: skip
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval, wcs.wcs.crpix = ["RA---TAN", "DEC--TAN"], [ra, dec], list(crpix)
    wcs.wcs.cd = [[-cd[0], cd[1]], [cd[1], cd[0]]]
    expected = wcs.pixel_to_world_values(399.5, 299.5)
    hint = hint_from_header(cards, 800, 600)
    assert hint.center is not None
    assert (hint.center.ra_deg - float(expected[0]) + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=1e-7)
    assert hint.center.dec_deg == pytest.approx(float(expected[1]), abs=1e-8)
    scale = 3600.0 * (cd[0] ** 2 + cd[1] ** 2) ** 0.5
    assert hint.scale_low_arcsec_px is not None
    assert hint.scale_high_arcsec_px is not None
    assert hint.scale_low_arcsec_px < scale < hint.scale_high_arcsec_px


@pytest.mark.parametrize(
    ("cards", "low", "high"),
    [
        ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0}, 1.856, 1.856),
        ({"FOCALLEN": 1000.0, "XPIXSZ": 9.0, "XBINNING": 2}, 1.856, 3.713),
        ({"PIXSCALE": 2.5}, 2.5, 2.5),
        ({"SECPIX": "0.7"}, 0.7, 0.7),
        (
            {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CDELT1": -5e-4, "CDELT2": 5e-4, "CROTA2": 30.0},
            1.8,
            1.8,
        ),
    ],
)
def test_scales_with_a_tenth_of_room(cards: Header, low: float, high: float) -> None:
    hint = hint_from_header(cards, 100, 100)
    assert hint.scale_low_arcsec_px == pytest.approx(0.9 * low, rel=1e-3)
    assert hint.scale_high_arcsec_px == pytest.approx(1.1 * high, rel=1e-3)


@pytest.mark.parametrize(
    "cards", [{"FOCALLEN": 0.0, "XPIXSZ": 9.0}, {"PIXSCALE": 0}, {"SCALE": 1e9}, {"PIXSCALE": "?"}]
)
def test_absurd_scales_are_passed_over(cards: Header) -> None:
    assert hint_from_header(cards, 100, 100).scale_low_arcsec_px is None


@pytest.mark.parametrize(
    ("cards", "expected"),
    [
        ({"DATE-OBS": "2026-11-20T01:02:03", "EXPTIME": 10}, datetime(2026, 11, 20, 1, 2, 8, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20 01:02:03Z"}, datetime(2026, 11, 20, 1, 2, 3, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20T01:02:03-0700"}, datetime(2026, 11, 20, 8, 2, 3, tzinfo=UTC)),
        (
            {"DATE-OBS": "2026-11-20", "TIME-OBS": "23:59:59.5"},
            datetime(2026, 11, 20, 23, 59, 59, 500_000, tzinfo=UTC),
        ),
        ({"DATE-OBS": "20/11/95", "UT": "03:04:05"}, datetime(1995, 11, 20, 3, 4, 5, tzinfo=UTC)),
        ({"DATE-AVG": "2026-11-20T01:00:00", "EXPTIME": 60}, datetime(2026, 11, 20, 1, tzinfo=UTC)),
        ({"MJD-OBS": 60000.5, "EXPTIME": 20}, datetime(2023, 2, 25, 12, 0, 10, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20T00:00:37", "TIMESYS": "TAI"}, datetime(2026, 11, 20, tzinfo=UTC)),
        ({"DATE-OBS": "2026-11-20"}, None),
        ({"DATE-OBS": "2026-13-45T00:00:00"}, None),
        ({"DATE-OBS": "1970-01-01T00:00:00"}, None),
        ({"DATE-OBS": "yesterday"}, None),
        ({"DATE-OBS": 12}, None),
        ({}, None),
    ],
)
def test_mid_exposure_from_odd_forms(cards: Header, expected: datetime | None) -> None:
    assert mid_exposure_from_header(cards) == expected


@pytest.mark.parametrize(
    ("value", "expected"), [(5, 5.0), ("2.5", 2.5), (-1, None), ("long", None), (True, None)]
)
def test_exposures(value: str | int | float | bool, expected: float | None) -> None:
    assert exposure_s_from_header({"EXPTIME": value}) == expected


KEYS = [
    "RA",
    "DEC",
    "OBJCTRA",
    "CRVAL1",
    "CTYPE1",
    "CD1_1",
    "FOCALLEN",
    "XPIXSZ",
    "DATE-OBS",
    "MJD-OBS",
    "EXPTIME",
]
TEXTS = st.text(alphabet="0123456789:-+.TZ RADEC", max_size=20)


@given(st.dictionaries(st.sampled_from(KEYS), st.one_of(TEXTS, st.floats(), st.integers(), st.booleans())))
def test_no_header_makes_reading_fail(cards: Header) -> None:
    hint_from_header(cards, 10, 10)
    mid_exposure_from_header(cards)
