"""A journal's file backed up while the service writes it, and put back while nobody does.

A backup is a journal of its own: every command reads it. A database server is backed up by its own tools
(pg_dump); here only files are.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from sqlalchemy import URL

from mountnav.errors import BadRequest, Busy, JournalFailed, NotFound
from mountnav.files import require_plain
from mountnav.journal.database import BUSY_S, database_url, file_of, shown_url
from mountnav.journal.upgrading import require_known_version, unusable
from mountnav.journal.upkeep import require_sound, require_whole

__all__ = ["back_up", "restore"]

_PAGES = 1000
"""Pages that are copied at once, 4 MB: between two pieces the service may write. Doubled, a write may wait
twice as long for the copy."""
_BETWEEN_S = 0.005
"""Pause between two pieces, s. Doubled, a backup takes a tenth longer."""


def back_up(where: str | Path, target: Path, utc: datetime, *, force: bool = False) -> Path:
    """Copy a journal into a file, whole and sound, while others may write it.

    Parameters
    ----------
    where : str or Path
        The journal: a file's path.
    target : Path
        The file to write, or a folder: then it is named by the time.
    utc : datetime
        The time, for that name.
    force : bool
        Write over a file that is there.

    Returns
    -------
    Path
        What was written, readable by its owner alone.

    Raises
    ------
    BadRequest
        It is on a server, or the target is there already.
    NotFound
        There is no journal.
    JournalDamaged, JournalFailed
    """
    url, file = _its_file(where)
    if not file.exists():
        raise NotFound("there is no journal", device=str(file), advice="name it with --journal or --config")
    if target.is_dir():
        target = target / f"mountnav-journal-{utc:%Y%m%dT%H%M%SZ}.sqlite"
    if target.exists() and (not force or target.samefile(file)):
        raise BadRequest(f"{target} is there already", advice="name another file, or give --force")
    require_whole(url)
    with _beside(target) as part:
        try:
            with (
                contextlib.closing(sqlite3.connect(file, timeout=BUSY_S)) as source,
                contextlib.closing(sqlite3.connect(part)) as copy,
            ):
                source.backup(copy, pages=_PAGES, sleep=_BETWEEN_S)
                # one file, complete by itself: no log beside it has to be kept with it
                copy.execute("PRAGMA journal_mode=DELETE")
        except sqlite3.Error as error:
            raise unusable(error, url) from error
        require_sound(database_url(part), most_s=float("inf"))
    return target


def restore(backup: Path, where: str | Path, utc: datetime) -> Path | None:
    """Put a backup in a journal's place. What is there is kept beside it.

    Parameters
    ----------
    backup : Path
        As `back_up` has made it; it may be of an older version.
    where : str or Path
        The journal: a file's path.
    utc : datetime
        The time, for the name of what was there.

    Returns
    -------
    Path or None
        Where the journal that was there is now; None if there was none.

    Raises
    ------
    Busy
        A service, or another program, has it open.
    BadRequest, BadSettings
        It is on a server; the backup is no journal, or a newer mountnav's.
    NotFound, JournalDamaged, JournalFailed
    """
    url, file = _its_file(where)
    if not backup.exists():
        raise NotFound("there is no such backup", device=str(backup), advice="check where it was written")
    require_plain(backup)
    if file.exists() and backup.samefile(file):
        raise BadRequest(f"{backup} is the journal itself", advice="name a backup of it")
    of_backup = database_url(backup)
    require_whole(of_backup)
    require_known_version(of_backup)
    require_sound(of_backup, most_s=float("inf"))
    file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    kept: Path | None = None
    with _beside(file, replaces=False) as part:
        try:
            with (
                contextlib.closing(sqlite3.connect(backup)) as source,
                contextlib.closing(sqlite3.connect(part)) as copy,
            ):
                source.backup(copy)
        except sqlite3.Error as error:
            raise unusable(error, of_backup) from error
        # no matter who puts it back, it is the service's: as the journal was, else as its folder is
        owner = (file if file.exists() else file.parent).stat()
        with contextlib.suppress(PermissionError):
            os.chown(part, owner.st_uid, owner.st_gid)
        if file.exists():
            _let_go(file, url)
            kept = file.with_name(f"{file.name}.before-{utc:%Y%m%dT%H%M%SZ}")
            if kept.exists():
                raise BadRequest(f"{kept} is there already", advice="move it away")
            os.link(file, kept)  # the journal is never not there
            for log in ("-wal", "-shm"):  # of a damaged one, whose log can't be put into its file
                with contextlib.suppress(FileNotFoundError):
                    Path(f"{file}{log}").rename(f"{kept}{log}")
        part.replace(file)
        _sync_folder(file.parent)
    return kept


def _its_file(where: str | Path) -> tuple[URL, Path]:
    url = database_url(where)
    file = file_of(url)
    if file is None:
        raise BadRequest(
            f"{shown_url(url)} is on a database server",
            advice="back it up and restore it with the server's own tools: pg_dump, pg_restore",
        )
    return url, file


@contextlib.contextmanager
def _beside(target: Path, *, replaces: bool = True) -> Iterator[Path]:
    """A file beside the target, for its owner alone, that takes its place once it is on the disk."""
    part = target.with_name(f"{target.name}.part")
    try:
        # not opened through a link that somebody has laid there
        part.unlink(missing_ok=True)
        os.close(os.open(part, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o600))
    except OSError as error:
        raise BadRequest(f"{part} can't be written: {error.strerror}", advice="name another file") from error
    try:
        yield part
        if replaces:
            opened = os.open(part, os.O_RDONLY)
            try:
                os.fsync(opened)
            finally:
                os.close(opened)
            part.replace(target)
            _sync_folder(target.parent)
    finally:
        for rest in (part, Path(f"{part}-journal"), Path(f"{part}-wal"), Path(f"{part}-shm")):
            rest.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Have a change of names on the disk itself."""
    opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _let_go(file: Path, url: URL) -> None:
    """Make sure that nobody has a journal open, and that all of it stands in its file alone."""
    try:
        with contextlib.closing(sqlite3.connect(file, timeout=0.0, isolation_level=None)) as connection:
            # anyone who has it open holds a shared lock on it for as long
            connection.execute("PRAGMA locking_mode=EXCLUSIVE")
            connection.execute("PRAGMA journal_mode=DELETE")
            connection.execute("BEGIN EXCLUSIVE")
            connection.execute("COMMIT")
    except sqlite3.OperationalError as error:
        if "locked" in str(error) or "busy" in str(error):
            raise Busy(
                "the journal is in use",
                device=str(file),
                advice="stop the service first: systemctl stop mountnav",
            ) from error
        raise JournalFailed(str(error), device=shown_url(url), advice="may it be written?") from error
    except sqlite3.DatabaseError:
        # damaged: that is why it is replaced; it is kept as it is
        return
