"""Answers without end, and ones that unpack to a thousand times their size, are given up in time."""

from __future__ import annotations

import asyncio
import contextlib
import json
import tracemalloc
import zlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import httpx
import pytest

from drivers.alpaca.client import answered
from drivers.alpaca.codec.base import Malformed

MOST = 1 << 20
BOMB_WBITS = (31, 15)
"""gzip's and zlib's wrapping."""
SOUND = json.dumps({"Value": 1.5, "ErrorNumber": 0, "ErrorMessage": ""}).encode()


def _packed(data: bytes, wbits: int) -> bytes:
    packer = zlib.compressobj(9, wbits=wbits)
    return packer.compress(data) + packer.flush()


@asynccontextmanager
async def server(head: str, body: bytes, *, endless: bool = False) -> AsyncIterator[str]:
    """Answer each request with these bytes; the address."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError, asyncio.IncompleteReadError):
            await reader.readuntil(b"\r\n\r\n")
            writer.write(f"HTTP/1.1 200 OK\r\nConnection: close\r\n{head}\r\n".encode() + body)
            while endless:
                writer.write(b"10000\r\n" + bytes(0x10000) + b"\r\n")
                await writer.drain()
        writer.close()

    opened = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"http://127.0.0.1:{opened.sockets[0].getsockname()[1]}/"
    finally:
        opened.close()


@pytest.mark.long
@pytest.mark.parametrize("method", ["GET", "PUT"])
@pytest.mark.parametrize(
    ("head", "body", "endless", "why"),
    [
        ("Transfer-Encoding: chunked\r\n", b"", True, "more than 1048576 bytes"),
        ("Content-Encoding: gzip\r\n", BOMB_WBITS[0], False, "more than 1048576 bytes"),
        ("Content-Encoding: deflate\r\n", BOMB_WBITS[1], False, "more than 1048576 bytes"),
        ("Content-Encoding: gzip\r\n", _packed(SOUND, 31)[:-9], False, "is cut off"),
        ("Content-Encoding: gzip\r\n", SOUND, False, "compression is damaged"),
        ("Content-Encoding: br\r\n", SOUND, False, "compressed as 'br'"),
    ],
    ids=["endless", "gzip bomb", "deflate bomb", "cut", "damaged", "unknown"],
)
async def test_it_is_given_up_within_its_bound(
    method: str, head: str, body: bytes | int, endless: bool, why: str
) -> None:
    if isinstance(body, int):  # made here: a collection of tests is not to pack it
        body = _packed(bytes(200_000_000), body)
    async with server(head, body, endless=endless) as url, httpx.AsyncClient(trust_env=False) as client:
        tracemalloc.start()
        try:
            with pytest.raises(Malformed, match=why):
                await answered(client, method, url, most_bytes=MOST)
            assert tracemalloc.get_traced_memory()[1] < 20 * MOST
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize(
    ("head", "body"),
    [
        ("", SOUND),
        ("Content-Encoding: gzip\r\n", _packed(SOUND, 31)),
        ("Content-Encoding: deflate\r\n", _packed(SOUND, 15)),
    ],
    ids=["plain", "gzip", "deflate"],
)
async def test_a_sound_one_is_read_packed_or_not(head: str, body: bytes) -> None:
    async with server(head, body) as url, httpx.AsyncClient(trust_env=False) as client:
        answer = await answered(client, "GET", url, most_bytes=MOST)
    assert (answer.status_code, answer.content) == (200, SOUND)
