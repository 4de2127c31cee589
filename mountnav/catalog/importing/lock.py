"""One import of a name at a time: a lock that goes with the process that holds it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mountnav.errors import Busy
from mountnav.files import open_lock

_LOCK = "lock"


@contextmanager
def held(unfinished: Path) -> Iterator[None]:
    """Hold the lock of an import.

    The lock lies in the import's own folder and goes with it: a file that was removed while we waited for it
    guards nothing, so what was locked is looked at once more.

    Parameters
    ----------
    unfinished : Path
        The import's folder; made if it isn't there.

    Raises
    ------
    Busy
        Another process holds it.
    OSError
        The folder can't be written.
    """
    path = unfinished / _LOCK
    while True:
        unfinished.mkdir(parents=True, exist_ok=True)
        try:
            number = open_lock(path)
        except FileNotFoundError:
            continue  # removed between the two lines by the process that had it
        try:
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise _busy(unfinished, number) from None
            if not _is(path, number):
                continue
            os.ftruncate(number, 0)
            os.write(number, str(os.getpid()).encode())
            yield
            return
        finally:
            os.close(number)


def _busy(unfinished: Path, number: int) -> Busy:
    holder = os.pread(number, 20, 0).decode("ascii", "replace").strip() or "unknown"
    return Busy(
        f"another import of this name is going on (process {holder})",
        device=unfinished.stem,
        advice="wait until it has ended, or give this one another name with --name",
    )


def _is(path: Path, number: int) -> bool:
    try:
        there = path.stat()
    except FileNotFoundError:
        return False
    mine = os.fstat(number)
    return (there.st_dev, there.st_ino) == (mine.st_dev, mine.st_ino)
