"""Fits against PMFIT's published results, spoiled data, and telescopes whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.errors import BadRequest, ModelRefused
from mountnav.pointing.model.acceptance import predicted
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.terms import ALTAZ
from tests.pointing.model.model_data import SIX, pmfit, spoiled, telescope
from tests.present import present

# [SPK manual, section on PMFIT]: what PMFIT prints for this file; its sigmas are √2 larger than ours
PUBLISHED = {
    "IH": (-92.258, 4.034),
    "ID": (-126.738, 2.273),
    "CH": (44.210, 3.266),
    "ME": (64.848, 2.495),
    "MA": (-2.992, 1.395),
    "TF": (10.993, 1.647),
}


def test_pmfit_is_reproduced(shared):
    found = fit(pmfit(shared), SIX)
    assert found.used.all()
    assert found.after.sky_rms_arcsec == pytest.approx(5.780, abs=0.01)
    assert found.before.sky_rms_arcsec == pytest.approx(36.26, abs=0.02)
    assert found.loo_arcsec == pytest.approx(5.68, abs=0.01)
    assert found.terms == ("IH", "ID", "CH", "ME", "MA", "TF")
    for name, value, sigma in zip(found.terms, found.coefficients_arcsec, found.sigma_arcsec, strict=True):
        told, told_sigma = PUBLISHED[name]
        assert value == pytest.approx(told, abs=0.15), name
        assert np.sqrt(2.0) * sigma == pytest.approx(told_sigma, rel=0.06), name
    n, k = 39, 6
    assert found.after.population_rms_arcsec == pytest.approx(
        found.after.sky_rms_arcsec * np.sqrt((n - k) / n)
    )


def test_the_six_terms_are_these_and_no_others(shared):
    m = pmfit(shared)
    for instead in (("IH", "ID", "NP", "ME", "MA", "TF"), ("IH", "ID", "CH", "ME", "MA", "FO")):
        assert present(fit(m, instead).after.sky_rms_arcsec) > 5.80


@pytest.mark.long
def test_spoiled_observations(shared):
    clean = pmfit(shared)
    for seed in range(25):
        made, wrong = spoiled(clean, seed)
        found = fit(made, SIX)
        # the geometry, on the data as they were
        geometry = dict(zip(found.geometry_terms, found.coefficients_arcsec[2:], strict=True))
        off = predicted(clean, np.ones(39, dtype=bool), clean, geometry)
        assert np.sqrt(np.mean(np.sum(off**2, axis=1))) <= 6.5, seed
        assert found.after.population_rms_arcsec <= 6.5, seed
        # a gross error stays in only where it is alone in its segment and tells nothing
        for index in np.flatnonzero(found.used & wrong):
            assert np.sum(found.used & (made.segment == made.segment[index])) == 1, seed


@pytest.mark.long
def test_many_spoiled_observations(shared):
    clean = pmfit(shared)
    for seed in range(1000, 1150):
        made, _ = spoiled(clean, seed)
        found = fit(made, SIX)
        geometry = dict(zip(found.geometry_terms, found.coefficients_arcsec[2:], strict=True))
        off = predicted(clean, np.ones(39, dtype=bool), clean, geometry)
        assert np.sqrt(np.mean(np.sum(off**2, axis=1))) <= 7.0, seed
        assert found.after.population_rms_arcsec <= 6.5, seed


def test_without_segments_syncs_would_spoil_it(shared):
    made, _ = spoiled(pmfit(shared), 1, outliers=0.0)
    together = replace(made, segment=np.zeros_like(made.segment), segment_ids=("s",))
    assert present(fit(made, SIX).after.sky_rms_arcsec) < 7.0
    assert present(fit(together, SIX, max_sigma_arcsec=1e6).after.sky_rms_arcsec) > 100.0


def test_segments_that_agree_are_joined():
    m = telescope("equatorial", {"CH": 200.0, "ME": 100.0, "MA": -50.0, "TF": 20.0}, n=60, noise_arcsec=5.0)
    order = np.arange(60)
    split = replace(m, segment=(order // 10).astype(np.int64), segment_ids=tuple("abcdef"))
    found = fit(split, SIX)
    assert [one.segment_ids for one in found.segments] == [tuple("abcdef")]
    apart = fit(split, SIX, join_segments=False)
    assert len(apart.segments) == 6
    assert found.sigma_arcsec[found.terms.index("CH")] < apart.sigma_arcsec[apart.terms.index("CH")]
    # but not over a sync
    jumped = replace(split, read_lon_rad=split.read_lon_rad + np.where(order < 30, 0.0, np.radians(0.1)))
    parts = [one.segment_ids for one in fit(jumped, SIX).segments]
    assert parts == [("a", "b", "c"), ("d", "e", "f")]


ALTAZ_TRUTH = {
    "IA": 300.0, "IE": -200.0, "CA": 120.0, "NPAE": 80.0, "AN": -60.0, "AW": 45.0, "TF": 150.0, "TX": 30.0,
    "ACES": 50.0, "ACEC": -40.0, "HASA2": 20.0, "HACA2": -15.0, "HVSA2": 12.0, "HVCA2": 10.0, "HZSA3": 8.0,
    "HZCA3": -9.0, "HZSE2": 25.0,
}  # fmt: skip


@pytest.mark.long
def test_every_altaz_term_comes_back():
    assert set(ALTAZ) <= set(ALTAZ_TRUTH)
    for seed in range(3):
        m = telescope("altaz", ALTAZ_TRUTH, n=300, noise_arcsec=1.0, seed=seed, both_sides=True)
        found = fit(m, tuple(ALTAZ_TRUTH))
        off = (found.coefficients_arcsec - [ALTAZ_TRUTH[name] for name in found.terms]) / found.sigma_arcsec
        assert np.max(np.abs(off)) < 4.0
        assert np.sqrt(np.mean(off**2)) < 1.7  # the sigmas are as large as the errors
        assert found.after.sky_rms_arcsec == pytest.approx(np.sqrt(2.0), rel=0.12)


@pytest.mark.long
def test_every_equatorial_term_comes_back():
    truth = {
        "IH": 5000.0, "ID": -3000.0, "CH": 400.0, "NP": 150.0, "ME": 900.0, "MA": -700.0, "TF": 60.0,
        "TX": 20.0, "FO": 40.0, "HCES": 50.0, "HCEC": -40.0, "DCES": 35.0, "DCEC": 25.0,
        "HHSH2": 15.0, "HHCH2": 12.0, "HDSH2": -10.0, "HDCH2": 9.0,
    }  # fmt: skip
    _comes_back(truth)
    _comes_back({name: value for name, value in truth.items() if name != "HCEC"} | {"DAF": 30.0})
    # the sagging axis is exactly a sum of these two
    with pytest.raises(ModelRefused, match="can't distinguish"):
        _comes_back(truth | {"DAF": 30.0})


def _comes_back(truth):
    m = telescope("equatorial", truth, n=400, noise_arcsec=1.0, both_sides=True)
    found = fit(m, tuple(truth))
    off = (found.coefficients_arcsec - [truth[name] for name in found.terms]) / found.sigma_arcsec
    assert np.max(np.abs(off)) < 4.0
    assert 0.5 < np.sqrt(np.mean(off**2)) < 1.7


def test_one_model_for_both_sides_of_the_pier():
    """[POINTING §5]: without side signs 849″, with those of CH and NP 132″, in mechanical angles 4.2″."""
    truth = {"CH": 900.0, "NP": 250.0, "ID": 200.0}
    names = ("IH", "ID", "CH", "NP", "ME", "MA", "TF")
    m = telescope("equatorial", truth, n=60, noise_arcsec=2.0, both_sides=True, seed=4)
    found = fit(m, names)
    assert present(found.after.sky_rms_arcsec) < 4.2
    assert found.used.all()
    # the same points with both sides taken for the normal posture
    folded = Mechanical(
        m.kind, m.site_latitude_rad, m.seen, np.zeros(60, dtype=bool),
        np.where(m.beyond, m.read_lon_rad + np.pi, m.read_lon_rad),
        np.where(m.beyond, np.pi - m.read_lat_rad, m.read_lat_rad),
        m.sigma_arcsec, m.segment, m.segment_ids,
    )  # fmt: skip
    off = fit(folded, names, max_sigma_arcsec=1e6).residuals_arcsec
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) > 500.0


@pytest.mark.long
@settings(max_examples=25, deadline=None)
@given(
    st.fixed_dictionaries(
        {name: st.floats(-1800.0, 1800.0) for name in ("IH", "ID", "CH", "ME", "MA", "TF")}
    ),
    st.integers(0, 2**16),
)
def test_without_noise_the_truth_comes_back_exactly(truth, seed):
    m = telescope("equatorial", truth, n=40, noise_arcsec=0.0, seed=seed, both_sides=True)
    found = fit(m, SIX)
    assert found.coefficients_arcsec == pytest.approx([truth[name] for name in found.terms], abs=1e-3)


def test_near_the_pole_distances_are_those_of_the_sky():
    """A point 6′ from the pole that is 10″ off is 10″ off, whatever its hour angle says."""
    m = telescope(
        "equatorial", {"CH": 100.0, "ME": 50.0, "MA": 30.0, "TF": 10.0}, n=40, noise_arcsec=2.0, seed=3
    )
    close = telescope("equatorial", {"CH": 100.0, "ME": 50.0, "MA": 30.0, "TF": 10.0}, n=1)
    from mountnav.pointing.model.rigorous import axes_for, direction, geometry

    g = geometry("equatorial", m.site_latitude_rad, {"CH": 100.0, "ME": 50.0, "MA": 30.0, "TF": 10.0})
    seen = direction(np.array([0.5]), np.radians([89.9]))
    axes = axes_for(g, seen, np.array([False]))
    near = replace(
        close, seen=seen, read_lon_rad=axes.lon_rad, read_lat_rad=axes.lat_rad + np.radians(10 / 3600)
    )
    both = Mechanical(
        m.kind,
        m.site_latitude_rad,
        np.concatenate([m.seen, near.seen]),
        np.concatenate([m.beyond, near.beyond]),
        np.concatenate([m.read_lon_rad, near.read_lon_rad]),
        np.concatenate([m.read_lat_rad, near.read_lat_rad]),
        np.concatenate([m.sigma_arcsec, near.sigma_arcsec]),
        np.concatenate([m.segment, near.segment]),
        ("s",),
    )
    found = fit(both, SIX)
    assert np.hypot(*found.residuals_arcsec[-1]) == pytest.approx(10.0, abs=2.0)
    assert found.coefficients_arcsec[2] == pytest.approx(100.0, abs=5 * found.sigma_arcsec[2])


def test_what_the_points_do_not_determine_is_refused():
    m = telescope("equatorial", {"CH": 100.0}, n=4)
    with pytest.raises(ModelRefused, match=r"4 usable points in 1 segment\(s\) can't tell 9 unknowns"):
        fit(m, ("CH", "ME", "MA", "TF", "NP", "FO", "DAF"))
    narrow = telescope("equatorial", {"CH": 100.0}, n=40, lowest_deg=84.0)
    with pytest.raises(ModelRefused, match=r"can't distinguish|too uncertain"):
        fit(narrow, ("CH", "NP", "ME", "MA", "TF", "TX"))
    with pytest.raises(ModelRefused, match="too uncertain"):
        fit(telescope("equatorial", {}, n=10, noise_arcsec=300.0), SIX, max_sigma_arcsec=100.0)
    with pytest.raises(BadRequest, match="not a term"):
        fit(m, ("IH", "ID", "XX"))


def test_points_with_larger_errors_count_less():
    m = telescope("equatorial", {"CH": 100.0, "ME": 50.0}, n=60, noise_arcsec=1.0)
    rng = np.random.default_rng(2)
    poor = np.arange(60) % 2 == 0
    off = np.where(poor, rng.normal(0.0, 40.0, 60), 0.0)
    mixed = replace(
        m, read_lat_rad=m.read_lat_rad + np.radians(off / 3600), sigma_arcsec=np.where(poor, 40.0, 0.5)
    )
    weighted = fit(mixed, SIX)
    same = fit(replace(mixed, sigma_arcsec=np.full(60, 0.5)), SIX)
    k = weighted.terms.index("ME")
    assert abs(weighted.coefficients_arcsec[k] - 50.0) < 5.0 * weighted.sigma_arcsec[k]
    assert weighted.sigma_arcsec[k] < 0.7 * same.sigma_arcsec[k]
