"""The solver's socket: takes calls of stubs, a thread each, for a solver that lives in an event loop."""

from __future__ import annotations

import asyncio
import errno
import fcntl
import logging
import os
import secrets
import socket
import stat
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from api.solver.link import Upload
from api.solver.solver import Solver
from api.solver_commands.host import Asked
from api.solver_daemon import stub
from api.solver_daemon.connection import OwnWord, serve_call
from mountnav.errors import BadSettings, Cancelled
from mountnav.files import make_private_folder, open_lock
from mountnav.frames import Frame
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

_log = logging.getLogger(__name__)

MOST_CALLS = 32
"""Calls that are carried out at once; more wait in the system's queue. Each has a thread. Doubled, a flood of
calls takes twice as many threads."""
CALLS_OF_SERVICE = 4
"""The same in the service, whose descriptors are for stops and devices first: a call holds up to four. It
solves one upload at a time in any case. Doubled, 16 more are taken from what `api.listeners.admission` keeps
for such things."""
WAITING_CALLS = 128
"""Calls that the system lets wait; chosen by hand: more than any program starts."""
ASK_EACH_S = 0.2
"""How often a command is asked whether its caller has given it up, s. Doubled, a cancelled solve goes on for
0.2 s longer."""
TAKE_OVER_S = 5.0
"""How long a service waits for a daemon to make room, s; chosen by hand. Doubled, a service whose daemon is
stuck starts 5 s later."""
TOKEN_BYTES = 16
"""Of the word that a stub must know on a port of TCP: it can't be guessed."""


def socket_path() -> Path:
    """Where the solver of this user listens, be it the service or the daemon."""
    return Path(stub.folder()) / "solver.sock"


class SolverOnLoop:
    """A solver of an event loop, for commands in threads. Implements `api.solver_commands.host.Solver`.

    Parameters
    ----------
    settings : callable
        The settings of a solve, at the time of a call.
    """

    def __init__(
        self, solver: Solver, settings: Callable[[], SolveSettings], loop: asyncio.AbstractEventLoop
    ) -> None:
        self._solver, self._settings, self._loop = solver, settings, loop

    def solve(self, asked: Asked, *, cancelled: Callable[[], bool] | None = None) -> Verdict:
        """As `Solver.solve`."""
        settings = replace(self._settings(), blind=asked.blind)
        if asked.cpu_limit_s is not None:
            settings = replace(settings, budget_s=min(settings.budget_s, asked.cpu_limit_s))
        upload = Upload(asked.name, asked.file.fileno(), asked.stars)
        solving = asyncio.run_coroutine_threadsafe(
            self._solver.solve_upload(upload, asked.hint, settings), self._loop
        )
        while True:
            try:
                return solving.result(None if cancelled is None else ASK_EACH_S)
            except TimeoutError:
                if solving.done():
                    raise
                if cancelled is not None and cancelled():
                    solving.cancel()
                    raise Cancelled(f"{asked.name} was given up", advice="call it again") from None

    def read(self, file: BinaryIO, name: str) -> Frame:
        """As `Solver.read`."""
        from mountnav.reading import demosaiced

        reading = self._solver.read_upload(Upload(name, file.fileno()))
        return demosaiced(asyncio.run_coroutine_threadsafe(reading, self._loop).result())


class SolverSocket:
    """Listens for stubs. Implements `api.listeners.listeners.Listener`.

    Parameters
    ----------
    path : Path, optional
        Of the socket; `socket_path()` if left out. It is for this user alone.
    tcp_port : int, optional
        Listen on this port of 127.0.0.1 instead, for stubs that see no socket of ours; 0: any that is free.
        They must know `token`.
    own : mapping, optional
        Words for the solver itself.
    most_calls : int
        See `MOST_CALLS`.
    takes_over : bool
        Ask a daemon that listens there to end, and take its place. Where another service listens this one
        doesn't, and that is no trouble: commands are answered.
    """

    def __init__(
        self,
        solver: SolverOnLoop,
        *,
        path: Path | None = None,
        tcp_port: int | None = None,
        own: Mapping[str, OwnWord] | None = None,
        most_calls: int = MOST_CALLS,
        takes_over: bool = False,
    ) -> None:
        self._solver, self._own, self._takes_over = solver, own or {}, takes_over
        self._path, self._tcp_port = path or socket_path(), tcp_port
        self.token = "" if tcp_port is None else secrets.token_hex(TOKEN_BYTES)
        self._socket: socket.socket | None = None
        self._lock_file: int | None = None
        self._places = threading.BoundedSemaphore(most_calls)
        self._links: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._ended_s = time.monotonic()

    @property
    def address(self) -> tuple[str, int]:
        """Path of the socket and 0, or host and port."""
        if self._socket is not None and self._tcp_port is not None:
            host, port = self._socket.getsockname()
            return str(host), int(port)
        return str(self._path), 0

    @property
    def idle_s(self) -> float:
        """For how long no call has been carried out; 0 while one is."""
        with self._lock:
            return 0.0 if self._links else time.monotonic() - self._ended_s

    async def start(self) -> None:
        """Listen.

        Raises
        ------
        BadSettings
            Another solver of this user listens there, or it can't be listened there.
        """
        if self._takes_over and self._tcp_port is None:
            await asyncio.to_thread(_ended, self._path)
        try:
            self._socket = self._unix() if self._tcp_port is None else self._tcp(self._tcp_port)
        except BlockingIOError as fault:
            if self._takes_over:
                _log.info("another service of this user answers the commands of other plate solvers")
                return
            raise BadSettings(
                "another solver of this user listens there",
                device="solver's socket",
                advice="mountnav solver status",
            ) from fault
        except OSError as fault:
            raise BadSettings(
                f"it can't listen on {self.address[0]}: {fault.strerror or fault}",
                device="solver's socket",
                advice="can the folder be written?",
            ) from fault
        threading.Thread(target=self._accept, args=(self._socket,), name="solver socket", daemon=True).start()

    async def stop(self) -> None:
        """Listen no more, and let all stubs go: they see to their commands themselves."""
        listening, self._socket = self._socket, None
        if listening is None:
            return
        if self._tcp_port is None:
            with suppress(OSError):
                self._path.unlink()
        with suppress(OSError):
            listening.shutdown(socket.SHUT_RDWR)
        listening.close()
        if self._lock_file is not None:
            os.close(self._lock_file)
            self._lock_file = None
        with self._lock:
            for link in self._links:
                with suppress(OSError):
                    link.shutdown(socket.SHUT_RDWR)

    def _unix(self) -> socket.socket:
        make_private_folder(self._path.parent)
        # who holds the lock owns the name: a socket without its owner is what a killed one has left
        lock = open_lock(self._path.with_suffix(".lock"))
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            listening = self._bound()
        except BaseException:
            os.close(lock)
            raise
        self._lock_file = lock
        return listening

    def _bound(self) -> socket.socket:
        with suppress(FileNotFoundError):
            if not stat.S_ISSOCK(self._path.lstat().st_mode):
                raise OSError(errno.EEXIST, "something else has this name")
            self._path.unlink()
        listening = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            # through the open folder: paths of sockets are short
            folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
            try:
                # the mode of the descriptor is that of the file: nobody can connect before it is private
                os.fchmod(listening.fileno(), 0o600)
                listening.bind(f"/proc/self/fd/{folder}/{self._path.name}")
            finally:
                os.close(folder)
            os.chmod(self._path, 0o600)
            listening.listen(WAITING_CALLS)
        except BaseException:
            listening.close()
            raise
        return listening

    def _tcp(self, port: int) -> socket.socket:
        return socket.create_server(("127.0.0.1", port), backlog=WAITING_CALLS)

    def _accept(self, listening: socket.socket) -> None:
        while self._socket is listening:
            self._places.acquire()
            try:
                link, _ = listening.accept()
            except OSError as fault:
                self._places.release()
                if fault.errno in (errno.EMFILE, errno.ENFILE, errno.ECONNABORTED):
                    time.sleep(ASK_EACH_S)
                    continue
                return
            if self._tcp_port is None and not _same_user(link):
                link.close()
                self._places.release()
                continue
            with self._lock:
                self._links.add(link)
            try:
                threading.Thread(target=self._serve, args=(link,), name="solver call", daemon=True).start()
            except RuntimeError:  # no thread is left: the caller sees to itself
                _log.exception("a command's call was dropped")
                link.close()
                self._over(link)

    def _serve(self, link: socket.socket) -> None:
        try:
            serve_call(link, self._solver, token=self.token, own=self._own)
        finally:
            self._over(link)

    def _over(self, link: socket.socket) -> None:
        """A call is over."""
        with self._lock:
            self._links.discard(link)
            self._ended_s = time.monotonic()
        self._places.release()


def _ended(path: Path) -> None:
    """Ask a daemon that listens there to end, and wait for it; a service doesn't listen to that word."""
    if not stub.asked(str(path), "stop"):
        return
    # its lock is the last that it lets go
    lock = open_lock(path.with_suffix(".lock"))
    until_s = time.monotonic() + TAKE_OVER_S
    try:
        while time.monotonic() < until_s:
            with suppress(BlockingIOError):
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
            time.sleep(ASK_EACH_S)
    finally:
        os.close(lock)


def _same_user(link: socket.socket) -> bool:
    """Whether the other end is a process of this user, or of root."""
    told = link.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    _, user, _ = struct.unpack("3i", told)
    return user in (os.geteuid(), 0)
