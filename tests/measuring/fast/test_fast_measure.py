"""The fast measurement on painted frames: what it finds, how well, when it leaves a frame to `measure`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from mountnav.frames import Frame
from mountnav.measuring.fast import FastMeasurement, measure_fast
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag, Measurements
from tests.measuring.painted import as_frame, painted, scattered, spots

Array = NDArray[np.float64]
SIZE = (600, 800)
NO_STAR = int(Flag.NO_PEAK | Flag.TRAIL | Flag.BLEED)


def looked_at(frame: Frame, most: int = 200) -> FastMeasurement:
    seen = measure_fast(frame, most=most)
    assert seen is not None
    return seen


def offsets(found: Measurements, x: Array, y: Array) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    distance, index = map(np.asarray, KDTree(np.c_[found.x_px, found.y_px]).query(np.c_[x, y]))
    return distance, found.x_px[index] - x, found.y_px[index] - y, index


def a_field(
    count: int = 100, *, fwhm_px: float = 2.6, beta: float = 0.0, seed: int = 3, **more: object
) -> tuple[Frame, Array, Array, Array]:
    """Stars of 3000 to 300 000 electrons, brightest first."""
    x, y = scattered(count, SIZE, seed)
    light = np.sort(10.0 ** np.random.default_rng(seed).uniform(3.5, 5.5, count))[::-1]
    image = painted(x, y, light, fwhm_px=fwhm_px, beta=beta, size=SIZE, seed=seed, **more)  # type: ignore[arg-type]
    return as_frame(image), x, y, light


@pytest.mark.long
@pytest.mark.parametrize(("fwhm_px", "beta"), [(1.6, 0.0), (2.2, 3.0), (3.5, 0.0), (5.5, 3.5)])
def test_the_brightest_are_found_and_nearly_placed(fwhm_px: float, beta: float) -> None:
    frame, x, y, _ = a_field(fwhm_px=fwhm_px, beta=beta)
    found = looked_at(frame).measurements
    assert np.all(np.diff(found.flux) <= 0.0)
    distance, dx, dy, index = offsets(found, x[:60], y[:60])
    assert (distance < 1.0).all()
    assert (found.flags[index] & NO_STAR == 0).all()
    assert np.median(np.hypot(dx, dy)) < 0.05
    assert np.median(found.fwhm_px[index]) == pytest.approx(fwhm_px, rel=0.2)  # moments see wings


@pytest.mark.parametrize(
    ("fwhm_px", "beta"),
    [
        (1.6, 0.0),
        (2.2, 3.0),
        pytest.param(3.5, 0.0, marks=pytest.mark.long),
        pytest.param(5.5, 3.5, marks=pytest.mark.long),
    ],
)
def test_fits_at_places_are_as_good_as_those_of_measure_and_honest(fwhm_px: float, beta: float) -> None:
    errors: list[Array] = []
    pulls: list[Array] = []
    plain: list[Array] = []
    for seed in (1, 2, 3):
        frame, x, y, _ = a_field(fwhm_px=fwhm_px, beta=beta, seed=seed)
        shift = np.random.default_rng(seed).normal(0.0, 0.4, (2, x.size))
        found = looked_at(frame).measured_at(x + shift[0], y + shift[1], reach_px=2.0)
        distance, dx, dy, index = offsets(found, x, y)
        assert (distance < 1.0).mean() > 0.97
        good = distance < 1.0
        errors += [dx[good], dy[good]]
        pulls += [(dx / found.x_sigma_px[index])[good], (dy / found.y_sigma_px[index])[good]]
        distance, dx, dy, _ = offsets(measure(frame), x, y)
        plain += [dx[good & (distance < 1.0)], dy[good & (distance < 1.0)]]
    error, pull, other = (np.concatenate(some) for some in (errors, pulls, plain))
    print(f"\n{fwhm_px} px: {np.median(np.abs(error)):.4f} px, {np.median(np.abs(other)):.4f} by measure")
    assert np.median(np.abs(error)) < 1.15 * np.median(np.abs(other))
    assert 0.85 < np.ptp(np.percentile(pull, [16.0, 84.0])) / 2.0 < 1.2


def test_fluxes_are_those_that_were_painted() -> None:
    frame, x, y, light = a_field(fwhm_px=2.6)
    found = looked_at(frame).measured_at(x, y, reach_px=2.0)
    distance, _, _, index = offsets(found, x, y)
    assert np.median(found.flux[index] / light) == pytest.approx(1.0, abs=0.02)
    pull = (found.flux[index] - light)[distance < 1.0] / found.flux_sigma[index][distance < 1.0]
    assert np.median(np.abs(pull)) < 1.5


def test_the_quality_is_that_of_measure() -> None:
    frame, x, y, _ = a_field(fwhm_px=3.0)
    quality, whole = looked_at(frame).measured_at(x, y, reach_px=2.0).quality, measure(frame).quality
    assert quality is not None
    assert whole is not None
    assert quality.images is whole.images
    for name, share in (
        ("fwhm_px", 0.03),
        ("sky_adu", 0.002),
        ("noise_adu", 0.06),
        ("limiting_flux_adu", 0.15),
    ):
        assert getattr(quality, name) == pytest.approx(getattr(whole, name), rel=share), name
    assert abs(quality.stars - 100) < 15


def test_hot_pixels_brighter_than_the_stars_are_told_from_them() -> None:
    frame, x, y, _ = a_field(fwhm_px=2.6)
    rng = np.random.default_rng(8)
    rows, columns = rng.integers(5, SIZE[0] - 5, 150), rng.integers(5, SIZE[1] - 5, 150)
    pixels = np.array(frame.pixels)
    pixels[rows, columns] = rng.integers(20_000, 60_000, 150)
    found = looked_at(replace(frame, pixels=pixels)).measurements
    star = found.flags & NO_STAR == 0
    distance, _ = KDTree(np.c_[x, y]).query(np.c_[found.x_px, found.y_px])
    hot, _ = KDTree(np.c_[columns, rows]).query(np.c_[x, y])
    distance, hot = np.asarray(distance), np.asarray(hot)
    assert (distance[star][:60] < 1.5).all()
    found_at, _, _, index = offsets(found, x[:60], y[:60])
    clean = hot[:60] > 8.0
    assert ((found_at < 1.0) & (found.flags[index] & NO_STAR == 0))[clean].mean() > 0.95


def test_saturated_stars_are_flagged_first_and_placed_by_their_wings() -> None:
    x, y = scattered(100, SIZE, 5)
    light = np.sort(10.0 ** np.random.default_rng(5).uniform(4.0, 5.3, 100))[::-1]
    light[:8] = np.geomspace(4e6, 1e6, 8)
    frame = as_frame(painted(x, y, light, fwhm_px=3.0, size=SIZE, seed=5))
    seen = looked_at(frame)
    assert (seen.measurements.flags[:8] & Flag.SATURATED > 0).all()
    found = seen.measured_at(x, y, reach_px=3.0)
    distance, _, _, index = offsets(found, x[:8], y[:8])
    assert (found.flags[index] & Flag.SATURATED > 0).all()
    assert distance.max() < 0.03
    assert found.flux[index] == pytest.approx(light[:8], rel=0.05)


def test_a_bright_streak_and_a_bad_column_fill_no_list() -> None:
    frame, x, y, _ = a_field(fwhm_px=2.6)
    pixels = np.array(frame.pixels)
    pixels[:, 333] = 40_000
    along = np.arange(1500) / 1500.0
    for width in (-1, 0, 1):
        pixels[(40 + 250 * along).astype(int) + width, (30 + 350 * along).astype(int)] = 30_000
    seen = measure_fast(replace(frame, pixels=pixels))
    assert seen is not None
    found = seen.measurements
    star = np.flatnonzero(found.flags & NO_STAR == 0)[:40]
    distance, _ = KDTree(np.c_[x, y]).query(np.c_[found.x_px, found.y_px][star])
    assert np.mean(distance < 2.0) > 0.8


def test_places_without_a_source_give_nothing_and_each_source_comes_once() -> None:
    frame, x, y, _ = a_field(fwhm_px=2.6)
    seen = looked_at(frame)
    empty = (
        0.5 * (x[:-1] + x[1:])[np.abs(np.diff(y)) < 20.0],
        0.5 * (y[:-1] + y[1:])[np.abs(np.diff(y)) < 20.0],
    )
    assert len(seen.measured_at(*empty, reach_px=4.0)) <= 0.1 * empty[0].size
    outside = seen.measured_at(np.array([-50.0, 1e5]), np.array([10.0, 10.0]), reach_px=3.0)
    assert len(outside) == 0
    assert len(seen.measured_at(np.zeros(0), np.zeros(0), reach_px=3.0)) == 0
    twice = seen.measured_at(np.r_[x[:5], x[:5] + 0.7], np.r_[y[:5], y[:5]], reach_px=3.0)
    assert len(twice) == 5


def test_of_two_sources_in_reach_the_likelier_one_is_taken() -> None:
    x, y = scattered(60, SIZE, 6)
    light = np.full(60, 50_000.0)
    faint = np.full(60, 1_500.0)
    image = painted(np.r_[x, x + 5.0], np.r_[y, y], np.r_[light, faint], fwhm_px=2.6, size=SIZE, seed=6)
    found = looked_at(as_frame(image)).measured_at(x + 1.5, y, reach_px=6.0)
    distance, _, _, _ = offsets(found, x, y)
    assert (distance < 0.5).all()


def test_neighbors_do_not_pull() -> None:
    x, y = scattered(80, SIZE, 7)
    light, near = np.full(80, 60_000.0), np.full(80, 40_000.0)
    image = painted(np.r_[x, x + 6.0], np.r_[y, y + 1.0], np.r_[light, near], fwhm_px=3.0, size=SIZE, seed=7)
    found = looked_at(as_frame(image)).measured_at(x, y, reach_px=2.0)
    distance, dx, dy, _ = offsets(found, x, y)
    assert (distance < 1.0).all()
    assert abs(float(dx.mean())) < 0.008  # of 6 px, with no star alone to learn from
    assert abs(float(dy.mean())) < 0.008


@pytest.mark.long
@pytest.mark.parametrize("kind", ["uint8", "int16", "int32", "float32", "float64", ">u2", ">f4", "flipped"])
def test_the_type_and_order_of_the_pixels_do_not_matter(kind: str) -> None:
    frame, x, y, _ = a_field(fwhm_px=3.0)
    pixels = np.asarray(frame.pixels).astype(np.float64)
    if kind == "uint8":
        pixels = np.clip(pixels / 40.0 - 5.0, 0, 255)
    elif kind == "int16":
        pixels = np.clip(pixels, 0, 32767)
    changed = np.asarray(frame.pixels)[::-1] if kind == "flipped" else pixels.astype(kind)
    if kind == "flipped":
        y = SIZE[0] - 1.0 - y
    found = looked_at(replace(frame, pixels=changed)).measurements
    distance, _, _, index = offsets(found, x[:60], y[:60])
    assert (distance < 0.3).mean() > 0.97
    whole = found.flags[index] & Flag.SATURATED == 0
    assert np.median(distance[whole]) < 0.06


@pytest.mark.long
def test_large_frames_are_looked_at_in_bins_and_odd_sizes_lose_nothing() -> None:
    rng = np.random.default_rng(4)
    x, y = scattered(80, (2303, 2503), 4)
    light = 10.0 ** rng.uniform(4.0, 5.3, 80)
    frame = as_frame(painted(x, y, light, fwhm_px=2.2, size=(2303, 2503), seed=4))
    seen = looked_at(frame)
    assert seen.scene.bin_px == 4
    distance, _, _, _ = offsets(seen.measurements, x, y)
    assert (distance < 0.3).all()
    found = seen.measured_at(x, y, reach_px=2.0)
    distance, _, _, _ = offsets(found, x, y)
    assert np.median(distance) < 0.02


def test_some_missing_pixels_are_passed_over_and_many_are_no_frame_for_a_glance() -> None:
    frame, x, y, _ = a_field(fwhm_px=3.0)
    pixels = np.asarray(frame.pixels).astype(np.float32)
    rng = np.random.default_rng(2)
    holes = rng.random(SIZE) < 0.004
    found = looked_at(replace(frame, pixels=np.where(holes, np.nan, pixels))).measurements
    distance, _, _, _ = offsets(found, x[:50], y[:50])
    assert (distance < 0.5).mean() > 0.9
    assert measure_fast(replace(frame, pixels=np.where(rng.random(SIZE) < 0.3, np.nan, pixels))) is None


STRANGE = (
    *("trailed", "rings", "noise", "hot pixels", "zero", "full", "no value", "tiny", "line", "colors"),
    *("absurd", "mosaic"),
)


@cache
def nothing_like_it() -> dict[str, Frame]:
    x, y = scattered(49, SIZE, 9, margin=60.0)
    light = 10.0 ** np.random.default_rng(9).uniform(4.5, 5.5, 49)
    rng = np.random.default_rng(1)
    noise = rng.normal(1000.0, 10.0, SIZE)
    stars, _, _, _ = a_field()
    return {
        "trailed": as_frame(
            painted(x, y, light, fwhm_px=2.5, size=SIZE, points=spots(trail_px=14.0, trail_deg=30.0))
        ),
        "rings": as_frame(painted(x, y, light, fwhm_px=2.5, size=SIZE, points=spots(donut_px=24.0))),
        "noise": Frame(pixels=noise.astype(np.uint16)),
        "hot pixels": Frame(pixels=np.where(rng.random(SIZE) < 0.001, 50_000.0, noise).astype(np.uint16)),
        "zero": Frame(pixels=np.zeros(SIZE, dtype=np.uint16)),
        "full": Frame(pixels=np.full(SIZE, 65535, dtype=np.uint16)),
        "no value": Frame(pixels=np.full(SIZE, np.nan, dtype=np.float32)),
        "tiny": Frame(pixels=np.asarray(stars.pixels)[:40, :40]),
        "line": Frame(pixels=np.asarray(stars.pixels)[0]),
        "colors": Frame(pixels=np.zeros((3, 200, 200), dtype=np.uint8)),
        "absurd": Frame(pixels=np.where(rng.random(SIZE) < 0.5, 1e30, -1e30).astype(np.float32)),
        "mosaic": replace(stars, mosaic=True),
    }


@pytest.mark.long
def test_the_names_are_those_of_the_strange_ones() -> None:
    assert tuple(nothing_like_it()) == STRANGE


@pytest.mark.long
@pytest.mark.parametrize("name", STRANGE)
def test_what_is_no_frame_for_a_glance_is_left_to_measure(name: str) -> None:
    assert measure_fast(nothing_like_it()[name]) is None


def test_the_pixels_stay_as_they_were() -> None:
    frame, x, y, _ = a_field()
    before = np.array(frame.pixels)
    looked_at(frame).measured_at(x, y, reach_px=2.0)
    assert np.array_equal(before, frame.pixels)


def test_no_more_sources_than_wanted() -> None:
    frame, _, _, _ = a_field()
    found = looked_at(frame, most=30).measurements
    assert (found.flags & NO_STAR == 0).sum() == 30
    assert len(found) <= 45
