"""Files: those that a user names, those for this user alone, locks, and the cache folder.

Files that a user names are opened only if they are plain files, and read no further than asked. A named pipe
blocks any process that opens it, a device such as ``/dev/zero`` never ends, and both come easily: by a typing
error in a path, or from someone who may name a path in an order. What is no plain file is refused with an
`OSError`, like a file that isn't there: callers have one kind of trouble to handle.

Private files are for this user alone, whatever the umask. Lock files are never links: a lock file is opened
for writing in a folder that others may write to, and a link in its place would make the service write into a
file of somebody else's choice.

The cache folder holds what mountnav can make or fetch again; one rule says where it is, for all of mountnav.
"""

from __future__ import annotations

import errno
import fcntl
import gzip
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BufferedReader, FileIO
from pathlib import Path
from typing import BinaryIO, cast

__all__ = ["FILE_MODE", "FOLDER_MODE", "locked", "make_private", "make_private_folder", "open_lock"]


_KINDS = (
    (stat.S_ISDIR, errno.EISDIR, "it is a folder, not a file"),
    (stat.S_ISFIFO, errno.EINVAL, "it is a pipe, not a file"),
    (stat.S_ISSOCK, errno.EINVAL, "it is a socket, not a file"),
    (stat.S_ISCHR, errno.EINVAL, "it is a device, not a file"),
    (stat.S_ISBLK, errno.EINVAL, "it is a device, not a file"),
)

MOST_TEXT_BYTES = 4_000_000
"""Longest text that is read whole: settings, orders, lists. The longest of ours, a horizon of one point each
arc minute, has 300 kB. Doubled, a parser may take twice as long over a file that was made for it."""

MOST_RECORD_BYTES = 500_000_000
"""Longest recording that is read whole: a night of a busy serial line has 50 MB. Doubled, twice as
much memory."""


def open_plain(path: Path) -> FileIO:
    """Open a plain file for reading, unbuffered, without waiting.

    Raises
    ------
    OSError
        It can't be opened, or is a folder, pipe, socket or device; `strerror` says which.
    """
    # not to wait for the other end of a pipe, nor to become the terminal of a device
    file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    try:
        mode = os.fstat(file).st_mode
        for is_kind, number, what in _KINDS:
            if is_kind(mode):
                raise OSError(number, what, str(path))
        return FileIO(file, "rb", closefd=True)
    except BaseException:
        os.close(file)
        raise


def open_buffered(path: Path) -> BufferedReader:
    """Open a plain file for reading, buffered. Raises what `open_plain` does."""
    return BufferedReader(open_plain(path))


def open_unpacked(path: Path, *, packed: bool) -> BinaryIO:
    """Open a plain file, or what a gzip holds, for reading piece by piece. Raises what `open_plain` does."""
    plain = open_buffered(path)
    if not packed:
        return plain
    inside = _Gzip(fileobj=plain)
    inside.beneath = plain
    return cast(BinaryIO, inside)


class _Gzip(gzip.GzipFile):
    """One that closes the file beneath it."""

    beneath: BufferedReader

    def close(self) -> None:
        super().close()
        self.beneath.close()


def require_plain(path: Path) -> None:
    """Raise what `open_plain` would, for a file that a library opens by its name."""
    open_plain(path).close()


def read_bytes(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> bytes:
    """Read a plain file whole.

    Parameters
    ----------
    most_bytes : int
        A longer one is refused before it is read.

    Raises
    ------
    OSError
        As `open_plain`; or it is longer.
    """
    with open_plain(path) as file:
        content = bytearray()
        while len(content) <= most_bytes:
            part = file.read(min(1 << 20, most_bytes + 1 - len(content)))
            if not part:
                return bytes(content)
            content += part
    raise OSError(errno.EFBIG, f"it is longer than {most_bytes / 1e6:g} MB", str(path))


def read_text(path: Path, most_bytes: int = MOST_TEXT_BYTES) -> str:
    """Read a plain UTF-8 file whole, whose line ends become line feeds; a byte order mark is no part of it.

    Raises
    ------
    OSError
        As `read_bytes`.
    UnicodeDecodeError
    """
    # editors and spreadsheets of Windows begin UTF-8 with the mark
    return read_bytes(path, most_bytes).decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def require_replaceable(path: Path) -> None:
    """Raise `OSError` if something is there that is no plain file: another file shall not take its place.

    Who may write to the folder of devices, as root may, would else put a plain file where ``/dev/null`` was.
    """
    with suppress(FileNotFoundError):
        mode = path.stat().st_mode
        for is_kind, number, what in _KINDS:
            if is_kind(mode):
                raise OSError(number, what, str(path))


def replace_bytes(path: Path, content: bytes | bytearray | memoryview) -> None:
    """Write a file at once or not at all: no reader ever sees half of it, and a full disk leaves the old one.

    Parameters
    ----------
    path : Path
        A link is followed. A file that is there keeps its mode, and its owner where that may be; a new one
        has the mode that the umask leaves.

    Raises
    ------
    OSError
        It can't be written, or is a folder, pipe, socket or device.
    """
    target = path.resolve()
    try:
        with open_plain(target) as old:
            found: os.stat_result | None = os.fstat(old.fileno())
        if not os.access(target, os.W_OK):  # a folder's owner could replace it all the same
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
    except FileNotFoundError:
        found = None
    try:
        number, name = tempfile.mkstemp(dir=target.parent, prefix=_WAITING)
    except OSError as fault:  # of the file that was asked for, not of one that nobody knows
        raise OSError(fault.errno, fault.strerror, str(path)) from fault
    try:
        with FileIO(number, "wb", closefd=True) as file:
            left = memoryview(content)
            while left:
                left = left[file.write(left) or 0 :]
            if found is not None:
                with suppress(OSError):
                    os.fchown(number, found.st_uid, found.st_gid)
            os.fchmod(number, stat.S_IMODE(found.st_mode) if found else _NEW_MODE & ~_umask())
            os.fsync(number)
        Path(name).replace(target)
    except BaseException as fault:
        with suppress(OSError):
            os.unlink(name)
        if isinstance(fault, OSError):  # a full disk names no file, others the one that nobody knows
            raise OSError(fault.errno, fault.strerror, str(path)) from fault
        raise


_NEW_MODE = 0o666
"""Of a file that a user asked for, before the umask takes from it."""
_WAITING = ".mountnav-"
"""How the name of a file begins that waits to replace another; hidden, and told from other programs'."""


def _umask() -> int:
    """Of this process; read from Linux's own account of it, for setting it to read it disturbs threads."""
    with suppress(OSError, ValueError, IndexError):
        status = Path("/proc/self/status").read_text()
        return int(status.split("\nUmask:")[1].split()[0], 8)
    return 0o022


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


def cache_folder() -> Path:
    """$MOUNTNAV_CACHE, else $XDG_CACHE_HOME/mountnav, else ~/.cache/mountnav; it may not exist yet."""
    if own := os.environ.get("MOUNTNAV_CACHE"):
        return Path(own)
    if shared := os.environ.get("XDG_CACHE_HOME"):
        return Path(shared) / "mountnav"
    return Path.home() / ".cache" / "mountnav"
