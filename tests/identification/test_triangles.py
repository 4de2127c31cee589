"""Triangles: their angles and limits, and an index that knows a triangle under any similarity."""

import tracemalloc
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.identification.plate import constants
from mountnav.identification.triangles import TriangleIndex, make_triangles


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_angles_are_those_of_the_corners_and_sides_keep_the_limits(seed):
    x, y = np.random.default_rng(seed).uniform(0, 1000, (2, 12))
    triangles = make_triangles(x, y, min_side=100, min_height=50, max_side=900, min_longest=400)
    assert np.all(np.diff(triangles.angles_rad, axis=1) <= 1e-12)
    p = x[triangles.corners] + 1j * y[triangles.corners]
    for at in range(3):  # atan2(u × v, u · v) of the rays that leave a corner [S23 eq. 11-16]
        u, v = p[:, (at + 1) % 3] - p[:, at], p[:, (at + 2) % 3] - p[:, at]
        angle = np.angle(u.conj() * v)
        assert np.allclose(np.abs(angle), triangles.angles_rad[:, at])
        assert np.array_equal(np.sign(angle).astype(int), triangles.parity)
    sides = np.abs(p - np.roll(p, 1, axis=1))
    assert np.all(sides >= 100)
    assert np.all(sides <= 900)
    assert np.allclose(np.log(sides.max(axis=1)), triangles.log_length)
    assert np.all(sides.max(axis=1) >= 400)
    assert len(triangles) == _count_by_hand(x, y, 100, 50, 900, 400)


def _count_by_hand(x, y, min_side, min_height, max_side, min_longest):
    count = 0
    for corners in combinations(x + 1j * y, 3):
        a, b, c = corners
        sides = [abs(a - b), abs(b - c), abs(c - a)]
        height = abs(((b - a).conjugate() * (c - a)).imag) / max(sides)
        count += (
            min(sides) >= min_side
            and height >= min_height
            and max(sides) <= max_side
            and max(sides) >= min_longest
        )
    return count


@given(st.integers(0, 2**32 - 1), st.floats(0, 360), st.floats(0.5, 50), st.booleans())
@settings(max_examples=40, deadline=None)
def test_a_mapped_triangle_is_found_and_gives_the_map_back(seed, rotation_deg, scale, mirrored):
    rng = np.random.default_rng(seed)
    z = rng.uniform(0, 1000, 8) + 1j * rng.uniform(0, 1000, 8)
    turn, shift = scale * np.exp(1j * np.radians(rotation_deg)), 300 - 200j
    w = turn * (z.conj() if mirrored else z) + shift
    frame = make_triangles(z.real, z.imag, min_side=100, min_height=100)
    sky = make_triangles(w.real, w.imag, min_side=100 * scale * 0.999, min_height=100 * scale * 0.999)
    if not len(frame):
        return
    index = TriangleIndex(frame, angle_rad=np.radians(0.5), scale_low=scale * 0.97, scale_high=scale * 1.03)
    of_frame, of_sky = index.like(sky)
    assert np.all(np.diff(of_frame) >= 0)
    worst = np.abs(frame.angles_rad[of_frame] - sky.angles_rad[of_sky]).max()
    assert worst <= np.radians(0.5) * (1 + 1e-9)
    assert set(of_frame) == set(range(len(frame)))
    same = np.all(frame.corners[of_frame] == sky.corners[of_sky], axis=1)
    assert same.sum() >= 0.9 * len(frame)  # only near-equal angles may be ordered otherwise
    got, moved, flipped, _ = constants(
        z[frame.corners[of_frame[same]]], w[sky.corners[of_sky[same]]], (scale * 0.9, scale * 1.1), 0.03
    )
    assert np.all(flipped == mirrored)
    assert np.allclose(got, turn)
    assert np.allclose(moved, shift, atol=1e-6 * scale * 1000)
    parity = frame.parity[of_frame[same]] * sky.parity[of_sky[same]]
    assert np.all(parity == (-1 if mirrored else 1))


def test_too_few_points_make_no_triangles():
    assert len(make_triangles(np.zeros(2), np.zeros(2), min_side=1, min_height=1)) == 0
    assert len(make_triangles(np.arange(5.0), np.arange(5.0), min_side=0.1, min_height=0.1)) == 0


@pytest.mark.parametrize("angle_arcmin", [30.0, 2.0, 0.01])
def test_a_narrow_tolerance_takes_bounded_memory_and_loses_no_pair(angle_arcmin):
    """The table of cells took 4 TiB for 0.01 arcmin."""
    rng = np.random.default_rng(1)
    x_px, y_px = rng.uniform(0, 3000, 30), rng.uniform(0, 2000, 30)
    frame = make_triangles(x_px, y_px, min_side=100, min_height=100, limit=4000)
    catalog = make_triangles(4.0 * x_px, 4.0 * y_px, min_side=400, min_height=400, limit=4000)
    tracemalloc.start()
    index = TriangleIndex(
        frame, angle_rad=float(np.radians(angle_arcmin / 60.0)), scale_low=4.0, scale_high=4.0
    )
    found, _ = index.like(catalog)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 300e6
    assert np.array_equal(np.unique(found), np.arange(len(frame)))


@pytest.mark.parametrize("sizes", [(9, 12, 7), (3, 0, 2, 5), (60, 51)])
def test_several_lists_make_the_triangles_of_each(sizes):
    """Tiles are searched together: none may have a corner in another, nor may one be lost or come twice."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, 1000, (2, sum(sizes)))
    together = make_triangles(x, y, min_side=50, min_height=20, max_side=900, lists=sizes)
    corners, angles, start = [], [], 0
    for size in sizes:
        here = slice(start, start + size)
        one = make_triangles(x[here], y[here], min_side=50, min_height=20, max_side=900)
        corners.append(one.corners + start)
        angles.append(one.angles_rad)
        start += size
    assert np.array_equal(together.corners, np.concatenate(corners))
    assert np.array_equal(together.angles_rad, np.concatenate(angles))


def test_like_triangles_come_list_after_list_each_as_by_itself():
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 1000, (2, 14))
    frame = make_triangles(x, y, min_side=100, min_height=50)
    index = TriangleIndex(frame, angle_rad=np.radians(0.5), scale_low=1.9, scale_high=2.1)
    lists = [(2.0 * x + rng.normal(0, 1, 14), 2.0 * y + rng.normal(0, 1, 14)) for _ in range(3)]
    alone = [
        index.like(make_triangles(*one, min_side=200, min_height=100, wanted=index.may_hold)) for one in lists
    ]
    all_x, all_y = (np.concatenate(side) for side in zip(*lists, strict=True))
    together = make_triangles(
        all_x, all_y, min_side=200, min_height=100, wanted=index.may_hold, lists=[14, 14, 14]
    )
    of_list = together.corners[:, 0] // 14
    of_frame, of_sky = index.like(together, of_list)
    assert np.array_equal(of_frame, np.concatenate([one for one, _ in alone]))
    assert np.array_equal(np.bincount(of_list[of_sky]), [one.size for one, _ in alone])
    assert (np.diff(of_list[of_sky]) >= 0).all()
