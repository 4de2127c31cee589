"""Bleeding charge, cosmic rays and hot pixels on painted frames, each with its exact truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from mountnav.measuring.cosmics import find_cosmics, sharpest
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.measuring.saturation import find_saturated_patches
from mountnav.measuring.settings import MeasuringSettings
from tests.measuring.nearest import nearest
from tests.measuring.painted import as_frame
from tests.measuring.skies import exposed, field, stamped
from tests.measuring.spoiling import add_bleed, add_cosmics, add_hot_pixels

SIZE = (700, 800)
FLAT = np.full(SIZE, 100.0)
TOP = 60_000.0
NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)
WELLS = np.array([[200.3, 300.6], [611.2, 150.4], [430.0, 520.8]])


def measured(image: np.ndarray) -> Measurements:
    return measure(as_frame(image - 500.0, top=TOP), settings=MeasuringSettings(max_sources=4000))


def spread_stars(count: int, seed: int, faint: float, fwhm_px: float) -> tuple[np.ndarray, ...]:
    """Stars clear of the wells of the bleeding ones and of each other."""
    x, y, electrons = field(count, seed, faint, SIZE)
    order = np.argsort(-electrons)
    x, y, electrons = x[order], y[order], electrons[order]
    keep = nearest(WELLS, np.c_[x, y])[0] > 40.0
    for i, j in KDTree(np.c_[x, y]).query_pairs(6.0 * fwhm_px):
        keep[max(i, j)] = False
    return x[keep], y[keep], electrons[keep]


@pytest.mark.long
@pytest.mark.parametrize("sideways", [False, True])
def test_bleeding_stars_keep_their_places_and_their_tails_make_no_stars(sideways: bool) -> None:
    x, y, electrons = spread_stars(250, 3, 500.0, 3.0)
    image = exposed(
        FLAT,
        stamped(x, y, electrons, SIZE) + stamped(WELLS[:, 0], WELLS[:, 1], np.array([3e6, 6e6, 1.2e7]), SIZE),
    )
    whole = image.copy()
    for k, (a, b) in enumerate(WELLS):
        add_bleed(image, a, b, up_px=50 + 30 * k, down_px=(0, 40, 90)[k], top=TOP + 600.0)
    if sideways:
        image, whole, x, y = image.T, whole.T, y, x
    wells = WELLS[:, ::-1] if sideways else WELLS
    found, plain = measured(image), measured(whole)
    tree = np.c_[found.x_px, found.y_px]
    distance, index = nearest(tree, wells)
    assert distance.max() < 0.3
    assert ((found.flags[index] & (Flag.SATURATED | Flag.BLEED)) == (Flag.SATURATED | Flag.BLEED)).all()
    stars = np.r_[np.c_[x, y], wells]
    false = nearest(stars, np.c_[found.x_px, found.y_px])[0] > 2.0
    false &= (found.flags & NO_STAR) == 0
    assert (false & (found.flux > 5.0 * found.flux_sigma)).sum() <= 2
    # stars off the columns don't notice
    along, across = (0, 1) if sideways else (1, 0)
    positions = np.c_[plain.x_px, plain.y_px]
    off = np.abs(positions[:, [across]] - wells[None, :, across]).min(axis=1) > 12.0
    off &= (plain.flux > 3e3) & (plain.flags == 0)
    assert along != across
    distance, index = nearest(tree, positions[off])
    assert np.percentile(distance, 98) < 0.05
    assert ((found.flags[index] & Flag.BLEED) == 0).all()


@pytest.mark.long
def test_a_round_saturated_star_and_a_spiked_one_do_not_bleed() -> None:
    x, y, electrons = spread_stars(250, 3, 500.0, 3.0)
    image = exposed(
        FLAT,
        stamped(x, y, electrons, SIZE) + stamped(WELLS[:, 0], WELLS[:, 1], np.array([3e6, 6e6, 1.2e7]), SIZE),
    )
    rows, columns = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    dx, dy = columns - WELLS[0, 0], rows - WELLS[0, 1]
    for a, b in ((dx, dy), (dy, dx)):
        image += 4e4 / (10.0 + np.abs(a)) ** 1.2 * np.exp(-(b**2) / 2.0)
    found = measured(image)
    assert not (found.flags & Flag.BLEED).any()


def test_blobs_are_the_patches_that_were_filled() -> None:
    full = np.zeros((60, 80), dtype=bool)
    full[10:14, 20:24] = True
    full[14, 24] = True  # touches at a corner
    full[30:55, 60:62] = True
    full[16, 5] = True
    blobs = find_saturated_patches(full, 3.0)
    assert [(b.left, b.right, b.top, b.bottom) for b in blobs] == [
        (20, 24, 10, 14),
        (5, 5, 16, 16),
        (60, 61, 30, 54),
    ]
    assert [b.bleeds for b in blobs] == [False, False, True]
    assert find_saturated_patches(np.zeros((20, 20), dtype=bool), 3.0) == []


@pytest.mark.long
@pytest.mark.parametrize("fwhm_px", [2.2, 3.0, 4.5])
def test_cosmic_rays_are_told_from_stars(fwhm_px: float) -> None:
    x, y, electrons = spread_stars(400, 7, 800.0, fwhm_px)
    image = exposed(FLAT, stamped(x, y, electrons, SIZE, fwhm_px))
    ray_x, ray_y = add_cosmics(image, 400, seed=2)
    hot_x, hot_y = add_hot_pixels(image, 100, seed=3)
    found = measured(image)
    positions = np.c_[found.x_px, found.y_px]
    hits = np.r_[np.c_[ray_x, ray_y], np.c_[hot_x, hot_y]]
    star_far, star = nearest(np.c_[x, y], positions)
    is_star = star_far < 1.0
    hit_far = nearest(hits, positions)[0]
    flagged = (found.flags & NO_STAR) > 0
    passed = ~is_star & ~flagged & (star_far > 3.0 * fwhm_px) & (found.flux > 5.0 * found.flux_sigma)
    clean_stars = is_star & (hit_far > 16.0) & (electrons[star] > 1500.0)
    print(f"\nFWHM {fwhm_px}: {passed.sum()} of {hits.shape[0]} hits pass for stars", end=", ")
    print(f"{flagged[clean_stars].sum()} of {clean_stars.sum()} stars without a hit are flagged")
    assert passed.sum() <= 0.02 * hits.shape[0]
    assert flagged[clean_stars].mean() <= 0.01
    assert clean_stars.sum() > 50
    best = np.flatnonzero(~flagged)[:50]
    assert is_star[best].mean() >= 0.98
    moved = star_far[is_star & ~flagged & (electrons[star] > 1e4)]
    assert np.percentile(moved, 98) < 0.1


@pytest.mark.parametrize("fwhm_px", [1.2, 1.5, 2.0, 3.0, 6.0])
def test_stars_of_any_width_are_no_cosmic_rays(fwhm_px: float) -> None:
    x, y, electrons = spread_stars(500, 11, 1000.0, max(fwhm_px, 3.0))
    image = exposed(FLAT, stamped(x, y, electrons, SIZE, fwhm_px)) - 600.0
    noise = np.full(x.size, np.sqrt(125.0))
    good = np.ones(SIZE, dtype=bool)
    struck, rows, _ = find_cosmics(image.astype(np.float32), good, x, y, noise, fwhm_px, 1.0)
    assert struck.mean() <= 0.01
    assert rows.size <= 0.05 * x.size * 9
    # a width that was guessed much too large is put right by the stars themselves
    struck, _, _ = find_cosmics(image.astype(np.float32), good, x, y, noise, 1.6 * fwhm_px, 1.0)
    assert struck.mean() <= 0.03


def test_the_sharpest_star_is_less_sharp_than_a_single_pixel() -> None:
    widths = np.linspace(1.0, 12.0, 50)
    values = np.array([sharpest(float(w)) for w in widths])
    assert (np.diff(values) < 0).all()
    assert values[-1] < 0.1
    assert sharpest(0.0) == 1.0
