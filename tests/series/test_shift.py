"""A plate moved over the sky: exact where a shift in pixels is not."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from astropy.wcs import WCS
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.identification.plate import Plate, fit_plate, similarity_plate
from mountnav.identification.wcs import plate_from_cards, wcs_cards
from mountnav.series.shift import icrs_at_pixels, move_plate, pixels_at_icrs, turn_plate
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

W, H = 1500, 1000


def plate_at(center: Icrs, *, scale: float = 3.5, angle_deg: float = 20.0, mirrored: bool = False) -> Plate:
    """A cubic plate with some distortion."""
    turn = scale * np.exp(1j * math.radians(angle_deg))
    flat = similarity_plate(center, complex(turn), 0j, mirrored=mirrored, width_px=W, height_px=H)
    flat = flat.moved_to(flat.center())
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(0, W, 15), np.linspace(0, H, 15)))
    u, v = x - flat.center_x_px, y - flat.center_y_px
    stretch = 1 + 4e-9 * (u * u + v * v)
    xi, eta = flat.tangential(flat.center_x_px + u * stretch, flat.center_y_px + v * stretch)
    return fit_plate(flat, x, y, xi, eta, np.ones(x.size), 3)


@pytest.mark.parametrize("mirrored", [False, True])
def test_plate_from_cards_is_the_plate_and_astropy_agrees(mirrored: bool) -> None:
    plate = plate_at(Icrs(83.0, 21.0), mirrored=mirrored)
    cards = wcs_cards(plate, width_px=W, height_px=H)
    again = plate_from_cards(cards, width_px=W, height_px=H)
    x, y = np.array([0.0, 700.3, 1499.0]), np.array([999.0, 12.5, 500.0])
    assert np.allclose(again.tangential(x, y), plate.tangential(x, y), atol=1e-6)
    assert again.parity == plate.parity
    ra, dec = icrs_at_pixels(again, x, y)
    assert np.allclose(
        np.column_stack((ra, dec)), WCS(cards).all_pix2world(np.column_stack((x, y)), 0), atol=1e-9
    )
    assert np.allclose(pixels_at_icrs(again, ra, dec), (x, y), atol=1e-4)


def test_cards_of_another_frame_are_refused() -> None:
    cards = wcs_cards(plate_at(Icrs(83.0, 21.0)), width_px=W, height_px=H)
    with pytest.raises(BadRequest, match="center"):
        plate_from_cards(cards, width_px=W // 2, height_px=H)
    with pytest.raises(BadRequest, match="CD2_1"):
        plate_from_cards({k: v for k, v in cards.items() if k != "CD2_1"}, width_px=W, height_px=H)


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0, 359.99),
    st.floats(-85, 85),
    st.floats(-0.4, 0.4),
    st.floats(-0.4, 0.4),
    st.booleans(),
)
def test_exact_for_any_move_on_a_wide_distorted_field(ra, dec, across, along, mirrored) -> None:
    old = plate_at(Icrs(ra, dec), scale=10.0, mirrored=mirrored)
    x, y = np.array([across * W + old.center_x_px]), np.array([along * H + old.center_y_px])
    new_ra, new_dec = icrs_at_pixels(old, x, y)
    center = Icrs(float(new_ra[0]), float(new_dec[0]))
    new = replace(old, tangent=center)
    rng = np.random.default_rng(1)
    seen_x, seen_y = rng.uniform(0, W, 40), rng.uniform(0, H, 40)
    sky = icrs_at_pixels(new, seen_x, seen_y)
    move = move_plate(old, *sky, seen_x, seen_y, np.full(40, 400.0))
    assert separation_arcsec(move.center, center) < 1e-3
    assert (move.dx_px, move.dy_px) == pytest.approx((across * W, along * H), abs=1e-3)
    assert move.trend_px < 1e-3
    assert move.rms_arcsec < 1e-3


def test_a_turned_and_stretched_field_is_seen_and_taken_up() -> None:
    old = plate_at(Icrs(150.0, 40.0))
    angle, stretch = math.radians(0.3), 1.0005
    w = (old.xi + 1j * old.eta) * stretch * np.exp(-1j * angle)
    turned_plate = replace(old, tangent=Icrs(150.05, 40.02), xi=w.real, eta=w.imag)
    rng = np.random.default_rng(2)
    x, y = rng.uniform(0, W, 80), rng.uniform(0, H, 80)
    sky = icrs_at_pixels(turned_plate, x, y)
    x, y = x + rng.normal(0, 0.05, 80), y + rng.normal(0, 0.05, 80)
    weight = np.full(80, 400.0)
    move = move_plate(old, *sky, x, y, weight)
    assert move.turn_deg == pytest.approx(0.3, abs=0.01)
    assert move.stretch == pytest.approx(0.0005, abs=1e-4)
    assert move.trend_px == pytest.approx(
        math.hypot(W, H) / 2 * abs(stretch * np.exp(1j * angle) - 1), rel=0.05
    )
    assert move.trend_sigma > 50
    again = turn_plate(move, old, *sky, x, y, weight)
    assert separation_arcsec(again.center, turned_plate.tangent) < 0.1
    assert (again.plate.rotation_deg() - old.rotation_deg()) == pytest.approx(0.3, abs=0.01)


def test_noise_alone_is_no_trend() -> None:
    old = plate_at(Icrs(150.0, 40.0))
    rng = np.random.default_rng(3)
    significance = []
    for _ in range(200):
        x, y = rng.uniform(0, W, 50), rng.uniform(0, H, 50)
        sky = icrs_at_pixels(old, x, y)
        move = move_plate(
            old, *sky, x + rng.normal(0, 0.05, 50), y + rng.normal(0, 0.05, 50), np.full(50, 400.0)
        )
        significance.append(move.trend_sigma)
    # two normal deviates in quadrature: median 1.18
    assert 0.9 < np.median(significance) < 1.5
    assert max(significance) < 5
