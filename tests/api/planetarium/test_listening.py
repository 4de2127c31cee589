"""A port and its clients: no more than it can bear, and none that is gone stays for long."""

from __future__ import annotations

import asyncio
import socket

import pytest

from api.planetarium.listening import Listening

pytestmark = pytest.mark.asyncio


async def test_a_client_too_many_is_told_and_let_go_and_room_is_made_by_one_that_leaves() -> None:
    left = asyncio.Semaphore(0)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(1)
        writer.write(b"hello")
        await reader.read()
        left.release()

    port = Listening("127.0.0.1", 0, serve, name="a test", full=lambda count: b"full %d" % count)
    await port.start()
    clients = [await asyncio.open_connection(*port.address) for _ in range(port.most // 2)]
    try:
        async with asyncio.timeout(60.0):
            for reader, writer in clients:
                writer.write(b"?")
                assert await reader.readexactly(5) == b"hello"
            reader, writer = await asyncio.open_connection(*port.address)
            assert await reader.read() == b"full %d" % len(clients)
            writer.close()
            clients.pop()[1].close()
            await left.acquire()
            clients.append(await asyncio.open_connection(*port.address))
            clients[-1][1].write(b"?")
            assert await clients[-1][0].readexactly(5) == b"hello"
    finally:
        for _, writer in clients:
            writer.close()
        await port.stop()


@pytest.mark.parametrize("speaks_first", [True, False])
async def test_clients_that_never_spoke_make_room_where_clients_speak_first(speaks_first: bool) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(1)
        writer.write(b"hello")
        await reader.read()

    port = Listening("127.0.0.1", 0, serve, name="a test", speaks_first=speaks_first, most=4)
    await port.start()
    mute = [await asyncio.open_connection(*port.address) for _ in range(2)]
    try:
        async with asyncio.timeout(60.0):
            reader, writer = await asyncio.open_connection(*port.address)
            mute.append((reader, writer))
            writer.write(b"?")
            if speaks_first:
                assert await reader.readexactly(5) == b"hello"
                with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
                    await mute[0][0].readexactly(1)
            else:
                with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
                    await reader.readexactly(5)
    finally:
        for _, writer in mute:
            writer.close()
        await port.stop()


async def test_a_client_that_vanished_is_noticed_within_minutes() -> None:
    """A phone that leaves the network says nothing: the system asks for it, and soon."""
    found: asyncio.Future[tuple[int, ...]] = asyncio.get_running_loop().create_future()
    options = [getattr(socket, f"TCP_KEEP{one}", None) for one in ("IDLE", "INTVL", "CNT")]
    if None in options:
        pytest.skip("this system has no such options")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connection: socket.socket = writer.get_extra_info("socket")
        found.set_result(tuple(connection.getsockopt(socket.IPPROTO_TCP, one) for one in options if one))

    port = Listening("127.0.0.1", 0, serve, name="a test")
    await port.start()
    _, writer = await asyncio.open_connection(*port.address)
    async with asyncio.timeout(60.0):
        idle_s, again_s, times = await found
    assert idle_s + again_s * times <= 180
    writer.close()
    await port.stop()
