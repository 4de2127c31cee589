"""Files mapped into memory for looks at a few thousand places spread all over them."""

from __future__ import annotations

import mmap
from contextlib import suppress
from pathlib import Path

from mountnav.files import open_buffered


def mapped(path: Path) -> mmap.mmap:
    """Map a file for reading, without reading ahead.

    Parameters
    ----------
    path : Path
        Not empty.

    Returns
    -------
    mmap.mmap

    Raises
    ------
    OSError
        It can't be opened.
    """
    with open_buffered(path) as file:
        whole = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    if hasattr(mmap, "MADV_RANDOM"):  # not known everywhere
        with suppress(OSError):
            whole.madvise(mmap.MADV_RANDOM)
    return whole


def let_go(whole: mmap.mmap) -> None:
    """Let go of the pages that were looked at; the system keeps what it has room for, for the next look.

    The system maps a file in pieces much larger than a look: unasked, the whole file would count as this
    process' memory after a few searches.
    """
    if hasattr(mmap, "MADV_DONTNEED"):
        with suppress(OSError):
            whole.madvise(mmap.MADV_DONTNEED)
