"""Wide lenses, drawn and solved; a sample of the benchmark, with seeds that its figures don't use."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks.wide_fields import asked, drawn_lens, field_errors_px

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex

FIRST = 5000


@pytest.mark.long
def test_lists_of_wide_lenses_are_solved_over_the_whole_field(sky_index: BlindIndex) -> None:
    right = 0
    for seed in range(FIRST, FIRST + 10):
        wide = drawn_lens(seed)
        verdict = asked(wide, sky_index, lists=True)
        if verdict.solution is None:
            continue
        errors = field_errors_px(wide, verdict)
        told = any("not proven" in note for note in verdict.notes)
        assert np.median(errors) < 0.2, wide.name
        assert errors.max() < 1.0 or told, wide.name
        right += 1
    assert right >= 8


@pytest.mark.long
def test_no_scrambled_wide_field_is_solved(sky_index: BlindIndex) -> None:
    for seed in range(FIRST, FIRST + 12):
        assert asked(drawn_lens(seed), sky_index, scrambled=True).solution is None


@pytest.mark.long
@pytest.mark.parametrize(("name", "blind"), [("equisolid 150°", True), ("bent 40°", False)])
def test_a_frame_with_planets_and_the_moon_is_held_to_its_corners(
    sky_index: BlindIndex, name: str, blind: bool
) -> None:
    wide = next(
        one
        for one in map(drawn_lens, range(FIRST, FIRST + 400))
        if one.name == name and (one.hint() is None) == blind and not one.horizon
    )
    verdict = asked(wide, sky_index)
    assert verdict.solution is not None, verdict.detail
    errors = field_errors_px(wide, verdict)
    assert np.sqrt(np.mean(errors**2)) < (0.1 if name.startswith("bent") else 0.2)
    assert verdict.solution.mode.endswith("/lens")
