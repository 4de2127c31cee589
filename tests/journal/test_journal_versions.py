"""Journals of other versions: older ones are brought up to date and lose nothing, newer ones are refused."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

import mountnav.journal
from mountnav.errors import BadSettings
from mountnav.journal.database import connectable, database_url
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.records import Cause, CommandEnd, EntryKind, Outcome
from mountnav.journal.sql_journal import open_journal
from mountnav.journal.tables import HEAD, metadata
from mountnav.journal.upgrading import upgrade
from tests.journal.samples import at, look_of, slew_of

VERSION_1 = Path(__file__).with_name("version_1.sql")


@pytest.fixture
def old_file(tmp_path: Path) -> Path:
    """A journal as version 1 wrote it: two looks, a command that ended and one in flight, an entry."""
    path = tmp_path / "old.sqlite"
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(VERSION_1.read_text(encoding="utf-8"))
    return path


def _set_version(path: Path, version: str) -> None:
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("UPDATE alembic_version SET version_num = ?", (version,))
        connection.commit()


def test_version_1_is_brought_up_to_date_and_loses_nothing(old_file: Path) -> None:
    journal = open_journal(old_file)
    reader = journal.reader
    first, second = reader.looks()
    assert first == look_of(look_id="look-1", cause=Cause("job-1", None, None, "centering"))
    assert (second.solved, second.reason, second.seen) == (False, "too-few-sources", None)
    (ended, end), (in_flight, none) = reader.commands()
    assert ended == slew_of(command_id="command-1")
    assert end == CommandEnd(at(20), Outcome.DONE, "", look_of().after, 3.5, {"tries": 1})
    assert none is None
    assert reader.in_flight("east") == [in_flight]
    [fault] = reader.entries(Wanted(kinds=frozenset({EntryKind.FAULT})))
    assert fault.facts == {"limit": "altitude", "degrees": [15.0, None, "″"]}
    assert [run.host for run in reader.runs()][1:] == ["dome"]
    assert reader.jobs(10) == []
    assert reader.audits() == []
    assert reader.leases(frozenset({"east"})) == []
    journal.close()
    assert upgrade(database_url(old_file)) is False


def test_a_reader_leaves_an_old_journal_as_it_is(old_file: Path) -> None:
    before = old_file.read_bytes()
    with pytest.raises(BadSettings, match=r"version 0001.*--upgrade"):
        JournalReader(old_file).lines()
    assert old_file.read_bytes() == before


def test_a_newer_journal_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "new.sqlite"
    open_journal(path).close()
    _set_version(path, "9999")
    before = path.read_bytes()
    for use in (open_journal, lambda where: JournalReader(where).lines()):
        with pytest.raises(BadSettings, match=r"version 9999.*newer mountnav"):
            use(path)
    assert path.read_bytes() == before


def test_an_upgrade_that_fails_changes_nothing(old_file: Path) -> None:
    """It is one transaction: killed in the middle of it, the old journal is there."""
    from mountnav.journal.migrations.versions import v0004_audit_chain

    assert v0004_audit_chain.revision == HEAD
    with closing(sqlite3.connect(old_file)) as connection:
        # what the last step of the upgrade is about to make is there already
        connection.execute("CREATE TABLE audit_gap (first_no INTEGER)")
        connection.commit()
    with pytest.raises(Exception, match="audit_gap"):
        open_journal(old_file)
    with closing(sqlite3.connect(old_file)) as connection:
        tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        assert tables.isdisjoint({"job", "audit"})
        assert connection.execute("SELECT version_num FROM alembic_version").fetchall() == [("0001",)]
        assert connection.execute("SELECT count(*) FROM look").fetchone() == (2,)


def _require_as_described(where: str | Path) -> None:
    engine = connectable(database_url(where), "read")
    with engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, metadata) == []
    engine.dispose()


def test_migrations_lead_to_the_tables_that_the_code_describes(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    open_journal(path).close()
    _require_as_described(path)
    folder = Path(mountnav.journal.__path__[0]) / "migrations"
    assert ScriptDirectory(str(folder)).get_heads() == [HEAD]


@pytest.mark.long
def test_migrations_lead_to_the_tables_on_postgresql(postgresql: str) -> None:
    open_journal(postgresql).close()
    _require_as_described(postgresql)
