"""Which Alpaca servers answer on the networks of this machine, and which devices they have [Alpaca §6].

A question goes to everybody once, by UDP; servers answer with the port of their HTTP. Broadcasts don't reach
a server that listens on this machine's own loopback alone, so that is asked by itself.
"""

from __future__ import annotations

import asyncio
import socket
from dataclasses import dataclass

from drivers.alpaca.client import AlpacaClient
from drivers.alpaca.codec.base import DeviceAddress
from drivers.wire.wire_log import WireLog
from mountnav.parsing import json_of

PORT = 32227
"""UDP port on which Alpaca servers answer [Alpaca §6]."""
_QUESTION = b"alpacadiscovery1"
_EVERYBODY = ("255.255.255.255", "127.0.0.1")


@dataclass(frozen=True, slots=True)
class AlpacaServer:
    """A server that answered.

    Attributes
    ----------
    address : str
        ``host:port`` of its HTTP.
    devices : tuple of str
        ``telescope/0 (name)``; empty if it doesn't say.
    """

    address: str
    devices: tuple[str, ...]


async def servers(
    *, wait_s: float = 1.5, port: int = PORT, hosts: tuple[str, ...] = _EVERYBODY
) -> list[AlpacaServer]:
    """Ask who is there; asks their devices' names and nothing else.

    Parameters
    ----------
    wait_s : float
        For answers.
    port : int
        Of the discovery.
    hosts : tuple of str
        Whom to ask.
    """
    loop = asyncio.get_running_loop()
    heard = Heard()
    asker = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    asker.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    asker.bind(("", 0))
    transport, _ = await loop.create_datagram_endpoint(lambda: heard, sock=asker)
    try:
        for host in hosts:
            transport.sendto(_QUESTION, (host, port))
        await asyncio.sleep(wait_s)
    finally:
        transport.close()
    return [AlpacaServer(address, await _devices(address)) for address in sorted(heard.addresses)]


async def _devices(address: str) -> tuple[str, ...]:
    client = AlpacaClient(
        DeviceAddress(f"http://{address}", "telescope", 0), log=WireLog(kept=10), deadline_s=2.0
    )
    await client.open()
    try:
        return tuple(await client.described())
    finally:
        await client.close()


class Heard(asyncio.DatagramProtocol):
    """Keeps the addresses of those who answer as a server does; passes over all else."""

    def __init__(self) -> None:
        self.addresses: set[str] = set()

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Note who answers as a server does."""
        try:
            http_port = json_of(data)["AlpacaPort"]
        except (ValueError, KeyError, TypeError):
            return
        if type(http_port) is int and 0 < http_port < 65536:
            self.addresses.add(f"{addr[0]}:{http_port}")

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there: no answer either."""
