"""Frames with known places: solved where they can be, refused where they can't, and never wrong."""

import math
import random
from dataclasses import replace
from typing import Any

import pytest

from benchmarks.frames import Known, asked, read, real, rendered
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadFrame
from mountnav.frames import Frame, Hint
from mountnav.identification.search import identify
from mountnav.measuring.measure import measure
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Reason
from mountnav.solving.solve import SolveSettings, solve, solve_file
from mountnav.units import julian_year

pytestmark = pytest.mark.shared
BUDGET = SolveSettings(budget_s=5.0)
SHORT = SolveSettings(budget_s=1.5)


@pytest.fixture(scope="module")
def frames(shared) -> list[tuple[Known, Frame]]:
    """Every shared frame that can be read, with what is known of it."""
    pairs = [(known, read(known)) for known in rendered(shared) + real(shared)]
    return [(known, frame) for known, frame in pairs if not isinstance(frame, BadFrame)]


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.long)])
def test_known_frames_are_solved_and_none_wrongly(frames, every):
    """Every fifth one; the long one tries all."""
    judged = [(known, frame) for known, frame in frames if known.grade in "ABR"][::every]
    right: list[Any] = []
    missed: list[Any] = []
    wrong: list[Any] = []
    for known, frame in judged:
        verdict = solve(frame, embedded_catalog(), hint=asked(known, frame), settings=BUDGET)
        name = f"{known.path.parts[-2]}/{known.path.name}"
        if verdict.solution is None:
            missed.append((name, known, verdict.reason))
            assert verdict.reason is not None
            assert verdict.detail
            continue
        error = known.error_px(verdict)
        (right if error <= known.allowed_px() else wrong).append((name, known, round(error, 3)))
        assert known.parity in (None, verdict.solution.parity)
        assert abs(math.log(verdict.solution.scale_arcsec_px / known.scale_arcsec_px)) < 0.02
        middle = verdict.solution.icrs_at((frame.width_px - 1) / 2, (frame.height_px - 1) / 2)
        assert separation_arcsec(middle, verdict.solution.center) < 1e-4
        assert verdict.solution.false_probability < 1e-9
    print(f"right {len(right)} of {len(judged)}; missed {missed}; wrong {wrong}")
    assert not wrong
    drawn = [one for one in right if one[1].grade == "R" and one[1].field_deg > 0.5]
    assert len(drawn) == sum(known.grade == "R" and known.field_deg > 0.5 for known, _ in judged)
    assert len(drawn) == 9 or every > 1
    wide = [one for one in right if one[1].grade in "AB" and one[1].field_deg >= 0.5]
    possible = [one for one, _ in judged if one.grade in "AB" and one.field_deg >= 0.5]
    assert len(wide) >= 0.9 * len(possible)


@pytest.mark.parametrize("every", [5, pytest.param(1, marks=pytest.mark.long)])
def test_frames_without_sky_are_refused(frames, every):
    """Three of five frames, each with one of three hints; the long one tries all frames with all hints."""
    negative = [(known, frame) for known, frame in frames if known.grade == "N"]
    assert negative
    for number, (known, frame) in enumerate(negative):
        hints = (known.hint, Hint(Icrs(283.0, 0.0), 2.0), Hint(Icrs(10.0, 41.0), 1.0, 30.0, 80.0))
        for hint in hints[number % every :: every]:
            verdict = solve(frame, embedded_catalog(), hint=hint, settings=SHORT)
            assert not verdict.solved, known.path
            assert verdict.reason in (
                Reason.CATALOG_TOO_SHALLOW,
                Reason.CLOUD_OR_DEFOCUS,
                Reason.TIMED_OUT,
                Reason.TOO_FEW_MEASUREMENTS,
                Reason.NO_MATCH,
                Reason.CHANCE,
                Reason.BAD_FRAME,
            )


def test_no_center_is_no_hint(frames):
    _, frame = frames[0]
    verdict = solve(replace(frame, hint=Hint()), embedded_catalog())
    assert verdict.reason is Reason.NO_HINT


def test_a_place_that_only_an_alternative_knows_is_enough(frames):
    known, frame = next((known, frame) for known, frame in frames if known.path.name.startswith("E03"))
    header = Hint(alternatives=(known.hint,))
    verdict = solve(replace(frame, hint=header), embedded_catalog())
    assert verdict.solved, verdict.detail
    assert known.error_px(verdict) <= known.allowed_px()


@pytest.mark.long
def test_scale_may_be_unknown(frames):
    chosen = [
        (known, frame)
        for known, frame in frames
        if known.path.name.startswith(("E00", "tiny", "FINDER", "orion2"))
    ]
    for known, frame in chosen:
        verdict = solve(replace(frame, hint=Hint()), embedded_catalog(), hint=Hint(known.hint.center, 0.6))
        assert verdict.solved, (known.path, verdict.detail)
        assert known.error_px(verdict) <= known.allowed_px()


def test_files_and_uploads(shared, tmp_path):
    known = next(one for one in real(shared) if one.path.name.startswith("tiny"))
    for source in (known.path, known.path.read_bytes()):
        verdict = solve_file(source, embedded_catalog(), known.hint, name="tiny.fits.gz")
        assert verdict.solved, verdict.detail
        assert verdict.times.read_s > 0
    bad = solve_file(b"no image at all", embedded_catalog(), known.hint)
    assert bad.reason is Reason.BAD_FRAME


@pytest.mark.first
@pytest.mark.long
def test_wrong_places_never_solve(frames):
    chance = random.Random(7)
    tried = 0
    for known, frame in frames:
        if known.scale_arcsec_px is None:
            continue
        try:
            measurements = measure(frame)
        except BadFrame:
            continue
        epoch_yr = julian_year(frame.mid_exposure_utc) if frame.mid_exposure_utc else 2020.0
        for _ in range(1):
            place = Icrs(chance.uniform(0, 360), math.degrees(math.asin(chance.uniform(-1, 1))))
            if known.center and separation_arcsec(place, known.center) < 20 * 3600:
                continue
            hint = Hint(place, 0.5, known.scale_arcsec_px * 0.95, known.scale_arcsec_px * 1.05)
            got = identify(measurements, embedded_catalog(), hint, epoch_yr=epoch_yr, budget_s=1.5)
            assert got.reference is None, (known.path, place, got.detail, got.false_probability)
            tried += 1
    print(f"{tried} wrong places, none solved")
    assert tried > 40
