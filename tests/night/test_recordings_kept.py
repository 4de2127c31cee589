"""How long recordings are kept: old ones of the same telescope go when a night begins, and nothing else."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from mountnav.night.recording import NightRecording

NIGHT = datetime(2026, 11, 25, 22, tzinfo=UTC)
FILES = {
    "east-2026-10-01.jsonl": 400_000,
    "east-2026-11-20.jsonl": 400_000,
    "east-2026-11-24.jsonl": 400_000,
    "west-2026-10-01.jsonl": 400_000,
    "east-wing-2026-10-01.jsonl": 400_000,
    "notes.jsonl": 10,
    "east-2026-10-01.txt": 10,
}


@pytest.mark.parametrize(
    ("keep_days", "max_mb", "gone"),
    [
        (0.0, 0.0, set()),
        (30.0, 0.0, {"east-2026-10-01.jsonl"}),
        (0.0, 1.0, {"east-2026-10-01.jsonl"}),
        (0.0, 0.5, {"east-2026-10-01.jsonl", "east-2026-11-20.jsonl"}),
        (1e5, 1e-6, {"east-2026-10-01.jsonl", "east-2026-11-20.jsonl", "east-2026-11-24.jsonl"}),
    ],
)
def test_old_recordings_go(tmp_path: Path, keep_days: float, max_mb: float, gone: set[str]) -> None:
    for name, size in FILES.items():
        (tmp_path / name).write_bytes(b"x" * size)
    recording = NightRecording(
        tmp_path, {"telescope": "east"}, lambda _: "east-2026-11-25", keep_days=keep_days, max_mb=max_mb
    )
    recording.keep("reading", NIGHT, {})
    recording.close()
    assert recording.problem == ""
    assert {path.name for path in tmp_path.iterdir()} == {*FILES, "east-2026-11-25.jsonl"} - gone


def test_a_night_with_another_name_removes_nothing(tmp_path: Path) -> None:
    (tmp_path / "2026-10-01.jsonl").write_text("x")
    recording = NightRecording(tmp_path, {}, lambda _: "night", keep_days=1.0, max_mb=1e-6)
    recording.keep("reading", NIGHT, {})
    recording.close()
    assert {path.name for path in tmp_path.iterdir()} == {"2026-10-01.jsonl", "night.jsonl"}
