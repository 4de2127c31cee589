"""SIP cards as TPV cards: the same places, by astropy."""

from __future__ import annotations

import numpy as np
import pytest
from astropy.wcs import WCS

from mountnav.errors import BadRequest
from mountnav.identification.tpv import tpv_cards


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
def test_the_places_are_the_same(degree: int) -> None:
    rng = np.random.default_rng(degree)
    cards: dict[str, str | int | float] = {
        "CTYPE1": "RA---TAN-SIP",
        "CTYPE2": "DEC--TAN-SIP",
        "CUNIT1": "deg",
        "CUNIT2": "deg",
        "CRPIX1": 500.5,
        "CRPIX2": 400.5,
        "CRVAL1": 83.2,
        "CRVAL2": -61.4,
        "RADESYS": "ICRS",
        "CD1_1": -1.2e-3,
        "CD1_2": 7e-4,
        "CD2_1": 6.5e-4,
        "CD2_2": 1.3e-3,
    }
    if degree == 1:
        cards |= {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN"}
    else:
        for name in "AB":
            cards[f"{name}_ORDER"] = degree
            for i in range(degree + 1):
                for j in range(degree + 1 - i):
                    if i + j > 1:
                        cards[f"{name}_{i}_{j}"] = float(rng.uniform(-5, 5) / 500.0 ** (i + j))
    found = tpv_cards(cards)
    x, y = rng.uniform(0, [[1000], [800]], (2, 200))
    wanted = WCS(cards).all_pix2world(x, y, 0)
    given = WCS(found).all_pix2world(x, y, 0)
    assert np.abs(np.subtract(given, wanted)).max() * 3600 < 1e-6
    assert not any(name.startswith(("A_", "B_", "AP_", "BP_")) for name in found)


def test_other_projections_are_left_alone() -> None:
    with pytest.raises(BadRequest, match="RA---SIN"):
        tpv_cards({"CTYPE1": "RA---SIN"})
