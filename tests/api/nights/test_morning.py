"""The morning report on its way: once a night, to a folder and to real servers that fail, hang and lie."""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import tenacity

from api.nights import morning
from api.nights.morning import MorningPosts, night_due
from mountnav.journal.reading import Wanted
from mountnav.journal.records import EntryKind
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.night.morning_report import night_of, report_of
from mountnav.night.report_messages import body_of, words_of
from mountnav.settings.observatory import Settings
from tests.api.conftest import OBSERVATORY

MORNING = datetime(2026, 11, 26, 8, tzinfo=UTC)


@pytest.mark.parametrize(
    ("utc", "latitude_deg", "longitude_deg", "night"),
    [
        (datetime(2026, 11, 26, 4, tzinfo=UTC), 47.0, 11.0, None),
        (MORNING, 47.0, 11.0, "2026-11-25"),
        (datetime(2026, 11, 26, 11, tzinfo=UTC), 47.0, 11.0, "2026-11-25"),
        (datetime(2026, 11, 26, 12, tzinfo=UTC), 47.0, 11.0, None),
        (datetime(2026, 11, 26, 22, tzinfo=UTC), 47.0, 11.0, None),
        # New Mexico: morning there is afternoon in Greenwich
        (datetime(2026, 11, 26, 15, tzinfo=UTC), 33.0, -105.0, "2026-11-25"),
        # no sunrise: before the next night begins
        (datetime(2026, 12, 21, 10, tzinfo=UTC), 80.0, 0.0, None),
        (datetime(2026, 12, 21, 11, 50, tzinfo=UTC), 80.0, 0.0, "2026-12-20"),
        # no sunset
        (datetime(2026, 6, 21, 1, tzinfo=UTC), 80.0, 0.0, "2026-06-20"),
    ],
)
def test_a_report_is_due_after_sunrise(
    utc: datetime, latitude_deg: float, longitude_deg: float, night: str | None
) -> None:
    toml = OBSERVATORY.replace("47.0", str(latitude_deg)).replace("11.0", str(longitude_deg))
    assert night_due(utc, Settings.parse(toml)) == night


class Hook:
    """A server of webhooks: answers as told, keeps what came."""

    def __init__(self) -> None:
        self.answers = ["200 OK"]
        self.came: list[tuple[str, Any]] = []
        self.server: asyncio.Server | None = None

    @property
    def url(self) -> str:
        assert self.server is not None
        return f"http://127.0.0.1:{self.server.sockets[0].getsockname()[1]}/hook/secret-of-path"

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        length = next(
            int(one.partition(":")[2]) for one in head.splitlines() if "ontent-length" in one.lower()
        )
        self.came.append((head, json.loads(await reader.readexactly(length))))
        answer = self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if answer != "hang up":
            head = f"HTTP/1.1 {answer}\r\nLocation: http://127.0.0.1:9/\r\nContent-Length: 2\r\n\r\nok"
            writer.write(head.encode())
        writer.close()


@pytest.fixture
async def hook() -> AsyncIterator[Hook]:
    one = Hook()
    one.server = await asyncio.start_server(one.serve, "127.0.0.1", 0)
    async with one.server:
        yield one


@pytest.fixture
def journal(tmp_path: Path) -> Any:
    opened = open_journal(tmp_path / "journal.sqlite", inline=True, fsync="never")
    yield opened
    opened.close()


def posts(
    journal: SqlJournal, report: str, events: list[tuple[str, dict[str, object]]] | None = None
) -> MorningPosts:
    settings = Settings.parse(f"{OBSERVATORY}\n[report]\n{report}")
    told = [] if events is None else events
    return MorningPosts(settings, journal, lambda kind, data: told.append((kind, data)))


async def test_it_goes_once_and_what_came_of_it_is_told(
    journal: SqlJournal, hook: Hook, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    events: list[tuple[str, dict[str, object]]] = []
    report = (
        f'folder = "{tmp_path}/out"\n[[report.webhook]]\nurl = "{hook.url}"\nheaders = {{ X-Key = "k" }}\n'
    )
    sender = posts(journal, report, events)
    with caplog.at_level(logging.INFO):
        assert await sender.due(MORNING - timedelta(hours=5)) == []
        await asyncio.gather(*await sender.due(MORNING))
        assert await sender.due(MORNING + timedelta(minutes=1)) == []
    assert sorted(one.name for one in (tmp_path / "out").iterdir()) == ["2026-11-25.html", "2026-11-25.json"]
    head, body = hook.came[0]
    assert ("x-key: k" in head.lower(), body["night"]) == (True, "2026-11-25")
    assert [one["telescope"] for one in body["reports"]] == ["east", "gone"]
    assert [kind for kind, _ in events] == ["report-sent", "report-sent"]
    # the path of the address is a secret: nowhere but in the settings
    notes = Wanted(kinds=frozenset({EntryKind.NOTE}))
    written = [one.what for one in journal.reader.entries(notes, limit=9)]
    assert len(written) == 2
    # httpx would log it, and is silenced by `begin_log`
    logged = [one.getMessage() for one in caplog.records if not one.name.startswith("http")]
    assert "secret-of-path" not in f"{events}{written}{logged}{sender.failed}"
    # after a restart it is known what went
    assert await posts(journal, report).due(MORNING + timedelta(hours=1)) == []


@pytest.mark.long
async def test_what_may_pass_is_tried_again_and_what_may_not_is_told(
    journal: SqlJournal, hook: Hook, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tenacity, "wait_random_exponential", lambda **_: tenacity.wait_none())
    hook.answers = ["503 Busy", "hang up", "429 Slower", "204 No Content"]
    webhook = f'[[report.webhook]]\nurl = "{hook.url}"\n'
    sender = posts(journal, webhook)
    await asyncio.gather(*await sender.due(MORNING))
    assert (len(hook.came), sender.failed) == (4, {})
    # a wrong address, or one that leads elsewhere, is no matter of patience; the next night is tried again
    for answer in ("404 Not Found", "302 Found"):
        hook.came.clear()
        hook.answers = [answer]
        other = posts(journal, webhook)
        await asyncio.gather(*await other.due(MORNING + timedelta(days=1)))
        assert len(hook.came) == 1
        (words,) = other.failed.values()
        assert ("HTTP " + answer[:3] in words, "secret-of-path" in words) == (True, False)
        assert await other.due(MORNING + timedelta(days=1, minutes=1)) == []
    hook.answers = ["200 OK"]
    await asyncio.gather(*await other.due(MORNING + timedelta(days=2)))
    assert other.failed == {}


async def test_nothing_waits_for_it(journal: SqlJournal, tmp_path: Path, hook: Hook) -> None:
    """One that hangs is given up at the end; a folder that can't be written is told."""
    (tmp_path / "file").write_text("x")
    hook.answers = ["503 Busy"]
    report = f'folder = "{tmp_path}/file/under"\n[[report.webhook]]\nurl = "{hook.url}"\n'
    sender = posts(journal, report)
    tasks = await sender.due(MORNING)
    assert len(tasks) == 2
    await tasks[0]
    assert "folder" in next(iter(sender.failed))
    assert not tasks[1].done()
    assert await sender.due(MORNING) == []
    await sender.close()
    assert tasks[1].cancelled()


def test_old_reports_go_and_nothing_else(journal: SqlJournal, tmp_path: Path) -> None:
    for name in ("2026-10-01.html", "2026-11-20.html", "2026-10-01.txt", "notes.html"):
        (tmp_path / name).write_text("x")
    sender = posts(journal, f'folder = "{tmp_path}"\nforms = ["markdown"]\nkeep_days = 30\n')
    sender._write(tmp_path, "2026-11-25", [])
    left = {one.name for one in tmp_path.iterdir() if one.suffix in (".html", ".md", ".txt")}
    assert left == {"2026-11-25.md", "2026-11-20.html", "2026-10-01.txt", "notes.html"}


def test_messages_fit_and_make_no_json_of_their_own(journal: SqlJournal) -> None:
    settings = Settings.parse(OBSERVATORY)
    since, until = night_of("2026-11-25", settings.site.site)
    report = report_of(journal.reader, "east", since, until)
    words = words_of([report], "2026-11-25", "7:abc")
    evil = {**words, "summary": 'a"}, @everyone ${text} {', "text": "\u2033" * 50_000}
    template = '{"t": ["${title}", {"${night}": "${summary} $$ ${unknown}"}], "n": 1}'
    assert body_of("json", [report], evil, template=template) == {
        "t": ["mountnav, night of 2026-11-25", {"2026-11-25": 'a"}, @everyone ${text} { $ ${unknown}'}],
        "n": 1,
    }
    assert len(body_of("slack", [report], evil)["text"]) <= 40_000
    discord = body_of("discord", [report], evil)
    assert len(discord["content"]) <= 2000
    assert discord["allowed_mentions"] == {"parse": []}
    told = body_of("ntfy", [report], {**evil, "advice": "\u2033" * 9000}, topic="t")
    assert len(told["message"].encode()) <= 4096
    assert told["topic"] == "t"
    assert morning._ENDINGS["json"] == ".json"
