"""Checking a journal: whether it is sound, what it holds, what is open in it."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import time
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import URL, func, select, text

from mountnav.journal.database import BUSY_S, FAULTS, connectable, file_of, shown_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandRecord
from mountnav.journal.tables import HEAD, audit, command, entry, job, look, run
from mountnav.journal.upgrading import damaged_journal, require_today, unusable

_log = logging.getLogger(__name__)


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
    except FAULTS as error:
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


CHECK_S = 5.0
"""So long the start of a service looks for damage: some 0.5 GB. What is beyond it `journal check` finds."""
_STEPS = 10_000
"""Of SQLite's machine between looks at the clock: some 0.1 ms."""
_HEAD_BYTES = 100
"""Length of the header of a database [SQLite file format, 1.3]."""


def require_whole(url: URL) -> None:
    """Raise `JournalDamaged` if a file of SQLite is shorter than it says [SQLite file format §1.3].

    SQLite itself reads what is missing as zeros, which may pass for an empty text. With a write-ahead log
    beside it nothing is said: what is missing may stand there.
    """
    file = file_of(url)
    if file is None:
        return
    log = file.with_name(file.name + "-wal")
    try:
        if log.exists() and log.stat().st_size:
            return
        with file.open("rb") as opened:
            head = opened.read(_HEAD_BYTES)
        size = file.stat().st_size
    except OSError:
        # whoever opens it tells why it can't be read
        return
    if len(head) < _HEAD_BYTES or not head.startswith(b"SQLite format 3\0"):
        return
    page_bytes = int.from_bytes(head[16:18], "big")
    page_bytes = 65_536 if page_bytes == 1 else page_bytes
    told = page_bytes * int.from_bytes(head[28:32], "big")
    # the count of pages counts if it was written with the last change
    if head[24:28] == head[92:96] and size < told:
        raise damaged_journal(f"the file has {size} bytes, and should have {told}", url)


def require_sound(url: URL, *, most_s: float = CHECK_S) -> bool:
    """Raise unless a file of SQLite is sound, as far as that can be seen in time. A server checks itself.

    Returns
    -------
    bool
        Whether all of it was looked at.

    Raises
    ------
    JournalDamaged
    JournalFailed
        It can't be read.
    """
    file = file_of(url)
    if file is None:
        return True
    deadline_s = time.monotonic() + most_s
    try:
        with contextlib.closing(sqlite3.connect(file, timeout=BUSY_S)) as connection:
            connection.set_progress_handler(lambda: time.monotonic() > deadline_s, _STEPS)
            told = [str(row[0]) for row in connection.execute("PRAGMA integrity_check(3)")]
    except sqlite3.OperationalError as error:
        if getattr(error, "sqlite_errorname", "") == "SQLITE_INTERRUPT":
            _log.info("the journal %s was not looked through whole within %g s", file, most_s)
            return False
        raise unusable(error, url) from error
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise unusable(error, url) from error
    if told != ["ok"]:
        raise damaged_journal(" ".join("; ".join(told).split()), url)
    return True


def _size_mb(url: URL) -> float | None:
    file = file_of(url)
    if file is None:
        return None
    size = 0
    for part in (file, file.with_name(file.name + "-wal")):
        # SQLite takes its log away when the last who has the journal open closes it
        with contextlib.suppress(FileNotFoundError):
            size += part.stat().st_size
    return size / 1e6
