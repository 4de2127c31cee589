"""A journal is brought to today's version when it is opened for writing, under a lock; never backwards."""

from __future__ import annotations

import contextlib
import sqlite3
import time
from pathlib import Path

from sqlalchemy import URL, Connection, inspect, text
from sqlalchemy.exc import OperationalError, SQLAlchemyError

from mountnav.errors import BadSettings, JournalDamaged, JournalFailed
from mountnav.journal.database import BUSY_S, connectable, explained, file_of, shown_url
from mountnav.journal.tables import HEAD, metadata

_LOCK = 0x6D6F756E  # any number, the same for all mountnavs that share a server
_VERSION = "alembic_version"


def upgrade(url: URL) -> bool:
    """Bring a journal to today's version; make it if there is none. Several processes may do it at once.

    Returns
    -------
    bool
        Whether anything had to be done.

    Raises
    ------
    BadSettings
        It was written by a newer mountnav, or the database is another program's.
    JournalFailed
        It can't be opened or written, or is damaged.
    """
    engine = connectable(url, "write")
    try:
        _write_ahead(url)
        with engine.connect() as connection, connection.begin():
            if url.get_backend_name() == "postgresql":
                connection.execute(text("SELECT pg_advisory_xact_lock(:lock)"), {"lock": _LOCK})
            if _checked(connection, url) == HEAD:
                return False
            _migrate(connection)
            return True
    except (SQLAlchemyError, UnicodeDecodeError) as error:
        raise unusable(error, url) from error
    finally:
        engine.dispose()


def require_today(connection: Connection, url: URL) -> None:
    """Raise `BadSettings` unless the journal is of today's version."""
    found = _checked(connection, url)
    if found != HEAD:
        raise BadSettings(
            f"this journal is of version {found or 'none'}, and this program reads {HEAD}",
            device=shown_url(url),
            advice="start the service once, or run `mountnav journal check --upgrade`",
        )


def is_begun(connection: Connection, url: URL) -> bool:
    """Tell whether a journal of any version is there. Raises `BadSettings` for what isn't ours."""
    return _checked(connection, url) is not None


def require_known_version(url: URL) -> None:
    """Raise `BadSettings` unless it is a journal of today's version or an older one."""
    engine = connectable(url, "read")
    try:
        with engine.connect() as connection, connection.begin():
            begun = is_begun(connection, url)
    except (SQLAlchemyError, UnicodeDecodeError) as error:
        raise unusable(error, url) from error
    finally:
        engine.dispose()
    if not begun:
        raise BadSettings(
            "this is not a journal of mountnav", device=shown_url(url), advice="name a file of journal backup"
        )


def unusable(error: Exception, url: URL) -> JournalFailed:
    """What to raise for a database's error at opening."""
    if is_damage(error):
        return damaged_journal(explained(error), url)
    return JournalFailed(
        explained(error),
        device=shown_url(url),
        advice="is there room on the disk, may it be written, does the server run?",
    )


def is_damage(error: Exception) -> bool:
    """Whether one of `FAULTS` shows a damaged file."""
    orig = getattr(error, "orig", error)
    if isinstance(orig, sqlite3.DatabaseError):
        return getattr(orig, "sqlite_errorname", "") in ("SQLITE_CORRUPT", "SQLITE_NOTADB")
    # what SQLite says of it is no text, a value is of another kind than it should be
    return isinstance(orig, ValueError | TypeError)


def damaged_journal(why: str, url: URL) -> JournalDamaged:
    """What to raise for a journal that is damaged."""
    return JournalDamaged(
        why,
        device=shown_url(url),
        advice="it is damaged: move it away (`sqlite3 FILE .recover` may save most of it) and start again",
    )


def _checked(connection: Connection, url: URL) -> str | None:
    """The journal's version, None if it is empty. Raises `BadSettings` for what isn't ours."""
    tables = set(inspect(connection).get_table_names())
    if _VERSION not in tables:
        if taken := tables & set(metadata.tables):
            raise BadSettings(
                f"this database has a table {sorted(taken)[0]!r} that is not mountnav's",
                device=shown_url(url),
                advice="give [journal] url a database of its own",
            )
        return None
    version = connection.execute(text(f"SELECT version_num FROM {_VERSION}")).scalar()
    if version is not None and version not in _known():
        raise BadSettings(
            f"this journal is of version {version}, and this program knows {HEAD} at most",
            device=shown_url(url),
            advice="it was written by a newer mountnav: use that one, or give [journal] url another file",
        )
    return None if version is None else str(version)


def _known() -> set[str]:
    """Versions of which there is a migration."""
    files = (Path(__file__).parent / "migrations" / "versions").glob("v[0-9]*_*.py")
    return {file.name[1:].partition("_")[0] for file in files}


def _migrate(connection: Connection) -> None:
    # alembic costs a tenth of a second to import, and most openings don't need it
    from alembic import command
    from alembic.config import Config

    config = Config()
    folder = Path(__file__).parent / "migrations"
    config.set_main_option("script_location", str(folder).replace("%", "%%"))
    config.attributes["connection"] = connection
    command.upgrade(config, HEAD)


def _write_ahead(url: URL) -> None:
    """Switch a file to the write-ahead log, for good. SQLite doesn't wait for others here, so this does."""
    file = file_of(url)
    if file is None:
        return
    deadline_s = time.monotonic() + BUSY_S
    while True:
        try:
            with contextlib.closing(sqlite3.connect(file, timeout=BUSY_S)) as connection:
                mode = connection.execute("PRAGMA journal_mode=WAL").fetchone()[0]
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > deadline_s:
                raise OperationalError("PRAGMA journal_mode=WAL", {}, error) from error
        except sqlite3.DatabaseError as error:
            raise OperationalError("PRAGMA journal_mode=WAL", {}, error) from error
        else:
            if mode == "wal":
                return
            if time.monotonic() > deadline_s:
                raise BadSettings(
                    f"SQLite can't keep a write-ahead log there (it chose {mode!r})",
                    device=str(file),
                    advice="is it on a network drive? give [journal] url a local file, or PostgreSQL",
                )
        time.sleep(0.02)
