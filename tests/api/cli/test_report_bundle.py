"""`mountnav report --bundle`, and `mountnav replay` of it: all that is needed, nothing that is secret."""

from __future__ import annotations

import json
import stat
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from api.access.callers import Role
from api.access.keys import KeyStore
from api.bundle import form
from api.bundle.bundle import Asked, make_bundle
from api.bundle.form import open_bundle
from api.cli.replay import replay
from api.cli.report import report
from mountnav.errors import BadRequest
from mountnav.journal.audit_and_leases import AuditRow
from mountnav.journal.audit_chain import open_audit_key
from mountnav.journal.records import Cause, Entry, EntryKind
from mountnav.journal.sql_journal import open_journal
from mountnav.settings.observatory import Settings
from tests.api.cli.test_replay import recording
from tests.api.nights.night_site import night_toml

NOW = datetime(2026, 11, 21, 22, tzinfo=UTC)
app = typer.Typer()
app.command("replay")(replay)
app.command("report")(report)

WEBHOOK = "https://hooks.example/services/webhook-secret-path"
TOKEN = "ab" * 32
IN_SETTINGS = f"""
[report]
[[report.webhook]]
url = "{WEBHOOK}"
headers = {{ Authorization = "Bearer header-secret" }}
"""


@pytest.fixture
def night(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Settings, a journal and a recording, with a secret of every kind wherever somebody may have put one."""
    folder = tmp_path / "home"
    folder.mkdir()
    recorded = recording(folder)
    key = KeyStore(folder / "keys.json").new("scheduler", Role.OPERATE)[1]
    audit_key = open_audit_key(folder / "audit.key")
    monkeypatch.setenv("MOUNTNAV_TOKEN", "token-of-environment")
    toml = night_toml(folder, folder, folder / "safety.txt").replace(
        "port = 0", f'port = 0\napi_token_sha256 = "{TOKEN}"'
    )
    toml = toml.replace('kind = "folder"', f'record = "{folder}"', 1) if "record =" not in toml else toml
    config = folder / "observatory.toml"
    config.write_text(f'{toml}\n[journal]\nurl = "{folder}/journal.sqlite"\n{IN_SETTINGS}', "utf-8")
    settings = Settings.load(config)
    leaks = f"{key} {WEBHOOK} Bearer header-secret {TOKEN} token-of-environment postgresql://me:hunter2@db/x"
    journal = open_journal(
        folder / "journal.sqlite", settings_text="{}", audit_key=audit_key, inline=True, fsync="never"
    )
    journal.note_now(Entry(NOW, "east", EntryKind.FAULT, leaks, {"url": leaks, "token": "t0p"}, Cause()))
    row = AuditRow(NOW, "east", "robot", "operate", "rest", "::1", "slew", {"say": leaks}, "taken", leaks)
    journal.audit_now(row)
    journal.close()
    # the recording lies where the settings say, under the night's name, with what somebody typed
    lines = recorded.read_text("utf-8")
    (folder / "east-2026-11-21.jsonl").write_text(lines, "utf-8")
    recorded.unlink()
    assert settings.telescope[0].id == "east"
    return config


def _bundle(night: Path, tmp_path: Path, **more: object) -> tuple[Path, dict[str, str]]:
    target = tmp_path / "bundle.zip"
    since, until = datetime(2026, 11, 21, 11, tzinfo=UTC), datetime(2026, 11, 22, 11, tzinfo=UTC)
    made = make_bundle(Asked(since, until, night, **more), target, NOW)  # type: ignore[arg-type]
    return target, made.missing


def _all_text(path: Path) -> str:
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return "\n".join(f"{name}\n{archive.read(name).decode()}" for name in archive.namelist())


def test_no_secret_of_any_kind_leaves(night: Path, tmp_path: Path) -> None:
    said = "mnk_" + "z" * 43

    def service(path: str) -> str:
        if path.endswith("/wire"):
            return json.dumps({"hex": b"header-secret".hex()}) + '\n{"dir": "x"}\n'
        return f"concerns {WEBHOOK} {said}" if path == "/metrics" else json.dumps({"x": f"{TOKEN} {said}"})

    target, missing = _bundle(night, tmp_path, service=service)
    assert missing == {}
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    text = _all_text(target)
    keys = (night.parent / "keys.json").read_text("utf-8")
    secrets = [
        TOKEN,
        "webhook-secret-path",
        "header-secret",
        b"header-secret".hex(),
        "token-of-environment",
        "hunter2",
        "t0p",
        said,
        json.loads(keys)["keys"][0]["sha256"],
        (night.parent / "audit.key").read_text("ascii").strip(),
    ]
    assert [one for one in secrets if one in text] == []
    assert "mnk_z" not in text
    for name in (
        "settings.json",
        "journal.jsonl",
        "audit.jsonl",
        "report.md",
        "system.json",
        "wire/east.jsonl",
    ):
        assert (name, f"{name}\n" in text) == (name, True)
    # what is not secret is there
    assert "https://hooks.example/***" in text
    assert "recordings/east-2026-11-21.jsonl" in text
    # the name of a key; a setting is called so as well
    assert '"name": "scheduler"' not in text


def test_a_bundle_is_played_as_its_recording_is(night: Path, tmp_path: Path) -> None:
    target = tmp_path / "sent.zip"
    words = ["report", "2026-11-21", "--bundle", "-c", str(night), "--out", str(target), "--service", ""]
    made = CliRunner().invoke(app, words, catch_exceptions=False)
    assert (made.exit_code, "secrets masked" in made.output) == (0, True)
    with pytest.raises(BadRequest, match="there already"):
        CliRunner().invoke(app, words, catch_exceptions=False)
    played = CliRunner().invoke(app, ["replay", str(target)], catch_exceptions=False)
    assert (played.exit_code, "all as they were" in played.output) == (0, True)
    assert played.output.startswith("east-2026-11-21 (mountnav ")
    told = json.loads(CliRunner().invoke(app, ["replay", str(target), "--json"]).output)
    assert told["recordings"]["east-2026-11-21"]["same"]
    with pytest.raises(BadRequest, match="no such recording"):
        CliRunner().invoke(app, ["replay", str(target), "--night", "west-2026-11-21"], catch_exceptions=False)


def test_what_is_broken_is_named_and_takes_nothing_else_with_it(night: Path, tmp_path: Path) -> None:
    def down(path: str) -> str:
        raise ConnectionError("no service")

    (night.parent / "journal.sqlite").write_bytes(b"no journal at all" * 1000)
    night.write_text(night.read_text("utf-8") + "\n[nonsense]\npassword = 'open-sesame'\n", "utf-8")
    target, missing = _bundle(night, tmp_path, journal=str(night.parent / "journal.sqlite"), service=down)
    assert {"settings.json", "journal.jsonl", "audit.jsonl"} <= set(missing)
    text = _all_text(target)
    assert "settings-as-found.json" in text
    assert [one for one in (TOKEN, "open-sesame", "header-secret", "webhook-secret") if one in text] == []
    assert '"python"' in text
    with pytest.raises(BadRequest):
        make_bundle(Asked(NOW, NOW, night), tmp_path / "nowhere" / "b.zip", NOW)
    assert [one.name for one in tmp_path.iterdir() if one.suffix == ".part"] == []


@pytest.mark.parametrize("evil", ["no zip", "no manifest", "form", "bomb", "torn", "members", "not json"])
def test_a_strangers_bundle_harms_nobody(tmp_path: Path, evil: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "evil.zip"
    monkeypatch.setattr(form, "MOST_RECORD_BYTES", 1_000_000)
    monkeypatch.setattr(form, "_MOST_MEMBERS", 20)
    manifest = json.dumps({"form": form.FORM})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        if evil != "no manifest":
            told = {"form": '{"form": "mountnav-bundle-9"}', "not json": "[" * 100_000}
            archive.writestr(form.MANIFEST, told.get(evil, manifest))
        if evil == "bomb":
            archive.writestr("recordings/bomb.jsonl", b"0" * 2_000_000)
        if evil == "members":
            for number in range(30):
                archive.writestr(f"recordings/{number}.jsonl", "x")
        archive.writestr("recordings/../../../evil.jsonl", "x")
    if evil == "no zip":
        path.write_bytes(b"PK\x05\x06")
    if evil == "torn":
        path.write_bytes(path.read_bytes()[:60] + b"\xff" * 30 + path.read_bytes()[90:])
    with pytest.raises(BadRequest), open_bundle(path):
        pass
    assert not (tmp_path / "evil.jsonl").exists()
    if evil == "members":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr(form.MANIFEST, manifest)
            archive.writestr("recordings/../../evil.jsonl", "x")
        with open_bundle(path) as bundle:
            assert [one.name for one in bundle.recordings.values()] == ["0.jsonl"]
