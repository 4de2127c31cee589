"""Models of ordinary nights, as the benchmark of that name makes them: syncs, play, a worm, false looks."""

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from api.cli.model import fit_lines, fit_record, model_lines
from benchmarks.ordinary_nights import START, judged, night
from mountnav.errors import ModelRefused
from mountnav.pointing.model.acceptance import make
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.mechanical import mechanical
from mountnav.pointing.model.model import model_of
from mountnav.pointing.model.visits import visits
from tests.pointing.model.model_data import telescope

GERMAN, FORK, ALTAZ = 0, 7, 2


@pytest.fixture(scope="module")
def nights():
    return {seed: night(seed) for seed in (GERMAN, FORK, ALTAZ)}


@pytest.fixture(scope="module")
def given(nights):
    return {seed: judged(one, tuple(one.geometry_terms)) for seed, one in nights.items()}


@pytest.mark.long
@pytest.mark.parametrize("seed", [GERMAN, FORK, ALTAZ])
def test_what_was_planted_comes_back_within_its_errors(nights, given, seed):
    told, _ = given[seed]
    assert set(told.z) == set(nights[seed].geometry_terms)
    assert max(map(abs, told.z.values())) < 3.0, told.z
    assert told.accepted
    assert told.true_left_out <= 0.03 * told.looks
    assert told.false_kept == 0
    assert told.with_arcsec < 0.2 * told.without_arcsec


@pytest.mark.long
@pytest.mark.parametrize(
    "seed", [GERMAN, pytest.param(FORK, marks=pytest.mark.long), pytest.param(ALTAZ, marks=pytest.mark.long)]
)
def test_chosen_terms_are_those_that_were_planted(nights, given, seed):
    told, _ = judged(nights[seed], "auto", given[seed][0].sigma_arcsec)
    assert max(map(abs, told.z.values())) < 3.0, told.z
    assert len(told.spurious) <= 1, told.spurious
    assert told.accepted
    assert told.true_left_out <= 0.03 * told.looks
    assert told.with_arcsec < 0.2 * told.without_arcsec


@pytest.mark.long
def test_one_leave_one_out_everywhere_and_what_is_unknown_is_told(given):
    made = given[GERMAN][1]
    model = model_of(made.fit, made_utc=START)
    loo = made.fit.loo_arcsec
    assert made.judged.new_loo_arcsec == model.loo_arcsec == loo
    record: Any = fit_record(made, model, None)
    told = record["loo_arcsec"], record["judgement"]["new_loo_arcsec"], record["model"]["loo_arcsec"]
    assert told == (loo, loo, loo)
    # the model's own lines are what `model show` prints
    shown, printed = "\n".join(model_lines(model)), "\n".join(fit_lines(made, model))
    assert f"predicted to {loo:.2f}″" in shown
    assert printed.count(f"{loo:.2f}″") >= 2
    left = made.fit.left_out_arcsec[made.fit.counted]
    left = left[np.isfinite(left[:, 0])]
    assert loo == pytest.approx(math.sqrt(np.mean(np.sum(left**2, axis=1))))
    assert "nan" not in printed + shown + json.dumps(record, allow_nan=False)
    if made.fit.after.sky_rms_arcsec is None:
        assert "unknown" in printed


def test_more_unknowns_than_points_is_unknown_and_no_number():
    """Each look but a few in a segment of its own."""
    m = telescope("equatorial", {"CH": 300.0, "ME": 200.0}, n=60)
    segment = np.arange(60) // 2
    many = replace(m, segment=segment.astype(np.int64), segment_ids=tuple(f"s{n}" for n in range(30)))
    found = fit(many, ("CH", "ME"), join_segments=False)
    assert found.after.sky_rms_arcsec is None
    model = model_of(found, made_utc=START)
    assert model.sky_rms_arcsec is None
    assert "sky RMS (n-k) unknown" in "\n".join(model_lines(model))


def test_looks_at_one_target_are_one_point(nights):
    lived = nights[GERMAN]
    m = mechanical(lived.looks, lived.conversion)
    made = visits(m)
    pairs = np.unique(np.stack([m.segment, m.targets], axis=1), axis=0)
    assert len(pairs) <= len(made.points) < 0.75 * len(m)
    # a false look among its like is a point of its own
    for index in np.flatnonzero(lived.false):
        assert np.sum(made.of == made.of[index]) == 1
    # and looks that nobody knows the target of are taken as they are
    alone = telescope("equatorial", {"CH": 300.0}, n=20)
    assert visits(alone).points is alone


@pytest.mark.long
def test_a_good_mount_gets_no_model_that_is_worse():
    """Of noise, play and the worm alone nothing is made that isn't better than nothing."""
    lived = night(160)
    told, _ = judged(lived, "auto")
    assert not told.accepted or told.with_arcsec <= told.without_arcsec


def test_never_more_than_a_fifth_is_left_out():
    """When a third of the looks disagrees with a model, the model is wrong."""
    m = telescope("equatorial", {"CH": 300.0, "ME": 200.0, "MA": 100.0}, n=60, noise_arcsec=1.0)
    off = np.where(np.arange(60) % 3 == 0, np.radians(0.05), 0.0)
    found = fit(replace(m, read_lat_rad=m.read_lat_rad + off), ("CH", "ME", "MA"))
    assert np.sum(~found.used) <= 12
    assert found.loo_arcsec > 50.0


@pytest.mark.long
def test_collimation_and_non_perpendicularity_that_overlap_are_told(nights, given):
    made = given[ALTAZ][1]
    value = dict(zip(made.fit.terms, made.fit.sigma_arcsec, strict=True))
    assert value["CA"] > 5.0
    assert any("CA" in note and "NPAE" in note and "told apart" in note for note in made.fit.notes)


def test_a_night_without_way_between_targets_makes_no_model():
    lived = night(GERMAN, targets=2)
    with pytest.raises(ModelRefused):
        make(mechanical(lived.looks, lived.conversion))
