"""Wide lenses, drawn and solved; a sample of the benchmark, with seeds that its figures don't use."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

import mountnav.solving.solve as solve_module
from benchmarks.wide_fields import asked, drawn_lens, field_errors_px
from mountnav.measuring.measurements import Flag, Measurements

if TYPE_CHECKING:
    from mountnav.frames import StarList
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
def test_a_lens_is_fitted_to_flagged_stars_where_its_middle_was_found_by_them(
    sky_index: BlindIndex, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a large quiet ground all of the sky passes for restless, and its stars for none."""
    wide = next(one for one in map(drawn_lens, range(FIRST, FIRST + 400)) if one.name == "equidistant 150°")
    measured = solve_module._measured_elsewhere

    def flagged(stars: StarList) -> Measurements:
        found = measured(stars)
        spared = np.arange(len(found)) % 20 == 0
        return replace(found, flags=np.where(spared, 0, int(Flag.NO_PEAK)))

    monkeypatch.setattr(solve_module, "_measured_elsewhere", flagged)
    verdict = asked(wide, sky_index, lists=True)
    assert verdict.solution is not None, verdict.detail
    errors = field_errors_px(wide, verdict)
    assert np.median(errors) < 0.2
    assert errors.max() < 1.0 or any("not proven" in note for note in verdict.notes)


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
