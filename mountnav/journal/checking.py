"""Checking a journal: whether it is sound, what it holds, what is open in it."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import URL, func, select, text
from sqlalchemy.exc import SQLAlchemyError

from mountnav.journal.database import connectable, file_of, shown_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandRecord
from mountnav.journal.tables import HEAD, audit, command, entry, job, look, run
from mountnav.journal.upgrading import require_today, unusable


@dataclass(frozen=True, slots=True)
class Checked:
    """What checking found.

    Attributes
    ----------
    where : str
    version : str
    size_mb : float or None
        Of the file with its write-ahead log.
    rows : dict of str to int
        By table.
    first_utc, last_utc : datetime or None
        Of all lines.
    damage : tuple of str
        What SQLite's own check says; empty when all is well. A server checks itself.
    open_commands : tuple of CommandRecord
        Begun and not closed: under way, or in flight when the service was killed.
    """

    where: str
    version: str
    size_mb: float | None
    rows: dict[str, int]
    first_utc: datetime | None
    last_utc: datetime | None
    damage: tuple[str, ...]
    open_commands: tuple[CommandRecord, ...]


def check(url: URL) -> Checked:
    """Read a journal through and check it. Changes nothing.

    Raises
    ------
    JournalFailed
        It can't be read at all.
    BadSettings
        It is of another version.
    Unknown
        There is none.
    """
    reader = JournalReader(url)
    open_ones = tuple(reader.in_flight())
    engine = connectable(url, "read")
    try:
        with engine.connect() as connection, connection.begin():
            require_today(connection, url)
            rows = {
                table.name: connection.execute(select(func.count()).select_from(table)).scalar_one()
                for table in (run, look, command, entry, job, audit)
            }
            ends = [
                connection.execute(select(func.min(table.c.utc), func.max(table.c.utc))).one()
                for table in (look, command, entry)
            ]
            damage: tuple[str, ...] = ()
            if file_of(url) is not None:
                told = [str(row[0]) for row in connection.execute(text("PRAGMA integrity_check"))]
                damage = () if told == ["ok"] else tuple(told)
    except SQLAlchemyError as error:
        raise unusable(error, url) from error
    finally:
        engine.dispose()
    return Checked(
        where=shown_url(url),
        version=HEAD,
        size_mb=_size_mb(url),
        rows=rows,
        first_utc=min((first for first, _ in ends if first is not None), default=None),
        last_utc=max((last for _, last in ends if last is not None), default=None),
        damage=damage,
        open_commands=open_ones,
    )


def _size_mb(url: URL) -> float | None:
    file = file_of(url)
    if file is None:
        return None
    parts = (file, file.with_name(file.name + "-wal"))
    return sum(part.stat().st_size for part in parts if part.exists()) / 1e6
