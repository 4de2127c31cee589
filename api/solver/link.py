"""A process of our own behind a socket, asked one question at a time, and how pixels reach it."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import subprocess
import sys
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from api.solver.messages import (
    HEADER,
    MOST_BYTES,
    Answer,
    BadAnswer,
    Done,
    SharedFile,
    SharedPixels,
    Task,
    packed,
    read,
)
from mountnav.frames import Frame, Hint
from mountnav.reading.content import OnDisk, stored
from mountnav.reading.fits_headers import MOST_PIXELS
from mountnav.reading.star_lists import ListFormat
from mountnav.solving.settings import SolveSettings
from mountnav.start_up import KEPT_BELOW_BYTES, by_one_thread

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration

_GOODBYE_S = 2.0
"""How long a process may take to end by itself before it is killed, s; chosen by hand. Doubled, a stuck
process delays the shutdown by 2 s more."""


class ProcessEnded(Exception):
    """The process at the other end is gone, or never came up.

    Parameters
    ----------
    signal_number : int
        Of the signal that ended it; 0 if none did.
    """

    def __init__(self, how: str, *, signal_number: int = 0) -> None:
        super().__init__(how)
        self.signal_number = signal_number

    @property
    def out_of_cpu(self) -> bool:
        """The kernel ended it for its limit of CPU time."""
        return self.signal_number == signal.SIGXCPU


class ProcessLink:
    """A Python module that runs as a process of its own and speaks in messages.

    Parameters
    ----------
    link : socket.socket
        Our end, not blocking.
    """

    def __init__(self, process: subprocess.Popen[bytes], link: socket.socket) -> None:
        self._process = process
        self._link = link

    @classmethod
    def start(cls, module: str, *, kept_bytes: int = 0) -> Self:
        """Start a module of ours. It is spawned, not forked: threads and open devices stay here.

        Parameters
        ----------
        module : str
            Such as ``api.solver.process``; it is given the number of its socket.
        kept_bytes : int
            Arrays are made in memory that was used before, not in memory that the system has to clear: a
            fifth of a frame's CPU time less, for so much that may lie idle until the process gives it back
            (`api.solver.process` does when nothing is asked of it). 0: none is kept.

        Raises
        ------
        ProcessEnded
            The system lets no process be started.
        """
        ours, theirs = socket.socketpair()
        ours.setblocking(False)
        try:
            process = _spawned(module, theirs.fileno(), kept_bytes=kept_bytes)
        except OSError as error:
            ours.close()
            raise ProcessEnded(f"no process could be started: {error}") from error
        finally:
            theirs.close()
        return cls(process, ours)

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    async def send(self, message: object, *files: int) -> None:
        """Send a message, and with it descriptors (two at most), which stay ours too.

        Raises
        ------
        ProcessEnded
        """
        content = packed(message)
        head = HEADER.pack(len(content))
        try:
            # nothing else is under way, so that these few bytes always find room
            socket.send_fds(self._link, [head], files)
            await asyncio.get_running_loop().sock_sendall(self._link, content)
        except OSError as error:
            raise await asyncio.to_thread(self._how) from error

    async def receive(self) -> Answer:
        """Wait for an answer. A process that answers otherwise is ended.

        Raises
        ------
        ProcessEnded
        """
        try:
            (length,) = HEADER.unpack(await self._exactly(HEADER.size))
            if length > MOST_BYTES:
                raise BadAnswer(f"it is {length} bytes long")
            return read(await self._exactly(length))
        except BadAnswer as error:
            self.kill()
            raise ProcessEnded(
                f"process {self.pid} was ended, because it sent an invalid answer: {error}"
            ) from error
        except (OSError, EOFError) as error:
            raise await asyncio.to_thread(self._how) from error

    async def ask(self, message: object, *files: int) -> Answer:
        """Send a message and wait for its answer. Raises `ProcessEnded`."""
        await self.send(message, *files)
        return await self.receive()

    def kill(self) -> None:
        """End it now, whatever it is doing; who waits for its answer gets a `ProcessEnded`. Close it then."""
        self._process.kill()

    async def close(self) -> None:
        """End it by closing the socket, which it watches; by force if it doesn't heed that.

        Nobody may be waiting for an answer any more.
        """
        self._link.close()
        try:
            await asyncio.to_thread(self._process.wait, _GOODBYE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            await asyncio.to_thread(self._process.wait)

    def _how(self) -> ProcessEnded:
        """How it ended."""
        try:
            code = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            return ProcessEnded(f"process {self.pid} closed its line")
        how = f"by signal {-code}" if code < 0 else f"with code {code}"
        return ProcessEnded(f"process {self.pid} ended {how}", signal_number=max(0, -code))

    async def _exactly(self, length: int) -> bytearray:
        loop = asyncio.get_running_loop()
        content = bytearray(length)
        view, at = memoryview(content), 0
        while at < length:
            taken = await loop.sock_recv_into(self._link, view[at:])
            if not taken:
                raise EOFError
            at += taken
        return content


def _spawned(module: str, link: int, *, kept_bytes: int) -> subprocess.Popen[bytes]:
    environment = dict(os.environ)
    # the same modules as here, wherever this process found them; and one core, since it is measured in those
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    by_one_thread(environment)
    if kept_bytes:
        environment.setdefault("MALLOC_MMAP_THRESHOLD_", str(KEPT_BELOW_BYTES))
        environment.setdefault("MALLOC_TRIM_THRESHOLD_", str(kept_bytes))
    else:
        # large arrays go back to the system as soon as they are done with: 30 MB less
        environment.setdefault("MALLOC_MMAP_THRESHOLD_", "4000000")
    return subprocess.Popen(
        # what it never uses isn't imported
        [sys.executable, "-P", "-m", "mountnav.start_up", module, str(link)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        pass_fds=[link],
        env=environment,
        start_new_session=True,  # an interrupt from the terminal is for the service, which then ends this one
    )


_BRIGHTNESS = re.compile(r"[<>|][iu][1248]|[<>][f][48]")
"""Kinds of numbers that a frame's pixels are (`mountnav.frames.Frame`)."""


@dataclass(frozen=True, slots=True)
class Upload:
    """A file as it came.

    Attributes
    ----------
    file : int
        An open descriptor; the maker of the upload closes it.
    stars : ListFormat or None
        How to read it if it is a list of stars.
    hdu : int or str or None
        Which FITS extension holds the image; None: chosen by the reader.
    """

    name: str
    file: int
    stars: ListFormat | None = None
    hdu: int | str | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """One frame or upload to solve, with the index for a blind search, if there is one."""

    source: Frame | Upload
    hint: Hint | None
    settings: SolveSettings
    index: Path | None = None


@dataclass(frozen=True, slots=True)
class Reading:
    """An upload to read, not to solve."""

    source: Upload


def task_of(work: Work, masters: list[Calibration], sent: set[int], index: Path | None) -> Task:
    """A piece of work as it is sent: masters go along once, and by their number from then on.

    Parameters
    ----------
    masters : list of Calibration
        Those that were met so far; a new one is added.
    sent : set of int
        Numbers of those that the other end has; this one's is added.
    index : Path or None
        The index of the whole sky, as the other end finds it.
    """
    mine, number = work.settings.calibration, None
    if mine is not None:
        known = [one for one, kept in enumerate(masters) if kept is mine]
        number = known[0] if known else len(masters)
        if not known:
            masters.append(mine)
    news = None if number is None or number in sent else mine
    if number is not None:
        sent.add(number)
    return Task(
        source=described(work.source),
        hint=work.hint,
        settings=replace(work.settings, calibration=None, index=None),
        calibration_number=number,
        calibration=news,
        index=index,
    )


def described(source: Frame | Upload) -> SharedPixels | SharedFile:
    """The source as it is sent: without what lies in the file that goes with it."""
    if isinstance(source, Upload):
        return SharedFile(source.name, source.stars, source.hdu)
    pixels = source.pixels
    bare = replace(source, pixels=np.empty((0, 0), pixels.dtype))
    return SharedPixels(bare, pixels.dtype.str, pixels.shape)


def in_memory(pixels: NDArray[np.generic]) -> int:
    """Copy pixels into a file without a name, which lives as long as one of the two processes holds it."""
    plain = np.ascontiguousarray(pixels)
    file = os.memfd_create("mountnav-frame")
    try:
        left = plain.reshape(-1).view(np.uint8).data
        while left:
            left = left[os.write(file, left) :]
    except BaseException:
        os.close(file)
        raise
    return file


def empty_file() -> int:
    """A file without a name, for the other process to fill."""
    return os.memfd_create("mountnav-pixels")


def pixels_in(file: int, told: Done) -> NDArray[np.generic]:
    """The pixels that the other process wrote; copied, for it still holds the file.

    Raises
    ------
    ProcessEnded
        They are none, or not as many as it told.
    """
    if not _BRIGHTNESS.fullmatch(told.dtype) or len(told.shape) != 2 or min(told.shape) < 1:
        raise ProcessEnded(f"the solver read pixels of the kind {told.dtype[:20]} and shape {told.shape}")
    count = told.shape[0] * told.shape[1]
    kind = np.dtype(told.dtype)
    with FileIO(file, closefd=False) as opened:
        content = OnDisk(opened)
        if count > MOST_PIXELS or len(content) != count * kind.itemsize:
            raise ProcessEnded(f"the solver announced {count} pixels and left {len(content)} bytes")
        try:
            return stored(content, kind, count, 0).reshape(told.shape)
        except EOFError as fault:
            raise ProcessEnded("the solver took pixels back") from fault
