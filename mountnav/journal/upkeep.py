"""A journal checked (is it sound, what does it hold, what is open) and thinned (old looks are removed).

Thinning removes a few rows at a time. Kept forever: commands with their outcomes, runs, and entries of
models, settings, segments, syncs, refusals, faults and the service. Removed when they are older than asked
or the file grows too big: looks, jobs that are over, and entries of decisions, links, nights, jobs,
centerings, what was learned, notes, and of where a mount stood, but for the last of each telescope. Audits
are removed when they are older than asked; a file that grows too big loses only those of guide pulses, so
that nobody can push their own audits out of it. Their chain tells of the gap, and a row of its own what was
removed (`mountnav.journal.audit_chain`).
"""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import URL, Column, Connection, Table, delete, func, select, text
from sqlalchemy.sql.elements import ColumnElement

from mountnav.clock import seconds, utc_now
from mountnav.journal.audit_and_leases import AuditRow, audit_values
from mountnav.journal.audit_chain import AuditKey, append_audit, remove_audits
from mountnav.journal.database import BUSY_S, FAULTS, connectable, file_of, shown_url
from mountnav.journal.reading import JournalReader
from mountnav.journal.records import CommandRecord, EntryKind
from mountnav.journal.tables import HEAD, audit, command, entry, job, look, run
from mountnav.journal.upgrading import damaged_journal, require_today, unusable

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Checked:
    """What checking found.

    Attributes
    ----------
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
    NotFound
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
        # its opening tells why it can't be read
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
            _log.info("the journal %s was not checked completely within %g s", file, most_s)
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


PASSING = frozenset(
    {
        EntryKind.DECISION,
        EntryKind.LINK,
        EntryKind.NIGHT,
        EntryKind.JOB,
        EntryKind.CENTERING,
        EntryKind.LEARNED,
        EntryKind.NOTE,
    }
)
"""Kinds of entries that may be removed when they are old."""

_PULSE = "guide"
# Rows that one transaction removes. Chosen by hand so that no command waits for the cleaning; doubled, each
# transaction holds the database twice as long.
_AT_ONCE = 200
# Seconds until the next look for old rows when nothing was left to remove. Chosen by hand: rows are kept
# for days.
_EVERY_S = 6 * 3600.0
_AHEAD = timedelta(days=1)
"""So far the clock may be set ahead while a service runs before retention stops believing it. Doubled, rows
go two days early by a clock that is wrong."""
_NEWEST_KEPT = 100
"""So many of the newest entries stay in any case: what a restart takes up again."""


@dataclass(slots=True)
class Thinning:
    """What may go, and when it was looked at last.

    Attributes
    ----------
    keep_days : float
        0 for no bound.
    max_size_mb : float
        Of a file; 0 for no bound.
    audit_key : AuditKey or None
        What seals gaps of the audit.
    run_id : str
        Of the run that removes.
    looks_keep_days, audit_keep_days : float or None
        The same as `keep_days` for these alone; None: that.
    """

    keep_days: float = 0.0
    max_size_mb: float = 0.0
    audit_key: AuditKey | None = None
    run_id: str = ""
    looks_keep_days: float | None = None
    audit_keep_days: float | None = None
    clock_s: Callable[[], float] = seconds
    _next_s: float = 0.0
    _audits: int = 0
    _began: tuple[datetime, float] | None = None

    @property
    def wanted(self) -> bool:
        """Whether anything is ever removed."""
        return self.max_size_mb > 0 or any(
            days > 0 for days in (self.keep_days, self._looks_days, self._audit_days)
        )

    @property
    def _looks_days(self) -> float:
        return self.keep_days if self.looks_keep_days is None else self.looks_keep_days

    @property
    def _audit_days(self) -> float:
        return self.keep_days if self.audit_keep_days is None else self.audit_keep_days

    def step(self, connection: Connection) -> bool:
        """Remove a little; return whether there is more to remove now."""
        if self.clock_s() < self._next_s:
            return False
        removed = 0
        now = self._now()
        if self._looks_days > 0:
            limit = now - timedelta(days=self._looks_days)
            removed += _remove(connection, look, look.c.row_id, look.c.utc < limit)
        if self.keep_days > 0:
            limit = now - timedelta(days=self.keep_days)
            removed += _remove(connection, entry, entry.c.row_id, entry.c.utc < limit, _passing(connection))
            over = job.c.finished_utc.is_not(None)
            removed += _remove(connection, job, job.c.job_id, job.c.created_utc < limit, over)
        if self._audit_days > 0:
            limit = now - timedelta(days=self._audit_days)
            why = f"older than {self._audit_days:g} days"
            removed += self._remove_audits(connection, why, audit.c.utc < limit)
        if removed == 0 and self.max_size_mb > 0 and _size_of_file_mb(connection) > self.max_size_mb:
            removed += _remove(connection, look, look.c.row_id)
            removed += _remove(connection, entry, entry.c.row_id, _passing(connection))
            why = f"guide pulses of a journal of more than {self.max_size_mb:g} MB"
            removed += self._remove_audits(connection, why, audit.c.what == _PULSE)
        if removed == 0:
            self._tell_audits(connection)
            self._next_s = self.clock_s() + _EVERY_S
        return removed > 0

    def _now(self) -> datetime:
        """Now, but no more than a day ahead of what has passed: a clock set to 2038 empties no journal."""
        if self._began is None:
            self._began = utc_now(), seconds()
        began_utc, began_s = self._began
        return min(utc_now(), began_utc + timedelta(seconds=seconds() - began_s) + _AHEAD)

    def _remove_audits(self, connection: Connection, why: str, condition: ColumnElement[bool]) -> int:
        removed = remove_audits(
            connection,
            condition,
            most=_AT_ONCE,
            why=why,
            run_id=self.run_id,
            utc=utc_now(),
            key=self.audit_key,
        )
        self._audits += removed
        return removed

    def _tell_audits(self, connection: Connection) -> None:
        """Write into the audit how many of its rows were removed since the last such row."""
        if not self._audits:
            return
        told = {"rows": self._audits, "keep_days": self._audit_days, "max_size_mb": self.max_size_mb}
        row = AuditRow(
            *(utc_now(), "", "the service", "configure", "service", "", "audit-thinned", told, "taken")
        )
        append_audit(connection, audit_values(row, self.run_id), self.audit_key)
        self._audits = 0


def _passing(connection: Connection) -> ColumnElement[bool]:
    newest = connection.execute(select(func.max(entry.c.row_id))).scalar() or 0
    stands = entry.c.kind == str(EntryKind.STANDING)
    latest = select(func.max(entry.c.row_id)).where(stands).group_by(entry.c.telescope)
    lasting = [row[0] for row in connection.execute(latest)]
    passing = entry.c.kind.in_([str(kind) for kind in PASSING])
    return (passing | (stands & entry.c.row_id.not_in(lasting))) & (entry.c.row_id < newest - _NEWEST_KEPT)


def _remove(
    connection: Connection, table: Table, key: Column[object], *conditions: ColumnElement[bool]
) -> int:
    """Remove the oldest rows that fulfill all conditions, a few at once."""
    oldest = select(key).where(*conditions).order_by(key).limit(_AT_ONCE)
    return connection.execute(delete(table).where(key.in_(oldest))).rowcount


def _size_of_file_mb(connection: Connection) -> float:
    """What the rows take in a file; 0 on a server, whose size is the site's business."""
    if connection.dialect.name != "sqlite":
        return 0.0
    pages, free, size = (
        connection.execute(text(f"PRAGMA {what}")).scalar_one()
        for what in ("page_count", "freelist_count", "page_size")
    )
    return float((pages - free) * size / 1e6)
