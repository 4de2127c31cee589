"""The journal in a database: SQLite, or PostgreSQL. What was awaited is there, whatever kills the process."""

from __future__ import annotations

import asyncio
import logging
import os
import platform
import threading
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import URL, Connection, Executable, delete, insert, or_, select, update

from mountnav.clock import utc_now
from mountnav.errors import JournalDamaged, JournalFailed
from mountnav.journal.audit_and_leases import AuditRow, LeaseRow, audit_values, lease_statement
from mountnav.journal.audit_chain import AuditKey, append_audit
from mountnav.journal.claims import CLAIM_PATIENCE_S, claim, require_free
from mountnav.journal.database import database_url, explained, shown_url
from mountnav.journal.job_rows import JobRow, save_statement
from mountnav.journal.reading import JournalReader, Wanted
from mountnav.journal.records import (
    Cause,
    CommandEnd,
    CommandRecord,
    Entry,
    EntryKind,
    LookRecord,
    Outcome,
    new_id,
)
from mountnav.journal.rows import command_row, end_row, entry_row, look_row
from mountnav.journal.runs import begin_run, end_run
from mountnav.journal.tables import command, entry, lease, look, run
from mountnav.journal.upgrading import upgrade
from mountnav.journal.upkeep import Thinning, require_sound, require_whole
from mountnav.journal.writer import Fsync, Piece, Statements, Trouble, Writer
from mountnav.version import version

_log = logging.getLogger(__name__)

# Seconds that an order waits for its row to be written before it is refused. Chosen by hand: longer than
# `BUSY_S` of a locked database. Doubled, an order to a dead disk is refused after a minute.
PATIENCE_S = 30.0


def open_journal(
    where: str | Path,
    *,
    settings_text: str = "",
    inline: bool = False,
    fsync: Fsync = "commands",
    keep_days: float = 0.0,
    max_size_mb: float = 0.0,
    patient: bool = False,
    audit_key: AuditKey | None = None,
    looks_keep_days: float | None = None,
    audit_keep_days: float | None = None,
    telescopes: frozenset[str] = frozenset(),
    claim_patience_s: float = CLAIM_PATIENCE_S,
) -> SqlJournal:
    """Open a journal for writing, made or brought up to date if need be. Blocks: call it in a thread.

    Parameters
    ----------
    where : str or Path
        A file of SQLite, or a URL.
    settings_text : str, optional
        The configuration as text; an entry tells what has changed since the last run. Passwords in URLs are
        left out.
    inline : bool
        Write in the caller's thread: for event loops whose time jumps.
    fsync : {"commands", "always", "never"}
        What is on the disk itself, not only with the operating system, when it counts as written.
    keep_days : float
        Looks and passing notes older than this are removed; 0 keeps all.
    max_size_mb : float
        The oldest of them are removed when a file grows beyond this; 0 for no bound.
    patient : bool
        Where it can't be opened or written now, give one that has a `problem`, and is opened as soon as that
        is possible: tried each second.
    audit_key : AuditKey, optional
        What seals the audit's rows.
    looks_keep_days, audit_keep_days : float, optional
        As `keep_days`, for these alone.
    telescopes : frozenset of str
        Taken for this service alone, where the journal is on PostgreSQL: see `mountnav.journal.claims`.
    claim_patience_s : float
        How long another service that has one of them is waited for.

    Raises
    ------
    BadSettings
        No such kind of database, another program's, or a newer mountnav's; or another service has one of the
        telescopes.
    JournalDamaged
        It is damaged.
    JournalFailed
        It can't be opened or written.
    """
    url = database_url(where)

    def prepare() -> None:
        require_whole(url)
        upgrade(url)
        require_sound(url)

    opened = True
    try:
        prepare()
    except JournalDamaged:
        raise
    except JournalFailed as failure:
        if not patient:
            raise
        _log.error("the journal can't be opened, and is tried again each second: %s", failure)
        opened = False
    if opened and telescopes:
        require_free(url, telescopes, claim_patience_s)
    journal = SqlJournal(
        url,
        telescopes=telescopes,
        inline=inline,
        fsync=fsync,
        thinning=Thinning(
            keep_days,
            max_size_mb,
            audit_key=audit_key,
            looks_keep_days=looks_keep_days,
            audit_keep_days=audit_keep_days,
        ),
        prepare=None if opened else prepare,
        audit_key=audit_key,
    )
    try:
        journal.begin_run(settings_text, kept=patient)
    except JournalFailed as failure:
        if not patient:
            raise
        _log.error("the journal can't be written, and is tried again each second: %s", failure)
    return journal


class SqlJournal:
    """Writes looks, commands and notes; see `Journal` for what each promises. Made by `open_journal`.

    Parameters
    ----------
    prepare : callable, optional
        Called before it is first written, until it doesn't raise.
    audit_key : AuditKey, optional
        What seals the audit's rows.
    telescopes : frozenset of str
        Claimed with each connection.
    """

    def __init__(
        self,
        url: URL,
        *,
        inline: bool = False,
        fsync: Fsync = "commands",
        thinning: Thinning | None = None,
        prepare: Callable[[], None] | None = None,
        audit_key: AuditKey | None = None,
        telescopes: frozenset[str] = frozenset(),
    ) -> None:
        self.run_id = new_id()
        self._audit_key = audit_key
        if thinning is not None:
            thinning.run_id = self.run_id
        self._url = url
        self._inline = inline
        self._reader = JournalReader(url, expected=True)
        self._writer = Writer(
            url,
            fsync=fsync,
            inline=inline,
            outlived=self._outlived,
            probe=self._probe,
            idle=thinning.step if thinning is not None and thinning.wanted else None,
            prepare=prepare,
            claim=(lambda connection: claim(connection, telescopes)) if telescopes else None,
        )

    @property
    def url(self) -> URL:
        """Where it is."""
        return self._url

    @property
    def reader(self) -> JournalReader:
        """A reader of this journal."""
        return self._reader

    @property
    def problem(self) -> str | None:
        """Why it can't be written just now, in words; None when all is well."""
        trouble = self._writer.trouble
        if trouble is None:
            return None
        return (
            f"the journal can't be written since {trouble.since_utc:%H:%M:%S} UTC: {trouble.why}; "
            "nothing but a stop and a park is sent to a mount until it can"
        )

    @property
    def waiting(self) -> int:
        """Rows that are not written yet."""
        return self._writer.waiting

    def begin_run(self, settings_text: str, *, kept: bool = False) -> None:
        """Write down that the service begins, and what is new in its settings.

        Raises
        ------
        JournalFailed
            It isn't written; with `kept` it will be.
        """
        text = platform.node(), os.getpid(), version()
        begun = begin_run(self.run_id, *text, settings_text, utc_now())
        self._now_or_raise(Piece(begun, durable=True, kept=kept))

    def close(self) -> None:
        """Write what waits, and that the service has ended. Blocks for 10 s at most."""
        self._writer.close(Piece(end_run(self.run_id, utc_now()), durable=True))

    async def look(self, record: LookRecord) -> None:
        """Write a look. Raises `JournalFailed`."""
        row = look_row(record, self.run_id)
        await self._written(Piece(lambda connection: _run(connection, insert(look).values(row))))

    async def begin(self, command_record: CommandRecord) -> None:
        """Write a command down before it is sent; on the disk on return.

        When it is not waited for to the end (cancelled, or after 30 s), it must not be sent: then its row is
        left out, or closed as not sent.

        Raises
        ------
        JournalFailed
            It isn't written: the command must not be sent.
        """
        not_sent = CommandEnd(utc_now(), Outcome.NOT_SENT, "nobody waited for the journal any more")
        piece = Piece(
            self._begin(command_record),
            durable=True,
            undo=self._end(command_record.command_id, not_sent),
        )
        await self._written(piece)

    def begin_now(self, command_record: CommandRecord) -> None:
        """Write a stop down without being waited for. Never raises."""
        self._writer.put(Piece(self._begin(command_record), durable=True, kept=True))

    async def end(self, command_id: str, end: CommandEnd) -> None:
        """Close a command. An end that can't be written now is kept and written later.

        The first end stands, but an unknown outcome gives way to a known one.

        Raises
        ------
        JournalFailed
            It isn't written yet.
        """
        await self._written(Piece(self._end(command_id, end), durable=True, kept=True))

    async def note(self, one: Entry) -> None:
        """Write anything else. Raises `JournalFailed`."""
        await self._written(Piece(self._entry(one)))

    def note_now(self, one: Entry) -> None:
        """As `note`, from code that can't wait; never raises."""
        # the next start asks for it: a power cut right afterwards must not lose it
        lasting = one.kind is EntryKind.STANDING
        self._writer.put(Piece(self._entry(one), durable=lasting, kept=True, dispensable=not lasting))

    async def save_job(self, job: JobRow) -> None:
        """Write how a job stands; on the disk on return. Raises `JournalFailed`; kept and written later."""
        await self._written(Piece(self._job(job), durable=True, kept=True))

    def save_job_now(self, job: JobRow) -> None:
        """As `save_job`, without waiting. Never raises."""
        self._writer.put(Piece(self._job(job), kept=True))

    def audit_now(self, row: AuditRow) -> None:
        """Write down who ordered what, without waiting. Never raises; kept and written later if need be."""
        values = audit_values(row, self.run_id)
        self._writer.put(
            Piece(
                lambda connection: append_audit(connection, values, self._audit_key), durable=True, kept=True
            )
        )

    async def save_lease(self, row: LeaseRow) -> None:
        """Write who holds a telescope; on the disk on return. Raises `JournalFailed`."""
        undo = self._no_lease(row.telescope, row.secret_sha256)
        await self._written(Piece(self._lease(row), durable=True, undo=undo))

    def save_lease_now(self, row: LeaseRow) -> None:
        """As `save_lease`, for a heartbeat: without waiting; never raises, the next one follows soon."""
        self._writer.put(Piece(self._lease(row), dispensable=True))

    def end_lease_now(self, telescope: str, secret_sha256: str) -> None:
        """A lease is over. Never raises; kept and written later if need be."""
        self._writer.put(Piece(self._no_lease(telescope, secret_sha256), durable=True, kept=True))

    async def recent(self, telescope: str, kind: EntryKind, count: int) -> list[Entry]:
        """The last entries of a kind, oldest first. Raises `JournalFailed`."""
        wanted = Wanted(telescope=telescope, kinds=frozenset({kind}))

        def read() -> list[Entry]:
            return self.reader.entries(wanted, limit=count, newest_first=True)[::-1]

        return read() if self._inline else await asyncio.to_thread(read)

    async def _written(self, piece: Piece) -> None:
        if self._inline:
            self._now_or_raise(piece)
            return
        loop = asyncio.get_running_loop()
        future: asyncio.Future[None] = loop.create_future()
        piece.told = _teller(loop, future)
        self._writer.put(piece)
        try:
            async with asyncio.timeout(PATIENCE_S):
                await future
        except asyncio.CancelledError:
            self._writer.give_up(piece)
            raise
        except TimeoutError:
            self._writer.give_up(piece)
            raise JournalFailed(
                f"nothing was written within {PATIENCE_S:.0f} s",
                device=shown_url(self._url),
                advice="does the disk, or the database server, still answer?",
            ) from None
        except Exception as error:
            raise self._failed(error) from error

    def _now_or_raise(self, piece: Piece) -> None:
        """Write in this thread, or wait for the writer's."""
        done = threading.Event()
        errors: list[Exception] = []

        def told(error: Exception | None) -> None:
            if error is not None:
                errors.append(error)
            done.set()

        piece.told = told
        self._writer.put(piece)
        if not done.wait(PATIENCE_S):
            self._writer.give_up(piece)
            errors.append(TimeoutError(f"nothing was written within {PATIENCE_S:.0f} s"))
        if errors:
            raise self._failed(errors[0]) from errors[0]

    def _failed(self, error: Exception) -> JournalFailed:
        if isinstance(error, JournalFailed):
            return error
        return JournalFailed(
            f"it can't be written: {explained(error)}",
            device=shown_url(self._url),
            advice="make room on the disk, or see whether the server runs; mountnav tries again by itself",
        )

    def _begin(self, record: CommandRecord) -> Statements:
        row = command_row(record, self.run_id)
        return lambda connection: _run(connection, insert(command).values(row))

    def _end(self, command_id: str, end: CommandEnd) -> Statements:
        values = end_row(end)
        # an outcome that is known takes the place of "unknown", not of another that is known
        weaker = [] if end.outcome is Outcome.UNKNOWN else [command.c.outcome == str(Outcome.UNKNOWN)]
        open_or_unknown = or_(command.c.outcome.is_(None), *weaker)

        def close(connection: Connection) -> None:
            closed = connection.execute(
                update(command).where(command.c.command_id == command_id, open_or_unknown).values(values)
            )
            known = select(command.c.row_id).where(command.c.command_id == command_id)
            if closed.rowcount == 0 and connection.execute(known).first() is None:
                lost = Entry(
                    end.utc,
                    "",
                    EntryKind.FAULT,
                    f"a command ended ({end.outcome}) whose beginning is not in the journal",
                    {"command_id": command_id, "outcome": end.outcome, "detail": end.detail},
                    Cause(),
                )
                _run(connection, insert(entry).values(entry_row(lost, self.run_id)))

        return close

    def _entry(self, one: Entry) -> Statements:
        row = entry_row(one, self.run_id)
        return lambda connection: _run(connection, insert(entry).values(row))

    def _job(self, job: JobRow) -> Statements:
        return lambda connection: _run(connection, save_statement(connection, job, self.run_id))

    def _lease(self, row: LeaseRow) -> Statements:
        return lambda connection: _run(connection, lease_statement(connection, row, self.run_id))

    def _no_lease(self, telescope: str, secret_sha256: str) -> Statements:
        # by its secret as well: another holder's lease may have taken its place meanwhile
        gone = delete(lease).where(lease.c.telescope == telescope, lease.c.secret_sha256 == secret_sha256)
        return lambda connection: _run(connection, gone)

    def _outlived(self, trouble: Trouble) -> Statements:
        lost = f"; {trouble.lost} notes were lost" if trouble.lost else ""
        seconds = (utc_now() - trouble.since_utc).total_seconds()
        told = Entry(
            utc_now(),
            "",
            EntryKind.FAULT,
            f"the journal could not be written for {seconds:.0f} s{lost}: {trouble.why}",
            {"since_utc": trouble.since_utc, "why": trouble.why, "lost": trouble.lost},
            Cause(),
        )
        return self._entry(told)

    def _probe(self, connection: Connection) -> None:
        _run(connection, update(run).where(run.c.run_id == self.run_id).values(pid=os.getpid()))


def _run(connection: Connection, statement: Executable) -> None:
    connection.execute(statement)


def _teller(
    loop: asyncio.AbstractEventLoop, future: asyncio.Future[None]
) -> Callable[[Exception | None], None]:
    def settle(error: Exception | None) -> None:
        if future.done():
            return
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(error)

    def told(error: Exception | None) -> None:
        try:
            loop.call_soon_threadsafe(settle, error)
        except RuntimeError:  # the loop has ended: nobody waits
            return

    return told
