"""The narrow telescopes of the paper under the invented sky: solved with a deep catalog, refused without."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.narrow_fields import main, results, solved_row
from benchmarks.narrow_frames import Field, Result, chosen_field, instant, result_of
from mountnav.catalog.embedded import embedded_catalog
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from mountnav.solving.settings import SolveSettings

NARROW = ("prompt-8", "mayaki-azt-3", "vihorlat-vnt")
WHEN = instant(2026.9)


def run(preset: str, kind: str, numbers: list[int], seed: int = 1) -> list[Result]:
    settings = SolveSettings()
    return list(results(preset, numbers, seed=seed, kind=kind, radius_deg=0.25, when=WHEN, settings=settings))


def failures(done: list[Result]) -> list[str]:
    return [f"{one.field.label}: {one.outcome}, {one.told}" for one in done if one.outcome != "solved"]


@pytest.mark.long
@pytest.mark.parametrize("preset", NARROW)
def test_narrow_frames_are_solved_with_a_deep_catalog(preset):
    done = run(preset, "gaia", [0, 1, 8, 9])
    assert failures(done) == []
    assert max(one.center_px for one in done) < 0.2


@pytest.mark.long
@pytest.mark.parametrize(("preset", "frames"), [("mayaki-azt-3", 1), ("vihorlat-vnt", 2)])
def test_with_tycho_alone_the_field_is_said_to_be_too_narrow(preset, frames):
    fields = (chosen_field(preset, 1, number, radius_deg=0.25) for number in range(100))
    poor = [one.number for one in fields if stars_round(one) < 3][:frames]
    done = run(preset, "tycho-2", poor)
    assert {one.outcome for one in done} == {"catalog-too-shallow"}
    assert all("Tycho-2" in one.told for one in done)


def stars_round(field: Field) -> int:
    """Tycho-2's stars in the circle round the frame."""
    return len(embedded_catalog().cone(field.center, field.optics.half_diagonal_deg, epoch_yr=2026.9))


def test_a_number_fixes_its_frame_and_fields_are_everywhere():
    fields = [chosen_field("prompt-8", 1, number, radius_deg=0.25) for number in range(200)]
    assert fields[17] == chosen_field("prompt-8", 1, 17, radius_deg=0.25)
    assert fields[17] != chosen_field("prompt-8", 2, 17, radius_deg=0.25)
    assert all(abs(one.center.dec_deg) >= 88.0 for one in fields[8::10])
    assert (
        min(one.center.dec_deg for one in fields[8::10])
        < 0
        < max(one.center.dec_deg for one in fields[8::10])
    )
    assert all(min(one.center.ra_deg, 360 - one.center.ra_deg) <= 0.2 for one in fields[9::10])
    assert {one.optics.parity for one in fields} == {1, -1}
    errors = np.array([separation_arcsec(one.center, one.believed) for one in fields]) / 60
    assert errors.max() < 15 * 0.96
    assert np.median(errors) == pytest.approx(3 * math.sqrt(2 * math.log(2)), abs=0.6)
    lows = [one.hint.scale_low_arcsec_px or math.nan for one in fields]
    scales = (
        np.array([one.optics.scale_arcsec_px / low for one, low in zip(fields, lows, strict=True)]) * 0.97
    )
    assert 0.003 < scales.std() < 0.005


class Elsewhere:
    """The embedded catalog, all of it moved a little north: whoever matches it is 20″ off."""

    name = "elsewhere"

    def cone(self, center, radius_deg, *, epoch_yr, mag_limit=None):
        south = displaced(center, 0.0, -20.0)
        stars = embedded_catalog().cone(south, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)
        return replace(stars, dec_deg=stars.dec_deg + 20.0 / 3600.0)


@pytest.mark.long
def test_an_answer_beside_the_truth_is_counted_as_wrong():
    field = chosen_field("ison-nm", 1, 3, radius_deg=0.25)
    field = replace(field, center=Icrs(300.0, 30.0), believed=Icrs(300.0, 30.0))
    field = replace(field, hint=replace(field.hint, center=field.believed))
    done = result_of(field, Elsewhere(), when=WHEN, settings=SolveSettings())
    assert done.outcome == "WRONG"
    assert done.center_px == pytest.approx(20.0 / field.optics.scale_arcsec_px, abs=0.3)
    assert "| 0.0% | 1 | none |" in solved_row("ison-nm", "elsewhere", [done])


@pytest.mark.long
def test_the_command_tells_all_tables(capsys):
    code = main(["--preset", "vihorlat-vnt", "--frames", "2", "--catalog", "gaia"])
    out = capsys.readouterr().out
    assert code == 0
    assert "| vihorlat-vnt | gaia | 2 | 100.0% | 0 | none |" in out
    assert "| vihorlat-vnt | gaia | 10 % | Δmag |" in out
    assert "Not solved" not in out
    main(["--preset", "vihorlat-vnt", "--only", "0", "--catalog", "tycho-2"])
    out = capsys.readouterr().out
    assert "- `--preset vihorlat-vnt --seed 1 --only 0 --catalog tycho-2`: catalog-too-shallow" in out


@pytest.mark.long
@pytest.mark.parametrize(
    ("preset", "frames"), [("vihorlat-vnt", 30), ("mayaki-azt-3", 15), ("prompt-8", 10), ("ison-nm", 2)]
)
def test_at_least_99_percent_are_solved_and_none_wrongly(preset, frames):
    done = run(preset, "gaia", list(range(frames)), seed=4)
    assert not any(one.outcome == "WRONG" for one in done)
    solved = np.mean([one.outcome == "solved" for one in done])
    assert solved >= 0.99, failures(done)


@pytest.mark.long
def test_with_ucac4_whatever_has_twelve_stars_is_solved_and_nothing_wrongly():
    done = run("vihorlat-vnt", "ucac4", list(range(30)), seed=4)
    done += run("mayaki-azt-3", "ucac4", list(range(20)), seed=4)
    assert not any(one.outcome == "WRONG" for one in done)
    rich = [one for one in done if one.stars >= 12]
    assert len(rich) > 20
    assert failures(rich) == []
