"""Alpaca discovery: the service's port for those who ask by UDP and can reach it [Alpaca §6].

It listens where the service does: bound to all addresses, or to one address and the broadcasts of its
network. A service for this machine alone is told to this machine alone.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import ipaddress
import json
import logging
import socket
import struct
import time
from collections.abc import Iterator

from mountnav.settings.faces import AlpacaSettings

_log = logging.getLogger(__name__)

QUESTION = b"alpacadiscovery1"
GROUP = "ff12::a1:9aca"
_SIOCGIFADDR, _SIOCGIFBRDADDR = 0x8915, 0x8919
"""Linux `ioctl` requests [netdevice(7)]: an interface's address, and its broadcast address."""
_LONGEST = 1024
"""Bytes of a datagram that are looked at; a question has 16."""
_MOST_ANSWERS_S = 100
"""In a second: a flood of questions must not keep the loop from a stop; a program asks once or twice."""


def answer_to(datagram: bytes, http_port: int) -> bytes | None:
    """The answer to a datagram; None for what is no question."""
    if not datagram.startswith(QUESTION):
        return None
    return json.dumps({"AlpacaPort": http_port}).encode()


class Discovery:
    """Answers programs that look for Alpaca devices.

    Parameters
    ----------
    settings : AlpacaSettings
        The port to listen on; 0 takes any free one.
    http_address : (str, int)
        Where the service listens, with the port that it really has.
    """

    def __init__(self, settings: AlpacaSettings, http_address: tuple[str, int]) -> None:
        host, self._http_port = http_address
        self._host = "127.0.0.1" if host == "localhost" else host
        self._port = settings.discovery_port
        self._transports: list[asyncio.DatagramTransport] = []

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens on; the port is 0 while it doesn't."""
        if not self._transports:
            return self._host, 0
        found = self._transports[0].get_extra_info("sockname")
        return str(found[0]), int(found[1])

    async def start(self) -> None:
        """Listen. Raises OSError where the service's own address can't be had."""
        loop = asyncio.get_running_loop()
        sockets: list[socket.socket] = []
        try:
            first = _bound(self._host, self._port)
            sockets.append(first)
            port = first.getsockname()[1]
            for address in _broadcasts_of(self._host):
                # a broadcast reaches no socket that is bound to one address
                with contextlib.suppress(OSError):
                    sockets.append(_bound(address, port))
            if first.family == socket.AF_INET6:
                _join(first)
            for made in sockets:
                transport, _ = await loop.create_datagram_endpoint(
                    lambda: _Answerer(self._http_port, self._transports), sock=made
                )
                self._transports.append(transport)
        except BaseException:
            await self.stop()
            for made in sockets:
                made.close()
            raise

    async def stop(self) -> None:
        """Listen no more. Twice is fine."""
        for transport in self._transports:
            transport.close()
        self._transports.clear()
        await asyncio.sleep(0)  # transports close on the loop's next turn


class _Answerer(asyncio.DatagramProtocol):
    """Answers from the first socket: one that is bound to a broadcast address may not send."""

    def __init__(self, http_port: int, transports: list[asyncio.DatagramTransport]) -> None:
        self._http_port = http_port
        self._transports = transports
        self._second, self._answered = 0, 0

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Answer a question, only to the one who asked."""
        second = int(time.monotonic())
        if second != self._second:
            self._second, self._answered = second, 0
        if self._answered >= _MOST_ANSWERS_S:
            return
        self._answered += 1
        answer = answer_to(data[:_LONGEST], self._http_port)
        if answer is not None and self._transports:
            self._transports[0].sendto(answer, addr)

    def error_received(self, exc: Exception) -> None:
        """An answer that didn't arrive is nobody's trouble but the asker's."""
        _log.debug("an answer to a discovery request was not delivered: %s", exc)


def _bound(host: str, port: int) -> socket.socket:
    version = ipaddress.ip_address(host).version if _is_address(host) else 4
    family = socket.AF_INET6 if version == 6 else socket.AF_INET
    made = socket.socket(family, socket.SOCK_DGRAM)
    try:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            # several servers of one machine share the port, since version 12 of the standard
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        if family == socket.AF_INET6:
            made.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        made.setblocking(False)
        made.bind((host, port))
    except BaseException:
        made.close()
        raise
    return made


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


def _broadcasts_of(host: str) -> Iterator[str]:
    """The broadcast addresses that reach one IPv4 address of this machine; none for all addresses."""
    if not _is_address(host) or ipaddress.ip_address(host).version == 6:
        return
    if ipaddress.ip_address(host).is_unspecified:
        return
    if ipaddress.ip_address(host).is_loopback:
        yield "127.255.255.255"
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):
                if _address_of(asker, name, _SIOCGIFADDR) == host:
                    yield _address_of(asker, name, _SIOCGIFBRDADDR)


def _address_of(asker: socket.socket, interface: str, question: int) -> str:
    answer = fcntl.ioctl(asker.fileno(), question, struct.pack("256s", interface.encode()[:15]))
    return socket.inet_ntoa(answer[20:24])


def _join(listener: socket.socket) -> None:
    """Join the multicast group on every interface that has IPv6."""
    group = socket.inet_pton(socket.AF_INET6, GROUP)
    for index, _ in socket.if_nameindex():
        with contextlib.suppress(OSError):
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group + struct.pack("@I", index))


__all__ = ["GROUP", "QUESTION", "Discovery", "answer_to"]
