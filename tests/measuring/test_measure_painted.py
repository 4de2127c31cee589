"""Measuring against painted frames: accuracy against the Cramér-Rao bound, flags, shifts, bad frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadFrame
from mountnav.frames import Frame
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.settings import MeasuringSettings
from tests.measuring.nearest import nearest
from tests.measuring.painted import Array, as_frame, painted, scattered
from tests.short_part import one_in


def source_at(found: Measurements, x: float, y: float) -> int:
    distance = np.hypot(found.x_px - x, found.y_px - y)
    assert distance.min() < 3.0, f"nothing measured near ({x}, {y})"
    return int(distance.argmin())


def cramer_rao_px(electrons: float, sigma_px: float, variance: float) -> float:
    """Bound of x from the Fisher information of a Gaussian star on a pixel grid, all else known."""
    u, v = np.meshgrid(np.arange(-25, 26), np.arange(-25, 26))
    model = electrons / (2 * np.pi * sigma_px**2) * np.exp(-(u**2 + v**2) / (2 * sigma_px**2))
    return float(1.0 / np.sqrt(((model * u / sigma_px**2) ** 2 / (variance + model)).sum()))


@pytest.mark.long
@pytest.mark.parametrize("fwhm_px", one_in(2, [1.5, 2.5, 4.0, 8.0]))
@pytest.mark.parametrize("electrons", [3_000.0, 30_000.0])
def test_centroids_come_near_the_cramer_rao_bound(fwhm_px: float, electrons: float) -> None:
    size = (600, 600)
    x, y = scattered(100, size, seed=3)
    found = measure(as_frame(painted(x, y, np.full(100, electrons), fwhm_px=fwhm_px, size=size, seed=4)))
    distance, index = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    matched = distance < 2.0
    assert matched.mean() > 0.97
    errors = np.r_[(found.x_px[index] - x)[matched], (found.y_px[index] - y)[matched]]
    bound = cramer_rao_px(electrons, fwhm_px / 2.3548, 125.0)
    spread = float(np.sqrt(np.mean(errors**2)))
    share = spread / bound
    print(
        f"\nFWHM {fwhm_px} px, {electrons:.0f} e-: rms {spread:.4f} px, bound {bound:.4f}, ratio {share:.2f}"
    )
    assert spread < 1.25 * bound + 0.002
    stated = float(np.median(found.x_sigma_px[index][matched]))
    assert 0.75 * bound < stated < 1.35 * bound
    assert np.median(found.fwhm_px[index][matched]) == pytest.approx(fwhm_px, rel=0.08)
    assert np.median(found.flux[index][matched]) == pytest.approx(electrons, rel=0.05)


def test_the_flags_say_what_is_no_clean_star() -> None:
    size = (400, 400)
    x, y = scattered(36, size, seed=5)
    electrons = np.geomspace(5e3, 2e5, 36)
    x[0], y[0], electrons[0] = 100.0, 350.0, 5e6  # saturates
    x[1], y[1], electrons[1] = 0.5, 200.0, 5e4  # on the edge
    x[2], y[2], electrons[2] = 200.0, 210.5, 2e5  # under the satellite
    alone = (np.arange(36) == 0) | (np.hypot(x - x[0], y - y[0]) > 30.0)
    x, y, electrons = x[alone], y[alone], electrons[alone]
    image = painted(x, y, electrons, fwhm_px=3.5, size=size)
    image[333, 222] += 20_000.0  # a hot pixel
    for step in range(7):
        image[60 + step // 2, 300 + step] += 6_000.0  # a cosmic ray
    ramp = np.arange(400)
    image[np.clip(np.rint(150 + 0.3 * ramp).astype(int), 0, 399), ramp] += 800.0
    image[np.clip(np.rint(151 + 0.3 * ramp).astype(int), 0, 399), ramp] += 800.0  # a satellite
    found = measure(as_frame(image, top=40_000.0))
    star = source_at(found, 100.0, 350.0)
    assert found.flags[star] & Flag.SATURATED
    assert np.hypot(found.x_px[star] - 100.0, found.y_px[star] - 350.0) < 0.02
    assert found.flags[source_at(found, 0.5, 200.0)] & Flag.EDGE
    assert found.flags[source_at(found, 222.0, 333.0)] & Flag.NO_PEAK
    assert found.flags[source_at(found, 303.0, 61.5)] & (Flag.NO_PEAK | Flag.ELONGATED)
    on_trail = np.abs(found.y_px - (150.5 + 0.3 * found.x_px)) < 2.0
    assert on_trail.any()
    assert (found.flags[on_trail] & Flag.TRAIL).all()
    clean = (found.flags == 0) & (found.flux > 4.0 * found.flux_sigma)
    distance, _ = nearest(np.c_[x, y], np.c_[found.x_px, found.y_px][clean])
    assert clean.sum() >= 25
    assert (distance < 0.3).all()


@pytest.mark.long
@pytest.mark.parametrize("electrons", [1e6, 5e6, 2e7])
def test_the_wings_place_a_saturated_star(electrons: float) -> None:
    pulls, errors = [], []
    for seed in range(6):
        cx, cy = 100.0 + np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
        x, y = scattered(25, (300, 300), seed=seed)
        far = np.hypot(x - cx, y - cy) > 45.0
        x, y, total = np.r_[cx, x[far]], np.r_[cy, y[far]], np.r_[electrons, np.full(far.sum(), 2e4)]
        found = measure(as_frame(painted(x, y, total, fwhm_px=3.5, seed=seed), top=40_000.0))
        star = source_at(found, cx, cy)
        assert found.flags[star] & Flag.SATURATED
        off = np.array([found.x_px[star] - cx, found.y_px[star] - cy])
        errors.append(off)
        pulls.append(off / [found.x_sigma_px[star], found.y_sigma_px[star]])
    assert np.abs(errors).max() < 0.03
    assert 0.4 < np.std(pulls) < 1.8  # the stated errors are the true ones


def test_bleeding_charge_is_flagged() -> None:
    x, y = scattered(25, (300, 300), seed=8)
    image = painted(x, y, np.full(25, 3e4), fwhm_px=3.0)
    image[60:240, 145:148] = 70_000.0
    found = measure(as_frame(image))
    near = (np.abs(found.x_px - 146) < 4) & (found.y_px > 55) & (found.y_px < 245)
    assert near.any()
    assert (found.flags[near] & (Flag.BLEED | Flag.TRAIL)).all()


def test_undersampled_stars_are_not_taken_for_hot_pixels() -> None:
    x, y = scattered(100, (400, 400), seed=9)
    found = measure(as_frame(painted(x, y, np.full(100, 2e4), fwhm_px=1.2, size=(400, 400))))
    distance, index = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    assert (distance < 0.5).mean() > 0.97
    assert ((found.flags[index] & Flag.NO_PEAK) == 0).mean() > 0.85


@pytest.mark.long
def test_defocused_stars_are_found() -> None:
    x, y = scattered(25, (500, 500), seed=10)
    found = measure(as_frame(painted(x, y, np.full(25, 1e5), fwhm_px=12.0, size=(500, 500))))
    distance, _ = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    assert (distance < 0.3).mean() >= 0.95
    assert np.median(found.fwhm_px) == pytest.approx(12.0, rel=0.1)


@pytest.mark.long
@given(dx=st.integers(-12, 12), dy=st.integers(-12, 12))
@settings(max_examples=8, deadline=None)
def test_a_shifted_frame_shifts_its_centroids(dx: int, dy: int) -> None:
    x, y = scattered(25, (260, 260), seed=11, margin=40.0)
    image = painted(x, y, np.full(25, 4e4), fwhm_px=3.0, size=(260, 260))
    here, there = measure(as_frame(image)), measure(as_frame(np.roll(image, (dy, dx), axis=(0, 1))))
    bright_here, bright_there = here.flux > 2e4, there.flux > 2e4
    a = np.c_[here.x_px + dx, here.y_px + dy][bright_here]
    distance, _ = nearest(np.c_[there.x_px, there.y_px][bright_there], a)
    assert a.shape[0] == 25
    assert distance.max() < 0.01  # the background mesh doesn't move along


def test_missing_pixels_and_negative_floats_do_no_harm() -> None:
    x, y = scattered(36, (300, 300), seed=12, margin=50.0)
    image = (painted(x, y, np.full(36, 3e4), fwhm_px=2.5) - 130.0) * 1e-3
    image[:30], image[:, -25:] = np.nan, np.nan
    found = measure(Frame(pixels=image.astype(np.float32)))
    distance, _ = nearest(np.c_[found.x_px, found.y_px], np.c_[x, y])
    assert (distance < 0.1).mean() > 0.95
    assert len(found) < 45
    assert np.isfinite(found.x_sigma_px).all()


def test_an_empty_sky_is_no_error() -> None:
    none: Array = np.zeros(0)
    found = measure(as_frame(painted(none, none, none, fwhm_px=3.0)))
    assert len(found) <= 3
    assert found.background_adu == pytest.approx(600.0, abs=1.0)
    assert found.noise_adu == pytest.approx(np.sqrt(125.0), rel=0.05)


def test_brightest_first_and_no_more_than_asked() -> None:
    x, y = scattered(64, (300, 300), seed=13)
    frame = as_frame(painted(x, y, np.geomspace(3e3, 3e5, 64), fwhm_px=2.5))
    found = measure(frame, settings=MeasuringSettings(max_sources=20))
    assert len(found) == 20
    assert (np.diff(found.flux) <= 0).all()
    assert found.flux[0] == pytest.approx(3e5, rel=0.05)


@pytest.mark.parametrize(
    ("pixels", "words"),
    [
        (np.zeros((100, 100), np.uint16), "same value"),
        (np.full((100, 100), 65535, np.uint16), "same value"),
        (np.full((64, 64), np.nan, np.float32), "hardly any pixel"),
        (np.ones((5, 5), np.uint16), "too small"),
        (np.where(np.arange(10000).reshape(100, 100) % 10 == 0, 100, 65535).astype(np.uint16), "saturated"),
    ],
)
def test_hopeless_frames_are_refused_with_advice(pixels: np.ndarray, words: str) -> None:
    with pytest.raises(BadFrame, match=words) as caught:
        measure(Frame(pixels=pixels, source="dark.fits"))
    assert caught.value.advice
    assert caught.value.device == "dark.fits"
