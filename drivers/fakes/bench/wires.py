"""Fakes on real wires: a pseudo-terminal (as a serial port), a TCP port, a UDP port."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import tty
from pathlib import Path
from typing import Any

from drivers.fakes.bench.thread import Bench, Fake
from mountnav.errors import DeviceMissing


class FakeOnPty(Bench):
    """A fake on a pseudo-terminal.

    Parameters
    ----------
    link : Path, optional
        A symlink that points at the pseudo-terminal, for a stable name: as in ``/dev/serial/by-id``, it goes
        and comes with the device, and the device returns under another name.
    baud : int, optional
        Bytes take their time.

    Notes
    -----
    It may vanish and return elsewhere, as a USB adapter that is pulled and plugged in again.
    """

    def __init__(self, fake: Fake, link: Path | None = None, *, baud: int | None = None) -> None:
        super().__init__(fake, baud=baud)
        self._link = link
        self._master = self._slave = -1
        self._device = ""

    @property
    def address(self) -> str:
        """The device path to open: the stable name if there is one."""
        return self._device if self._link is None else str(self._link)

    @property
    def device(self) -> str:
        """The present name of the pseudo-terminal itself."""
        return self._device

    def _open(self) -> None:
        # the slave is kept open here, so that the master survives the time between two clients
        try:
            pairs = [os.openpty()]
        except OSError as error:
            raise DeviceMissing(
                f"no pseudo-terminal can be had for a fake mount: {error.strerror}",
                advice="mount devpts on /dev/pts (a bare chroot has none), or allow it to this service; or "
                "let the fake listen on TCP: mountnav fake-mount --tcp",
            ) from error
        while os.ttyname(pairs[-1][1]) == self._device:
            # a device comes back under another name
            pairs.append(os.openpty())
        self._master, self._slave = pairs.pop()
        for ends in pairs:
            for end in ends:
                os.close(end)
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._device = os.ttyname(self._slave)
        if self._link is not None:
            # made beside it and then put in its place: it is never missing
            fresh = self._link.with_name(f"{self._link.name}.new")
            fresh.unlink(missing_ok=True)
            fresh.symlink_to(self._device)
            fresh.replace(self._link)

    def _close(self) -> None:
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        os.close(self._master)
        os.close(self._slave)

    def _hang_up(self) -> None:
        self._close()
        self._open()

    def _ends(self) -> list[int]:
        return [self._master]

    def _hear(self, end: int) -> None:
        with contextlib.suppress(BlockingIOError):
            self._tell(os.read(end, 4096))

    def _say(self, data: bytes) -> None:
        # if nobody reads and the terminal's buffer is full, bytes are lost, as on a real cable
        with contextlib.suppress(BlockingIOError):
            os.write(self._master, data)


_MOST_WAITING = 65536
"""Bytes that wait for a client that doesn't read; what comes after is dropped, as by a full buffer. Chosen by
hand. Doubled, a fake that floods holds 64 kB more."""


class FakeOnTcp(Bench):
    """A fake behind a TCP port; one client at a time, a new one takes the place of the old.

    Parameters
    ----------
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
        return f"socket://{_host_and_port(self._host, self._port)}"

    def _open(self) -> None:
        try:
            self._listener = listening(self._host, self._port)
        except OSError as cause:
            raise _cannot_listen(cause, self.address) from cause
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
            # without lingering, closing sends a reset instead of an orderly end
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
    """A listening TCP socket; IPv6 if the host is an IPv6 address."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family)


def _host_and_port(host: str, port: int) -> str:
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _cannot_listen(cause: OSError, address: str) -> DeviceMissing:
    advice = "another program listens there" if cause.errno == errno.EADDRINUSE else None
    return DeviceMissing(f"can't listen: {cause}", device=address, advice=advice)


class FakeOnUdp(Bench):
    """A fake behind a UDP port; it answers the last sender.

    Parameters
    ----------
    port : int
        0 takes a free one.

    Notes
    -----
    There is no connection that could be cut: `hang_up` and `reset` forget the last sender.
    """

    def __init__(self, fake: Fake, host: str = "127.0.0.1", port: int = 0) -> None:
        super().__init__(fake)
        self._host, self._port = host, port
        self._socket: socket.socket | None = None
        # an address of the socket's own family: (host, port), with two more values in IPv6
        self._peer: Any = None

    @property
    def address(self) -> str:
        """``udp://host:port``."""
        return f"udp://{_host_and_port(self._host, self._port)}"

    def _open(self) -> None:
        family = socket.AF_INET6 if ":" in self._host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((self._host, self._port))
        except OSError as cause:
            self._socket.close()
            self._socket = None
            raise _cannot_listen(cause, self.address) from cause
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
        # an earlier datagram that was refused shows as an error of this read
        with contextlib.suppress(BlockingIOError, ConnectionError):
            data, self._peer = self._socket.recvfrom(4096)
            self._tell(data)

    def _say(self, data: bytes) -> None:
        if self._socket is not None and self._peer is not None:
            with contextlib.suppress(BlockingIOError, ConnectionError):
                self._socket.sendto(data, self._peer)
