"""Where a journal lies and how it is connected to: a file of SQLite, or PostgreSQL by URL."""

from __future__ import annotations

import re
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from sqlalchemy import URL, Engine, create_engine, event, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from mountnav.errors import BadSettings, JournalFailed
from mountnav.private_files import make_private, make_private_folder

BUSY_S = 10.0
"""How long another writer, or a silent server, is waited for before it counts as a failure."""

Access = Literal["write", "read"]


def database_url(where: str | Path) -> URL:
    """The database that a path or a URL means.

    Parameters
    ----------
    where : str or Path
        A file of SQLite, ``sqlite:///...``, or ``postgresql://user@host/name`` (``postgresql+psycopg://``).

    Raises
    ------
    BadSettings
        It is neither.
    """
    text = str(where)
    if isinstance(where, Path) or "://" not in text:
        return URL.create("sqlite", database=str(Path(text).expanduser()))
    try:
        url = make_url(text)
        if url.get_backend_name() == "postgresql":
            return url.set(drivername="postgresql+psycopg")
        if url.get_backend_name() == "sqlite" and url.database not in (None, "", ":memory:"):
            return url.set(drivername="sqlite")
    except (ArgumentError, NoSuchModuleError, ValueError):
        pass
    raise BadSettings(
        f"the journal can't be at {without_password(text)}",
        advice="give a file's path, or postgresql://user@host/database; a password belongs into ~/.pgpass",
    )


def without_password(text: str) -> str:
    """`text` with the passwords of the URLs in it replaced by stars."""
    return re.sub(r"(://[^/\s:@\"']*):[^/\s@\"']*@", r"\1:***@", text)


def file_of(url: URL) -> Path | None:
    """The file of a journal of SQLite; None for a server's."""
    return Path(url.database) if url.get_backend_name() == "sqlite" and url.database else None


def shown_url(url: URL) -> str:
    """For people: the file's path, or the URL without its password."""
    file = file_of(url)
    return url.render_as_string(hide_password=True) if file is None else str(file)


def connectable(url: URL, access: Access) -> Engine:
    """An engine for a journal that keeps no connections; nothing is connected yet.

    Raises
    ------
    BadSettings
        The database's driver isn't installed.
    JournalFailed
        The folder of the file can't be made.
    """
    if url.get_backend_name() == "postgresql":
        return _postgresql(url)
    return _sqlite(url, access)


def _postgresql(url: URL) -> Engine:
    wait_ms = round(BUSY_S * 1000)
    try:
        return create_engine(
            url,
            poolclass=NullPool,
            connect_args={
                "connect_timeout": round(BUSY_S),
                # a server whose cable was pulled must not hold a command for the kernel's two hours
                "tcp_user_timeout": wait_ms,
                "options": f"-c statement_timeout={wait_ms} -c lock_timeout={wait_ms} -c timezone=UTC",
                "application_name": "mountnav",
            },
        )
    except ImportError as error:
        raise BadSettings(
            "this journal is in PostgreSQL, and its driver isn't installed",
            device=shown_url(url),
            advice="pip install 'mountnav[postgresql]'",
        ) from error


def _sqlite(url: URL, access: Access) -> Engine:
    file = file_of(url)
    assert file is not None
    if access == "write":
        try:
            make_private_folder(file.parent)
        except OSError as error:
            raise JournalFailed(
                f"its folder can't be made: {error.strerror or error}",
                device=str(file),
                advice="give [journal] url a place that can be written",
            ) from error
    if access == "write":
        # what SQLite puts beside it (-wal, -shm) has the modes of the file itself
        for one in (file, *_beside(file)):
            with suppress(OSError):
                # whoever opens it tells why it can't be
                make_private(one)
    engine = create_engine(
        url, poolclass=NullPool, connect_args={"timeout": BUSY_S, "check_same_thread": False}
    )

    @event.listens_for(engine, "connect")
    def _on_connect(connection: Any, _record: object) -> None:
        # SQLAlchemy's BEGIN below is the only one: the driver's own comes too late for a reader's snapshot
        connection.isolation_level = None
        connection.execute(f"PRAGMA busy_timeout={round(BUSY_S * 1000)}")
        if access == "read":
            connection.execute("PRAGMA query_only=ON")
        else:
            connection.execute("PRAGMA fullfsync=ON")  # macOS: fsync alone leaves it in the disk's own cache
            connection.execute("PRAGMA journal_size_limit=67108864")

    @event.listens_for(engine, "begin")
    def _on_begin(connection: Any) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE" if access == "write" else "BEGIN")

    return engine


def _beside(file: Path) -> list[Path]:
    beside = (file.with_name(file.name + ending) for ending in ("-wal", "-shm"))
    return [one for one in beside if one.exists()]


FAULTS: tuple[type[Exception], ...] = (SQLAlchemyError, ValueError, TypeError)
"""What reading a database may raise. The last two are those of a damaged file: what SQLite says of it is no
text (UnicodeDecodeError), an instant is none, a JSON value is none or of another kind."""


def explained(error: Exception) -> str:
    """What a database's error says, in one line without the statement."""
    told: BaseException = error
    if isinstance(error, DBAPIError) and error.orig is not None:
        told = error.orig
    text = " ".join(str(told).split()) or type(told).__name__
    name = getattr(told, "sqlite_errorname", None) if isinstance(told, sqlite3.Error) else None
    return without_password(f"{text} ({name})" if name else text)
