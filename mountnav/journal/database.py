"""Where the journal lies, how it is connected to, and how values lie in its columns.

A journal is a file of SQLite, or PostgreSQL by URL. Without a setting it lies with the user's state, as the
platform has it. In its columns times are UTC with microseconds, JSON has no NaN, text has no NUL (PostgreSQL
takes neither).
"""

from __future__ import annotations

import math
import os
import re
import sqlite3
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, date, datetime
from enum import Enum
from pathlib import Path
from typing import Any, Literal

from sqlalchemy import (
    JSON,
    URL,
    DateTime,
    Dialect,
    Engine,
    Float,
    Text,
    TypeDecorator,
    create_engine,
    event,
    make_url,
)
from sqlalchemy.exc import ArgumentError, DBAPIError, NoSuchModuleError, SQLAlchemyError
from sqlalchemy.pool import NullPool

from mountnav.errors import BadSettings, JournalFailed
from mountnav.files import make_private, make_private_folder


def state_folder() -> Path:
    """$XDG_STATE_HOME/mountnav, else ~/.local/state/mountnav; it may not exist yet."""
    if shared := os.environ.get("XDG_STATE_HOME"):
        return Path(shared) / "mountnav"
    return Path.home() / ".local" / "state" / "mountnav"


def default_url() -> str:
    """$MOUNTNAV_JOURNAL (a path or a URL), else ``journal.sqlite`` in the folder of the user's state."""
    return os.environ.get("MOUNTNAV_JOURNAL") or str(state_folder() / "journal.sqlite")


def audit_key_beside(where: str | Path) -> Path:
    """Where the key that seals an audit is, unless the settings say otherwise: beside the journal's file."""
    file = file_of(database_url(where))
    return (state_folder() if file is None else file.parent) / "audit.key"


# Levels of nested JSON that are kept; what lies deeper is stored as its text. Chosen by hand: it ends
# values that contain themselves. Doubled, nothing breaks.
_DEEPEST = 20


class UtcTime(TypeDecorator[datetime]):
    """An instant: ``2026-11-22 03:12:45.123456`` (UTC) in SQLite, ``timestamptz`` in PostgreSQL."""

    impl = DateTime
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> Any:
        """With a zone where the database knows zones."""
        return dialect.type_descriptor(DateTime(timezone=dialect.name != "sqlite"))

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """To the database; an instant without a zone is UTC."""
        if value is None:
            return None
        aware = value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
        return aware.replace(tzinfo=None) if dialect.name == "sqlite" else aware

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """From the database: always aware UTC."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Number(TypeDecorator[float]):
    """A double; NaN and infinities are NULL: a value that is none is not known."""

    impl = Float(53)
    cache_ok = True

    def process_bind_param(self, value: float | None, dialect: Dialect) -> float | None:
        """To the database."""
        return None if value is None or not math.isfinite(value) else float(value)


class Words(TypeDecorator[str]):
    """Text that any database takes: no NUL, no half of a surrogate pair."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Dialect) -> str | None:
        """To the database."""
        return None if value is None else plain_text(value)


class Facts(TypeDecorator[Any]):
    """A JSON value."""

    impl = JSON(none_as_null=True)
    cache_ok = True

    def process_bind_param(self, value: object, dialect: Dialect) -> object:
        """To the database."""
        return plain_json(value)


def plain_text(text: str) -> str:
    """`text` with what databases refuse (NUL, lone surrogates) replaced by U+FFFD."""
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "replace").replace("\0", "\ufffd")


def plain_json(value: object, depth: int = 0) -> object:
    """`value` as JSON can hold it, whatever somebody put into facts: it never fails for a fact's type.

    NaN and infinities become null, instants ISO 8601 text, enumerations their values, mappings objects
    with text keys, sequences and sets arrays, numpy's scalars and arrays numbers and lists; all else, and
    what is nested too deep, becomes its text.
    """
    if isinstance(value, Enum):
        return plain_json(value.value, depth)
    if value is None or isinstance(value, bool):
        return value
    if isinstance(value, str):
        return plain_text(value)
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, datetime | date):
        return value.isoformat()
    if depth < _DEEPEST:
        if isinstance(value, Mapping):
            return {plain_text(str(key)): plain_json(one, depth + 1) for key, one in value.items()}
        if isinstance(value, list | tuple | set | frozenset):
            return [plain_json(one, depth + 1) for one in value]
        if callable(tolist := getattr(value, "tolist", None)):
            return plain_json(tolist(), depth + 1)
    return plain_text(str(value))


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
        advice="give a file's path, or postgresql://user@host/database; put a password into ~/.pgpass",
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
                # its opening tells why it can't be
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
