"""A second exposure drawn out beside a few stars, in no bin above the noise, is told by its common share."""

from __future__ import annotations

import numpy as np
import pytest

from mountnav.identification.drawn_out_exposure import drawn_out_exposure
from mountnav.identification.faint_exposure import FaintExposure
from mountnav.measuring.segmentation import segment_light
from mountnav.measuring.star_trail import in_bins

SIDE, SKY_ADU, NOISE_ADU, SIGMA_PX = 700, 500.0, 10.0, 1.2
LIGHT = np.array([9_000.0, 2_400.0, 2_200.0, 1_800.0, 1_600.0, 1_200.0, 1_100.0, 900.0, 800.0, 800.0])
"""Of the stars, ADU: one is four times as bright as the next one."""
OFFSET, LENGTH_PX = complex(26.0, 14.0), 30.0

Light = list[tuple[complex, float]]


def _trail(middle: complex, length_px: float, share: float) -> Light:
    """Even light along a line, 40 points of it."""
    return [(middle + step * length_px * np.exp(-0.5j), share / 40.0) for step in np.linspace(-0.5, 0.5, 40)]


def _found(
    light: Light, *, strangers: Light | None = None, seed: int = 1, stars: int = LIGHT.size
) -> FaintExposure | None:
    """What is found where the stars have that light besides; strangers lie about the brightest one."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(70, SIDE - 70, (2, LIGHT.size))
    pixels = rng.normal(SKY_ADU, NOISE_ADU, (SIDE, SIDE))
    rows, columns = np.mgrid[0:SIDE, 0:SIDE]

    def add(at: complex, flux: float) -> None:
        left, top = round(at.real), round(at.imag)
        box = (slice(max(0, top - 8), max(0, top + 9)), slice(max(0, left - 8), max(0, left + 9)))
        away2 = (columns[box] - at.real) ** 2 + (rows[box] - at.imag) ** 2
        pixels[box] += flux / (2.0 * np.pi * SIGMA_PX**2) * np.exp(-0.5 * away2 / SIGMA_PX**2)

    for place, flux in zip(x + 1j * y, LIGHT, strict=True):
        add(place, flux)
        for offset, share in light:
            add(place + offset, share * flux)
    for offset, flux in strangers or []:
        add(complex(x[0], y[0]) + offset, flux)
    bins = in_bins(pixels)
    patches = segment_light(pixels, bins[0])
    return drawn_out_exposure(bins, patches, x[:stars], y[:stars], LIGHT[:stars], 2.8, least_pull_px=0.75)


@pytest.mark.parametrize("seed", [1, *(pytest.param(one, marks=pytest.mark.long) for one in range(2, 8))])
def test_a_third_of_the_light_drawn_out_beside_few_stars_is_found(seed: int) -> None:
    found = _found(_trail(OFFSET, LENGTH_PX, 0.35), seed=seed)
    assert found is not None
    assert abs(found.offset_px - OFFSET) < 14.0
    assert 0.1 < found.share < 0.6
    assert found.stars >= 5


@pytest.mark.parametrize("seed", [1, *(pytest.param(one, marks=pytest.mark.long) for one in range(2, 16))])
def test_points_have_none(seed: int) -> None:
    assert _found([], seed=seed) is None


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 6))
def test_a_galaxy_beside_the_brightest_star_is_none(seed: int) -> None:
    # as bright and as long as that star's second image would be; the others have none
    galaxy = [(at, share * 9_000.0) for at, share in _trail(OFFSET, LENGTH_PX, 0.35)]
    assert _found([], strangers=galaxy, seed=seed) is None


@pytest.mark.long
@pytest.mark.parametrize("seed", range(1, 6))
def test_spikes_on_both_sides_are_none(seed: int) -> None:
    spikes = [*_trail(OFFSET, LENGTH_PX, 0.3), *_trail(-OFFSET, LENGTH_PX, 0.3)]
    assert _found(spikes, seed=seed) is None


def test_too_few_stars_tell_nothing() -> None:
    assert _found(_trail(OFFSET, LENGTH_PX, 0.35), stars=3) is None
