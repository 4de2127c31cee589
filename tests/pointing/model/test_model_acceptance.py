"""A new model takes the old one's place only if it predicts better, unseen points included."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from mountnav.errors import BadRequest, ModelRefused
from mountnav.pointing.model.acceptance import judge, make
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.model import model_of
from tests.pointing.model.model_data import SIX, pmfit, spoiled, telescope
from tests.present import present

TRUTH = {"CH": 200.0, "ME": 150.0, "MA": -90.0, "TF": 20.0}
WHEN = datetime(2026, 11, 22, tzinfo=UTC)


def looks(seed, n=30, truth=TRUTH, **more):
    return telescope("equatorial", truth, n=n, seed=seed, **more)


def test_better_than_nothing_is_accepted():
    found = fit(looks(1), SIX)
    told = judge(found, held_out=looks(2, 8), fresh=looks(3, 4))
    assert told.accepted
    assert told.held_out == 8
    assert present(told.new_held_out_arcsec) < 5.0 < 50.0 < present(told.old_held_out_arcsec)
    assert present(told.fresh_chance) > 0.0027
    assert "before to" in told.reasons[0]


def test_better_than_an_old_one_that_is_worn_out():
    worn = model_of(fit(looks(1, truth={"CH": 100.0, "ME": 50.0}), SIX), made_utc=WHEN)
    assert judge(fit(looks(2), SIX), old=worn, held_out=looks(4, 8)).accepted


def test_an_old_one_that_is_better_stays():
    good = model_of(fit(looks(1, 100, noise_arcsec=1.0), SIX), made_utc=WHEN)
    # a few poor looks near each other
    poor = fit(looks(5, 8, noise_arcsec=25.0), SIX)
    told = judge(poor, old=good, held_out=looks(6, 8, noise_arcsec=2.0))
    assert not told.accepted
    assert any("the old model" in reason for reason in told.reasons)


@pytest.mark.long
def test_noise_alone_makes_no_model():
    accepted = [
        judge(
            fit(looks(seed, 16, truth={}, noise_arcsec=20.0), SIX),
            held_out=looks(seed + 50, 6, truth={}, noise_arcsec=20.0),
        ).accepted
        for seed in range(8)
    ]
    assert sum(accepted) <= 1


def test_fresh_points_that_disagree():
    found = fit(looks(1), SIX)
    moved = looks(3, 5)
    moved = replace(moved, read_lat_rad=moved.read_lat_rad + np.radians(30.0 / 3600.0))
    told = judge(found, fresh=moved)
    assert not told.accepted
    assert "did something move" in told.reasons[-1]
    # in a segment of their own the zero points are theirs: only the geometry is checked
    assert judge(found, fresh=replace(moved, segment_ids=("later",))).accepted
    other = replace(looks(3, 5, truth=TRUTH | {"ME": 300.0}), segment_ids=("later",))
    assert not judge(found, fresh=other).accepted
    with pytest.raises(BadRequest, match="2 fresh points"):
        judge(found, fresh=looks(3, 2))


@pytest.mark.long
def test_true_models_pass_the_fresh_check_nearly_always():
    passed = [judge(fit(looks(seed), SIX), fresh=looks(seed + 100, 5)).accepted for seed in range(20)]
    assert sum(passed) >= 19


@pytest.mark.long
def test_a_model_is_made_of_all_points_and_judged_by_each_in_turn(shared):
    made = make(pmfit(shared))
    assert made.judged.accepted
    assert made.judged.held_out == 39
    assert len(made.fit.observations) == 39
    assert made.fit.loo_arcsec <= 2.2
    judged = made.judged
    assert present(judged.new_held_out_arcsec) < 6.0 < 30.0 < present(judged.old_held_out_arcsec)


def test_spoiled_data_make_a_model_too(shared):
    made = make(spoiled(pmfit(shared), 4)[0], terms=SIX)
    assert made.judged.accepted
    assert made.fit.after.population_rms_arcsec < 6.5


def test_too_few_points():
    with pytest.raises(ModelRefused, match="5 points are too few"):
        make(looks(1, 5))
    assert make(looks(1, 8)).judged.held_out == 0
