"""Files that a user names, opened: plain ones only, and no more of them than asked.

A named pipe keeps whoever opens it waiting, a device such as ``/dev/zero`` never ends, and both come easily:
a slip in a path, or someone who may name a path in an order. What is no plain file is refused with an
`OSError`, as a file that isn't there is: whoever opens files needs to know of one kind of trouble only.
"""

from __future__ import annotations

import errno
import gzip
import os
import stat
from io import BufferedReader, FileIO
from pathlib import Path
from typing import BinaryIO, cast

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

    Parameters
    ----------
    path : Path

    Returns
    -------
    FileIO

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
    path : Path
    most_bytes : int
        A longer one is refused before it is read.

    Returns
    -------
    bytes

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
    """Read a plain UTF-8 file whole, whose line ends become line feeds.

    Raises
    ------
    OSError
        As `read_bytes`.
    UnicodeDecodeError
    """
    return read_bytes(path, most_bytes).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
