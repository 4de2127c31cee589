"""A journal is copied while it is written, and put back while nobody has it open."""

from __future__ import annotations

import asyncio
import sqlite3
import stat
import threading
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest

from mountnav.errors import BadRequest, BadSettings, Busy, JournalDamaged, NotFound
from mountnav.journal.backup import back_up, restore
from mountnav.journal.database import database_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import Entry, EntryKind
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.journal.upkeep import check
from tests.journal.test_journal_versions import VERSION_1

NOW = datetime(2026, 11, 26, 4, 30, tzinfo=UTC)


def _note(journal: SqlJournal, words: str) -> None:
    """Write a note, and wait until it is written."""
    asyncio.run(journal.note(Entry(NOW, "east", EntryKind.NOTE, words, {})))


def _words(file: Path) -> list[str]:
    return [row.what for row in JournalReader(str(file)).entries() if row.kind is EntryKind.NOTE]


def test_a_copy_of_a_journal_that_is_being_written_is_whole_and_sound(file: Path, tmp_path: Path) -> None:
    journal = open_journal(file)
    over, copies = threading.Event(), []

    def write() -> None:
        number = 0
        while not over.is_set():
            _note(journal, f"note {number}")
            number += 1

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for number in range(4):
            copies.append(back_up(file, tmp_path / f"copy-{number}.sqlite", NOW))
    finally:
        over.set()
        writer.join()
        journal.close()
    counts = [len(_words(copy)) for copy in copies]
    assert counts == sorted(counts)
    for copy, count in zip(copies, counts, strict=True):
        assert check(database_url(copy)).damage == ()
        assert _words(copy) == [f"note {number}" for number in range(count)]
        assert stat.S_IMODE(copy.stat().st_mode) == 0o600
        assert not list(tmp_path.glob(f"{copy.name}[.-]*"))


def test_a_folder_takes_it_under_a_name_of_its_time(file: Path, tmp_path: Path) -> None:
    open_journal(file).close()
    folder = tmp_path / "backups"
    folder.mkdir()
    assert back_up(file, folder, NOW) == folder / "mountnav-journal-20261126T043000Z.sqlite"
    with pytest.raises(BadRequest, match="is there already"):
        back_up(file, folder, NOW)
    back_up(file, folder, NOW, force=True)


def test_nothing_is_written_over_the_journal_itself(file: Path) -> None:
    open_journal(file).close()
    before = file.read_bytes()
    with pytest.raises(BadRequest, match="is there already"):
        back_up(file, file, NOW, force=True)
    with pytest.raises(BadRequest, match="the journal itself"):
        restore(file, file, NOW)
    assert file.read_bytes() == before


def test_what_is_put_back_is_the_backup_and_what_was_there_is_kept(file: Path, tmp_path: Path) -> None:
    journal = open_journal(file)
    _note(journal, "before")
    backup = back_up(file, tmp_path / "backup.sqlite", NOW)
    _note(journal, "after")
    journal.close()
    kept = restore(backup, file, NOW)
    assert _words(file) == ["before"]
    assert kept is not None
    assert _words(kept) == ["before", "after"]
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    again = open_journal(file)
    _note(again, "goes on")
    again.close()
    assert _words(file) == ["before", "goes on"]


def test_a_journal_that_is_in_use_is_left_alone(file: Path, tmp_path: Path) -> None:
    journal = open_journal(file)
    _note(journal, "kept")
    backup = back_up(file, tmp_path / "backup.sqlite", NOW)
    with pytest.raises(Busy, match="in use"):
        restore(backup, file, NOW)
    _note(journal, "still written")
    journal.close()
    assert _words(file) == ["kept", "still written"]
    assert not list(file.parent.glob(f"{file.name}.*"))


def test_it_is_put_where_there_was_none_and_where_a_damaged_one_is(file: Path, tmp_path: Path) -> None:
    journal = open_journal(file)
    _note(journal, "saved")
    backup = back_up(file, tmp_path / "backup.sqlite", NOW)
    journal.close()
    elsewhere = tmp_path / "new" / "journal.sqlite"
    assert restore(backup, elsewhere, NOW) is None
    assert _words(elsewhere) == ["saved"]
    file.write_bytes(b"SQLite format 3" + bytes(5000))
    kept = restore(backup, file, NOW)
    assert kept is not None
    assert kept.read_bytes().startswith(b"SQLite format 3")
    assert _words(file) == ["saved"]


def test_what_is_no_whole_backup_changes_nothing(file: Path, tmp_path: Path) -> None:
    journal = open_journal(file)
    for number in range(100):
        _note(journal, f"note {number} " + "x" * 600)
    backup = back_up(file, tmp_path / "backup.sqlite", NOW)
    journal.close()
    before = file.read_bytes()
    cut = tmp_path / "cut.sqlite"
    cut.write_bytes(backup.read_bytes()[:-3000])
    with pytest.raises(JournalDamaged):
        restore(cut, file, NOW)
    other = tmp_path / "other.sqlite"
    with closing(sqlite3.connect(other)) as connection, connection:
        connection.execute("CREATE TABLE planets (name TEXT)")
    with pytest.raises(BadSettings, match="not a journal of mountnav"):
        restore(other, file, NOW)
    with closing(sqlite3.connect(backup)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = '9999'")
    with pytest.raises(BadSettings, match="newer mountnav"):
        restore(backup, file, NOW)
    with pytest.raises(NotFound):
        restore(tmp_path / "none.sqlite", file, NOW)
    assert file.read_bytes() == before


def test_a_backup_of_an_older_version_is_brought_up_to_date_at_the_next_start(
    file: Path, tmp_path: Path
) -> None:
    old = tmp_path / "old.sqlite"
    with closing(sqlite3.connect(old)) as connection, connection:
        connection.executescript(VERSION_1.read_text())
    assert restore(old, file, NOW) is None
    open_journal(file).close()
    assert check(database_url(file)).damage == ()


def test_a_server_is_told_to_be_backed_up_by_its_own_tools(tmp_path: Path) -> None:
    for work in (
        lambda: back_up("postgresql://me@host/nights", tmp_path / "copy", NOW),
        lambda: restore(tmp_path / "copy", "postgresql://me@host/nights", NOW),
    ):
        with pytest.raises(BadRequest, match="database server"):
            work()
