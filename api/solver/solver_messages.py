"""What the service asks of its solving process, and how both send: each message with its length before it.

Pixels and uploads don't go through the pipe: they lie in a file without a name (`memfd_create`, or the
upload's spool), whose descriptor is sent along. What is asked are pickles: they come from the service, whom
its process obeys in any case. What is answered is data, since the process reads strangers' files
(`api.solver.solver_answers`).
"""

from __future__ import annotations

import pickle
import socket
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from api.solver.solver_answers import Answer, written
from api.solver.solver_limits import Limits
from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.solving.settings import SolveSettings

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration

HEADER = struct.Struct("<Q")
"""Length of the message that follows, bytes."""


@dataclass(frozen=True, slots=True)
class Setup:
    """First of all: what to solve with, which catalog, which index is known to exist, and the limits."""

    catalog: Catalog
    index: Path | None
    limits: Limits = field(default_factory=Limits)
    niceness: int = 0


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

    @property
    def name(self) -> str:
        """What to call the frame."""
        return self.source.name if isinstance(self.source, SharedFile) else self.source.frame.source


@dataclass(frozen=True, slots=True)
class Read:
    """A file to read, not to solve: its pixels go into the second of the two files that come along."""

    name: str


def packed(message: object) -> bytes:
    """Pickle what is asked."""
    return pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)


def unpacked(content: bytes | bytearray) -> object:
    """Read what is asked; only the service may have written it."""
    return pickle.loads(content)


def send(link: socket.socket, answer: Answer) -> None:
    """Answer through a blocking socket. Raises `OSError` when the other end is gone."""
    content = written(answer)
    link.sendall(HEADER.pack(len(content)))
    link.sendall(content)


def receive(link: socket.socket) -> tuple[object, list[int]]:
    """Receive what is asked, and the descriptors that came with it, from a blocking socket.

    Raises
    ------
    EOFError
        The other end is gone.
    """
    head, files, _, _ = socket.recv_fds(link, HEADER.size, 2)
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
