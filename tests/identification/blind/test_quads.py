"""Quads' codes: the same for whoever looks from wherever, another for another shape."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.identification.blind.file_format import CELLS, LOW, RASTER, STRIDES, pack, stepped, unpack
from mountnav.identification.blind.quads import (
    QUAD_QUERIES,
    QuadQuery,
    all_quads,
    codes,
    flattened,
    frame_codes,
    frame_quads,
)

seeds = st.integers(0, 2**32 - 1)


def quads(rng, count=40):
    return rng.uniform(-1, 1, (count, 4)) + 1j * rng.uniform(-1, 1, (count, 4))


@given(seeds, st.floats(0.01, 100), st.floats(0, 6.3), st.booleans(), st.permutations(range(4)))
@settings(max_examples=50, deadline=None)
def test_a_code_knows_no_place_scale_rotation_parity_nor_order(seed, scale, angle, mirrored, order):
    rng = np.random.default_rng(seed)
    some = quads(rng)
    moved = scale * np.exp(1j * angle) * (some.conj() if mirrored else some) + complex(*rng.normal(size=2))
    code, corners = codes(some)
    again, moved_corners = codes(moved[:, order])
    # where two choices tie, either may be taken
    clear = clearness(some) > 1e-6
    np.testing.assert_allclose(again[clear], code[clear], atol=1e-7)
    np.testing.assert_array_equal(np.array(order)[moved_corners][clear], corners[clear])


def clearness(some):
    """How far a quad is from having two widest pairs, or two orders of its other corners."""
    lengths = np.sort(np.stack([abs(some[:, a] - some[:, b]) for a in range(4) for b in range(a)]), axis=0)
    code, _ = codes(some)
    return np.minimum.reduce(
        [
            1 - lengths[-2] / lengths[-1],
            abs(1 - code[:, 0] - code[:, 2]),
            abs(code[:, 2] - code[:, 0]),
            abs(code[:, 1]),
        ]
    )


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_the_corners_give_the_code_and_lie_on_the_raster(seed):
    some = quads(np.random.default_rng(seed))
    code, order = codes(some)
    a, b, c, d = np.take_along_axis(some, order, axis=1).T
    c, d = (c - a) / (b - a), (d - a) / (b - a)
    sign = np.where(c.imag < 0, -1, 1)
    wanted = np.stack((c.real, sign * c.imag, d.real, sign * d.imag), axis=1)
    np.testing.assert_allclose(code, wanted, atol=1e-12)
    cell = np.floor(stepped(code) / 256).astype(int)
    assert np.all((cell >= 0) & (cell < RASTER))
    number = cell @ STRIDES
    assert np.all((number >= 0) & (number < CELLS))
    assert np.all(code >= LOW)


@given(seeds, st.floats(1e-5, 0.2))
@settings(max_examples=30, deadline=None)
def test_a_flattened_quad_has_the_distances_of_the_sphere(seed, size):
    rng = np.random.default_rng(seed)
    middle = rng.normal(size=(20, 1, 3))
    middle /= np.linalg.norm(middle, axis=2)[:, :, None]
    vectors = middle + size * rng.uniform(-1, 1, (20, 4, 3)) / 3
    vectors /= np.linalg.norm(vectors, axis=2)[:, :, None]
    flat = flattened(vectors)
    for a, b in ((0, 1), (1, 2), (0, 3)):
        arc = 2 * np.arcsin(np.linalg.norm(vectors[:, a] - vectors[:, b], axis=1) / 2)
        np.testing.assert_allclose(abs(flat[:, a] - flat[:, b]), arc, rtol=2 * size**2 + 1e-9, atol=1e-15)


@pytest.mark.parametrize("z", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_a_quad_is_flattened_at_the_poles_and_on_the_equator_alike(z):
    spots = np.array(z) + 1e-3 * np.array([(0, 0, 0), (1, 0, 0.5), (0, 1, 0), (1, 1, -1)])
    vectors = spots / np.linalg.norm(spots, axis=1)[:, None]
    flat = flattened(vectors[None])[0]
    assert abs(flat[0] - flat[1]) == pytest.approx(np.linalg.norm(vectors[0] - vectors[1]), rel=1e-5)


@pytest.mark.long
@given(st.integers(0, 30), st.integers(0, 30))
def test_all_quads_are_all_and_no_more(count, since):
    got = all_quads(count, since=since)
    wanted = {
        (a, b, c, d) for d in range(count) for c in range(d) for b in range(c) for a in range(b) if d >= since
    }
    assert set(map(tuple, got.tolist())) == wanted
    assert len(got) == len(wanted)


def test_rounds_together_ask_each_quad_of_the_brightest_once():
    z = np.exp(1j * np.arange(24)) * np.arange(1, 25) * 20
    plain = [ask for ask in QUAD_QUERIES if not ask.neighbors and not ask.side_deg and ask.error_px < 1]
    asked = [tuple(quad) for ask in plain for quad in frame_quads(ask, z).tolist()]
    assert len(asked) == len(set(asked)) == 24 * 23 * 22 * 21 // 24


def test_quads_of_neighbors_are_local_and_differ():
    rng = np.random.default_rng(3)
    z = rng.uniform(0, 1000, 80) + 1j * rng.uniform(0, 1000, 80)
    got = frame_quads(QuadQuery(0, 80, neighbors=6), z)
    assert len(got) == len(set(map(tuple, got.tolist())))
    rank = np.argsort(np.argsort(abs(z[:, None] - z[None, :]), axis=1), axis=1)
    # one corner of each quad has the three others among its six nearest
    held = [min(max(rank[i, j] for j in quad) for i in quad) for quad in got]
    assert max(held) == 6
    assert len(frame_quads(QuadQuery(0, 80, neighbors=6, most=50), z)) == 50


@pytest.mark.parametrize("focal_px", [None, 1e7])
def test_a_quad_too_small_for_the_tolerance_is_not_asked(focal_px):
    z = np.array([0, 100 + 1j, 51 + 30j, 20 + 60j, 2003 + 5j, 11 + 1990j, 907 + 811j])
    ask = QuadQuery(0, 7, error_px=1.0, tolerance=4e-3)
    code, corners, tolerance = frame_codes(ask, z, all_quads(7), 1000 + 1000j, focal_px)
    assert len(code) == len(corners) == len(tolerance)
    assert len(code) == 34  # of 35: all but the one of the first four, 100 px wide
    widest = abs(z[corners[:, 0]] - z[corners[:, 1]])
    np.testing.assert_allclose(tolerance, np.maximum(1.0 / widest, 4e-4))
    flat, _ = codes(z[np.sort(corners, axis=1)])
    np.testing.assert_allclose(code, flat, atol=1e-6)


@given(seeds)
@settings(max_examples=20)
def test_star_numbers_survive_packing(seed):
    rng = np.random.default_rng(seed)
    first = rng.integers(9000, 3_400_000, 200)
    stars = np.column_stack((first, *(first + rng.integers(-9000, 9000, 200) for _ in range(3))))
    packed, fits = pack(stars)
    np.testing.assert_array_equal(unpack(packed), stars[fits])
    near = (abs(stars[:, 1:] - stars[:, :1] + 0.5) < 8192).all(axis=1)
    np.testing.assert_array_equal(fits, near)
