"""Puts a fake device on a real wire - a pseudo-terminal or a TCP port - in a thread of its own."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import socket
import threading
import tty
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from mountnav.errors import DeviceMissing


class Fake(Protocol):
    """Bytes in, bytes out; and when it wants to speak unasked."""

    def feed(self, data: bytes) -> bytes:
        """Take bytes (maybe none) and return what is said now."""
        ...

    def due_in_s(self) -> float | None:
        """Seconds until there is something to say without new bytes."""
        ...


class _Bench(ABC):
    """The thread, its wake pipe, and the context manager; the wires differ below."""

    def __init__(self, fake: Fake) -> None:
        self.fake = fake
        self._thread: threading.Thread | None = None
        self._wake_read = self._wake_write = -1

    def start(self) -> Self:
        """Open the wire and start answering."""
        self._open()
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._run, name="bench", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Stop answering and take the wire away; stopping twice is fine."""
        if self._thread is None:
            return
        os.write(self._wake_write, b".")
        self._thread.join()
        self._thread = None
        os.close(self._wake_read)
        os.close(self._wake_write)
        self._close()

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self._wake_read, *self._ends()], [], [], self.fake.due_in_s())
            if self._wake_read in ready:
                return
            if not ready:
                self._say(self.fake.feed(b""))
            for end in ready:
                self._hear(end)

    @abstractmethod
    def _open(self) -> None:
        """Open the wire."""

    @abstractmethod
    def _close(self) -> None:
        """Take the wire away."""

    @abstractmethod
    def _ends(self) -> list[int]:
        """File descriptors to listen on."""

    @abstractmethod
    def _hear(self, end: int) -> None:
        """Read from one of them and answer."""

    @abstractmethod
    def _say(self, data: bytes) -> None:
        """Send to whoever listens."""


class FakeOnPty(_Bench):
    """A fake on a pseudo-terminal, as if on a serial port.

    Parameters
    ----------
    fake : Fake
    link : Path, optional
        A symlink that is made to point at the pseudo-terminal, for a stable name.
    """

    def __init__(self, fake: Fake, link: Path | None = None) -> None:
        super().__init__(fake)
        self._link = link
        self._master = self._slave = -1
        self._address = ""

    @property
    def address(self) -> str:
        """The device path to open."""
        return self._address

    def _open(self) -> None:
        # the slave is kept open here, so that the master lives on between two clients
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._address = os.ttyname(self._slave)
        if self._link is not None:
            if self._link.is_symlink():
                self._link.unlink()
            self._link.symlink_to(self._address)
            self._address = str(self._link)

    def _close(self) -> None:
        os.close(self._master)
        os.close(self._slave)
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()

    def _ends(self) -> list[int]:
        return [self._master]

    def _hear(self, end: int) -> None:
        self._say(self.fake.feed(os.read(end, 4096)))

    def _say(self, data: bytes) -> None:
        # nobody reads and the terminal's buffer is full: a real cable loses the bytes as well
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)


class FakeOnTcp(_Bench):
    """A fake behind a TCP port; one client at a time, a new one takes the place of the old.

    Parameters
    ----------
    fake : Fake
    host : str
    port : int
        0 takes a free one.
    """

    def __init__(self, fake: Fake, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__(fake)
        self._host, self._port = host, port
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None

    @property
    def address(self) -> str:
        """The pyserial URL to open, ``socket://host:port``."""
        return f"socket://{self._host}:{self._port}"

    def hang_up(self) -> None:
        """Cut the present client off."""
        client = self._client
        if client is not None:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def _open(self) -> None:
        try:
            self._listener = socket.create_server((self._host, self._port))
        except OSError as cause:
            advice = "another program listens there" if cause.errno == errno.EADDRINUSE else None
            raise DeviceMissing(f"can't listen: {cause}", device=self.address, advice=advice) from cause
        self._port = self._listener.getsockname()[1]

    def _close(self) -> None:
        for end in (self._client, self._listener):
            if end is not None:
                end.close()
        self._client = self._listener = None

    def _ends(self) -> list[int]:
        return [end.fileno() for end in (self._listener, self._client) if end is not None]

    def _hear(self, end: int) -> None:
        if self._listener is not None and end == self._listener.fileno():
            self._drop()
            self._client, _ = self._listener.accept()
            return
        if self._client is None or end != self._client.fileno():
            return
        try:
            data = self._client.recv(4096)
        except OSError:
            data = b""
        if data:
            self._say(self.fake.feed(data))
        else:
            self._drop()

    def _say(self, data: bytes) -> None:
        if self._client is not None and data:
            try:
                self._client.sendall(data)
            except OSError:
                self._drop()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
            self._client = None
