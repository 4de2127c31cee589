"""A second exposure whose images are too faint to be seen one by one is found by the sum of their light."""

from __future__ import annotations

import numpy as np
import pytest

from mountnav.identification.double_exposure import unexplained_light
from mountnav.identification.faint_exposure import FaintExposure, faint_exposure
from mountnav.measuring.segmentation import segment_light
from mountnav.measuring.star_trail import in_bins

SIDE, SKY_ADU, NOISE_ADU, SIGMA_PX = 900, 500.0, 10.0, 1.4
OFFSET = complex(120.0, -70.0)
LIGHT = np.geomspace(60_000.0, 4_000.0, 14)
"""Of the stars, ADU: the second image of the first two or three is a patch of its own, those of the others
are lost in the noise."""


def _found(
    share: float, *, trail_px: float = 30.0, strangers: int = 0, seed: int = 1, least_pull_px: float = 1.0
) -> FaintExposure | None:
    """What is found in a frame of fourteen stars that fell a second time, drawn out."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(80, SIDE - 80, (2, LIGHT.size))
    pixels = rng.normal(SKY_ADU, NOISE_ADU, (SIDE, SIDE))
    rows, columns = np.mgrid[0:SIDE, 0:SIDE]

    def add(at: complex, light: float) -> None:
        left, top = round(at.real), round(at.imag)
        box = (slice(max(0, top - 9), max(0, top + 10)), slice(max(0, left - 9), max(0, left + 10)))
        away2 = (columns[box] - at.real) ** 2 + (rows[box] - at.imag) ** 2
        pixels[box] += light / (2.0 * np.pi * SIGMA_PX**2) * np.exp(-0.5 * away2 / SIGMA_PX**2)

    for place, light in zip(x + 1j * y, LIGHT, strict=True):
        add(place, light)
        for step in np.linspace(-0.5, 0.5, 30):
            add(place + OFFSET + step * trail_px * np.exp(0.4j), share * light / 30.0)
    for place in rng.uniform(20, SIDE - 20, (2, strangers)).T:
        add(complex(*place), float(rng.uniform(3_000.0, 20_000.0)))
    bins = in_bins(pixels)
    patches = segment_light(pixels, bins[0])
    left = unexplained_light(patches, x, y, LIGHT)
    if left is None:
        return None
    return faint_exposure(bins, patches, x, y, left, least_pull_px=least_pull_px)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("share", [0.15, 0.3])
def test_a_faint_second_exposure_is_found_where_it_is(seed: int, share: float) -> None:
    found = _found(share, seed=seed)
    assert found is not None
    assert abs(found.offset_px - OFFSET) < 12.0
    assert share / 1.5 < found.share < share * 1.5
    assert found.pull_px == pytest.approx(abs(OFFSET) * share / (1.0 + share), rel=0.4)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(40))
@pytest.mark.parametrize("strangers", [0, 3, 25])
def test_strangers_are_no_second_exposure(seed: int, strangers: int) -> None:
    # galaxies, planets, stars that the catalog lacks
    assert _found(0.0, strangers=strangers, seed=100 + seed) is None


def test_one_that_moves_the_middle_by_less_than_matters_is_left_alone() -> None:
    assert _found(0.2, seed=3, least_pull_px=60.0) is None
