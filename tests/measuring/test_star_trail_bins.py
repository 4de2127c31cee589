"""Bins that are at hand are those that the check for trails would sum itself; windows are counted alike."""

import numpy as np
import pytest
from scipy import ndimage

from mountnav.measuring.fast.coarse import Summed, coarse_plane, coarse_sky, in_wider_bins
from mountnav.measuring.psf_fitting import _medians, _part_sizes
from mountnav.measuring.segmentation import _widened
from mountnav.measuring.star_trail import (
    _SEEN_SIGMA,
    _add_cover,
    _scaled,
    _stands_nowhere_out,
    _windows,
    in_bins,
)


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.uint8, np.int32])
@pytest.mark.parametrize("shape", [(203, 310), (400, 402), (67, 71)])
def test_smaller_bins_give_the_same_plane(dtype, shape):
    rng = np.random.default_rng(1)
    pixels = rng.integers(0, 200, shape).astype(dtype)
    pixels[::17, ::19] = np.iinfo(dtype).max if np.iinfo(dtype).max < 70_000 else 65_535
    for bin_px in (1, 2, 4):
        plane = coarse_plane(pixels, bin_px)
        assert np.array_equal(in_wider_bins(plane, bin_px, 4), coarse_plane(pixels, 4))
        sky = coarse_sky(plane, bin_px, whole_numbers=True)
        for summed in (Summed(plane.copy(), bin_px), Summed(plane.copy(), bin_px, sky)):
            own, given = in_bins(pixels), in_bins(pixels, summed)
            assert all(np.array_equal(one, other) for one, other in zip(own, given, strict=True))


@pytest.mark.parametrize("seed", range(5))
def test_windows_are_counted_as_if_added_one_by_one(seed):
    rng = np.random.default_rng(seed)
    shape, half = (90, 70), 20
    # some lie beyond the frame, a few far beyond
    x, y = rng.uniform(-400, 700, 60), rng.uniform(-400, 760, 60)
    windows, cover = _windows(x, y, 4, half, shape), np.ones(shape, dtype=np.float32)
    told, added = (np.zeros((2 * half + 1,) * 2, dtype=np.float32) for _ in range(2))
    _add_cover(told, windows, cover, whole=True)
    _add_cover(added, windows, cover, whole=False)
    assert added.max() > 1
    assert np.array_equal(told, added)


@pytest.mark.parametrize(("size", "count"), [(60, 7), (61, 7), (5, 5), (1000, 12), (9, 1)])
def test_medians_of_parts_are_those_of_split_arrays(size, count):
    values = np.random.default_rng(size).normal(size=size)
    parts = np.array_split(values, count)
    assert np.array_equal(_medians(values, count), [np.median(part) for part in parts])
    assert np.array_equal(_part_sizes(size, count), [part.size for part in parts])


@pytest.mark.parametrize("shape", [(1, 3), (5, 7), (40, 31)])
@pytest.mark.parametrize("by", [1, 2, 5, 8])
def test_light_is_widened_as_by_a_filter(shape, by):
    lit = np.random.default_rng(by).random(shape) < 0.03
    lit[0, -1] = True
    assert np.array_equal(_widened(lit, by), ndimage.maximum_filter(lit, 2 * by + 1))


@pytest.mark.parametrize("height", [0.0, 0.9, 1.1, 3.0])
@pytest.mark.parametrize("size", [60, 61])
def test_what_stands_nowhere_out_is_nowhere_seen(height, size):
    rng = np.random.default_rng(size)
    total = rng.normal(size=(size, size)).astype(np.float32)
    count = np.full_like(total, 9.0)
    known = rng.random(total.shape) < 0.9
    known[3, 4] = True
    total[3, 4] = 0.0
    scaled = _scaled(total, count, known)
    one_sigma = 1.0 / (scaled[5, 6] - scaled[3, 4]) * (total[5, 6] - total[3, 4])
    total[3, 4] = height * _SEEN_SIGMA * one_sigma
    seen = bool((_scaled(total, count, known)[known] >= _SEEN_SIGMA).any())
    assert _stands_nowhere_out(total, count, known) is (not seen)
    assert seen is (height > 1.0)
