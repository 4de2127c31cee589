"""Discovery over real UDP: who is answered, with what, and who shares the port."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from api.alpaca.discovery import QUESTION, Discovery, answer_to
from mountnav.settings.faces import AlpacaSettings

PORT_OF_HTTP = 11_111


@asynccontextmanager
async def discovering(host: str, port: int = 0) -> AsyncIterator[Discovery]:
    made = Discovery(AlpacaSettings(discovery_port=port), (host, PORT_OF_HTTP))
    await made.start()
    try:
        yield made
    finally:
        await made.stop()


async def ask(
    where: tuple[str, int], words: bytes, *, family: socket.AddressFamily = socket.AF_INET
) -> bytes:
    """Send a question, and give the first answer."""
    loop = asyncio.get_running_loop()
    with socket.socket(family, socket.SOCK_DGRAM) as asker:
        asker.setblocking(False)
        asker.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        await loop.sock_sendto(asker, words, where)
        async with asyncio.timeout(60):
            return await loop.sock_recv(asker, 1024)


@pytest.mark.parametrize(
    ("words", "answered"),
    [
        (QUESTION, True),
        (QUESTION + b" and more", True),
        (QUESTION[:-1], False),
        (QUESTION[:-1] + b"2", False),
        (b"AlpacaDiscovery1", False),
        (b"", False),
    ],
)
def test_what_is_a_question(words: bytes, answered: bool) -> None:
    found = answer_to(words, PORT_OF_HTTP)
    assert (found is not None) == answered
    if found is not None:
        assert json.loads(found) == {"AlpacaPort": PORT_OF_HTTP}


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "0.0.0.0"])
async def test_whoever_asks_this_machine_is_answered(host: str) -> None:
    async with discovering(host) as made:
        port = made.address[1]
        assert port != 0
        # a datagram that is no question doesn't stop it
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"hello", ("127.0.0.1", port))
        for where in ("127.0.0.1", "127.255.255.255"):
            assert json.loads(await ask((where, port), QUESTION)) == {"AlpacaPort": PORT_OF_HTTP}


async def test_a_service_for_this_machine_alone_is_told_to_nobody_else() -> None:
    outside = _own_address()
    if outside is None:
        pytest.skip("this machine has no address but the loopback")
    async with discovering("127.0.0.1") as made:
        loop = asyncio.get_running_loop()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asker:
            asker.setblocking(False)
            # bound to that address alone: no datagram to another address of this machine reaches it
            asker.connect((outside, made.address[1]))
            await loop.sock_sendall(asker, QUESTION)
            with pytest.raises(ConnectionRefusedError):
                async with asyncio.timeout(60):
                    await loop.sock_recv(asker, 1024)


async def test_two_servers_share_a_port() -> None:
    async with discovering("127.0.0.1") as first:
        port = first.address[1]
        async with discovering("127.0.0.1", port) as second:
            assert second.address[1] == port
            assert await ask(("127.0.0.1", port), QUESTION)
        assert await ask(("127.0.0.1", port), QUESTION)
    assert first.address[1] == 0


async def test_over_ipv6() -> None:
    try:
        with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as probe:
            probe.bind(("::1", 0))
    except OSError:
        pytest.skip("this machine has no IPv6")
    async with discovering("::1") as made:
        answer = await ask(("::1", made.address[1]), QUESTION, family=socket.AF_INET6)
        assert json.loads(answer) == {"AlpacaPort": PORT_OF_HTTP}


async def test_a_port_that_cant_be_had_is_told() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))  # without sharing it
        with pytest.raises(OSError):
            async with discovering("127.0.0.1", other.getsockname()[1]):
                pass


def _own_address() -> str | None:
    """An IPv4 address of this machine that isn't the loopback."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # nothing is sent
        except OSError:
            return None
        found = str(probe.getsockname()[0])
    return None if found.startswith("127.") else found
