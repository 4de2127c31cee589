"""A fake behind a UDP port: one datagram in, one out, as motor controllers with Wi-Fi have it."""

from __future__ import annotations

import contextlib
import errno
import socket
from typing import Any

from drivers.fakes.bench.thread import Bench, Fake
from mountnav.errors import DeviceMissing


class FakeOnUdp(Bench):
    """A fake behind a UDP port; it answers whoever spoke last.

    Parameters
    ----------
    fake : Fake
    host : str
    port : int
        0 takes a free one.

    Notes
    -----
    There is no connection that could be cut: `hang_up` and `reset` forget who spoke last.
    """

    def __init__(self, fake: Fake, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__(fake)
        self._host, self._port = host, port
        self._socket: socket.socket | None = None
        # an address of the socket's own family
        self._peer: Any = None

    @property
    def address(self) -> str:
        """``udp://host:port``."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"udp://{host}:{self._port}"

    def _open(self) -> None:
        family = socket.AF_INET6 if ":" in self._host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((self._host, self._port))
        except OSError as cause:
            self._socket.close()
            self._socket = None
            advice = "another program listens there" if cause.errno == errno.EADDRINUSE else None
            raise DeviceMissing(f"can't listen: {cause}", device=self.address, advice=advice) from cause
        self._socket.setblocking(False)
        self._port = self._socket.getsockname()[1]

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = self._peer = None

    def _hang_up(self) -> None:
        self._peer = None

    def _ends(self) -> list[int]:
        return [] if self._socket is None else [self._socket.fileno()]

    def _hear(self, end: int) -> None:
        if self._socket is None:
            return
        # a refused datagram of before shows as an error of this read
        with contextlib.suppress(BlockingIOError, ConnectionError):
            data, self._peer = self._socket.recvfrom(4096)
            self._tell(data)

    def _say(self, data: bytes) -> None:
        if self._socket is not None and self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data, self._peer)
