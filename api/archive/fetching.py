"""Frames brought to an open file: from this machine as they lie there, from elsewhere by fsspec.

A frame from elsewhere goes into a file without a name, so that a worker that is killed leaves nothing behind.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

from mountnav.errors import BadRequest
from mountnav.extras import extra
from mountnav.files import open_plain

MOST_FETCHED_BYTES = 2_500_000_000
"""Longest frame that is fetched: as long as the largest image that is read. Doubled, a wrong URL fills twice
as much of a disk."""

_PIECE_BYTES = 1 << 22
"""Read at a time; for speed alone."""

_S3 = ("s3://", "s3a://")


@dataclass(slots=True)
class Fetched:
    """A frame that can be read here.

    Attributes
    ----------
    file : FileIO
        Open; whoever fetched it closes it.
    sha256 : str
    size_bytes : int
    """

    file: FileIO
    sha256: str
    size_bytes: int


def is_remote(file: str) -> bool:
    """Whether a frame is named by a URL."""
    return "://" in file


def fetched(file: str) -> Fetched:
    """Open a frame and hash it.

    Raises
    ------
    OSError
        It isn't there or can't be read.
    BadRequest
        A package for such URLs is missing.
    """
    opened = _from_elsewhere(file) if is_remote(file) else open_plain(Path(os.fsdecode(file)))
    try:
        sha256 = hashlib.sha256()
        size = 0
        while piece := opened.read(_PIECE_BYTES):
            sha256.update(piece)
            size += len(piece)
        os.lseek(opened.fileno(), 0, os.SEEK_SET)
        return Fetched(opened, sha256.hexdigest(), size)
    except BaseException:
        opened.close()
        raise


def spread(pattern: str) -> list[str]:
    """The URLs that fit a pattern; the URL itself where it is none.

    Raises
    ------
    BadRequest
        Nothing fits, or the server doesn't answer.
    """
    if not any(sign in pattern for sign in "*[?"):
        return [pattern]
    protocol = pattern.split("://", 1)[0]
    try:
        found = sorted(_file_system(pattern).glob(pattern))
    except (OSError, ValueError) as fault:
        raise BadRequest(f"{pattern}: {fault}", advice="is it written right?") from fault
    if not found:
        raise BadRequest(f"nothing fits the pattern {pattern}", advice="is it written right?")
    return [name if is_remote(name) else f"{protocol}://{name}" for name in found]


def _file_system(url: str) -> Any:
    if url.startswith(_S3):
        with extra("s3", "frames on S3"):
            import s3fs  # noqa: F401
    with extra("remote", "frames from elsewhere"):
        from fsspec.core import url_to_fs
    try:
        return url_to_fs(url)[0]
    except (ImportError, ValueError) as fault:
        raise BadRequest(f"{url}: {fault}", advice="file, http, https and s3 are proven") from fault


def _from_elsewhere(url: str) -> FileIO:
    system = _file_system(url)
    number, name = tempfile.mkstemp(prefix="mountnav-frame-")
    os.unlink(name)
    target = FileIO(number, "r+b", closefd=True)
    try:
        size = 0
        try:
            with system.open(url, "rb", block_size=_PIECE_BYTES) as source:
                while piece := source.read(_PIECE_BYTES):
                    size += len(piece)
                    if size > MOST_FETCHED_BYTES:
                        raise OSError(27, "it is too long")
                    target.write(piece)
        except OSError:
            raise
        except Exception as fault:  # each kind of server has errors of its own
            raise OSError(5, f"{type(fault).__name__}: {fault}"[:200]) from fault
        os.lseek(number, 0, os.SEEK_SET)
        return target
    except BaseException:
        target.close()
        raise
