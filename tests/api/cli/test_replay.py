"""`mountnav replay` and `mountnav night`, as they are typed."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from api.cli.night import night_app, shown
from api.cli.replay import replay
from api.replay.recording_header import recording_header
from api.replay.replaying import turns_of
from mountnav.devices import MountReading
from mountnav.errors import BadRequest, DeviceMissing
from mountnav.night.events import Act, Decision, NightState, Tick, Why
from mountnav.night.memory import EventsKept
from mountnav.night.recording import VERSION, NightRecording, read_recording
from mountnav.settings.observatory import Settings
from mountnav.sky.coordinates import Apparent
from tests.api.nights.night_site import night_toml

START = datetime(2026, 11, 21, 20, tzinfo=UTC)
app = typer.Typer()
app.command("replay")(replay)
app.add_typer(night_app, name="night")


def recording(folder: Path) -> Path:
    """A minute of a night in which nothing happens but its beginning."""
    settings = Settings.parse(night_toml(folder, folder, folder / "safety.txt"))
    header = recording_header(settings.telescope[0], settings)
    kept = NightRecording(folder, header, lambda utc: "night")
    kept.keep("reading", START, {"reading": MountReading(Apparent(10.0, 20.0, START), START)})
    events = EventsKept(kept, lambda utc: "night")
    events.keep(NightState(), Tick(START, -30.0, "east-2026-11-21"), [Decision(Act.BEGIN, Why.DARK)])
    kept.close()
    return folder / "night.jsonl"


def test_exit_codes_and_what_is_shown(tmp_path: Path) -> None:
    path = recording(tmp_path)
    same = CliRunner().invoke(app, ["replay", str(path), "--all"])
    assert same.exit_code == 0, same.output
    assert "all as they were" in same.output
    assert "begin: it is dark" in same.output
    assert "1 decisions judged" in same.output
    # the night is said to have ended, and by these rules it doesn't
    path.write_text(path.read_text().replace('"begin"', '"end"').replace("it is dark", "daylight"))
    other = CliRunner().invoke(app, ["replay", str(path), "--json"])
    assert other.exit_code == 1
    told = json.loads(other.output)
    assert not told["same"]
    assert (told["judged"], told["not_judged"]) == (2, 0)
    assert [row["recorded"] for row in told["rows"]] == ["end: daylight", "-"]


def test_other_settings(tmp_path: Path) -> None:
    path = recording(tmp_path)
    config = tmp_path / "other.toml"
    toml = night_toml(tmp_path, tmp_path, tmp_path / "safety.txt")
    config.write_text(toml.replace("settle_s = 0.0", "settle_s = 0.0\nbegin_sun_below_deg = -80.0"))
    result = CliRunner().invoke(app, ["replay", str(path), "--config", str(config)])
    assert result.exit_code == 1
    assert "then: begin: it is dark" in result.output
    config.write_text(toml.replace('id = "east"', 'id = "north"'))
    with pytest.raises(BadRequest, match="no telescope east"):
        CliRunner().invoke(app, ["replay", str(path), "-c", str(config)], catch_exceptions=False)


def test_no_secret_is_recorded(tmp_path: Path) -> None:
    toml = night_toml(tmp_path, tmp_path, tmp_path / "s").replace(
        "port = 0", f'port = 0\napi_token_sha256 = "{"ab" * 32}"'
    )
    settings = Settings.parse(toml + '\n[journal]\nurl = "postgresql://me:hunter2@there/journal"\n')
    told = json.dumps(recording_header(settings.telescope[0], settings))
    assert "abab" not in told
    assert "hunter2" not in told
    assert [one["id"] for one in json.loads(told)["settings"]["telescope"]] == ["east"]


def test_an_answer_written_down_before_its_question_is_put_right(tmp_path: Path) -> None:
    path = tmp_path / "wire.jsonl"
    lines: list[dict[str, object]] = [{"kind": "header", "version": VERSION, "telescope": "east"}]
    said = [
        ("driver->mount", ":GR#"), ("mount->driver", "05:"), ("mount->driver", "00:00#"),
        ("driver->mount", ":GD#"), ("mount->driver", "+20*00:00#"),
        ("mount->driver", "late#"), ("driver->mount", ":GL#"),
        ("driver->mount", ":GR#"), ("mount->driver", "06:00:00#"),
    ]  # fmt: skip
    for number, (way, text) in enumerate(said):
        utc = START + timedelta(milliseconds=number)
        lines.append({"kind": "wire", "utc": utc.isoformat(), "dir": way, "hex": text.encode().hex()})
    path.write_text("\n".join(json.dumps(line) for line in lines) + "\n")
    turns = turns_of(read_recording(path))
    assert turns[b":GR#"].answers == [b"05:00:00#", b"06:00:00#"]
    assert turns[b":GD#"].answers == [b"+20*00:00#"]
    assert turns[b":GL#"].answers == [b"late#"]
    assert turns[b":GR#"].at(START - timedelta(hours=1)) == b"05:00:00#"
    assert turns[b":GR#"].at(START + timedelta(hours=1)) == b"06:00:00#"


def test_a_night_without_a_service(tmp_path: Path) -> None:
    with pytest.raises(DeviceMissing, match="no mountnav service"):
        CliRunner().invoke(
            app, ["night", "status", "east", "--service", "http://127.0.0.1:9"], catch_exceptions=False
        )


def test_a_night_in_lines() -> None:
    night = {
        "telescope": "east",
        "phase": "following",
        "night_id": "east-2026-11-21",
        "holds": ["not safe"],
        "unsafe_why": "rain",
        "sun_altitude_deg": -20.0,
        "frames": 9,
        "placed": 8,
        "waiting": 0,
        "corrections": 1,
        "correct_by": "sync",
        "calibration": {"scale_arcsec_px": 2.0, "rotation_deg": 12.0, "parity": 1},
        "drift": {
            "field": "083.2+21.4",
            "frames": 5,
            "ra_cosdec_arcsec_min": 1.5,
            "ra_cosdec_sigma_arcsec_min": 0.1,
            "dec_arcsec_min": -0.5,
            "dec_sigma_arcsec_min": 0.1,
            "last": {"east_arcsec": 3.0, "north_arcsec": 4.0, "total_arcsec": 5.0},
        },
        "last": {"act": "leave", "why": "paused", "text": "not safe"},
        "folder_problem": None,
        "recording_problem": "the recording can't be written: disk full",
    }
    text = shown(night)
    for words in (
        "nothing is corrected: not safe: rain",
        "1 corrections by sync",
        "drift RA +1.50",
        "disk full",
    ):
        assert words in text
