"""Each target over its kept corpus and some mutations of it; `python -m tests.fuzz` goes on for longer."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.fuzz import files, targets
from tests.fuzz.__main__ import mutated
from tests.fuzz.targets import TARGETS, corpus

pytestmark = pytest.mark.filterwarnings("ignore")  # what libraries find odd about an input


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
def test_the_kept_inputs_break_nothing(name: str) -> None:
    for data in (b"", *corpus(name)):
        TARGETS[name].run(data)


MANY_PARSERS = {"lx200", "nexstar", "skywatcher", "alpaca", "alpaca-parameters", "typed"}
"""Each input goes to parsers of several things, and is refused by most of them."""


@pytest.mark.parametrize("name", sorted(set(TARGETS) - MANY_PARSERS))
def test_a_seed_is_no_stranger_to_its_parser(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where each is refused at the door, whatever is made of them is refused there too."""
    refused: list[str] = []

    @contextmanager
    def told(*kinds: type[Exception]) -> Iterator[None]:
        try:
            yield
        except kinds as refusal:
            refused.append(str(refusal))

    monkeypatch.setattr(targets, "_promised", told)
    monkeypatch.setattr(files, "_said", lambda refusal: refused.append(str(refusal)))
    for data in TARGETS[name].seeds():
        refused.clear()
        TARGETS[name].run(data)
        if not refused:
            return
    pytest.fail(f"the last seed is refused: {refused}")


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=10)  # CI tries hundreds of each: `python -m tests.fuzz`
@given(seed=st.integers(0, 2**32 - 1))
def test_mutations_break_nothing(name: str, seed: int) -> None:
    rng, inputs = random.Random(seed), corpus(name)
    TARGETS[name].run(mutated(rng.choice(inputs), inputs, rng))
