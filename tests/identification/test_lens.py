"""The lens of a wide frame: its polynomial, and its FITS cards as astropy reads them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from astropy.io.fits import Header
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.identification.lens import MOST_TERMS, Lens
from mountnav.identification.wcs import plate_from_cards
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs import icrs_at_pixel, places_at_pixels, zpn_pixels
from mountnav.sky.wcs_numbers import linear_cards, touching_cards, wcs_numbers

PROJECTIONS = {
    "gnomonic": (math.tan, 35.0),
    "equidistant": (lambda away: away, 90.0),
    "equisolid": (lambda away: 2 * math.sin(away / 2), 90.0),
    "stereographic": (lambda away: 2 * math.tan(away / 2), 90.0),
}


def lens(
    terms: tuple[float, ...] = (), scale_arcsec: float = 300.0, dec_deg: float = 20.0, mirrored: bool = False
) -> Lens:
    """An 1800 × 1200 px lens, its axis a little off the center."""
    turn = 0.5
    matrix = (
        206264.8
        / scale_arcsec
        * np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    )
    if not mirrored:
        matrix[0] *= -1.0
    padded = np.zeros(MOST_TERMS)
    padded[: len(terms)] = terms
    return Lens(Icrs(80.0, dec_deg), 903.7, 590.1, matrix, padded, 1800, 1200)


def _read_by_astropy(cards: dict[str, str | int | float]) -> WCS:
    header = Header()
    for key, value in cards.items():
        header[key] = value
    return WCS(header, relax=True)


@pytest.mark.parametrize("name", PROJECTIONS)
def test_the_polynomial_meets_each_projection(name: str) -> None:
    projected, most_deg = PROJECTIONS[name]
    away = np.linspace(0.001, math.radians(most_deg), 400)
    wanted = np.array([projected(one) for one in away])
    rows = np.column_stack([away ** (2 * number + 3) for number in range(MOST_TERMS)])
    terms = np.linalg.lstsq(rows, wanted - away, rcond=None)[0]
    off = lens(tuple(terms)).radius(away) - wanted
    assert np.abs(off).max() * 1000.0 < 0.02  # px, of a focal length of 1,000


@settings(max_examples=15, deadline=None)
@given(
    st.tuples(st.floats(-0.05, 0.1), st.floats(-0.01, 0.01)),
    st.floats(60.0, 300.0),
    st.sampled_from((-90.0, -89.9, 0.0, 47.0, 89.99)),
    st.booleans(),
)
def test_wcslib_has_the_same_lens(
    terms: tuple[float, float], scale_arcsec: float, dec_deg: float, mirrored: bool
) -> None:
    one = lens(terms, scale_arcsec, dec_deg, mirrored)
    cards = one.zpn_cards()
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 1799, 40), rng.uniform(0, 1199, 40)
    ra, dec = places_at_pixels(cards, x, y)
    for back in (
        one.pixels(ra, dec),
        zpn_pixels(cards, ra, dec),
        _read_by_astropy(cards).wcs_world2pix(ra, dec, 0),
    ):
        assert np.hypot(back[0] - x, back[1] - y).max() < 1e-6


def test_a_narrow_lens_is_told_as_sip_and_a_wide_one_as_zpn() -> None:
    narrow, wide = lens((0.0, 0.0), 80.0), lens((0.0, 0.0), 300.0)
    cards = narrow.cards()
    assert cards["CTYPE1"] == "RA---TAN-SIP"
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(0, 1799, 30), np.linspace(0, 1199, 30)))
    for ra, dec in (places_at_pixels(cards, x, y), _read_by_astropy(cards).all_pix2world(x, y, 0)):
        back_x, back_y = narrow.pixels(ra, dec)
        assert np.hypot(back_x - x, back_y - y).max() < 0.11
    assert wide.cards()["CTYPE1"] == "RA---ZPN"


def test_where_a_lens_shows_no_sky_no_position_is_made_up() -> None:
    one = lens((-0.2,), 300.0)  # turns back at 74°
    cards = one.zpn_cards()
    ra, _ = places_at_pixels(cards, np.array([903.0, -3000.0]), np.array([590.0, -3000.0]))
    assert np.isfinite(ra).tolist() == [True, False]
    with pytest.raises(BadRequest, match="no sky"):
        icrs_at_pixel(cards, -3000.0, -3000.0)
    with pytest.raises(BadRequest, match="no polynomial plate"):
        plate_from_cards(cards, width_px=1800, height_px=1200)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_plain_plate_touches_the_lens_at_the_frames_center(mirrored: bool) -> None:
    one = lens((0.08,), 300.0, mirrored=mirrored)
    cards = one.zpn_cards()
    plain = touching_cards(cards)
    assert plain == linear_cards(cards)
    assert plain["CTYPE1"] == "RA---TAN"
    assert (plain["CRPIX1"], plain["CRPIX2"]) == (900.5, 600.5)
    center = one.place(899.5, 599.5)
    for x, y, within_px in ((899.5, 599.5, 1e-6), (904.5, 596.5, 0.01)):
        off = separation_arcsec(icrs_at_pixel(plain, x, y), icrs_at_pixel(cards, x, y))
        assert off < within_px * 300.0
    numbers = wcs_numbers(cards)
    assert separation_arcsec(Icrs(numbers.ra_deg, numbers.dec_deg), center) < 1e-3
    assert numbers.determinant_sign == (1 if mirrored else -1)
    assert numbers.pixscale_arcsec == pytest.approx(300.0, rel=0.01)
    assert 60.0 < numbers.radius_deg < 110.0
