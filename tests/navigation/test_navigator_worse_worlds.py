"""Drawn worlds in which something was done wrongly, or no way out worked, each for a cause of its own."""

from __future__ import annotations

import pytest

from benchmarks.worse_worlds import TARGETS, Outcome, lived

BROKE = [
    # after a stop on its way it was planned again, and the end of that stop took the next slew as well
    ("side-swapped", 216),
    # the way alone is refused, by the side that is told wrongly
    ("side-swapped", 206),
    # takes no syncs, and is too far off to count by sight
    ("syncs-refused", 109),
    ("zero-point-5deg", 105),
    # lost by 36°: after its sync it believed to be below the ground, was stopped, and could not be seen again
    ("syncs-reversed", 316),
    # so near the pole that what a reversed sync did is a large turn of the hour angle
    ("syncs-reversed", 230),
    # stood at the meridian, told the wrong side, and let itself go 60° past it: no reading showed that
    ("side-swapped", 507),
    ("side-swapped", 327260005),
    # each correction by the pole was turned by the zero point, and halved what was left
    ("zero-point-5deg", 327260004),
    # by the pole the axis turned on by degrees before it stood
    ("syncs-refused", 204),
    ("new-telescope", 327260005),
]
WIRED = [
    # the limits, judged by the wrong longitude, were named as the cause
    ("service-longitude", 203),
    ("service-clock-10min-obeyed", 4),
    ("service-clock-1h-obeyed", 3),
    ("service-longitude-obeyed", 3),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "seed"), BROKE)
def test_nothing_is_wrong_and_each_refusal_has_a_way_out(name: str, seed: int) -> None:
    outcome = Outcome(name)
    lived(name, seed, outcome)
    assert not outcome.wrong
    assert not outcome.lost
    assert sum(outcome.results.values()) == TARGETS


@pytest.mark.long
@pytest.mark.parametrize(("name", "seed"), WIRED)
def test_wrong_clocks_and_sites_are_found_out_and_set_right(name: str, seed: int) -> None:
    outcome = Outcome(name)
    lived(name, seed, outcome)
    assert not outcome.wrong
    assert not outcome.lost
