"""The plate gives an exact polynomial back, and its cards mean to astropy what they mean to us."""

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.identification.plate import Plate, fit_plate, powers, similarity_plate
from mountnav.identification.wcs import wcs_cards
from mountnav.sky.coordinates import Icrs
from mountnav.solution import icrs_at_pixel, places_at_pixels

WIDTH, HEIGHT = 1200, 800


def plate_of(degree, *, ra=123.4, dec=-35.0, rotation_deg=33.0, mirrored=False, scale=2.5, bend=3.0, seed=1):
    turn = scale * np.exp(1j * np.radians(rotation_deg))
    middle = complex((WIDTH - 1) / 2, (HEIGHT - 1) / 2 * (-1 if mirrored else 1))
    start = similarity_plate(
        Icrs(ra, dec), turn, -turn * middle, mirrored=mirrored, width_px=WIDTH, height_px=HEIGHT
    )
    rng = np.random.default_rng(seed)
    xi, eta = (np.zeros(len(powers(degree))) for _ in range(2))
    xi[:3], eta[:3] = start.xi, start.eta
    xi[3:], eta[3:] = rng.normal(0, bend, (2, xi.size - 3))
    return Plate(
        start.tangent, start.center_x_px, start.center_y_px, start.unit_px, degree, start.parity, xi, eta
    )


@given(st.integers(0, 3), st.floats(0, 360), st.booleans(), st.floats(0.3, 70), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_fit_recovers_an_exact_plate(degree, rotation_deg, mirrored, scale, seed):
    true = plate_of(degree, rotation_deg=rotation_deg, mirrored=mirrored, scale=scale, bend=scale, seed=seed)
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, WIDTH, 60), rng.uniform(0, HEIGHT, 60)
    xi, eta = true.tangential(x, y)
    got = fit_plate(true, x, y, xi, eta, rng.uniform(0.1, 1, 60), degree)
    assert np.allclose(got.xi, true.xi, atol=1e-6 * scale * WIDTH)
    assert np.allclose(got.eta, true.eta, atol=1e-6 * scale * WIDTH)
    assert got.parity == true.parity
    assert got.scale_arcsec_px() == pytest.approx(true.scale_arcsec_px())
    back_x, back_y = got.pixels(xi, eta)
    assert np.allclose(back_x, x, atol=1e-5)
    assert np.allclose(back_y, y, atol=1e-5)


@pytest.mark.long
@given(st.integers(0, 3), st.floats(0, 359.9), st.floats(-89.5, 89.5), st.booleans())
@settings(max_examples=60, deadline=None)
def test_cards_mean_the_same_to_astropy(degree, ra, dec, mirrored):
    plate = plate_of(degree, ra=ra, dec=dec, mirrored=mirrored)
    cards = wcs_cards(plate, width_px=WIDTH, height_px=HEIGHT)
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(0, WIDTH - 1, 7), np.linspace(0, HEIGHT - 1, 5)))
    header = fits.Header()
    for key, value in cards.items():
        header[key] = value
    theirs = np.radians(WCS(header).all_pix2world(x, y, 0))
    ours = np.radians(places_at_pixels(cards, x, y))
    off = np.hypot((theirs[0] - ours[0] + np.pi) % (2 * np.pi) - np.pi, 0) * np.cos(ours[1])
    assert np.degrees(np.hypot(off, theirs[1] - ours[1])).max() * 3600 < 1e-6
    back = WCS(header).all_world2pix(*np.degrees(theirs), 0, tolerance=1e-6)
    assert np.allclose(back, (x, y), atol=1e-3)
    if degree > 1:  # the inverse polynomials AP and BP alone
        focal = WCS(header).wcs_world2pix(*np.degrees(theirs), 0)
        u, v = focal[0] - (WIDTH - 1) / 2, focal[1] - (HEIGHT - 1) / 2
        add = [sum(cards[f"{k}_{i}_{j}"] * u**i * v**j for i, j in powers(degree + 1)) for k in ("AP", "BP")]
        assert np.allclose((focal[0] + add[0], focal[1] + add[1]), (x, y), atol=0.05)


@pytest.mark.parametrize("degree", [1, 3])
@pytest.mark.parametrize("dec", [-89.9, 89.9])
@pytest.mark.parametrize("ra", [0.0, 359.9999, 180.0])
def test_cards_hold_at_the_poles_and_across_the_seam(degree, ra, dec):
    plate = plate_of(degree, ra=ra, dec=dec)
    header = fits.Header()
    for key, value in wcs_cards(plate, width_px=WIDTH, height_px=HEIGHT).items():
        header[key] = value
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(0, WIDTH - 1, 7), np.linspace(0, HEIGHT - 1, 5)))
    theirs = WCS(header).all_pix2world(x, y, 0)
    ours = plate.pixels(*plate.project(*theirs))
    assert np.allclose(ours, (x, y), atol=1e-4)
    assert np.allclose(WCS(header).all_world2pix(*theirs, 0, tolerance=1e-6), (x, y), atol=1e-3)


def test_center_rotation_and_parity_are_those_of_the_drawing():
    # the sky as seen: x right is west, y up is north
    seen = plate_of(1, rotation_deg=180, mirrored=True, scale=2.0)
    assert seen.matrix()[0, 0] < 0 < seen.matrix()[1, 1]
    assert seen.parity == 1
    assert seen.rotation_deg() == pytest.approx(0, abs=1e-9)
    mirror = plate_of(1, rotation_deg=0, mirrored=False, scale=2.0)
    assert mirror.parity == -1
    assert mirror.rotation_deg() == pytest.approx(0, abs=1e-9)
    cards = wcs_cards(seen, width_px=WIDTH, height_px=HEIGHT)
    center = icrs_at_pixel(cards, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    assert center.ra_deg == pytest.approx(123.4)
    assert center.dec_deg == pytest.approx(-35.0)
    assert icrs_at_pixel(cards, 0.0, (HEIGHT - 1) / 2).ra_deg > center.ra_deg
    assert icrs_at_pixel(cards, (WIDTH - 1) / 2, HEIGHT - 1.0).dec_deg > center.dec_deg


def test_cards_that_are_none_are_refused():
    with pytest.raises(BadRequest, match="CTYPE1"):
        icrs_at_pixel({"CTYPE1": "RA---SIN"}, 0, 0)
    with pytest.raises(BadRequest, match="CRPIX1"):
        icrs_at_pixel({"CTYPE1": "RA---TAN"}, 0, 0)
