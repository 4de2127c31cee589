"""Files that hold no sky, at the doors of the solver: none is solved, none breaks anything; a sample."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.bad_inputs import DOORS, KINDS, Kept, Tally, bad_input, run_here

FIRST = 40_120
"""Seeds that the figures of the benchmark don't use, and of which few draw every kind."""
COUNT = 30


def test_the_same_seed_draws_the_same_file() -> None:
    for seed in range(FIRST, FIRST + 6):
        assert bad_input(seed) == bad_input(seed)


@pytest.mark.long
def test_no_bad_file_of_any_kind_is_solved_or_breaks_a_door(sky_index: object) -> None:
    # memory is the benchmark's to judge: this process has run other tests before
    tally = run_here(range(FIRST, FIRST + COUNT), DOORS, most_mb=math.inf)
    assert tally.bad == []
    assert sum(tally.asked.values()) == COUNT
    assert {name.split(": ")[1] for name in tally.asked} == set(KINDS)


@pytest.mark.long
def test_a_strip_of_true_stars_among_others_is_no_solution(sky_index: object) -> None:
    """Orion's sword in a strip of 35 px, mirrored: it was taken for the middle of a wide lens."""
    assert bad_input(200_398).kind == "list"
    assert run_here(range(200_398, 200_399), ("solve-field",), most_mb=math.inf).bad == []


def test_a_run_goes_on_from_what_is_kept(tmp_path: Path) -> None:
    kept = Kept.at(tmp_path / "kept", "astap")
    one = Tally(Counter({"astap: noise": 2}), ["seed 1"], 40.0)
    kept.add(range(2), one)
    with (tmp_path / "kept").open("a") as file:
        file.write('{"how": "cut sho')
    kept.add(range(2, 4), one)
    again = Kept.at(tmp_path / "kept", "astap")
    assert [again.tally(part) for part in (range(2), range(2, 4), range(4, 6))] == [one, one, None]
    with pytest.raises(SystemExit, match="other doors"):
        Kept.at(tmp_path / "kept", "solve")
