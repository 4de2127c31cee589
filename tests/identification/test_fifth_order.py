"""The fifth order beside a cubic plate: lenses of known laws, whose cubic plate isn't enough."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from mountnav.identification.fifth_order import LEAST_PAIRS, fifth_order
from mountnav.identification.plate import CUBIC, Plate, powers, products
from mountnav.identification.wcs import plate_from_cards, wcs_cards
from mountnav.sky.coordinates import Icrs
from mountnav.sky.wcs import places_at_pixels
from mountnav.units import ARCSEC_PER_RAD

Array = NDArray[np.float64]

WIDTH_PX, HEIGHT_PX = 3948, 2764
UNIT_PX = WIDTH_PX / 2
SCALE_RAD = 9.0 / ARCSEC_PER_RAD
TURN = np.exp(0.7j)


def third_order(k: float) -> Callable[[Array], Array]:
    """Tangents of radii, in tangents at the half frame: the inverse of r (1 + k r²)."""

    def tangent(radius: Array) -> Array:
        ideal = radius.copy()
        for _ in range(60):
            ideal = radius / (1 + k * ideal**2)
        return ideal

    return tangent


LENSES = {
    "barrel": third_order(-0.003),
    "cushion": third_order(0.003),
    # a half frame is UNIT_PX * SCALE_RAD focal lengths
    "equidistant": lambda r: np.tan(r * UNIT_PX * SCALE_RAD) / (UNIT_PX * SCALE_RAD),
    "equisolid": lambda r: np.tan(2 * np.arcsin(r * UNIT_PX * SCALE_RAD / 2)) / (UNIT_PX * SCALE_RAD),
    "stereographic": lambda r: np.tan(2 * np.arctan(r * UNIT_PX * SCALE_RAD / 2)) / (UNIT_PX * SCALE_RAD),
}


def sky(lens: Callable[[Array], Array], x_px: Array, y_px: Array) -> tuple[Array, Array]:
    """True tangential coordinates of pixels, arcsec."""
    z = (x_px - (WIDTH_PX - 1) / 2 + 1j * (y_px - (HEIGHT_PX - 1) / 2)) / UNIT_PX
    radius = np.maximum(np.abs(z), 1e-9)
    w = -np.conj(z * lens(radius) / radius * TURN) * UNIT_PX * SCALE_RAD * ARCSEC_PER_RAD
    return w.real, w.imag


def cubic(x: Array, y: Array, xi: Array, eta: Array, sigma: Array) -> Plate:
    """The best cubic plate of pairs."""
    middle = ((WIDTH_PX - 1) / 2, (HEIGHT_PX - 1) / 2)
    rows = products((x - middle[0]) / UNIT_PX, (y - middle[1]) / UNIT_PX, CUBIC) / sigma
    got = np.linalg.lstsq(rows.T, np.column_stack((xi, eta)) / sigma[:, None], rcond=None)[0].T
    return Plate(Icrs(40.0, 20.0), *middle, UNIT_PX, CUBIC, 1, got[0], got[1])


def fitted(name: str, number: int, sigma_px: float, seed: int = 1) -> tuple[Plate, Plate | None]:
    """A cubic plate of drawn pairs, and what came of it."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, WIDTH_PX, number), rng.uniform(0, HEIGHT_PX, number)
    xi, eta = sky(LENSES[name], x, y)
    # errors between a fifth of the largest and that, as bright and faint stars have
    sigma = sigma_px * rng.uniform(0.2, 1.0, number)
    x, y = x + sigma * rng.normal(size=number), y + sigma * rng.normal(size=number)
    sigma_arcsec = sigma * SCALE_RAD * ARCSEC_PER_RAD
    plate = cubic(x, y, xi, eta, sigma_arcsec)
    got_xi, got_eta = plate.tangential(x, y)
    found = fifth_order(plate, x, y, got_xi - xi, got_eta - eta, sigma_arcsec)
    if found is not None:
        assert found.leverage.shape == (number,)
        assert 0.0 <= found.leverage.sum() <= 0.5 + 1e-9
        assert np.linalg.eigvalsh(found.center_covariance_arcsec2).min() >= -1e-12
    return plate, None if found is None else found.plate


def error_px(name: str, plate: Plate) -> tuple[float, float]:
    """Root mean square over the whole frame, and the worst point."""
    x, y = (
        side.ravel()
        for side in np.meshgrid(np.linspace(0, WIDTH_PX - 1, 21), np.linspace(0, HEIGHT_PX - 1, 21))
    )
    xi, eta = sky(LENSES[name], x, y)
    got_xi, got_eta = plate.tangential(x, y)
    off = np.hypot(got_xi - xi, got_eta - eta) / (SCALE_RAD * ARCSEC_PER_RAD)
    return float(np.sqrt(np.mean(off**2))), float(off.max())


@pytest.mark.parametrize("name", LENSES)
def test_exact_pairs_of_any_lens_leave_a_tenth_of_a_cubics_error(name: str) -> None:
    plate, better = fitted(name, 400, 1e-5)
    assert better is not None
    before, after = error_px(name, plate), error_px(name, better)
    assert before[0] > 3e-4
    assert after[0] < 0.1 * before[0]
    assert after[1] < 0.1 * before[1]


@pytest.mark.parametrize("name", ["barrel", "cushion", "equisolid"])
def test_noise_doesnt_make_it_worse_than_a_cubic(name: str) -> None:
    errors = []
    for seed in range(20):
        plate, better = fitted(name, 600, 0.05, seed)
        errors.append((error_px(name, plate)[0], error_px(name, better or plate)[0]))
    before, after = np.sqrt(np.mean(np.square(errors), axis=0))
    assert after < 1.01 * before
    # and where the cubic's lack stands out of its noise, as of the third-order lenses here, it goes
    assert name == "equisolid" or after < 0.95 * before


def test_it_stays_out_where_it_is_nothing_or_pairs_are_few() -> None:
    LENSES["none"] = lambda r: r
    try:
        assert fitted("none", 800, 0.05)[1] is None
    finally:
        del LENSES["none"]
    assert fitted("barrel", LEAST_PAIRS - 1, 0.05)[1] is None
    better = fitted("barrel", 400, 1e-5)[1]
    assert better is not None
    x = np.linspace(0, 2000, 200)
    assert fifth_order(better, x, x, x, x, np.ones(200)) is None, "no cubic"


def test_the_cards_hold_it() -> None:
    better = fitted("barrel", 400, 1e-5)[1]
    assert better is not None
    cards = wcs_cards(better, width_px=WIDTH_PX, height_px=HEIGHT_PX)
    assert cards["A_ORDER"] == 5
    again = plate_from_cards(cards, width_px=WIDTH_PX, height_px=HEIGHT_PX)
    assert len(again.xi) == len(powers(5))
    x, y = np.array([0.0, 1973.5, WIDTH_PX - 1.0]), np.array([0.0, 1381.5, HEIGHT_PX - 1.0])
    ra, dec = places_at_pixels(cards, x, y)
    back = again.pixels(*again.project(ra, dec))
    assert back[0] == pytest.approx(x, abs=1e-5)
    assert back[1] == pytest.approx(y, abs=1e-5)
