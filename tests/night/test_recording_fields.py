"""A recording with a field missing is told with its file and line, however deep the field lies."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mountnav.errors import BadRequest
from mountnav.night.recording import read_recording, reading_of


def _written(path: Path, *lines: dict[str, object]) -> Path:
    path.write_text("".join(json.dumps(one) + "\n" for one in lines), encoding="utf-8")
    return path


def test_a_missing_field_is_told_with_its_place(tmp_path: Path) -> None:
    path = _written(
        tmp_path / "night.jsonl",
        {"kind": "header", "version": read_version()},
        {"kind": "event", "utc": "2026-11-21T00:00:00+00:00"},
        {"kind": "reading", "utc": "2026-11-21T00:00:01+00:00", "reading": {"pier_side": None, "place": {}}},
    )
    recording = read_recording(path)
    with pytest.raises(BadRequest, match=r"night\.jsonl: line 2 has no 'event'"):
        recording.lines[1].facts["event"]
    with pytest.raises(BadRequest, match=r"line 3, reading, place has no 'is'"):
        reading_of(recording.lines[2].facts["reading"])
    assert recording.lines[1].facts.get("event") is None


def read_version() -> int:
    from mountnav.night.recording import VERSION

    return VERSION
