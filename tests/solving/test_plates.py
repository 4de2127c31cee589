"""Photographic plates by `SolveSettings.exposures`: negatives, scratches, a wedge, several exposures."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.archive.plates import TAKEN_UTC, drawn_plate
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.sky.coordinates import Icrs
from mountnav.solving.exposures import looks_negative, mended_plate
from mountnav.solving.settings import SolveSettings
from mountnav.solving.solve import solve

SETTINGS = SolveSettings(blind="never", exposures=6)


@pytest.mark.long
@pytest.mark.parametrize("number", [1, 2, 5])
def test_each_exposure_of_a_plate_is_found_and_none_is_false(number: int) -> None:
    plate = drawn_plate(number)
    first = plate.exposures[0]
    frame = Frame(plate.scan, TAKEN_UTC, hint=Hint())
    hint = Hint(Icrs(first.ra_deg + 0.3, first.dec_deg - 0.2), 1.0)
    verdict = solve(frame, embedded_catalog(), hint=hint, settings=SETTINGS)
    assert verdict.solved
    assert plate.false(verdict) == 0
    assert 1 + len(verdict.further) == len(plate.exposures)
    assert any("negative" in note for note in verdict.notes) == plate.negative
    if verdict.further:
        assert f"{len(plate.exposures)} exposures on one plate" in verdict.notes


def test_a_plate_is_mended_of_what_is_too_narrow_or_too_wide_for_a_star() -> None:
    y, x = np.mgrid[:200, :300]
    sky = 1000.0 + np.random.default_rng(3).normal(0.0, 5.0, (200, 300))
    star = 800.0 * np.exp(-((x - 200) ** 2 + (y - 100) ** 2) / (2 * 4.0**2))
    plate = sky + star
    plate[20:60, 30:90] += 3000.0  # a step of a wedge
    along = np.arange(140)
    plate[along, 60 + along] -= 500.0  # a scratch, through the star's edge
    plate[along, 130 + along // 2] = 4000.0
    mended = mended_plate(plate)
    assert np.isnan(mended[20:60, 30:90]).all()
    assert not np.isnan(mended[:, 120:]).any()
    assert np.abs(mended - sky - star)[100:, 100:].max() < 120.0


def test_a_plate_is_told_for_a_negative_by_what_stands_out_of_its_sky() -> None:
    sky = np.random.default_rng(3).normal(1000.0, 5.0, (200, 200))
    stars = sky.copy()
    stars[::20, ::10] += 800.0
    assert not looks_negative(stars)
    assert looks_negative(2000.0 - stars)
    assert not looks_negative(np.full((10, 10), np.nan))
