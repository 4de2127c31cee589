"""Drift rates: the true rate within the stated error; jumps cut a series and never count as drift."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.series.drift import Drift, Track, fit_drift, joined, jumps
from tests.present import present


def track(
    minutes,
    rate=(20.0, -6.0),
    *,
    ra=100.0,
    dec=30.0,
    noise=0.05,
    seed=1,
    steps=(),
    anchors=None,
    anchor_errors=None,
) -> Track:
    """Centers of a drifting mount; `steps` are (point, east, north) jumps."""
    rng = np.random.default_rng(seed)
    minutes = np.asarray(minutes, dtype=float)
    east, north = rate[0] * minutes, rate[1] * minutes
    for point, across, along in steps:
        east[point:] += across
        north[point:] += along
    anchor = np.zeros(minutes.size, dtype=np.int64) if anchors is None else np.asarray(anchors)
    if anchor_errors is not None:
        east += np.asarray(anchor_errors)[anchor]
        north -= np.asarray(anchor_errors)[anchor]
    east, north = east + rng.normal(0, noise, east.size), north + rng.normal(0, noise, north.size)
    decs = dec + north / 3600
    middle = decs.mean() if decs.size else dec
    return Track(
        minutes,
        (ra + east / 3600 / np.cos(np.radians(middle))) % 360,
        decs,
        np.full(minutes.size, noise),
        anchor,
        np.full(minutes.size, 0.5),
    )


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-900, 900),
    st.floats(-900, 900),
    st.floats(0, 359.999),
    st.floats(-80, 80),
    st.integers(0, 10**6),
)
def test_rate_within_its_error(east, north, ra, dec, seed) -> None:
    got = fit_drift(track(np.arange(12), (east / 10, north / 10), ra=ra, dec=dec, seed=seed))
    assert got is not None
    # six errors: eleven degrees of freedom and a hundred numbers drawn
    assert abs(got.ra_arcsec_min - east / 10) < 6 * got.ra_sigma_arcsec_min
    assert abs(got.dec_arcsec_min - north / 10) < 6 * got.dec_sigma_arcsec_min
    assert got.ra_sigma_arcsec_min < 0.05


def test_stated_errors_are_what_repeated_draws_scatter_by() -> None:
    drifts = [fit_drift(track(np.arange(15), seed=seed)) for seed in range(200)]
    off = np.std([present(one).ra_arcsec_min - 20.0 for one in drifts])
    stated = np.median([present(one).ra_sigma_arcsec_min for one in drifts])
    assert 0.8 < off / stated < 1.3


def test_over_the_seam_of_right_ascension() -> None:
    whole = track(np.arange(10), (600.0, 0.0), ra=359.5)
    assert whole.ra_deg.min() < 1 < 359 < whole.ra_deg.max()
    assert present(fit_drift(whole)).ra_arcsec_min == pytest.approx(600.0, abs=0.1)
    assert jumps(whole, 5.0) == []


def test_jumps_cut_and_the_rate_is_untouched_by_them() -> None:
    one = track(np.arange(20), steps=((7, 40.0, 0.0), (13, -15.0, 22.0)))
    assert jumps(one, 10.0) == [7, 13]
    parts = [present(fit_drift(one.part(a, b))) for a, b in ((0, 7), (7, 13), (13, 20))]
    whole = present(joined(parts))
    assert whole.ra_arcsec_min == pytest.approx(20.0, abs=5 * whole.ra_sigma_arcsec_min)
    assert whole.dec_arcsec_min == pytest.approx(-6.0, abs=5 * whole.dec_sigma_arcsec_min)
    assert whole.frames == 20


def test_a_gap_in_time_is_no_jump() -> None:
    assert jumps(track([0, 1, 2, 3, 60, 61, 62, 63]), 10.0) == []


def test_a_jump_among_three_frames() -> None:
    assert jumps(track([0, 1, 2], (1.0, 0.0), steps=((2, 300.0, 0.0),)), 10.0) == [2]


def test_one_wrong_center_has_no_say() -> None:
    one = track(np.arange(16))
    one.ra_deg[9] += 2.0 / 3600
    got = present(fit_drift(one))
    assert got.outliers == 1
    assert got.ra_arcsec_min == pytest.approx(20.0, abs=0.03)


def test_scatter_beyond_the_errors_widens_them() -> None:
    quiet, restless = track(np.arange(20)), track(np.arange(20), noise=2.0)
    restless = Track(
        restless.minutes, restless.ra_deg, restless.dec_deg, quiet.sigma_arcsec, quiet.anchor,
        quiet.anchor_sigma_arcsec,
    )  # fmt: skip
    assert (
        present(fit_drift(restless)).ra_sigma_arcsec_min > 10 * present(fit_drift(quiet)).ra_sigma_arcsec_min
    )


def test_an_anchors_error_is_no_drift() -> None:
    """Each solved frame is off by half an arcsecond: that must neither tilt the line nor go unseen."""
    off, stated = [], []
    for seed in range(60):
        errors = np.random.default_rng(seed).normal(0, 0.5, 3)
        got = present(
            fit_drift(
                track(np.arange(18), anchors=[0] * 6 + [1] * 6 + [2] * 6, anchor_errors=errors, seed=seed)
            )
        )
        off.append(got.ra_arcsec_min - 20.0)
        stated.append(got.ra_sigma_arcsec_min)
    assert 0.6 < np.std(off) / np.median(stated) < 1.4
    assert np.std(off) < 0.02


@pytest.mark.parametrize("minutes", [[], [0], [0, 1], [5, 5, 5]])
def test_no_rate_from_too_little(minutes) -> None:
    assert fit_drift(track(minutes)) is None


def test_joining_disagreeing_segments_widens_the_error() -> None:
    one = Drift(10.0, 0.0, 0.1, 0.1, 0.2, 5, 0)
    other = Drift(12.0, 0.0, 0.1, 0.1, 0.2, 5, 0)
    both = present(joined([one, other]))
    assert both.ra_arcsec_min == pytest.approx(11.0)
    assert both.ra_sigma_arcsec_min == pytest.approx(1.0, rel=0.05)
    assert both.dec_sigma_arcsec_min == pytest.approx(0.1 / np.sqrt(2), rel=0.01)
    assert joined([]) is None


def alike(count: int, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Residuals of which neighbors are alike: AR(1), scatter 1."""
    noise = rng.normal(0.0, 1.0, count)
    for number in range(1, count):
        noise[number] = rho * noise[number - 1] + np.sqrt(1.0 - rho**2) * noise[number]
    return noise


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "least", "most"),
    [
        ("white", 0.6, 1.15),
        ("seeing", 0.5, 1.4),
        ("wind", 0.5, 1.6),
        ("worm", 0.0, 1.3),
        ("scale", 0.7, 1.3),
    ],
)
def test_stated_rate_errors_cover_the_truth(kind, least, most) -> None:
    """It was six times too small where neighboring frames are alike (0.0029 for an error of 0.0169)."""
    misses = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        count = 40
        minutes = np.arange(count) * 0.5
        stated, scale_error = 0.03, 0.0
        if kind == "worm":
            off = [0.5 * np.sin(2 * np.pi * (minutes / 8.0 + rng.uniform())) for _ in range(2)]
        elif kind == "scale":
            scale_error = 1e-3
            off = [0.001 * rng.normal(size=count) for _ in range(2)]
        else:
            rho = {"seeing": 0.6, "wind": 0.9}.get(kind, 0.0)
            off = [0.2 * alike(count, rho, rng) for _ in range(2)]
        rate = np.array((20.0, -6.0))
        seen = rate * (1.0 + scale_error * rng.normal())
        north = seen[1] * minutes + off[1]
        dec = 30.0 + north / 3600
        ra = 100.0 + (seen[0] * minutes + off[0]) / 3600 / np.cos(np.radians(dec.mean()))
        zeros = np.zeros(count, dtype=np.int64)
        sigma = np.full(count, 0.001 if kind == "scale" else stated)
        got = fit_drift(Track(minutes.astype(float), ra, dec, sigma, zeros, np.full(count, 0.5), scale_error))
        assert got is not None
        misses += [
            (got.ra_arcsec_min - rate[0]) / got.ra_sigma_arcsec_min,
            (got.dec_arcsec_min - rate[1]) / got.dec_sigma_arcsec_min,
        ]
    if kind == "scale":
        misses = misses[::2]  # one error of the scale makes both
    assert least < float(np.sqrt(np.mean(np.clip(misses, -10, 10) ** 2))) < most


@pytest.mark.long
@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_the_error_of_few_frames_covers_the_truth_as_often_as_one_sigma_says(count):
    """Their scatter is known as badly as their rate: two thirds lie within the stated error all the same."""
    within = []
    for seed in range(300):
        rng = np.random.default_rng(seed)
        minutes = np.arange(count, dtype=float)
        east, north = (rate * minutes + 0.2 * rng.normal(size=count) for rate in (3.0, -1.0))
        dec = 30.0 + north / 3600
        ra = 100.0 + east / 3600 / np.cos(np.radians(dec.mean()))
        few = Track(
            minutes, ra, dec, np.full(count, 0.03), np.zeros(count, dtype=np.int64), np.full(count, 0.5)
        )
        got = fit_drift(few)
        assert got is not None
        within += [
            abs(got.ra_arcsec_min - 3.0) < got.ra_sigma_arcsec_min,
            abs(got.dec_arcsec_min + 1.0) < got.dec_sigma_arcsec_min,
        ]
    assert 0.6 < float(np.mean(within)) < 0.95
