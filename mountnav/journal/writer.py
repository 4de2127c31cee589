"""Who writes to the database: one thread with a queue, or the caller itself; trouble is outlived.

What is waited for is told how it ended. What nobody waits for, and what must not be lost (the end of a
command), is kept in memory while the database can't be written, tried again each second, and written in its
order later.
"""

from __future__ import annotations

import logging
import queue
import sqlite3
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from sqlalchemy import URL, Connection, Engine
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, ProgrammingError, StatementError

from mountnav.clock import utc_now
from mountnav.errors import MountnavError
from mountnav.journal.database import connectable, explained, file_of
from mountnav.journal.upgrading import upgrade

_log = logging.getLogger(__name__)

Fsync = Literal["commands", "always", "never"]

# Seconds between attempts to write while the database fails. Chosen by hand; doubled, rows are written up
# to a second later after a failure.
AGAIN_S = 1.0
# Rows kept in memory while the database fails; beyond it the oldest are dropped, the dispensable first.
# Chosen by hand to bound the memory; doubled, it takes twice as much.
KEPT_MOST = 10_000
# Most rows of one transaction. Chosen by hand; one fsync serves them all. Doubled, a row that must be
# durable may wait for more others.
_BATCH = 500
# Seconds that the writer's thread sleeps when it has nothing to do; a new row wakes it at once.
_IDLE_S = 60.0

Statements = Callable[[Connection], None]


@dataclass(slots=True, eq=False)
class Piece:
    """Something to write.

    Attributes
    ----------
    write : callable
        What to do in a transaction.
    durable : bool
        Whether it must be on the disk, not only with the operating system.
    kept : bool
        Whether it is tried again when the database can't be written.
    dispensable : bool
        Whether it may be dropped when there is too much of it.
    told : callable, optional
        Given None or the error, once, in the writer's thread.
    undo : callable, optional
        Written behind it if it was given up while it was being written.
    """

    write: Statements
    durable: bool = False
    kept: bool = False
    dispensable: bool = False
    told: Callable[[Exception | None], None] | None = None
    undo: Statements | None = None
    state: Literal["waiting", "writing", "done"] = "waiting"
    given_up: bool = False


@dataclass(slots=True)
class Trouble:
    """Since when the database can't be written, and why."""

    since_utc: datetime
    why: str
    lost: int = 0


class Writer:
    """Writes pieces in their order, several of them in one transaction when they come fast.

    Parameters
    ----------
    fsync : {"commands", "always", "never"}
        What is forced onto the disk at once; all is safe from the process's death in any case.
    inline : bool
        Write in the caller's thread.
    outlived : callable
        Makes the statements that tell of a trouble that is over.
    probe : callable
        A harmless write, to find out whether it is.
    idle : callable, optional
        A small piece of housekeeping; returns whether there is more of it.
    prepare : callable, optional
        Makes the database fit to be written; called before the first connection until it doesn't raise.
    claim : callable, optional
        Called with each new connection before it is used; a connection that it raises for isn't used.
    """

    def __init__(
        self,
        url: URL,
        *,
        fsync: Fsync,
        inline: bool,
        outlived: Callable[[Trouble], Statements],
        probe: Statements,
        idle: Callable[[Connection], bool] | None = None,
        prepare: Callable[[], None] | None = None,
        claim: Callable[[Connection], None] | None = None,
    ) -> None:
        self._url = url
        self._claim = claim
        self._file = file_of(url)
        self._prepare = prepare
        # made when it is first needed: making it may fail as well
        self._engine: Engine | None = None
        self._connection: Connection | None = None
        self._inode: tuple[int, int] | None = None
        self._synchronous: str | None = None
        self._fsync = fsync
        self._outlived = outlived
        self._probe = probe
        self._idle = idle
        self._kept: deque[Piece] = deque()
        self._lock = threading.RLock()
        self._states = threading.Lock()
        self._queue: queue.SimpleQueue[Piece | None] = queue.SimpleQueue()
        self._trouble: Trouble | None = None
        self._lost = 0
        self._closed = False
        self._thread: threading.Thread | None = None
        if not inline:
            self._thread = threading.Thread(target=self._run, name="journal", daemon=True)
            self._thread.start()

    @property
    def trouble(self) -> Trouble | None:
        """Why the database can't be written just now."""
        return self._trouble

    @property
    def waiting(self) -> int:
        """Pieces not yet written."""
        return self._queue.qsize() + len(self._kept)

    def put(self, piece: Piece) -> None:
        """Have a piece written. Never raises, and waits for nothing but where the writer is inline."""
        if self._closed:
            if piece.told is not None:
                piece.told(RuntimeError("the journal is closed"))
            return
        if self._thread is None:
            with self._lock:
                self._write([piece])
        elif piece.dispensable and self._queue.qsize() > 2 * KEPT_MOST:
            self._lost += 1
        else:
            self._queue.put(piece)

    def give_up(self, piece: Piece) -> None:
        """Nobody waits for this piece any more: it isn't written, or undone."""
        with self._states:
            piece.given_up = True
            done = piece.state == "done"
        if done and piece.undo is not None:
            self.put(Piece(piece.undo, durable=True, kept=True))

    def close(self, last: Piece, patience_s: float = 10.0) -> None:
        """Write what waits, then `last`; no longer than `patience_s`."""
        self.put(last)
        self._closed = True
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(patience_s)
            if self._thread.is_alive():
                _log.error("the journal was left with %d rows unwritten", self.waiting)
                return
        with self._lock:
            self._disconnect()
        if self._engine is not None:
            self._engine.dispose()

    def _run(self) -> None:
        ending = False
        more = True
        while not ending:
            pieces: list[Piece] = []
            try:
                first = self._queue.get(timeout=AGAIN_S if self._busy() else 0.05 if more else _IDLE_S)
                while True:
                    if first is None:
                        ending = True
                        break
                    pieces.append(first)
                    if len(pieces) >= _BATCH:
                        break
                    first = self._queue.get_nowait()
            except queue.Empty:
                pass
            with self._lock:
                if pieces or self._busy():
                    more = True
                    try:
                        self._write(pieces)
                    except Exception as error:  # a fault of ours: nobody may wait for a thread that has died
                        _log.exception("the journal's writer failed unexpectedly")
                        self._failed(pieces, error)
                elif not ending:
                    more = self._housekeeping()
        with self._lock:
            self._disconnect()

    def _busy(self) -> bool:
        return bool(self._kept) or self._trouble is not None

    def _write(self, fresh: list[Piece]) -> None:
        pieces = [*self._kept, *(piece for piece in fresh if self._takes(piece))]
        self._kept.clear()
        try:
            self._transaction(
                [self._probe] if not pieces else [one.write for one in pieces], _durable(pieces)
            )
        except Exception as error:  # whatever it is, those who wait must be told
            if _is_of_a_row(error) and len(pieces) > 1:
                for piece in pieces:
                    self._alone(piece)
            else:
                self._failed(pieces, error)
        else:
            self._succeeded(pieces)

    def _alone(self, piece: Piece) -> None:
        try:
            self._transaction([piece.write], _durable([piece]))
        except Exception as error:
            self._failed([piece], error)
        else:
            self._succeeded([piece])

    def _takes(self, piece: Piece) -> bool:
        with self._states:
            if piece.given_up and piece.undo is not None:
                return False
            piece.state = "writing"
        return True

    def _succeeded(self, pieces: list[Piece]) -> None:
        if self._trouble is not None or self._lost:
            over = self._trouble or Trouble(utc_now(), "too much to write at once")
            over.lost += self._lost
            self._trouble, self._lost = None, 0
            _log.warning("the journal can be written again (since %s: %s)", over.since_utc, over.why)
            self._kept.append(Piece(self._outlived(over), kept=True))
        for piece in pieces:
            with self._states:
                piece.state = "done"
                undo = piece.undo if piece.given_up else None
            if undo is not None:
                self._kept.append(Piece(undo, durable=True, kept=True))
            if piece.told is not None:
                piece.told(None)
                piece.told = None

    def _failed(self, pieces: list[Piece], error: Exception) -> None:
        of_a_row = _is_of_a_row(error)
        if of_a_row:
            _log.error("the journal can't hold a row: %s", explained(error))
        else:
            self._disconnect()
            if self._trouble is None:
                _log.error("the journal can't be written: %s", explained(error))
                self._trouble = Trouble(utc_now(), explained(error))
            self._trouble.why = explained(error)
        for piece in pieces:
            if piece.kept and not of_a_row:
                self._kept.append(piece)
            else:
                piece.state = "done"
                piece.undo = None
            if piece.told is not None:
                piece.told(error)
                piece.told = None
        while len(self._kept) > KEPT_MOST:
            at = next((at for at, one in enumerate(self._kept) if one.dispensable), 0)
            del self._kept[at]
            self._lost += 1

    def _transaction(self, steps: list[Statements], durable: bool) -> None:
        connection = self._connected()
        want = "FULL" if self._fsync == "always" or (durable and self._fsync == "commands") else "NORMAL"
        if self._file is not None and want != self._synchronous:
            driver = connection.connection.driver_connection
            assert driver is not None
            driver.execute(f"PRAGMA synchronous={want}")
            self._synchronous = want
        with connection.begin():
            if self._file is None and want != "FULL":
                connection.exec_driver_sql("SET LOCAL synchronous_commit = off")
            for step in steps:
                step(connection)

    def _connected(self) -> Connection:
        if self._connection is not None and self._file is not None:
            # a file that was moved or removed beneath us would take rows that nobody ever sees
            try:
                found = self._file.stat()
            except FileNotFoundError:
                self._disconnect()
            else:
                if (found.st_dev, found.st_ino) != self._inode:
                    self._disconnect()
        if self._connection is None:
            if self._prepare is not None:
                self._prepare()
                self._prepare = None
            if self._file is not None and not self._file.exists():
                upgrade(self._url)
            if self._engine is None:
                self._engine = connectable(self._url, "write")
            self._connection = self._engine.connect()
            if self._claim is not None:
                self._claim(self._connection)
            if self._file is not None:
                found = self._file.stat()
                self._inode = found.st_dev, found.st_ino
        return self._connection

    def _disconnect(self) -> None:
        connection, self._connection, self._synchronous = self._connection, None, None
        if connection is not None:
            try:
                connection.close()
            except Exception as error:  # it is given up in any case
                _log.debug("closing the journal's connection: %s", error)

    def _housekeeping(self) -> bool:
        if self._idle is None:
            return False
        try:
            connection = self._connected()
            with connection.begin():
                return self._idle(connection)
        except Exception as error:
            self._disconnect()
            _log.warning("the journal's housekeeping: %s", explained(error))
            return False


def _durable(pieces: list[Piece]) -> bool:
    return any(piece.durable for piece in pieces)


def _is_of_a_row(error: Exception) -> bool:
    """Whether a row can't be written, rather than the database."""
    if isinstance(error, IntegrityError | DataError | ProgrammingError):
        return True
    if isinstance(error, StatementError):
        return not isinstance(error, DBAPIError)
    return not isinstance(error, DBAPIError | sqlite3.Error | OSError | MountnavError)
