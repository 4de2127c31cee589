"""A recording with a field missing is told with its file and line, however deep the field lies."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path

import pytest

from mountnav.errors import BadRequest
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.navigation.reading_history import Meanwhile
from mountnav.night.recording import as_json, read_recording, reading_of, verdict_of
from mountnav.night.replay_inputs import meanwhile_of
from mountnav.sky.coordinates import Icrs
from mountnav.solution import MOVED_KEY, Times, Verdict
from tests.navigation.sync_rig import solution_at


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


def test_what_the_sky_moved_in_a_frame_comes_back_as_it_was() -> None:
    # syncs are decided by it
    quality = SkyQuality(50, StarImages.TRAILED, 6.0, 0.6, 12.0, 100.0, 5.0, 0.0, None, 0.0)
    verdict = Verdict(
        solution_at(Icrs(10.0, 20.0), 0.0), None, "", 50, Times(), {MOVED_KEY: 3.5}, quality=quality
    )
    again = verdict_of(json.loads(json.dumps(as_json(verdict))))
    assert again.apart_px == 7.0
    assert again.quality == quality
    still = verdict_of(json.loads(json.dumps(as_json(Verdict(verdict.solution, None, "", 50, Times())))))
    assert still.apart_px == 0.0
    assert still.quality is None


@pytest.mark.parametrize("tolerance_arcsec", [10.0, math.inf])
def test_the_tolerance_of_a_frames_work_comes_back_as_it_was(tolerance_arcsec: float) -> None:
    told = Meanwhile(None, 31.0, datetime(2026, 11, 21, tzinfo=UTC), "s", None, "", tolerance_arcsec)
    assert meanwhile_of(json.loads(json.dumps(as_json(told)))) == told
