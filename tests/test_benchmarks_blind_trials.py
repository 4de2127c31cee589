"""The random trials of the blind search: their truths are true, and none of their answers is false."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

from benchmarks.blind_trials import EPOCH_YR, KINDS, Tally, run, table, trial_of
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Hint
from mountnav.identification.search import identify

SEED = 2_027


@pytest.mark.long
def test_what_is_said_to_be_a_sky_is_found_there_with_a_hint():
    kinds = list(KINDS)
    outcomes: Counter[Any] = Counter()
    for number in range(kinds.index("sky"), 20 * len(kinds), len(kinds)):
        trial = trial_of(number, SEED)
        (truth,) = trial.truths
        scale = truth.scale_arcsec_px
        got = identify(
            trial.measurements,
            embedded_catalog(),
            Hint(truth.center, 0.1, 0.98 * scale, 1.02 * scale),
            epoch_yr=EPOCH_YR,
            budget_s=5.0,
        )
        tally = Tally()
        tally.add(trial, got)
        outcomes += Counter(right=tally.right, wrong=tally.wrong)
    assert outcomes["wrong"] == 0
    assert outcomes["right"] >= 18


def test_the_same_number_gives_the_same_list():
    for number in range(len(KINDS)):
        one, again = trial_of(number, SEED), trial_of(number, SEED)
        assert one.truths == again.truths
        assert one.measurements.x_px.tolist() == again.measurements.x_px.tolist()
        assert bool(one.truths) == (one.kind not in ("even", "clustered", "raster"))


def _tallies(trials, seed, index, *, budget_s):
    tallies: dict[str, Tally] = {}
    run(trials, seed, budget_s, index, tallies)
    told = "\n".join(table(tallies))
    assert sum(one.wrong for one in tallies.values()) == 0, told
    return tallies


@pytest.mark.parametrize(("trials", "right"), [(45, 4), pytest.param(90, 8, marks=pytest.mark.long)])
def test_no_answer_to_random_lists_is_wrong_and_skies_are_found(sky_index, trials, right):
    tallies = _tallies(trials, SEED, sky_index, budget_s=2.0)  # enough on a busy machine
    assert tallies["sky"].right >= right
    assert all(tallies[kind].right == 0 for kind in ("even", "clustered", "raster"))


@pytest.mark.first
@pytest.mark.long
def test_no_answer_to_two_hundred_random_lists_is_wrong(sky_index):
    _tallies(200, SEED + 1, sky_index, budget_s=0.1)
