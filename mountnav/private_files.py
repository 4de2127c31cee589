"""Files that are for this user alone, whatever the umask; and lock files, that are no links.

A lock file is opened for writing in a folder that others may write as well: a link in its place would have
the service write into a file of somebody else's choice.
"""

from __future__ import annotations

import fcntl
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FILE_MODE = 0o600
"""The owner's alone: journals and keys tell where a telescope is and who may move it."""
FOLDER_MODE = 0o700
"""The same of a folder."""
_OTHERS = stat.S_IRWXG | stat.S_IRWXO


def make_private(path: Path) -> None:
    """Make a file if there is none, and close it to others if it is ours. Raises OSError."""
    number = os.open(path, os.O_RDONLY | os.O_CREAT | os.O_CLOEXEC, FILE_MODE)
    try:
        _close_to_others(number)
    finally:
        os.close(number)


def make_private_folder(folder: Path) -> None:
    """Make a folder, and those above it, for this user alone; one that is there stays as it is.

    Raises
    ------
    OSError
    """
    missing = []
    while not folder.exists():
        missing.append(folder)
        folder = folder.parent
    for one in reversed(missing):
        with suppress(FileExistsError):
            one.mkdir(mode=FOLDER_MODE)
            # a umask takes away, and never adds
            one.chmod(FOLDER_MODE)
    if missing and not missing[0].is_dir():
        raise NotADirectoryError(20, "Not a directory", str(missing[0]))


def open_lock(path: Path) -> int:
    """Open a lock file for this user alone, made if there is none; its descriptor.

    Raises
    ------
    OSError
        Among others if it is a link.
    """
    number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, FILE_MODE)
    try:
        _close_to_others(number)
    except BaseException:
        os.close(number)
        raise
    return number


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold an advisory lock, waiting for it; it goes with the process that holds it. Raises OSError."""
    number = open_lock(path)
    try:
        fcntl.flock(number, fcntl.LOCK_EX)
        yield
    finally:
        os.close(number)


def _close_to_others(number: int) -> None:
    found = os.fstat(number)
    if found.st_mode & _OTHERS and found.st_uid == os.geteuid() and stat.S_ISREG(found.st_mode):
        os.fchmod(number, stat.S_IMODE(found.st_mode) & ~_OTHERS)


__all__ = ["FILE_MODE", "FOLDER_MODE", "locked", "make_private", "make_private_folder", "open_lock"]
