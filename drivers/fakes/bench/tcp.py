"""A fake behind a TCP port, as mounts with a network plug or a serial server have it."""

from __future__ import annotations

import contextlib
import errno
import socket
import struct

from drivers.fakes.bench.thread import Bench, Fake
from mountnav.errors import DeviceMissing

_MOST_WAITING = 65536


class FakeOnTcp(Bench):
    """A fake behind a TCP port; one client at a time, a new one takes the place of the old.

    Parameters
    ----------
    fake : Fake
    host : str
    port : int
        0 takes a free one.
    baud : int, optional
        Bytes take their time, as behind a serial server.
    """

    def __init__(
        self, fake: Fake, host: str = "127.0.0.1", port: int = 0, *, baud: int | None = None
    ) -> None:
        super().__init__(fake, baud=baud)
        self._host, self._port = host, port
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._waiting = b""

    @property
    def address(self) -> str:
        """The pyserial URL to open, ``socket://host:port``."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"socket://{host}:{self._port}"

    def _open(self) -> None:
        try:
            self._listener = listening(self._host, self._port)
        except OSError as cause:
            advice = "another program listens there" if cause.errno == errno.EADDRINUSE else None
            raise DeviceMissing(f"can't listen: {cause}", device=self.address, advice=advice) from cause
        self._port = self._listener.getsockname()[1]

    def _close(self) -> None:
        for end in (self._client, self._listener):
            if end is not None:
                end.close()
        self._client = self._listener = None
        self._waiting = b""

    def _hang_up(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_RDWR)
        self._drop()

    def _reset(self) -> None:
        if self._client is not None:
            # no lingering: closing then breaks the connection off
            self._client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._drop()

    def _ends(self) -> list[int]:
        return [end.fileno() for end in (self._listener, self._client) if end is not None]

    def _hear(self, end: int) -> None:
        if self._listener is not None and end == self._listener.fileno():
            self._drop()
            self._client, _ = self._listener.accept()
            self._client.setblocking(False)
            self._client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._opened_by_client()
            return
        if self._client is None:
            return
        try:
            data = self._client.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._tell(data)
        else:
            self._drop()

    def _say(self, data: bytes) -> None:
        if self._client is not None and len(self._waiting) < _MOST_WAITING:
            self._waiting += data
            self._write_on(self._client.fileno())

    def _waits_to_write(self, end: int) -> bool:
        return bool(self._waiting) and self._client is not None and end == self._client.fileno()

    def _write_on(self, end: int) -> None:
        if self._client is None or end != self._client.fileno():
            return
        try:
            self._waiting = self._waiting[self._client.send(self._waiting) :]
        except BlockingIOError:
            return
        except OSError:
            self._drop()

    def _drop(self) -> None:
        self._waiting = b""
        if self._client is not None:
            self._client.close()
            self._client = None


def listening(host: str, port: int) -> socket.socket:
    """Make a listening socket; IPv6 where the host is one."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family)
