"""Reading the journal: filters, a page at a time, or everything as one story in the order of time.

All of it blocks: call it in a thread. It never writes; a service may write the same journal meanwhile.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
import json
import re
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import URL, Connection, Select, Table, desc, false, func, or_, select
from sqlalchemy.sql.elements import ColumnElement

from mountnav.errors import BadRequest, JournalFailed, NotFound
from mountnav.journal.audit_and_leases import AuditRow, LeaseRow, audit_of, audit_query, lease_of
from mountnav.journal.audit_chain import AuditHead, head_of
from mountnav.journal.database import (
    FAULTS,
    connectable,
    database_url,
    explained,
    file_of,
    plain_text,
    shown_url,
)
from mountnav.journal.job_rows import JobRow, job_of
from mountnav.journal.records import CommandEnd, CommandRecord, Entry, EntryKind, LookRecord, Outcome
from mountnav.journal.rows import command_of, end_of, entry_of, look_of
from mountnav.journal.tables import command, entry, job, lease, look, run
from mountnav.journal.upgrading import damaged_journal, is_begun, is_damage, require_today
from mountnav.parsing import json_of

__all__ = ["ALL", "JournalReader", "Line", "Mark", "Run", "Wanted"]


LOOK, COMMAND = "look", "command"
KINDS = (LOOK, COMMAND, *(str(kind) for kind in EntryKind))
"""Kinds of lines that there are."""
_AGO = re.compile(r"(\d+(?:\.\d+)?)\s*(s|min|m|h|d|w)")
_EARLIEST, _LATEST = datetime(1000, 1, 1), datetime(9000, 1, 1)
# Seconds of each unit of time that a filter may name.
_UNIT_S = {"s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0, "d": 86400.0, "w": 604800.0}


@dataclass(frozen=True, slots=True)
class Wanted:
    """Filters; what is None or empty filters nothing. A line must pass all of them.

    Attributes
    ----------
    telescope : str or None
        Rows of the whole service (``""``) don't pass a telescope's name.
    telescopes : frozenset of str or None
        One of these; an empty one lets nothing pass.
    kinds : frozenset of str
        Of `KINDS`: ``look``, ``command``, or an entry's kind.
    since, until : datetime or None
        From (included) and to (not included).
    job_id, night_id : str or None
        Of its cause.
    outcome : str or None
        A command's; ``open`` for one that has none yet, ``solved`` and ``unsolved`` for looks.
    text : str or None
        Somewhere in its words, without regard to case.
    run_id : str or None
        Of one run of the service.
    """

    telescope: str | None = None
    kinds: frozenset[str] = frozenset()
    since: datetime | None = None
    until: datetime | None = None
    job_id: str | None = None
    night_id: str | None = None
    outcome: str | None = None
    text: str | None = None
    segment_id: str | None = None
    run_id: str | None = None
    telescopes: frozenset[str] | None = None

    def __post_init__(self) -> None:
        if unknown := sorted(self.kinds - set(KINDS)):
            raise BadRequest(
                f"there is no kind {unknown[0]!r} of journal lines", advice=f"one of {', '.join(KINDS)}"
            )
        for utc in (self.since, self.until):
            if utc is not None and not _EARLIEST <= utc.replace(tzinfo=None) <= _LATEST:
                raise BadRequest(
                    f"{utc.isoformat()} is not a time of a journal's", advice="from 1000 to 9000"
                )
        outcomes = ("open", "solved", "unsolved", *(str(one) for one in Outcome))
        if self.outcome is not None and self.outcome not in outcomes:
            raise BadRequest(f"there is no outcome {self.outcome!r}", advice=f"one of {', '.join(outcomes)}")


@dataclass(frozen=True, slots=True, order=True)
class Mark:
    """A line's place in the story: in order of instants, then of the tables and their rows."""

    utc: datetime
    table: int
    row: int

    def encoded(self) -> str:
        """As text that a client hands back."""
        raw = json.dumps([self.utc.isoformat(), self.table, self.row])
        return base64.urlsafe_b64encode(raw.encode()).decode().rstrip("=")

    @classmethod
    def decoded(cls, text: str) -> Mark:
        """From that text. Raises `BadRequest`."""
        try:
            padded = text + "=" * (-len(text) % 4)
            utc, table, row = json_of(base64.urlsafe_b64decode(padded.encode("ascii")))
            found = cls(datetime.fromisoformat(utc), int(table), int(row))
            dated = _EARLIEST <= found.utc.replace(tzinfo=None) <= _LATEST
            if found.utc.tzinfo is None or not dated or not 0 <= found.row < 2**62:
                raise ValueError(text)
        except (ValueError, TypeError, OverflowError, UnicodeError, binascii.Error) as error:
            raise BadRequest(
                "this is not a cursor", advice="take the one that the last answer gave"
            ) from error
        return found


def instant(text: str, now: datetime) -> datetime:
    """The instant that a user means: ``2h``, ``3 d`` (ago), an ISO date or time, UTC unless it tells a zone.

    Raises
    ------
    BadRequest
        It is none.
    """
    if found := _AGO.fullmatch(text.strip()):
        try:
            return now - timedelta(seconds=float(found.group(1)) * _UNIT_S[found.group(2)])
        except OverflowError:
            return _EARLIEST.replace(tzinfo=UTC)
    try:
        at = datetime.fromisoformat(text.strip())
        return at.replace(tzinfo=UTC) if at.tzinfo is None else at.astimezone(UTC)
    except (ValueError, OverflowError):
        raise BadRequest(
            f"{text!r} is not a time", advice="write 2h, 3d (ago), 2026-11-22, or 2026-11-22T03:00 (UTC)"
        ) from None


_WORDS = {
    "look": ("reason", "detail", "camera", "source", "mode", "catalog", "used", "why", "look_id"),
    "command": ("order", "end_detail", "outcome", "why", "command_id"),
    "entry": ("what", "kind", "why"),
}


def tables_of(wanted: Wanted) -> tuple[Table, ...]:
    """Tables that may hold a line that passes."""
    kinds = wanted.kinds
    found = []
    if not kinds or kinds & {str(kind) for kind in EntryKind}:
        found.append(entry)
    if not kinds or COMMAND in kinds:
        found.append(command)
    if not kinds or LOOK in kinds:
        found.append(look)
    if wanted.outcome is not None:
        found = [look if wanted.outcome in ("solved", "unsolved") else command]
        if kinds and found[0].name not in kinds:
            return ()
    return tuple(found)


def chosen(table: Table, wanted: Wanted) -> Select[Any]:
    """All columns of the rows that pass, in no order."""
    columns = table.c
    query = select(table)
    for column, value in (
        (columns.telescope, wanted.telescope),
        (columns.cause_job_id, wanted.job_id),
        (columns.cause_night_id, wanted.night_id),
        (columns.run_id, wanted.run_id),
    ):
        if value is not None:
            query = query.where(column == value)
    if wanted.telescopes is not None:
        query = query.where(columns.telescope.in_(sorted(wanted.telescopes)))
    if wanted.since is not None:
        query = query.where(columns.utc >= wanted.since)
    if wanted.until is not None:
        query = query.where(columns.utc < wanted.until)
    if wanted.segment_id is not None:
        query = query.where(false() if table is entry else columns.segment_id == wanted.segment_id)
    if table is entry and wanted.kinds:
        query = query.where(columns.kind.in_(sorted(wanted.kinds)))
    if wanted.outcome is not None:
        query = query.where(_outcome(table, wanted.outcome))
    if wanted.text:
        words = plain_text(wanted.text).lower()
        query = query.where(
            or_(*(func.lower(columns[name]).contains(words, autoescape=True) for name in _WORDS[table.name]))
        )
    return query


def _outcome(table: Table, outcome: str) -> ColumnElement[bool]:
    if table is look:
        return look.c.solved.is_(outcome == "solved")
    if table is command:
        return command.c.outcome.is_(None) if outcome == "open" else command.c.outcome == outcome
    return false()


_TABLES: tuple[Table, ...] = (run, entry, command, look)
ALL = Wanted()


@dataclass(frozen=True, slots=True)
class Line:
    """One thing that was written down.

    Attributes
    ----------
    end : CommandEnd or None
        Of a command that isn't open.
    run_id : str
        In which run of the service.
    """

    mark: Mark
    record: LookRecord | CommandRecord | Entry
    end: CommandEnd | None
    run_id: str

    @property
    def utc(self) -> datetime:
        """When."""
        return self.record.utc

    @property
    def kind(self) -> str:
        """Of `wanted.KINDS`."""
        if isinstance(self.record, LookRecord):
            return LOOK
        return COMMAND if isinstance(self.record, CommandRecord) else str(self.record.kind)


@dataclass(frozen=True, slots=True)
class Run:
    """One start of the service; `ended_utc` is None while it lasts, and when it was killed."""

    run_id: str
    started_utc: datetime
    ended_utc: datetime | None
    version: str
    host: str
    pid: int
    settings_sha256: str
    settings: str


class JournalReader:
    """Reads a journal.

    Parameters
    ----------
    where : str, Path or URL
        A file of SQLite, or a URL.

    Raises
    ------
    BadSettings
        No such kind of database.
    """

    def __init__(self, where: str | Path | URL, *, expected: bool = False) -> None:
        self._expected = expected
        self.url = where if isinstance(where, URL) else database_url(where)
        self._engine = connectable(self.url, "read")
        self._checked = threading.Event()

    def looks(
        self, wanted: Wanted = ALL, *, limit: int | None = None, newest_first: bool = False
    ) -> list[LookRecord]:
        """Looks that pass, in the order of time. Raises as `lines`."""
        return [look_of(row) for row in self._rows(look, wanted, limit, newest_first)]

    def commands(
        self, wanted: Wanted = ALL, *, limit: int | None = None, newest_first: bool = False
    ) -> list[tuple[CommandRecord, CommandEnd | None]]:
        """Commands that pass, with their ends, in the order of time. Raises as `lines`."""
        return [(command_of(row), end_of(row)) for row in self._rows(command, wanted, limit, newest_first)]

    def entries(
        self, wanted: Wanted = ALL, *, limit: int | None = None, newest_first: bool = False
    ) -> list[Entry]:
        """Entries that pass, in the order of time. Raises as `lines`."""
        return [entry_of(row) for row in self._rows(entry, wanted, limit, newest_first)]

    def in_flight(self, telescope: str | None = None, *, but_run: str | None = None) -> list[CommandRecord]:
        """Commands that were begun and not closed, in the order of time.

        Parameters
        ----------
        telescope : str, optional
            Of all, if it isn't given.
        but_run : str, optional
            Leave out those of this run of the service: they are under way.
        """
        query = select(command).where(command.c.outcome.is_(None)).order_by(command.c.row_id)
        if telescope is not None:
            query = query.where(command.c.telescope == telescope)
        if but_run is not None:
            query = query.where(command.c.run_id != but_run)
        with self._reading() as connection:
            return [command_of(row) for row in _found(connection, query)]

    def latest_of(
        self, order: str, telescope: str, *, but_run: str | None = None, limit: int = 1
    ) -> list[tuple[CommandRecord, CommandEnd | None]]:
        """The latest commands of one order to a telescope, with their ends, the latest first.

        Parameters
        ----------
        but_run : str, optional
            Leave out those of this run of the service.
        """
        query = (
            select(command)
            .where(command.c.order == order, command.c.telescope == telescope)
            .order_by(desc(command.c.row_id))
            .limit(limit)
        )
        if but_run is not None:
            query = query.where(command.c.run_id != but_run)
        with self._reading() as connection:
            return [(command_of(row), end_of(row)) for row in _found(connection, query)]

    def last_entry(self, kind: EntryKind, telescope: str) -> Entry | None:
        """The entry of a kind that was written last, whatever the clock said then. Raises as `lines`."""
        query = (
            select(entry)
            .where(entry.c.telescope == telescope, entry.c.kind == str(kind))
            .order_by(desc(entry.c.row_id))
            .limit(1)
        )
        with self._reading() as connection:
            rows = _found(connection, query)
        return entry_of(rows[0]) if rows else None

    def lines(
        self, wanted: Wanted = ALL, *, after: Mark | None = None, limit: int = 100, newest_first: bool = False
    ) -> list[Line]:
        """A page of the story: looks, commands and entries together, in the order of time.

        Parameters
        ----------
        after : Mark, optional
            Go on behind this line: the last one of the page before.
        newest_first : bool
            Backwards.

        Raises
        ------
        JournalFailed
            It can't be read.
        BadSettings
            It is of another version.
        NotFound
            There is none.
        """
        found: list[Line] = []
        with self._reading() as connection:
            for table in tables_of(wanted):
                query = _after(chosen(table, wanted), table, after, newest_first)
                ordered = _ordered(query, table, newest_first).limit(limit)
                found += [_line(table, row) for row in _found(connection, ordered)]
        found.sort(key=lambda line: line.mark, reverse=newest_first)
        return found[:limit]

    def story(self, wanted: Wanted = ALL, *, page: int = 1000) -> Iterator[Line]:
        """All lines that pass, in the order of time, without holding them all in memory."""
        mark: Mark | None = None
        while lines := self.lines(wanted, after=mark, limit=page):
            yield from lines
            mark = lines[-1].mark

    def rows(self, table: Table, wanted: Wanted = ALL, *, page: int = 5000) -> Iterator[Mapping[str, Any]]:
        """Raw rows of one table that pass, in the order of writing, a page in memory at a time."""
        last = 0
        while True:
            query = chosen(table, wanted).where(table.c.row_id > last).order_by(table.c.row_id).limit(page)
            with self._reading() as connection:
                found = _found(connection, query)
            yield from found
            if len(found) < page:
                return
            last = found[-1]["row_id"]

    def newest(self) -> tuple[int, int, int]:
        """The last row numbers of entries, commands and looks: where following begins."""
        with self._reading() as connection:
            last = [connection.execute(select(func.max(table.c.row_id))).scalar() for table in _TABLES[1:]]
        return (last[0] or 0, last[1] or 0, last[2] or 0)

    def written_after(
        self, newest: tuple[int, int, int], wanted: Wanted = ALL, *, limit: int = 1000
    ) -> tuple[list[Line], tuple[int, int, int]]:
        """What was written since, in the order of time; and where to go on."""
        found: list[Line] = []
        last = list(newest)
        with self._reading() as connection:
            for table in tables_of(wanted):
                number = _TABLES.index(table) - 1
                query = chosen(table, wanted).where(table.c.row_id > newest[number])
                rows = _found(connection, query.order_by(table.c.row_id).limit(limit))
                found += [_line(table, row) for row in rows]
                if rows:
                    last[number] = rows[-1]["row_id"]
        found.sort(key=lambda line: line.mark)
        return found, (last[0], last[1], last[2])

    def runs(
        self, limit: int | None = 100, *, since: datetime | None = None, until: datetime | None = None
    ) -> list[Run]:
        """Starts of the service, newest first; from `since` on, and before `until`. Raises as `lines`."""
        query = select(run).order_by(desc(run.c.started_utc)).limit(limit)
        if since is not None:
            query = query.where(run.c.started_utc >= since)
        if until is not None:
            query = query.where(run.c.started_utc < until)
        with self._reading() as connection:
            return [Run(**row) for row in _found(connection, query)]

    def job(self, job_id: str) -> JobRow | None:
        """A job, as it was written last."""
        with self._reading() as connection:
            rows = _found(connection, select(job).where(job.c.job_id == job_id))
        return job_of(rows[0]) if rows else None

    def jobs(
        self,
        limit: int | None,
        *,
        telescopes: frozenset[str] | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
    ) -> list[JobRow]:
        """The last jobs, newest first; made from `since` on, and before `until`."""
        query = select(job).order_by(desc(job.c.created_utc)).limit(limit)
        if telescopes is not None:
            query = query.where(job.c.telescope.in_(sorted(telescopes)))
        if since is not None:
            query = query.where(job.c.created_utc >= since)
        if until is not None:
            query = query.where(job.c.created_utc < until)
        with self._reading() as connection:
            return [job_of(row) for row in _found(connection, query)]

    def audits(
        self,
        *,
        telescope: str | None = None,
        caller: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
        before_row: int | None = None,
        limit: int = 100,
        telescopes: frozenset[str] | None = None,
    ) -> list[AuditRow]:
        """Who ordered what, newest first; with `before_row`, older than that row. Raises as `lines`."""
        query = audit_query(
            telescope=telescope,
            caller=caller,
            since=since,
            until=until,
            before_row=before_row,
            limit=limit,
            telescopes=telescopes,
        )
        with self._reading() as connection:
            return [audit_of(row) for row in _found(connection, query)]

    def audit_head(self) -> AuditHead | None:
        """Where the audit's chain stands; None without a row. Raises as `lines`."""
        with self._reading() as connection:
            return head_of(connection)

    def leases(self, telescopes: frozenset[str]) -> list[LeaseRow]:
        """Leases of these telescopes that were not ended. Raises as `lines`."""
        query = select(lease).where(lease.c.telescope.in_(sorted(telescopes)))
        with self._reading() as connection:
            return [lease_of(row) for row in _found(connection, query)]

    def _rows(
        self, table: Table, wanted: Wanted, limit: int | None, newest_first: bool
    ) -> list[dict[str, Any]]:
        if table not in tables_of(wanted):
            return []
        query = _ordered(chosen(table, wanted), table, newest_first).limit(limit)
        with self._reading() as connection:
            return _found(connection, query)

    @contextlib.contextmanager
    def _reading(self) -> Iterator[Connection]:
        file = file_of(self.url)
        if file is not None and not file.exists():
            if self._expected:
                raise JournalFailed(
                    "it is not there at the moment",
                    device=str(file),
                    advice="is its disk mounted? mountnav tries again by itself",
                )
            raise NotFound(
                f"there is no journal at {file}",
                advice="the service makes it when it is first started; --journal names another",
            )
        try:
            with self._engine.connect() as connection, connection.begin():
                if not self._checked.is_set():
                    if self._expected and not is_begun(connection, self.url):
                        raise JournalFailed(
                            "it could not be created yet: the file is empty",
                            device=shown_url(self.url),
                            advice="is there room on the disk, may it be written? it is tried again",
                        )
                    require_today(connection, self.url)
                    self._checked.set()
                yield connection
        except FAULTS as error:
            if is_damage(error):
                raise damaged_journal(explained(error), self.url) from error
            raise JournalFailed(
                f"it can't be read: {explained(error)}",
                device=shown_url(self.url),
                advice="`mountnav journal check` says more",
            ) from error


def _found(connection: Connection, query: Select[Any]) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in connection.execute(query).mappings()]


def _line(table: Table, row: Mapping[str, Any]) -> Line:
    mark = Mark(row["utc"], _TABLES.index(table), row["row_id"])
    if table is look:
        return Line(mark, look_of(row), None, row["run_id"])
    if table is command:
        return Line(mark, command_of(row), end_of(row), row["run_id"])
    return Line(mark, entry_of(row), None, row["run_id"])


def _ordered(query: Select[Any], table: Table, newest_first: bool) -> Select[Any]:
    columns = (table.c.utc, table.c.row_id)
    return query.order_by(*(desc(column) for column in columns)) if newest_first else query.order_by(*columns)


def _after(query: Select[Any], table: Table, after: Mark | None, newest_first: bool) -> Select[Any]:
    if after is None:
        return query
    number = _TABLES.index(table)
    # at the same instant, tables stand in their order: all rows of one before the mark's, or none
    row = after.row if number == after.table else 2**62 if number < after.table else -1
    if newest_first:
        return query.where(or_(table.c.utc < after.utc, (table.c.utc == after.utc) & (table.c.row_id < row)))
    return query.where(or_(table.c.utc > after.utc, (table.c.utc == after.utc) & (table.c.row_id > row)))
