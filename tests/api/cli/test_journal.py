"""`mountnav journal`: lists, shows, exports, follows and checks real journals."""

from __future__ import annotations

import asyncio
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.journal import journal_app
from mountnav.errors import BadRequest, NotFound
from mountnav.journal.records import Cause, CommandEnd, EntryKind, Outcome
from mountnav.journal.sql_journal import open_journal
from tests.journal.samples import at, look_of, note_of, slew_of

ROOT = Path(__file__).resolve().parents[3]
VERSION_1 = ROOT / "tests" / "journal" / "version_1.sql"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A journal with a solved look, one that failed, a slew that ended, one in flight, and a fault."""
    path = tmp_path / "journal.sqlite"
    journal = open_journal(path, inline=True)

    async def write() -> None:
        cause = Cause(job_id="job-7")
        await journal.look(look_of(look_id="look-1", cause=cause))
        await journal.look(look_of("west", 60, solved=False, seen=None, reason="too-few-sources"))
        await journal.begin(slew_of(command_id="command-1", cause=cause))
        await journal.end("command-1", CommandEnd(at(20), Outcome.REFUSED, "below the horizon"))
        await journal.begin(slew_of(command_id="command-2", seconds=70))
        await journal.note(note_of("stopped at\na limit", seconds=80, kind=EntryKind.FAULT))

    asyncio.run(write())
    journal.close()
    return path


def run(*words: object) -> str:
    done = CliRunner().invoke(journal_app, [str(word) for word in words], catch_exceptions=True)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.stdout


def test_list_tells_a_line_each_in_the_order_of_time(file: Path) -> None:
    told = run("list", "-j", file, "--until", "2026-11-22T03:20").splitlines()
    assert len(told) == 5
    assert told[0].startswith("2026-11-22 03:12:45  east ")
    assert "seen at RA 120.0100° Dec +40.0100°: 42 stars, rms 0.40″" in "".join(told)
    assert any(line.endswith("refused (below the horizon)") for line in told)
    assert told[-1].endswith("fault      stopped at a limit")


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "count"),
    [
        (["--kind", "look"], 2),
        (["-k", "look", "-k", "fault"], 3),
        (["-t", "west"], 1),
        (["--outcome", "open"], 1),
        (["--outcome", "unsolved"], 1),
        (["--job", "job-7"], 2),
        (["--text", "HORIZON"], 1),
        (["--since", "2026-11-22T03:13:50", "--until", "2026-11-22T04:00"], 2),
        (["--limit", "2"], 2),
        (["--limit", "0", "-t", "east"], 4),
        (["--since", "1 s", "-k", "look"], 0),
    ],
)
def test_filters_and_json(file: Path, options: list[str], count: int) -> None:
    lines = [json.loads(line) for line in run("list", "-j", file, "--json", *options).splitlines()]
    assert len(lines) == count
    assert all(line["words"] for line in lines)


def test_the_newest_are_listed_oldest_first(file: Path) -> None:
    told = [
        json.loads(line) for line in run("list", "-j", file, "--json", "-n", 3, "-t", "east").splitlines()
    ]
    assert [line["kind"] for line in told] == ["command", "command", "fault"] or [
        line["kind"] for line in told
    ] == ["look", "command", "fault"]
    assert [line["utc"] for line in told] == sorted(line["utc"] for line in told)


def test_show(file: Path) -> None:
    told = run("show", "-j", file, "command-1")
    assert re.search(r"end_detail +below the horizon", told)
    assert re.search(r"to_ra_deg +120.0", told)
    assert json.loads(run("show", "-j", file, "look-1", "--json"))["pairs"] == 42
    assert len(run("show", "-j", file, "job-7").splitlines()) > 2
    with pytest.raises(NotFound, match="no look, command or job"):
        run("show", "-j", file, "nonsense")


def test_export(file: Path, tmp_path: Path) -> None:
    for ending in ("csv", "parquet", "fits"):
        out = tmp_path / f"out.{ending}"
        assert run("export", out, "-j", file, "-t", "east") == f"1 looks written to {out}\n"
        assert out.stat().st_size > 100
    with pytest.raises(BadRequest, match="can't be written"):
        run("export", tmp_path / "none" / "out.csv", "-j", file)


def test_check(file: Path) -> None:
    told = run("check", "-j", file)
    assert "look              2 rows" in told
    assert "open: east: a slew to apparent RA 120.0000° Dec +40.0000°, begun 2026-11-22 03:13:55 UTC" in told
    assert told.splitlines()[-1].strip() == "sound"
    found = json.loads(run("check", "-j", file, "--json"))
    assert (found["damage"], len(found["open_commands"]), found["rows"]["command"]) == ([], 1, 2)


def test_a_damaged_journal_is_told(file: Path) -> None:
    content = bytearray(file.read_bytes())
    # all but the first pages: the tables can be opened, their indexes are wrong
    for page in range(12, len(content) // 4096):
        content[page * 4096 + 100 : page * 4096 + 4096] = bytes(3996)
    file.write_bytes(content)
    done = CliRunner().invoke(journal_app, ["check", "-j", str(file)])
    assert done.exit_code == 1
    assert "DAMAGED" in done.stdout or "malformed" in str(done.exception)


def test_an_old_journal_is_upgraded_when_asked(tmp_path: Path) -> None:
    import sqlite3
    from contextlib import closing

    path = tmp_path / "old.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(VERSION_1.read_text(encoding="utf-8"))
    with pytest.raises(Exception, match="--upgrade"):
        run("list", "-j", path)
    assert "sound" in run("check", "-j", path, "--upgrade")
    assert len(run("list", "-j", path).splitlines()) == 7
    with pytest.raises(NotFound):
        run("check", "-j", tmp_path / "none.sqlite", "--upgrade")
    assert not (tmp_path / "none.sqlite").exists()


def test_which_journal(file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = tmp_path / "observatory.toml"
    config.write_text(
        f'[journal]\nurl = "{file}"\n[site]\nlatitude_deg = 47.0\nlongitude_deg = 11.0\n'
        '[[telescope]]\nid = "east"\nmount = { url = "fake+lx200://" }\ncamera = { kind = "simulated" }\n'
    )
    assert "sound" in run("check", "-c", config)
    monkeypatch.setenv("MOUNTNAV_JOURNAL", str(file))
    assert "sound" in run("check")
    monkeypatch.delenv("MOUNTNAV_JOURNAL")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with pytest.raises(NotFound, match=r"state/mountnav/journal\.sqlite"):
        run("check")


@pytest.mark.long
def test_follow_prints_what_is_written_from_now_on(file: Path) -> None:
    code = "from api.cli.journal import journal_app; journal_app()"
    child = subprocess.Popen(
        [sys.executable, "-c", code, "follow", "-j", str(file), "--every", "0.1", "--json", "-t", "east"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    journal = open_journal(file, inline=True)
    try:
        # nobody tells when it has begun to follow: so it is told until it answers
        os.set_blocking(child.stdout.fileno(), False)
        for number in range(600):
            asyncio.run(journal.note(note_of(f"news {number}")))
            line = child.stdout.readline()
            if line:
                break
            asyncio.run(asyncio.sleep(0.1))
        assert re.fullmatch(r"news \d+", json.loads(line)["what"])
    finally:
        child.kill()
        child.wait()
        child.stdout.close()
        journal.close()
