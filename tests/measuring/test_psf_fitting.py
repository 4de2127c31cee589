"""Fits of the PSF to single stars, and the least squares of two non-negative unknowns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import nnls
from scipy.spatial import KDTree

from mountnav.measuring.cutouts import make_cutouts
from mountnav.measuring.measure import measure
from mountnav.measuring.psf import Psf
from mountnav.measuring.psf_fitting import fit_profiles, learn_psf, nonnegative_pair
from tests.measuring.painted import as_frame, painted, scattered, spots, star

SIGMA = 2.354820045


@pytest.mark.parametrize(("fwhm_px", "beta"), [(1.2, 0.0), (1.7, 0.0), (1.2, 3.0), (1.7, 3.0)])
def test_undersampled_stars_keep_their_place_wherever_they_fall_on_the_pixels(
    fwhm_px: float, beta: float
) -> None:
    count, side = 40, 33
    phase = np.random.default_rng(1).uniform(-0.5, 0.5, (count, 2))
    strip = np.zeros((side * count, side), dtype=np.float32)
    for k in range(count):
        strip[side * k : side * (k + 1)] = 1e5 * star(
            fwhm_px, beta, spots(), phase[k, 0], phase[k, 1], side // 2
        )
    row = side // 2 + side * np.arange(count)
    column = np.full(count, side // 2)
    cutouts = make_cutouts(
        strip,
        np.ones(strip.shape, dtype=bool),
        column.astype(float),
        row.astype(float),
        np.full(count, 8.0),
        4,
    )
    errors = {}
    for integrated in (False, True):
        psf = Psf(0.0 if beta == 0.0 else 1.0 / beta, 1.5, 0.0, integrated)
        fits = fit_profiles(
            cutouts,
            column.astype(np.float64),
            row.astype(np.float64),
            float(np.hypot(fwhm_px, 0.68)) / SIGMA,
            psf,
        )
        errors[integrated] = np.hypot(fits.x_px - column - phase[:, 0], fits.y_px - row - phase[:, 1]).max()
        if integrated:
            assert np.median(fits.flux) == pytest.approx(1e5, rel=0.01)
    print(f"\nFWHM {fwhm_px}, beta {beta}: sampled {errors[False]:.4f} px, integrated {errors[True]:.4f} px")
    assert errors[True] < 6e-4
    if fwhm_px < 1.5:
        assert errors[False] > 3.0 * errors[True]


def test_a_star_without_a_good_pixel_says_nothing_of_the_others() -> None:
    """Its χ² of 0 once made the wings NaN, and with them every star of a crowded frame was lost."""
    x, y = scattered(25, (200, 200), seed=3)
    image = painted(x, y, np.full(25, 2e5), fwhm_px=3.0, beta=3.0, size=(200, 200), seed=4) - 1000.0
    everywhere = np.ones(image.shape, dtype=bool)
    cutouts = make_cutouts(image.astype(np.float32), everywhere, x, y, np.full(25, 30.0), 5)
    hidden = cutouts.good.copy()
    hidden[7] = False
    told = learn_psf(replace(cutouts, good=hidden), x, y, 1.3, 1.5, integrated=False, card=True)
    others = learn_psf(
        cutouts.part(np.arange(25) != 7),
        np.delete(x, 7),
        np.delete(y, 7),
        1.3,
        1.5,
        integrated=False,
        card=True,
    )
    assert told == others


@pytest.mark.long
@pytest.mark.parametrize(("fwhm_px", "beta"), [(1.6, 3.0), (3.0, 0.0), (3.0, 3.0), (4.0, 4.5)])
def test_width_and_flux_hold_for_any_wings(fwhm_px: float, beta: float) -> None:
    size = (500, 500)
    x, y = scattered(64, size, seed=21)
    electrons = np.geomspace(1e4, 2e5, 64)
    found = measure(as_frame(painted(x, y, electrons, fwhm_px=fwhm_px, beta=beta, size=size, seed=22)))
    distance, index = KDTree(np.c_[found.x_px, found.y_px]).query(np.c_[x, y])
    assert np.mean(distance < 0.3) > 0.95
    assert np.median(found.flux[index] / electrons) == pytest.approx(1.0, abs=0.04)
    assert np.median(found.fwhm_px[index]) == pytest.approx(fwhm_px, rel=0.03)


@pytest.mark.long
@pytest.mark.parametrize("gain", [0.4, 1.5, 6.0])
def test_sigmas_are_honest_though_no_card_tells_the_gain(gain: float) -> None:
    size = (700, 700)
    x, y = scattered(144, size, seed=23)
    electrons = gain * np.geomspace(3e3, 4e5, 144)
    image = painted(x, y, electrons, fwhm_px=3.0, beta=3.0, size=size, sky=60.0, read_noise=8.0, seed=24)
    frame = as_frame(image, gain=gain)
    frame.header.clear()
    found = measure(frame)
    distance, index = KDTree(np.c_[found.x_px, found.y_px]).query(np.c_[x, y])
    use = (distance < 1.0) & (found.flags[index] == 0) & (electrons > 1e4)
    pulls = np.r_[
        ((found.x_px[index] - x) / found.x_sigma_px[index])[use],
        ((found.y_px[index] - y) / found.y_sigma_px[index])[use],
    ]
    low, high = np.percentile(pulls, [15.8655, 84.1345])
    print(f"\ngain {gain}: pulls {0.5 * (high - low):.2f} of {pulls.size}")
    assert 0.75 < 0.5 * (high - low) < 1.3


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(2, 20), positive=st.booleans())
def test_as_scipy_has_it(seed: int, count: int, *, positive: bool) -> None:
    rng = np.random.default_rng(seed)
    table = rng.normal(size=(count, 2)) * 10.0 ** rng.uniform(-3, 3, 2)
    if positive:  # as the table of a PSF is: brightness and its square
        table = np.abs(table)
    right = 10.0 * rng.normal(size=count)
    ours = np.array(nonnegative_pair(table, right))
    theirs, misfit = nnls(table, right)
    assert (ours >= 0.0).all()
    assert np.linalg.norm(table @ ours - right) == pytest.approx(misfit, rel=1e-9, abs=1e-9)
    assert np.allclose(table @ ours, table @ theirs, rtol=1e-6, atol=1e-6)


def test_nothing_explains_what_only_falls() -> None:
    assert nonnegative_pair(np.array([[1.0, 1.0], [1.0, 2.0]]), np.array([-1.0, -2.0])) == (0.0, 0.0)


def test_a_column_of_zeros_gets_nothing() -> None:
    assert nonnegative_pair(np.array([[0.0, 1.0], [0.0, 2.0]]), np.array([3.0, 6.0])) == pytest.approx(
        (0.0, 3.0)
    )
