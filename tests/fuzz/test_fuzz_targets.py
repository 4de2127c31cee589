"""Each target over its kept corpus and some mutations of it; `python -m tests.fuzz` goes on for longer."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz.__main__ import mutated
from tests.fuzz.targets import TARGETS, corpus

pytestmark = pytest.mark.filterwarnings("ignore")  # what libraries find odd about an input


@pytest.mark.parametrize("name", TARGETS)
def test_the_kept_inputs_break_nothing(name: str) -> None:
    for data in (b"", *corpus(name)):
        TARGETS[name].run(data)


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=10)  # CI tries hundreds of each: `python -m tests.fuzz`
@given(seed=st.integers(0, 2**32 - 1))
def test_mutations_break_nothing(name: str, seed: int) -> None:
    rng, inputs = random.Random(seed), corpus(name)
    TARGETS[name].run(mutated(rng.choice(inputs), inputs, rng))
