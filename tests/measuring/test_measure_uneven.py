"""Moonlight, vignetting, amplifier glow and nebulae neither make stars nor lose them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import KDTree

from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from tests.measuring.painted import Array, as_frame, painted, scattered
from tests.short_part import one_in

SIZE = (800, 800)
NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)


NAMES = ("flat", "gradient", "moonlight", "vignetting", "amplifier glow", "nebula")


@cache
def skies() -> dict[str, Array]:
    """Electrons of sky per pixel; all have the same at the faintest position."""
    row, column = np.indices(SIZE) / 800.0
    grain = ndimage.gaussian_filter(np.random.default_rng(81).normal(size=SIZE), 60.0)
    return {
        "flat": np.full(SIZE, 200.0),
        "gradient": 200.0 + 300.0 * column,
        "moonlight": 200.0 + 1500.0 * np.exp(-np.hypot(row + 0.1, column + 0.1) / 0.5),
        "vignetting": 400.0 * (1.0 - 0.5 * ((row - 0.5) ** 2 + (column - 0.5) ** 2) / 0.5),
        "amplifier glow": 200.0 + 6000.0 * np.exp(-np.hypot(1.0 - row, 1.0 - column) / 0.06),
        "nebula": 200.0 + 300.0 * np.maximum(grain / grain.std(), 0.0),
    }


def test_the_names_are_those_of_the_skies() -> None:
    assert tuple(skies()) == NAMES


@pytest.mark.long
@pytest.mark.parametrize("name", one_in(2, NAMES))
def test_stars_are_neither_made_nor_lost(name: str) -> None:
    sky = skies()[name]
    x, y = scattered(196, SIZE, seed=82)
    local = sky[np.rint(y).astype(int), np.rint(x).astype(int)]
    # every star stands 12 σ above its own sky
    electrons = 12.0 * np.sqrt(local + 25.0) * 3.0 * 1.7
    found = measure(as_frame(painted(x, y, electrons, fwhm_px=3.0, size=SIZE, sky=sky, seed=83)))
    real = (found.flags & NO_STAR) == 0
    distance, index = KDTree(np.c_[found.x_px, found.y_px]).query(np.c_[x, y])
    complete = float(((distance < 1.5) & real[index]).mean())
    far, _ = KDTree(np.c_[x, y]).query(np.c_[found.x_px, found.y_px][real])
    false = int(np.sum(far > 3.0))
    print(f"\n{name}: {complete:.1%} complete, {false} false of {real.sum()}")
    assert complete >= 0.95
    assert false <= 6
