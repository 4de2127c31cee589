"""What passes between the service and its solving process: pickles, each with its length before it.

Pixels and uploads don't go through the pipe: they lie in a file without a name (`memfd_create`, or the
upload's spool), whose descriptor is sent along. Both ends are one program: pickles are safe here.
"""

from __future__ import annotations

import pickle
import socket
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.solution import Verdict
from mountnav.solve_settings import SolveSettings

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration

HEADER = struct.Struct("<Q")
"""Length of the pickle that follows, bytes."""


@dataclass(frozen=True, slots=True)
class Setup:
    """First of all: what to solve with, which catalog, and which index is known to exist."""

    catalog: Catalog
    index: Path | None


@dataclass(frozen=True, slots=True)
class Ready:
    """The process solved a frame of its own, and will not be slower from now on."""

    started_s: float
    troubles: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SharedPixels:
    """A frame whose pixels lie in the file that comes along.

    Attributes
    ----------
    frame : Frame
        With an empty array for pixels.
    dtype : str
    shape : tuple of int
    """

    frame: Frame
    dtype: str
    shape: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class SharedFile:
    """An upload, as it came, in the file that comes along."""

    name: str


@dataclass(frozen=True, slots=True)
class Task:
    """One frame to solve.

    Attributes
    ----------
    source : SharedPixels or SharedFile
    hint : Hint or None
    settings : SolveSettings
        Without masters and index, which have ways of their own.
    calibration_number : int or None
        Which masters; numbers are the service's.
    calibration : Calibration or None
        The masters of that number, if this process has not heard of them yet.
    index : Path or None
        For the blind search.
    """

    source: SharedPixels | SharedFile
    hint: Hint | None
    settings: SolveSettings
    calibration_number: int | None = None
    calibration: Calibration | None = None
    index: Path | None = None


@dataclass(frozen=True, slots=True)
class Done:
    """What became of a task: a verdict, or the error that `solve` raised."""

    verdict: Verdict | None = None
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class Progress:
    """How far the index is built, 0 to 1."""

    share: float


@dataclass(frozen=True, slots=True)
class Built:
    """The index lies there now."""

    path: Path


def packed(message: object) -> bytes:
    """Pickle a message."""
    return pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)


def unpacked(content: bytes | bytearray) -> object:
    """Read a pickled message."""
    return pickle.loads(content)


def send(link: socket.socket, message: object) -> None:
    """Send a message through a blocking socket. Raises `OSError` when the other end is gone."""
    content = packed(message)
    link.sendall(HEADER.pack(len(content)))
    link.sendall(content)


def receive(link: socket.socket) -> tuple[object, list[int]]:
    """Receive a message, and the descriptors that came with it, from a blocking socket.

    Raises
    ------
    EOFError
        The other end is gone.
    """
    head, files, _, _ = socket.recv_fds(link, HEADER.size, 1)
    head += _exactly(link, HEADER.size - len(head)) if head else b""
    if not head:
        raise EOFError
    (length,) = HEADER.unpack(head)
    return unpacked(_exactly(link, length)), files


def _exactly(link: socket.socket, length: int) -> bytes:
    content = bytearray()
    while len(content) < length:
        piece = link.recv(min(length - len(content), 1 << 20))
        if not piece:
            raise EOFError
        content += piece
    return bytes(content)
