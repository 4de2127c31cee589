"""Preliminary identification: the true shift is found or none, and never a wrong one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.series import star_list, two_lists
from mountnav.identification.preliminary import ADVICE, Outcome, preliminary
from mountnav.identification.settings import PreliminarySettings
from mountnav.identification.shift import make_sources, sources_of
from mountnav.measuring.measurements import Measurements
from tests.measuring.nearest import nearest
from tests.present import present

PAPER = PreliminarySettings()
MEASURED = PreliminarySettings.measured()
SIZE = (1500, 1000)
some = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def error_px(got, shift) -> float:
    return math.hypot(got.pairing.dx_px - shift[0], got.pairing.dy_px - shift[1])


def test_defaults_are_the_papers() -> None:
    values = (PAPER.r_rej_px, PAPER.n_min_ack, PAPER.m_reg, PAPER.n_mea_reg, PAPER.tries)
    assert values == (20.0, 0.7, 4, 3, 3)


@some
@given(
    st.integers(0, 10**6),
    st.sampled_from([40, 200, 1200]),
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
)
def test_any_shift_up_to_half_the_frame_is_found_by_the_measured_profile(seed, stars, across, along) -> None:
    shift = (across * SIZE[0], along * SIZE[1])
    first, second = two_lists(np.random.default_rng(seed), stars, SIZE, shift, 0.0)
    got = preliminary(first, second, MEASURED)
    if not got.found:
        # a quarter of a frame of 40 stars may hold so few of them that no shift can be proved
        places = np.column_stack((first.x_px - shift[0], first.y_px - shift[1]))
        distance, _ = nearest(np.column_stack((second.x_px, second.y_px)), places)
        assert (distance < 0.5).sum() <= 5, got.detail
        assert got.outcome in (Outcome.CHANCE, Outcome.NO_SHIFT, Outcome.TOO_FEW)
        return
    assert error_px(got, shift) < 0.15
    assert got.false_probability <= 1e-9


@some
@given(st.integers(0, 10**6), st.floats(-0.05, 0.05), st.floats(-0.05, 0.05))
def test_small_shifts_are_found_by_the_papers_profile(seed, across, along) -> None:
    shift = (across * SIZE[0], along * SIZE[1])
    first, second = two_lists(np.random.default_rng(seed), 100, SIZE, shift, 0.0)
    got = preliminary(first, second, PAPER)
    assert got.found, got.detail
    assert got.tries <= 3
    # the plain mean of (3, 4) has false neighbors in it: within its own error all the same
    pairing = present(got.pairing)
    assert abs(pairing.dx_px - shift[0]) < 6 * pairing.dx_sigma_px + 0.1
    assert abs(pairing.dy_px - shift[1]) < 6 * pairing.dy_sigma_px + 0.1
    plain_x = first.x_px[sources_of(first, PAPER).index[pairing.first]]
    plain_x = plain_x - second.x_px[sources_of(second, PAPER).index[pairing.second]]
    assert pairing.dx_px == pytest.approx(plain_x.mean(), abs=1e-9)
    assert pairing.dx_sigma_px == pytest.approx(plain_x.std(ddof=1) / math.sqrt(plain_x.size), rel=1e-9)


@pytest.mark.long
@some
@given(st.integers(0, 10**6), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_exchanging_the_frames_turns_the_sign(seed, across, along) -> None:
    shift = (across * SIZE[0], along * SIZE[1])
    first, second = two_lists(np.random.default_rng(seed), 200, SIZE, shift, 0.0)
    there, back = preliminary(first, second, MEASURED), preliminary(second, first, MEASURED)
    assert there.found
    assert back.found
    assert present(there.pairing).dx_px == pytest.approx(-present(back.pairing).dx_px, abs=0.05)
    assert present(there.pairing).dy_px == pytest.approx(-present(back.pairing).dy_px, abs=0.05)


@pytest.mark.long
@settings(max_examples=120, deadline=None)
@given(
    st.integers(0, 10**6),
    st.sampled_from([3, 6, 30, 300, 1500]),
    st.sampled_from([(1500, 1000), (256, 256)]),
    st.sampled_from([PAPER, MEASURED]),
)
def test_unrelated_lists_are_refused(seed, stars, size, profile) -> None:
    rng = np.random.default_rng(seed)
    first, _ = two_lists(rng, stars, size, (0.0, 0.0), 0.0)
    _, second = two_lists(rng, stars, size, (0.0, 0.0), 0.0)
    got = preliminary(first, second, profile)
    assert not got.found, got.detail
    assert got.outcome is not Outcome.FOUND
    assert ADVICE[got.outcome] in got.detail


@pytest.mark.long
def test_unrelated_clusters_are_refused() -> None:
    """Lists that both crowd in the middle overlap by far more than even ones."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        lists = []
        for _ in range(2):
            x, y = rng.normal(750, 60, 200), rng.normal(500, 60, 200)
            x, y = np.r_[x, rng.uniform(0, 1500, 60)], np.r_[y, rng.uniform(0, 1000, 60)]
            lists.append(star_list(x, y, rng.pareto(1.2, x.size) + 1, *SIZE))
        for profile in (PAPER, MEASURED):
            assert not preliminary(lists[0], lists[1], profile).found


def with_more(measurements: Measurements, x, y, flux) -> Measurements:
    m = measurements
    return star_list(
        np.concatenate((m.x_px, x)),
        np.concatenate((m.y_px, y)),
        np.concatenate((m.flux, flux)),
        m.width_px,
        m.height_px,
    )


@pytest.mark.long
@some
@given(st.integers(0, 10**6), st.floats(-0.08, 0.08), st.floats(-0.08, 0.08))
def test_half_the_stars_missing_a_trail_and_a_bleed(seed, across, along) -> None:
    """Trail and bleed come as strings of bright sources without flags, as a naive detector gives them."""
    rng = np.random.default_rng(seed)
    shift = (across * SIZE[0], along * SIZE[1])
    first, second = two_lists(rng, 250, SIZE, shift, 0.5)
    s = np.linspace(0, 1, 60)
    second = with_more(second, 1500 * s, 100 + 700 * s, np.full(60, 1e4))
    second = with_more(second, np.full(40, 612.0), np.linspace(300, 700, 40), np.full(40, 3e4))
    got = preliminary(first, second, MEASURED)
    if got.found:
        assert error_px(got, shift) < 0.1
    else:
        # the trail fits itself along its own direction, and hot pixels show a shift of less than a pixel too
        assert got.outcome in (Outcome.CHANCE, Outcome.NO_SHIFT, Outcome.AMBIGUOUS)


def test_half_missing_with_trail_and_bleed_is_found_as_a_rule() -> None:
    rng = np.random.default_rng(11)
    found = 0
    for _ in range(50):
        shift = tuple(rng.uniform(-80, 80, 2))
        first, second = two_lists(rng, 250, SIZE, shift, 0.5)
        s = np.linspace(0, 1, 60)
        second = with_more(second, 1500 * s, 100 + 700 * s, np.full(60, 1e4))
        got = preliminary(first, second, MEASURED)
        found += got.found
        assert not got.found or error_px(got, shift) < 0.1
    assert found >= 47


def test_the_papers_share_refuses_half_missing_and_says_so() -> None:
    first, second = two_lists(np.random.default_rng(4), 100, SIZE, (30.0, 10.0), 0.5)
    got = preliminary(first, second, PAPER)
    assert got.outcome is Outcome.NO_SHIFT
    assert got.tries == 3
    assert 0 < got.share < 0.7
    assert "assumed center is far off" in got.detail


@pytest.mark.parametrize("size", [SIZE, (795, 596), (512, 512)])
@pytest.mark.parametrize("stars", [40, 300, 1500])
def test_the_papers_cameras_are_followed_however_many_stars_they_see(size, stars) -> None:
    """Of 1000 measurements in 512 × 512 px some lie in 99 % of the strobes, of the brightest 96 in 37 %."""
    for seed in range(5):
        first, second = two_lists(np.random.default_rng(seed), stars, size, (7.0, -6.0), 0.0)
        got = preliminary(first, second, PAPER)
        assert got.found, got.detail
        assert got.tries <= 3
        assert (
            error_px(got, (7.0, -6.0))
            < 6 * math.hypot(present(got.pairing).dx_sigma_px, present(got.pairing).dy_sigma_px) + 0.1
        )


def test_crowded_strobes_are_named_as_such_and_a_narrower_one_helps() -> None:
    first, second = two_lists(np.random.default_rng(5), 300, (256, 256), (3.0, 1.0), 0.0)
    got = preliminary(first, second, PAPER)
    assert got.outcome is Outcome.CROWDED
    assert got.chance_share > 0.5
    assert f"r_rej_px = {got.narrower_px:.1f} leaves 15 % to chance here" in got.detail
    narrower = preliminary(first, second, replace(PAPER, r_rej_px=round(got.narrower_px, 1)))
    assert narrower.found, narrower.detail
    assert error_px(narrower, (3.0, 1.0)) < 0.5
    assert preliminary(first, second, MEASURED).found


def test_hot_pixels_stand_still_and_are_not_followed() -> None:
    rng = np.random.default_rng(6)
    hot_x, hot_y, hot = rng.uniform(0, 1500, 20), rng.uniform(0, 1000, 20), rng.uniform(2, 6, 20)
    first, second = (with_more(m, hot_x, hot_y, hot) for m in two_lists(rng, 150, SIZE, (7.3, -4.1), 0.0))
    got = preliminary(first, second, MEASURED)
    assert got.found
    assert error_px(got, (7.3, -4.1)) < 0.05


@pytest.mark.long
def test_hot_pixels_alone_never_say_that_the_field_stood_still() -> None:
    """After a slew to another field, hot pixels are all that two frames share."""
    rng = np.random.default_rng(7)
    for _ in range(20):
        hot_x, hot_y, hot = rng.uniform(0, 1500, 60), rng.uniform(0, 1000, 60), rng.uniform(2, 6, 60)
        first, _ = two_lists(rng, 150, SIZE, (0.0, 0.0), 0.0)
        _, second = two_lists(rng, 150, SIZE, (0.0, 0.0), 0.0)
        got = preliminary(with_more(first, hot_x, hot_y, hot), with_more(second, hot_x, hot_y, hot), MEASURED)
        assert not got.found, got.detail


def test_a_regular_pattern_is_ambiguous() -> None:
    x, y = (side.ravel() for side in np.meshgrid(np.arange(50.0, 1500, 100), np.arange(50.0, 1000, 100)))
    rng = np.random.default_rng(8)
    flux = rng.uniform(1, 2, x.size)
    got = preliminary(
        star_list(x, y, flux, *SIZE), star_list(x + 12.0, y + 5.0, rng.permutation(flux), *SIZE), MEASURED
    )
    assert got.outcome is Outcome.AMBIGUOUS


@pytest.mark.parametrize("count", [0, 1, 3])
def test_too_few_measurements(count: int) -> None:
    full, _ = two_lists(np.random.default_rng(9), 50, SIZE, (0.0, 0.0), 0.0)
    few = star_list(full.x_px[:count], full.y_px[:count], full.flux[:count], *SIZE)
    for pair in ((few, full), (full, few), (few, few)):
        assert preliminary(*pair).outcome is Outcome.TOO_FEW


def test_standard_error_is_what_repeated_draws_scatter_by() -> None:
    off, stated = [], []
    rng = np.random.default_rng(10)
    for _ in range(60):
        first, second = two_lists(rng, 120, SIZE, (31.0, -17.0), 0.2)
        got = preliminary(first, second, MEASURED)
        assert got.pairing is not None
        off.append((got.pairing.dx_px - 31.0, got.pairing.dy_px + 17.0))
        stated.append((got.pairing.dx_sigma_px, got.pairing.dy_sigma_px))
    ratio = np.sqrt(np.mean(np.square(off))) / np.sqrt(np.mean(np.square(stated)))
    assert 0.7 < ratio < 1.4


def test_selection_takes_the_brightest_of_each_region() -> None:
    rng = np.random.default_rng(12)
    x, y = rng.uniform(0, 400, 500), rng.uniform(0, 400, 500)
    sources = make_sources(
        x, y, np.full(500, 0.1), np.arange(500), (-0.5, -0.5, 399.5, 399.5), PreliminarySettings()
    )
    cell = np.clip((y[sources.proposing] + 0.5) // 100, 0, 3) * 4 + (x[sources.proposing] + 0.5) // 100
    assert np.unique(cell, return_counts=True)[1].tolist() == [3] * 16
    brightest = np.flatnonzero((x < 99.5) & (y < 99.5))[:3]
    assert set(brightest) <= set(sources.proposing)
