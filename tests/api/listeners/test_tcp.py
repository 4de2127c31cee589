"""A port and its clients: no more than it can bear, and none that is gone stays for long."""

from __future__ import annotations

import asyncio
import socket
from contextlib import ExitStack, suppress

import pytest

from api.listeners.tcp import TcpPort

pytestmark = pytest.mark.asyncio


async def test_a_client_too_many_is_told_and_let_go_and_room_is_made_by_one_that_leaves() -> None:
    left = asyncio.Semaphore(0)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(1)
        writer.write(b"hello")
        await reader.read()
        left.release()

    port = TcpPort("127.0.0.1", 0, serve, name="a test", full=lambda count: b"full %d" % count)
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
async def test_clients_that_never_spoke_make_room_where_clients_speak_first(
    speaks_first: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "api.listeners.admission.CHANCE_S", -1.0
    )  # they could have said by now what they want

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(1)
        writer.write(b"hello")
        await reader.read()

    port = TcpPort("127.0.0.1", 0, serve, name="a test", speaks_first=speaks_first, most=4)
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


async def _closed(writer: asyncio.StreamWriter) -> None:
    writer.close()
    with suppress(ConnectionError):
        await writer.wait_closed()


async def _is_heard(port: TcpPort) -> bool:
    """Whether a stop is; it comes a moment after its connection, as from another machine."""
    reader, writer = await asyncio.open_connection(*port.address)
    await asyncio.sleep(0)
    writer.write(b"Q")
    told = b""
    with suppress(ConnectionError):
        told = await reader.read(100)
    await _closed(writer)
    return told == b"heard Q"


async def _hear_first_byte(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Serve a client: answer what it says first, and stay with it."""
    if said := await reader.read(1):
        writer.write(b"heard " + said)
        await reader.read()


async def test_one_that_has_just_come_makes_no_room_for_newcomers_of_the_same_moment() -> None:
    port = TcpPort("127.0.0.1", 0, _hear_first_byte, name="a test", most=8)
    await port.start()
    with ExitStack() as held:
        # all of them are there before the loop has a turn to accept one: the stop is the oldest
        stop = held.enter_context(socket.create_connection(port.address))
        stop.sendall(b"Q")
        for _ in range(40):
            held.enter_context(socket.create_connection(port.address))
        stop.setblocking(False)
        async with asyncio.timeout(60.0):
            assert await asyncio.get_running_loop().sock_recv(stop, 100) == b"heard Q"
            # whoever comes last is heard when all are accepted
            assert await _is_heard(port)
    await port.stop()


@pytest.mark.long
async def test_beside_clients_that_reconnect_without_end_each_stop_is_heard() -> None:
    port = TcpPort("127.0.0.1", 0, _hear_first_byte, name="a test", most=16)
    await port.start()
    came = 0

    async def reconnects() -> None:
        nonlocal came
        loop = asyncio.get_running_loop()
        while True:
            with socket.socket() as one, suppress(ConnectionError):
                one.setblocking(False)
                await loop.sock_connect(one, port.address)
                came += 1
                # it says nothing, and comes again as soon as it is let go
                await loop.sock_recv(one, 1)

    flood = [asyncio.create_task(reconnects()) for _ in range(40)]
    async with asyncio.timeout(120.0):
        unheard = [await _is_heard(port) for _ in range(100)].count(False)
    for one in flood:
        one.cancel()
    await asyncio.gather(*flood, return_exceptions=True)
    assert await _is_heard(port)
    await port.stop()
    assert came > 100
    assert unheard == 0


async def test_clients_that_are_turned_away_without_end_are_logged_seldom(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = TcpPort("127.0.0.1", 0, _hear_first_byte, name="a test", speaks_first=False, most=2)
    await port.start()

    async def turned_away(count: int) -> None:
        for _ in range(count):
            reader, writer = await asyncio.open_connection(*port.address)
            with suppress(ConnectionError):
                assert await reader.read() == b""
            await _closed(writer)

    _, staying = await asyncio.open_connection(*port.address)
    async with asyncio.timeout(60.0):
        await turned_away(10)
        assert len(caplog.messages) == 1
        monkeypatch.setattr("api.listeners.admission._TOLD_AGAIN_S", 0.0)
        await turned_away(1)
    assert caplog.messages[1].endswith("(and 9 times since this was last told)")
    await _closed(staying)
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

    port = TcpPort("127.0.0.1", 0, serve, name="a test")
    await port.start()
    _, writer = await asyncio.open_connection(*port.address)
    async with asyncio.timeout(60.0):
        idle_s, again_s, times = await found
    assert idle_s + again_s * times <= 180
    writer.close()
    await port.stop()
