"""Frames brought to an open file: from this machine as they lie there, from elsewhere by fsspec.

A frame from elsewhere goes into a file without a name, so that a worker that is killed leaves nothing behind.
"""

from __future__ import annotations

import errno
import hashlib
import os
import tempfile
import time
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

from mountnav.errors import BadRequest
from mountnav.extras import extra
from mountnav.files import open_plain

MOST_FETCHED_BYTES = 2_500_000_000
"""Longest frame that is fetched, or hashed here: as long as the largest image that is read. Doubled, a wrong
URL fills twice as much of a disk."""

_PIECE_BYTES = 1 << 22
"""Read at a time; for speed alone."""

_HASHED_BYTES = 1 << 18
"""Hashed at a time, in memory that stays in the processor's cache: for speed alone. Four times as much, fresh
for each piece, cost a third more."""

MOST_WORDS = 200
"""Letters of a server's error that are kept: it may send a page. Doubled, a million refusals may take twice
the room."""

LISTED_S = 300.0
"""Until a server has to have listed what fits a pattern. Doubled, one that hangs is noticed twice as late."""

_HTTP = ("http://", "https://")
_S3 = ("s3://", "s3a://")


@dataclass(slots=True)
class Fetched:
    """A frame that can be read here.

    Attributes
    ----------
    file : FileIO
        Open; whoever fetched it closes it.
    fetch_s : float
        Wall time that it took.
    state : tuple of int
        Its length and time of change (ns) before it was hashed.
    """

    file: FileIO
    sha256: str
    size_bytes: int
    fetch_s: float = 0.0
    state: tuple[int, int] = (0, 0)

    def unchanged(self) -> bool:
        """Whether nobody wrote to it since: else what is solved isn't what was hashed. Raises `OSError`."""
        return self.state == _state(self.file)


def is_remote(file: str) -> bool:
    """Whether a frame is named by a URL."""
    return "://" in file


def fetched(file: str, timeout_s: float) -> Fetched:
    """Open a frame and hash it.

    Parameters
    ----------
    file : str
        A path, or a URL.
    timeout_s : float
        After which a server that says nothing is given up.

    Raises
    ------
    OSError
        It isn't there or can't be read.
    BadRequest
        A package for such URLs is missing.
    """
    began_s = time.monotonic()
    opened = _from_elsewhere(file, timeout_s) if is_remote(file) else open_plain(Path(os.fsdecode(file)))
    try:
        sha256 = hashlib.sha256()
        size, state = 0, _state(opened)
        piece = memoryview(bytearray(_HASHED_BYTES))
        if state[0] <= MOST_FETCHED_BYTES:
            while (count := opened.readinto(piece)) and size <= MOST_FETCHED_BYTES:
                sha256.update(piece[:count])
                size += count
        if max(size, state[0]) > MOST_FETCHED_BYTES:
            raise OSError(errno.EFBIG, f"it is longer than {MOST_FETCHED_BYTES / 1e9:g} GB", file)
        os.lseek(opened.fileno(), 0, os.SEEK_SET)
        return Fetched(opened, sha256.hexdigest(), size, time.monotonic() - began_s, state)
    except BaseException:
        opened.close()
        raise


def _state(file: FileIO) -> tuple[int, int]:
    """Length and time of change of an open file; other marks change with its name or mode, too."""
    found = os.fstat(file.fileno())
    return found.st_size, found.st_mtime_ns


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
        found = sorted(_file_system(pattern, LISTED_S).glob(pattern))
    except (OSError, ValueError) as fault:
        raise BadRequest(f"{pattern}: {fault}", advice="is it written right?") from fault
    if not found:
        raise BadRequest(f"nothing fits the pattern {pattern}", advice="is it written right?")
    return [name if is_remote(name) else f"{protocol}://{name}" for name in found]


def _file_system(url: str, timeout_s: float) -> Any:
    if url.startswith(_S3):
        with extra("s3", "frames on S3"):
            import s3fs  # noqa: F401
    with extra("remote", "frames from elsewhere"):
        from fsspec.core import url_to_fs
    more: dict[str, Any] = {}
    if url.startswith(_HTTP):
        with extra("remote", "frames from elsewhere"):
            from aiohttp import ClientTimeout
        more["client_kwargs"] = {"timeout": ClientTimeout(total=timeout_s)}
    try:
        return url_to_fs(url, **more)[0]
    except (ImportError, ValueError) as fault:
        raise BadRequest(f"{url}: {fault}", advice="file, http, https and s3 are proven") from fault


def _from_elsewhere(url: str, timeout_s: float) -> FileIO:
    system = _file_system(url, timeout_s)
    number, name = tempfile.mkstemp(prefix="mountnav-frame-")
    os.unlink(name)
    target = FileIO(number, "r+b", closefd=True)
    try:
        size = 0
        try:
            # a plain server gives a file from its beginning alone
            block = 0 if url.startswith(_HTTP) else _PIECE_BYTES
            with system.open(url, "rb", block_size=block) as source:
                while piece := source.read(_PIECE_BYTES):
                    size += len(piece)
                    if size > MOST_FETCHED_BYTES:
                        raise OSError(errno.EFBIG, f"it is longer than {MOST_FETCHED_BYTES / 1e9:g} GB")
                    target.write(piece)
        except FileNotFoundError as fault:
            # fsspec says so of a server that doesn't answer, too, and leaves the number out
            other = _beneath(fault)
            if other is not None:
                raise OSError(errno.EIO, _words(other, url, timeout_s)) from fault
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), url) from fault
        except PermissionError as fault:
            # the store's word, not the file's: credentials that have expired close all frames alike
            raise OSError(errno.EIO, "the store refuses it (credentials missing or expired?)") from fault
        except Exception as fault:  # each kind of server has errors of its own
            if isinstance(fault, OSError) and fault.errno is not None and fault.strerror:
                raise
            raise OSError(errno.EIO, _words(fault, url, timeout_s)) from fault
        os.lseek(number, 0, os.SEEK_SET)
        return target
    except BaseException:
        target.close()
        raise


def _words(fault: BaseException, url: str, timeout_s: float) -> str:
    """What a server or the way to it did, in words that say something; without what a URL has signed."""
    if isinstance(fault, TimeoutError):
        return f"no answer came within {timeout_s:g} s"
    if type(fault).__name__ == "ClientResponseError":
        told = f"{getattr(fault, 'status', '?')} {getattr(fault, 'message', '')}".strip()
        return f"the server answers {told}"[:MOST_WORDS]
    text = f"{type(fault).__name__}: {fault}"
    _, sign, signed = url.partition("?")
    return (text.replace(signed, "...") if sign and signed else text)[:MOST_WORDS]


def _beneath(fault: BaseException) -> BaseException | None:
    """Why a file is said not to be there, if for another reason than that it isn't."""
    beneath = fault.__cause__
    while isinstance(beneath, FileNotFoundError):
        beneath = beneath.__cause__
    return None if getattr(beneath, "status", None) in (404, 410) else beneath
