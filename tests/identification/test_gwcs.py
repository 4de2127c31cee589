"""GWCS of plates and lenses, written as ASDF and read again, beside wcslib by astropy with the FITS cards."""

from __future__ import annotations

import io
import math
import warnings

import numpy as np
import pytest
from astropy.wcs import WCS, FITSFixedWarning

from mountnav.errors import BadRequest
from mountnav.identification.gwcs import asdf_bytes, gwcs_of
from mountnav.identification.lens import Lens
from mountnav.identification.plate import Plate, powers
from mountnav.identification.wcs import Cards, wcs_cards
from mountnav.sky.coordinates import Icrs

asdf = pytest.importorskip("asdf", reason="the extra gwcs isn't installed")
pytest.importorskip("gwcs", reason="the extra gwcs isn't installed")

WITHIN_PX = 1e-6


def _bent(degree: int, parity: int) -> Cards:
    """A frame of 5° that is bent by some pixels."""
    rng = np.random.default_rng(degree)
    unit, scale = 1500.0, 6.0
    xi, eta = (rng.normal(0.0, 5.0, len(powers(degree))) for _ in range(2))
    linear = (
        scale
        * unit
        * np.array([[-parity * math.cos(0.4), math.sin(0.4)], [parity * math.sin(0.4), math.cos(0.4)]])
    )
    for at, (i, j) in enumerate(powers(degree)):
        if i + j == 0:
            xi[at] = eta[at] = 0.0
        elif i + j == 1:
            xi[at], eta[at] = linear[:, j]
    plate = Plate(Icrs(359.9, 71.0), 1499.5, 999.5, unit, degree, parity, xi, eta)
    return wcs_cards(plate, width_px=3000, height_px=2000)


def _all_sky(terms: tuple[float, ...], edge_deg: float) -> Cards:
    """A lens whose image circle has its edge at the longer side's ends."""
    width, height = 2400, 1800
    lens = Lens(Icrs(212.0, 40.0), 1210.0, 880.0, np.eye(2), np.array(terms), width, height)
    scale = 0.5 * width / float(lens.radius(np.array([math.radians(edge_deg)]))[0])
    matrix = scale * np.array([[math.cos(1.0), math.sin(1.0)], [-math.sin(1.0), math.cos(1.0)]])
    return Lens(lens.axis, lens.axis_x_px, lens.axis_y_px, matrix, lens.terms, width, height).zpn_cards()


EQUISOLID = (-1 / 24, 1 / 1920)
STEREOGRAPHIC = (1 / 12, 1 / 120, 17 / 20160)
BENT = (-0.08, 0.004, -0.002, 0.0001)

CARDS = {
    "TAN": _bent(1, 1),
    "SIP of 3": _bent(3, -1),
    "SIP of 5": _bent(5, 1),
    "equisolid, 75°": _all_sky(EQUISOLID, 75.0),
    "equisolid, 90°": _all_sky(EQUISOLID, 90.0),
    "stereographic, 80°": _all_sky(STEREOGRAPHIC, 80.0),
    "bent, 70°": _all_sky(BENT, 70.0),
}


@pytest.mark.parametrize("name", CARDS)
def test_pixels_lie_where_wcslib_has_them_and_come_back(name: str) -> None:
    cards = CARDS[name]
    with asdf.open(io.BytesIO(asdf_bytes(cards, {"file": "a.fits"}))) as opened:
        wcs = opened["wcs"]
        assert opened["mountnav"]["file"] == "a.fits"
        x, y = (
            side.ravel()
            for side in np.meshgrid(
                *(np.linspace(0, float(cards[side]) - 1, 25) for side in ("IMAGEW", "IMAGEH"))
            )
        )
        ra, dec = wcs(x, y)
        shown = np.isfinite(ra)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FITSFixedWarning)
            by_wcslib = WCS(cards)
        assert shown.mean() > 0.9
        to_pixels = by_wcslib.all_world2pix if "SIP" in name else by_wcslib.wcs_world2pix
        more = {"tolerance": 1e-9, "maxiter": 50} if "SIP" in name else {}
        at = np.array(to_pixels(ra[shown], dec[shown], 0, **more))
        assert np.abs(at - (x[shown], y[shown])).max() < WITHIN_PX
        back = np.array(wcs.invert(ra[shown], dec[shown], with_bounding_box=False))
        assert np.abs(back - (x[shown], y[shown])).max() < (0.05 if "SIP" in name else WITHIN_PX)


def test_where_a_lens_shows_no_sky_there_is_no_position() -> None:
    cards = _all_sky(BENT, 70.0)
    # four times the field on the same pixels: the corners lie beyond where the lens turns back
    wide = cards | {name: 4.0 * float(cards[name]) for name in cards if name.startswith("CD")}
    told = np.array(gwcs_of(wide)([0.0, 1200.0], [0.0, 880.0]))
    assert np.isnan(told[:, 0]).all()
    assert np.isfinite(told[:, 1]).all()


def test_cards_of_another_projection_are_refused() -> None:
    with pytest.raises(BadRequest, match="RA---SIN"):
        gwcs_of(CARDS["TAN"] | {"CTYPE1": "RA---SIN"})
