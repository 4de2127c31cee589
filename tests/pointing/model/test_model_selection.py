"""Automatic choice of terms: as good as TPOINT's on its author's data, and nothing made of noise."""

from collections import Counter
from typing import Any

import numpy as np
import pytest

from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.leave_one_out import loo_rms
from mountnav.pointing.model.linear import Segments, ZeroPoints, solve
from mountnav.pointing.model.robust import robust_fit
from mountnav.pointing.model.selection import select
from mountnav.pointing.model.terms import NON_PERPENDICULARITY
from tests.pointing.model.model_data import pmfit, spoiled, telescope


def test_pmfit_data(shared):
    found = fit(pmfit(shared))
    assert found.loo_arcsec <= 2.0
    assert found.used.all()
    assert len(found.terms) <= 14
    assert [one.added for one in found.steps].count(True) >= len(found.terms) - 2
    assert np.linalg.cond(found.correlation) < 1e6


def test_what_is_left_out_is_really_left_out(shared):
    """The hat matrix against fits without each point in turn."""
    m = pmfit(shared)
    whole = robust_fit(m, ("CH", "ME", "MA", "TF"))
    by_hat = whole.linear.left_out()
    for index in (0, 7, 20, 35, 38):
        others = np.arange(len(m)) != index
        zero = ZeroPoints.of(Segments(m.segment, 1), whole.state.cos_lat, np.where(others, whole.weight, 0.0))
        one = solve(whole.state.columns, whole.state.residuals_arcsec, zero)
        assert one.residuals[index] == pytest.approx(by_hat[index], abs=1e-6)


def test_left_out_with_segments(shared):
    made, _ = spoiled(pmfit(shared), 2, outliers=0.0)
    whole = robust_fit(made, ("CH", "ME", "MA"))
    by_hat = whole.linear.left_out()
    segments = Segments(made.segment, len(made.segment_ids))
    for index in range(0, 39, 6):
        weight = np.where(np.arange(39) != index, whole.weight, 0.0)
        one = solve(
            whole.state.columns,
            whole.state.residuals_arcsec,
            ZeroPoints.of(segments, whole.state.cos_lat, weight),
        )
        if np.sum(weight[made.segment == made.segment[index]]) > 0.0:
            assert one.residuals[index] == pytest.approx(by_hat[index], abs=1e-7)
        else:
            assert np.isnan(by_hat[index]).all()


@pytest.mark.long
def test_spoiled_data_are_no_worse_than_the_core(shared):
    """With 14 unknowns more in 36 points there is less to choose by, but never is it worse than without."""
    found = [fit(spoiled(pmfit(shared), seed)[0]).loo_arcsec for seed in range(6)]
    assert max(found) < 5.68
    assert np.median(found) < 2.6


@pytest.mark.long
def test_true_terms_are_found_and_noise_is_not():
    truth = {"CH": 60.0, "ME": 80.0, "MA": -40.0, "TF": 30.0, "HHSH2": 25.0, "FO": 20.0}
    chosen: Counter[Any] = Counter()
    for seed in range(6):
        s = select(telescope("equatorial", truth, n=80, noise_arcsec=3.0, seed=seed))
        assert {"CH", "ME", "MA", "HHSH2", "FO"} <= set(s.terms), s.terms
        chosen.update(s.terms)
        assert loo_rms(s.fit.linear.left_out(), s.fit.used) < 1.15 * 3.0 * np.sqrt(2.0)
    assert sum(count for name, count in chosen.items() if name not in truth) <= 6


@pytest.mark.long
def test_a_perfect_mount_gets_hardly_any_terms():
    several = [
        len(select(telescope("equatorial", {}, n=40, noise_arcsec=5.0, seed=seed)).terms) for seed in range(8)
    ]
    assert np.mean(several) < 1.5


def test_few_points_get_few_terms():
    truth = {"CH": 300.0, "ME": 400.0, "MA": 200.0, "TF": 20.0}
    for n in (3, 4, 5, 6, 8):
        s = select(telescope("equatorial", truth, n=n, noise_arcsec=2.0, seed=2))
        assert len(s.terms) <= 2 * n - 3


def test_non_perpendicularity_comes_last():
    truth = {"CA": 100.0, "AN": 30.0, "AW": -20.0, "TF": 100.0, "HZSE2": 20.0}
    for seed in range(3):
        s = select(telescope("altaz", truth, n=100, noise_arcsec=1.0, seed=seed))
        added = [one.term for one in s.steps if one.added]
        name = NON_PERPENDICULARITY["altaz"]
        assert name not in added or added.index(name) >= len(added) - 2
