"""Dither patterns: bounded, repeatable, spread out; and settling as looks tell it."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.guiding.dither import DitherPlan, Settle


@given(
    st.sampled_from(["random", "spiral", "ring"]),
    st.floats(0.01, 600.0),
    st.integers(2, 1000),
    st.integers(0, 2**31 - 1),
    st.integers(0, 100_000),
)
def test_no_step_leaves_the_bound_and_each_is_told_again_the_same(
    pattern: str, bound: float, steps: int, seed: int, number: int
) -> None:
    plan = DitherPlan(pattern, bound, steps, seed)  # type: ignore[arg-type]
    east, north = plan.step(number)
    assert math.hypot(east, north) <= bound * (1.0 + 1e-12)
    assert DitherPlan(pattern, bound, steps, seed).step(number) == (east, north)  # type: ignore[arg-type]
    assert plan.step(0) == (0.0, 0.0)


@pytest.mark.parametrize("pattern", ["spiral", "ring"])
def test_the_steps_of_a_turn_are_all_apart(pattern: str) -> None:
    plan = DitherPlan(pattern, 10.0, 9)  # type: ignore[arg-type]
    places = [plan.step(number) for number in range(1, 10)]
    apart = [math.dist(a, b) for at, a in enumerate(places) for b in places[at + 1 :]]
    assert min(apart) > 2.5


def test_random_steps_differ_by_seed_and_fill_the_disk() -> None:
    plan = DitherPlan("random", 10.0, seed=3)
    places = [plan.step(number) for number in range(1, 400)]
    assert len(set(places)) == len(places)
    assert sum(math.hypot(*place) < 10.0 / math.sqrt(2.0) for place in places) == pytest.approx(200, abs=50)
    assert DitherPlan("random", 10.0, seed=4).step(1) != plan.step(1)


@pytest.mark.parametrize(("bound", "steps"), [(0.0, 9), (math.nan, 9), (601.0, 9), (10.0, 1), (10.0, 1001)])
def test_a_plan_that_makes_no_sense_is_refused(bound: float, steps: int) -> None:
    with pytest.raises(BadRequest):
        DitherPlan("ring", bound, steps)


def test_settled_is_so_many_looks_in_a_row() -> None:
    settle = Settle(1.0, 3)
    assert [settle.saw(off) for off in (0.5, 0.5, 2.0, 0.1, 0.2)] == [False] * 5
    settle.missed()
    assert [settle.saw(off) for off in (0.5, 1.0, 0.9)] == [False, False, True]
    assert not settle.saw(math.nan)
