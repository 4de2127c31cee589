"""A line over UDP, as the Wi-Fi adapters of Sky-Watcher mounts speak it: one datagram to a command or answer.

Datagrams get lost, come twice and come late; what reads them must ask again and never take an old one for
new. A port that nobody listens on says so on most networks; that counts as a lost line. Silence doesn't.
"""

from __future__ import annotations

import asyncio

from drivers.wire.incoming import Incoming
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing

_ADVICE = "check host, port, and that this computer is in the mount's Wi-Fi network"


class _Datagrams(asyncio.DatagramProtocol):
    """Hands what the socket tells to its line."""

    def __init__(self, line: UdpLine) -> None:
        self._line = line

    def datagram_received(self, data: bytes, addr: object) -> None:
        self._line.take(data)

    def error_received(self, exc: Exception) -> None:
        self._line.lose(str(exc))

    def connection_lost(self, exc: Exception | None) -> None:
        if exc is not None:
            self._line.lose(str(exc))


class UdpLine:
    """A `drivers.wire.line.ByteLine` over UDP.

    Parameters
    ----------
    host : str
        Name or address.
    port : int
    log : WireLog, optional
        Where all bytes are noted, both ways.
    """

    def __init__(self, host: str, port: int, *, log: WireLog | None = None) -> None:
        self._host, self._port = host, port
        self._log = log or WireLog(kept=1)
        self._transport: asyncio.DatagramTransport | None = None
        self._incoming = Incoming(self.address, lambda: _ADVICE, self._log)

    @property
    def address(self) -> str:
        """``udp://host:port``."""
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"udp://{host}:{self._port}"

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        return self._incoming.usable

    async def open(self) -> None:
        """Open a socket of our own; whether anybody listens shows at the first question.

        Raises
        ------
        DeviceMissing
            If the host has no address, or there is no way to it.
        """
        await self.close()
        loop = asyncio.get_running_loop()
        try:
            transport, _ = await loop.create_datagram_endpoint(
                lambda: _Datagrams(self), remote_addr=(self._host, self._port)
            )
        except OSError as cause:
            raise DeviceMissing(f"can't be opened: {cause}", device=self.address, advice=_ADVICE) from cause
        self._transport = transport
        self._incoming.opened()

    async def close(self) -> None:
        """Close the socket; closing twice is fine."""
        transport, self._transport = self._transport, None
        self._incoming.closed()
        if transport is not None:
            transport.close()
            # the loop closes the socket in its next turn
            await asyncio.sleep(0)

    async def write(self, data: bytes) -> None:
        """Send one datagram.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost.
        """
        self._usable_transport().sendto(data)
        self._log.note("driver->mount", data)

    async def write_now(self, data: bytes) -> None:
        """Send one datagram; nothing waits in front of it."""
        await self.write(data)

    async def read(self, timeout_s: float) -> bytes:
        """Return what has come, waiting up to `timeout_s` for the first datagram; empty when none came.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost, and nothing is left to read.
        """
        return await self._incoming.read(timeout_s)

    def drain(self) -> bytes:
        """Throw away what has come so far, and return it."""
        return self._incoming.drain()

    async def lost(self) -> str:
        """Wait until the open line is lost, and tell why."""
        return await self._incoming.lost()

    def take(self, data: bytes) -> None:
        """Keep a datagram that came; called by the socket."""
        if self._transport is not None:
            self._log.note("mount->driver", data)
            self._incoming.arrived(data)

    def lose(self, why: str) -> None:
        """Count the line as lost; called by the socket."""
        if self._transport is not None:
            self._incoming.lose(why)

    def _usable_transport(self) -> asyncio.DatagramTransport:
        self._incoming.require()
        assert self._transport is not None
        return self._transport
