"""A journal whose file was damaged is told as such, wherever the damage lies."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from mountnav.errors import JournalDamaged
from mountnav.journal.database import database_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.sql_journal import open_journal
from mountnav.journal.upkeep import check
from tests.journal.samples import look_of, note_of, slew_of


@pytest.fixture
async def told(tmp_path: Path) -> Path:
    """A journal with a look, an order and a note, closed."""
    file = tmp_path / "journal.sqlite"
    journal = open_journal(file, inline=True)
    await journal.look(look_of())
    await journal.begin(slew_of())
    await journal.note(note_of("a note"))
    journal.close()
    return file


def test_damage_that_sqlite_cannot_name_in_utf_8(told: Path) -> None:
    data = told.read_bytes()
    name = b"CREATE TABLE look"
    assert name in data
    # SQLite repeats the name in its error, and its driver can't read that
    told.write_bytes(data.replace(name, b"CREATE \xa3ABLE look", 1))
    with pytest.raises(JournalDamaged, match="damaged"):
        JournalReader(told).looks()
    with pytest.raises(JournalDamaged, match="damaged"):
        check(database_url(told))
    with pytest.raises(JournalDamaged, match="damaged"):
        open_journal(told, inline=True)


@pytest.mark.long
@pytest.mark.parametrize(
    ("column", "value"),
    [("utc", "not an instant"), ("utc", 12.5), ("facts", "{not json"), ("facts", b"\xff\xfe")],
)
def test_values_that_are_none(told: Path, column: str, value: object) -> None:
    connection = sqlite3.connect(told)
    connection.execute(f"UPDATE entry SET {column} = ?", (value,))
    connection.commit()
    connection.close()
    with pytest.raises(JournalDamaged, match="damaged"):
        JournalReader(told).entries()
