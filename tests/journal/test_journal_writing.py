"""Writing: order, trouble with the disk and its end, two at once, waiting that was given up."""

from __future__ import annotations

import asyncio
import json
import os
import resource
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from mountnav.errors import BadSettings, JournalFailed, NotFound
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.records import (
    CommandEnd,
    EntryKind,
    Outcome,
    because,
)
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.journal.writer import Piece
from tests.journal.samples import at, look_of, note_of, slew_of

ROOT = Path(__file__).resolve().parents[2]


async def _until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not true():
            await asyncio.sleep(0.01)


async def test_rows_stand_in_the_order_of_writing(journal: SqlJournal) -> None:
    command = slew_of()
    for number in range(50):
        journal.note_now(note_of(str(number)))
    await journal.begin(command)
    assert [one.what for one in journal.reader.entries(Wanted(telescope="east"))] == [
        str(n) for n in range(50)
    ]
    assert journal.reader.in_flight("east") == [command]
    await journal.end(command.command_id, CommandEnd(at(5), Outcome.DONE))
    assert journal.reader.in_flight("east") == []
    assert journal.problem is None


async def test_the_first_end_stands_but_unknown_gives_way(journal: SqlJournal) -> None:
    first, second = slew_of(), slew_of()
    await journal.begin(first)
    await journal.begin(second)
    for outcome in (Outcome.DONE, Outcome.STOPPED, Outcome.UNKNOWN):
        await journal.end(first.command_id, CommandEnd(at(1), outcome))
    for outcome in (Outcome.UNKNOWN, Outcome.UNKNOWN, Outcome.STALLED):
        await journal.end(second.command_id, CommandEnd(at(1), outcome))
    ends = [end.outcome for _, end in journal.reader.commands() if end is not None]
    assert ends == [Outcome.DONE, Outcome.STALLED]


async def test_an_end_without_a_beginning_is_not_lost(journal: SqlJournal) -> None:
    await journal.end("never-begun", CommandEnd(at(1), Outcome.REFUSED, "it said no"))
    [fault] = journal.reader.entries(Wanted(kinds=frozenset({EntryKind.FAULT})))
    assert fault.facts == {"command_id": "never-begun", "outcome": "refused", "detail": "it said no"}


async def test_the_cause_stands_in_each_row(journal: SqlJournal) -> None:
    with because(job_id="job", night_id="night", why="centering"):
        await journal.begin(slew_of())
        await journal.look(look_of())
    lines = journal.reader.lines(Wanted(job_id="job"))
    assert {line.kind for line in lines} == {"command", "look"}
    assert {line.record.cause.why for line in lines} == {"centering"}


@pytest.mark.parametrize("kind", [MemoryJournal, None])
async def test_recent_entries_oldest_first(journal: SqlJournal, kind: type[MemoryJournal] | None) -> None:
    writing = journal if kind is None else kind()
    for number in range(5):
        await writing.note(note_of(str(number), seconds=number, kind=EntryKind.NIGHT))
    writing.note_now(note_of("another", kind=EntryKind.MODEL))
    writing.note_now(note_of("elsewhere", "west", kind=EntryKind.NIGHT))
    assert [one.what for one in await writing.recent("east", EntryKind.NIGHT, 2)] == ["3", "4"]
    assert await writing.recent("north", EntryKind.NIGHT, 2) == []


async def test_a_cancelled_beginning_is_not_left_open(journal: SqlJournal) -> None:
    """Whoever was cancelled while it was written will not send it: wherever the writing stood then."""
    commands = [slew_of(seconds=number) for number in range(30)]
    for number, command in enumerate(commands):
        task = asyncio.ensure_future(journal.begin(command))
        for _ in range(number % 4):
            await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
    last = slew_of(seconds=99)
    await journal.begin(last)
    await _until(lambda: journal.reader.in_flight() == [last])
    assert {end.outcome for _, end in journal.reader.commands() if end is not None} <= {Outcome.NOT_SENT}


async def test_a_row_that_cannot_be_held_harms_no_other(journal: SqlJournal) -> None:
    look = look_of()
    await journal.look(look)
    waiting = [journal.look(look), journal.look(look_of()), journal.begin(slew_of())]
    outcomes = await asyncio.gather(*waiting, return_exceptions=True)
    assert [type(one) for one in outcomes] == [JournalFailed, type(None), type(None)]
    assert journal.problem is None
    assert len(journal.reader.looks()) == 2


async def test_a_locked_disk_never_holds_up_the_loop(journal: SqlJournal) -> None:
    """While the writer's thread waits, the event loop goes on and a stop is written down without waiting."""
    held, go = threading.Event(), threading.Event()

    def hold(_connection: object) -> None:
        held.set()
        assert go.wait(60)

    journal._writer.put(Piece(hold))
    assert await asyncio.to_thread(held.wait, 60)
    stop = slew_of(order="stop", place=None)
    journal.begin_now(stop)
    journal.note_now(note_of("meanwhile"))
    begun = asyncio.ensure_future(journal.begin(slew_of()))
    for _ in range(100):
        await asyncio.sleep(0)
    assert not begun.done()
    go.set()
    await begun
    assert stop in journal.reader.in_flight()


DISK_FULL = """
import asyncio, json, resource, sys
from mountnav.errors import JournalFailed
from mountnav.journal.records import CommandEnd, EntryKind, Outcome
from mountnav.journal.sql_journal import open_journal
from mountnav.journal.reading import Wanted
from tests.journal.samples import at, note_of, slew_of

async def main():
    journal = open_journal(sys.argv[1], inline=sys.argv[2] == "inline")
    open_one = slew_of()
    await journal.begin(open_one)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # from now on no file may grow: what a full disk does
    resource.setrlimit(resource.RLIMIT_FSIZE, (1, hard))
    refused = 0
    for number in range(3):
        try:
            await journal.begin(slew_of(facts={"refused": True}))
        except JournalFailed as error:
            refused += 1
            told = str(error)
    problem = journal.problem
    stop = slew_of(order="stop", place=None)
    journal.begin_now(stop)
    journal.note_now(note_of("meanwhile"))
    try:
        await journal.end(open_one.command_id, CommandEnd(at(9), Outcome.DONE))
        end = "written"
    except JournalFailed:
        end = "owed"
    resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    if sys.argv[2] == "inline":
        await journal.note(note_of("again"))
    else:
        async with asyncio.timeout(60):
            while journal.problem is not None:
                await asyncio.sleep(0.01)
    await journal.note(note_of("after"))
    commands = {command.command_id: end for command, end in journal.reader.commands()}
    print(json.dumps({
        "refused": refused, "told": told, "problem": problem, "end": end, "after": journal.problem,
        "ended": commands[open_one.command_id] is not None, "stop": stop.command_id in commands,
        "commands": len(commands),
        "notes": [one.what for one in journal.reader.entries(Wanted(telescope="east"))],
        "faults": [one.what for one in journal.reader.entries(Wanted(kinds=frozenset({EntryKind.FAULT})))],
    }))
    journal.close()

asyncio.run(main())
"""


@pytest.mark.long
@pytest.mark.parametrize("how", ["thread", "inline"])
def test_a_full_disk_refuses_commands_and_is_outlived(file: Path, how: str) -> None:
    if not hasattr(resource, "RLIMIT_FSIZE"):
        pytest.skip("no limit of file sizes here")
    done = subprocess.run(
        [sys.executable, "-c", DISK_FULL, str(file), how],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["refused"] == 3
    assert "can't be written" in told["told"]
    assert "nothing but a stop and a park is sent" in told["problem"]
    assert told["end"] == "owed"
    # when there is room again: end and stop were kept, the refused commands were never sent, nor written
    assert told["after"] is None
    assert (told["ended"], told["stop"], told["commands"]) == (True, True, 2)
    assert told["notes"][:1] == ["meanwhile"]
    assert told["notes"][-1] == "after"
    assert "could not be written for" in told["faults"][0]


async def test_a_file_that_is_taken_away_is_made_anew(journal: SqlJournal, file: Path) -> None:
    await journal.note(note_of("before"))
    away = file.with_name("away.sqlite")
    for suffix in ("", "-wal", "-shm"):
        part = file.with_name(file.name + suffix)
        if part.exists():
            part.rename(away.with_name(away.name + suffix))
    await journal.note(note_of("after"))
    assert [one.what for one in JournalReader(file).entries(Wanted(telescope="east"))] == ["after"]
    assert [one.what for one in JournalReader(away).entries(Wanted(telescope="east"))] == ["before"]


async def test_two_services_may_share_a_journal(file: Path) -> None:
    journals = await asyncio.gather(*(asyncio.to_thread(open_journal, file) for _ in range(4)))
    await asyncio.gather(
        *(
            one.begin(slew_of(str(number), count))
            for number, one in enumerate(journals)
            for count in range(25)
        )
    )
    assert len(JournalReader(file).in_flight()) == 100
    assert len(JournalReader(file).in_flight("2", but_run=journals[1].run_id)) == 25
    assert JournalReader(file).in_flight("2", but_run=journals[2].run_id) == []
    for one in journals:
        await asyncio.to_thread(one.close)


OPENING = (
    "import sys; from mountnav.journal.sql_journal import open_journal; open_journal(sys.argv[1]).close()"
)


@pytest.mark.long
def test_processes_that_open_at_once_are_safe(file: Path) -> None:
    children = [
        subprocess.Popen(
            [sys.executable, "-c", OPENING, str(file)], cwd=ROOT, stderr=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    for child in children:
        _, errors = child.communicate(timeout=300)
        assert child.returncode == 0, errors
    runs = JournalReader(file).runs()
    assert len(runs) == 3
    assert all(run.ended_utc is not None for run in runs)


def test_runs_tell_what_of_the_configuration_is_new(file: Path) -> None:
    for text in ("a = 1\n", "a = 1\n", 'a = 2\nurl = "postgresql://me:secret@host/db"\n'):
        open_journal(file, settings_text=text).close()
    changes = JournalReader(file).entries(Wanted(kinds=frozenset({EntryKind.SETTINGS})))
    assert [one.facts["changes"] for one in changes] == [
        [],
        ["-a = 1", "+a = 2", '+url = "postgresql://me:***@host/db"'],
    ]
    assert "secret" not in JournalReader(file).runs()[0].settings


def test_a_run_that_was_killed_is_known(file: Path) -> None:
    killed = open_journal(file)
    open_journal(file).close()
    told = JournalReader(file).entries(Wanted(kinds=frozenset({EntryKind.SERVICE})))
    assert [("killed" in one.what) for one in told] == [False, True, False]
    killed.close()


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ("mysql://somebody:secret@host/db", "can't be at mysql://somebody:***@host/db"),
        ("sqlite://", "can't be at"),
        ("nonsense://", "can't be at"),
    ],
)
def test_places_that_are_none(where: str, words: str) -> None:
    with pytest.raises(BadSettings) as caught:
        open_journal(where)
    assert words in str(caught.value)
    assert "secret" not in str(caught.value)


def test_places_that_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(JournalFailed):
        open_journal(tmp_path / "file" / "journal.sqlite")
    damaged = tmp_path / "damaged.sqlite"
    damaged.write_bytes(b"this is not a database at all, but long enough to be taken for one" * 99)
    with pytest.raises(JournalFailed, match="damaged"):
        open_journal(damaged)
    with pytest.raises(NotFound, match="no journal"):
        JournalReader(tmp_path / "none.sqlite").lines()
    foreign = tmp_path / "foreign.sqlite"
    with closing(sqlite3.connect(foreign)) as connection, connection:
        connection.execute("CREATE TABLE look (x)")
    connection.close()
    with pytest.raises(BadSettings, match="not mountnav's"):
        open_journal(foreign)
