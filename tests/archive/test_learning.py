"""What solved frames teach of their cameras, and what they don't."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.archive.folder import RunFolder
from mountnav.archive.learning import LEAST_FRAMES, _arc, learned
from mountnav.archive.tables import FRAME_TABLE, SOLUTION_TABLE, write_table


def _chunk(run: RunFolder, number: int, scales: list[float], **more: object) -> None:
    run.chunk(number).mkdir(parents=True)
    rows: list[dict[str, Any]] = [{"number": 100 * number + at} for at in range(len(scales))]
    camera = {"instrument": "SBIG", "telescope": "C11"}
    write_table(run.chunk(number) / "frames.parquet", FRAME_TABLE, [row | camera for row in rows])
    solved = [
        row
        | {"scale_arcsec_px": scale, "rotation_deg": 350.0 + 2.0 * at, "parity": 1, "width_px": 9}
        | {"height_px": 7, "false_probability": 1e-30}
        | more
        for at, (row, scale) in enumerate(zip(rows, scales, strict=True))
    ]
    write_table(run.chunk(number) / "solutions.parquet", SOLUTION_TABLE, solved)


def test_a_scale_is_learned_of_frames_that_agree(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    _chunk(run, 0, [2.0 + 0.001 * at for at in range(9)])
    _chunk(run, 1, [1.0])  # one odd frame of ten
    (found,) = learned(run, [1, 0])
    assert found == learned(run, [0, 1])[0]
    assert found.prior is not None
    assert (found.instrument, found.telescope, found.width_px, found.height_px) == ("SBIG", "C11", 9, 7)
    assert found.prior.frames == 9
    assert 1.99 < found.prior.scale_low_arcsec_px < 2.0
    assert 2.008 < found.prior.scale_high_arcsec_px < 2.02
    assert (found.rotation_low_deg, found.rotation_high_deg % 360.0) == (350.0, 6.0)


@pytest.mark.parametrize(
    ("scales", "more", "why"),
    [
        ([2.0] * (LEAST_FRAMES - 1), {}, "fewer than"),
        ([2.0] * 10 + [1.0] * 5, {}, "scales differ"),
    ],
)
def test_few_frames_or_several_optics_teach_nothing(
    tmp_path: Path, scales: list[float], more: dict[str, object], why: str
) -> None:
    run = RunFolder(tmp_path / "run")
    _chunk(run, 0, scales, **more)
    (found,) = learned(run, [0])
    assert found.prior is None
    assert why in found.why


def test_frames_that_may_be_false_have_no_say(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run")
    _chunk(run, 0, [2.0] * 10, false_probability=1e-6)
    assert learned(run, [0]) == []


def test_thousands_of_cameras_and_frames_are_cut_to_those_that_teach_most(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mountnav.archive.learning.MOST_CAMERAS", 2)
    monkeypatch.setattr("mountnav.archive.learning.MOST_FRAMES", 9)
    run = RunFolder(tmp_path / "run")
    for number, width in enumerate((30, 10, 20)):
        _chunk(run, number, [2.0] * (10 - number), width_px=width)
    assert [(one.width_px, one.frames) for one in learned(run, [0, 1, 2])] == [(10, 9), (30, 9)]


@given(st.floats(0.0, 359.0), st.lists(st.floats(0.0, 170.0), max_size=20))
def test_the_arc_has_all_angles_and_is_the_shortest(start: float, further: list[float]) -> None:
    low, high = _arc([(start + one) % 360.0 for one in (0.0, *further)])
    assert (high - low) % 360.0 == pytest.approx(max(further, default=0.0), abs=1e-9)
