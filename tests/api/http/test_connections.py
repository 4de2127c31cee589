"""Hundreds of connections that say nothing, or little: a stop gets through, and what dawdles is closed."""

from __future__ import annotations

import asyncio
import hashlib
import os
import resource
import socket
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import ExitStack, asynccontextmanager, suppress
from typing import Self

import httpx
import pytest
import uvicorn
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from api.http.connections import Bounds, Deadlines, Gate
from api.http.serving import bind
from api.listeners.admission import listener_burst, listener_fresh, shares
from tests.api.conftest import OBSERVATORY
from tests.pace import slowness

TOKEN = "mnk_for-this-test-alone"
STOP = (
    f"POST /v1/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nX-API-Key: {TOKEN}\r\nContent-Length: 0\r\n\r\n".encode()
)
FEW = 256
"""Descriptors of the service under attack; with the usual 1,024 it is the same with four times as many."""
STOP_S = 2.0
"""Within that a stop is answered on a machine that has the time for it."""


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, int]]:
    """A real `mountnav serve`, with few descriptors and a key."""
    folder = tmp_path_factory.mktemp("few")
    config = folder / "observatory.toml"
    digest = hashlib.sha256(TOKEN.encode()).hexdigest()
    config.write_text(OBSERVATORY.replace("port = 0", f'port = 0\napi_token_sha256 = "{digest}"'))
    process = subprocess.Popen(
        [sys.executable, "-m", "api.main", "serve", "--config", str(config)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"MOUNTNAV_JOURNAL": str(folder / "journal.sqlite")},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (FEW, FEW)),
    )
    assert process.stdout is not None
    try:
        url = process.stdout.readline().split()[-1]
        with httpx.Client(base_url=url, trust_env=False, timeout=120) as client:
            while True:
                try:
                    client.get("/v1/health/live")
                    break
                except httpx.TransportError:
                    assert process.poll() is None
        host, port = url.removeprefix("http://").split(":")
        yield host, int(port)
    finally:
        process.terminate()
        process.wait(60)
        process.stdout.close()


def _from(address: tuple[str, int], source: str, data: bytes) -> socket.socket:
    made = socket.create_connection(address, timeout=30, source_address=(source, 0))
    if data:
        made.sendall(data)
    return made


def _one_machine(number: int) -> str:
    return "127.0.0.1"


def _another_machine(number: int) -> str:
    return "127.0.0.2"


def _many_machines(number: int) -> str:
    return f"127.0.1.{1 + number % 200}"


@pytest.mark.long
@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Slow: ",
        b"POST /v1/solve HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        b"Content-Length: 1000\r\n\r\n{",
        b"GET /v1/health/live HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    ],
    ids=["nothing", "half a head", "half a body", "one question each"],
)
@pytest.mark.parametrize("source", [_one_machine, _another_machine, _many_machines])
def test_a_stop_gets_through(address: tuple[str, int], source: Callable[[int], str], data: bytes) -> None:
    most_s = STOP_S * slowness()
    with ExitStack() as held:
        for number in range(FEW + 50):
            try:
                held.enter_context(_from(address, source(number), data))
            except ConnectionResetError:
                continue
        begun_s = time.monotonic()
        with _from(address, "127.0.0.1", STOP) as stop:
            answer = stop.recv(65_536)
        took_s = time.monotonic() - begun_s
    assert answer.startswith(b"HTTP/1.1 200"), answer
    assert took_s < most_s


def test_descriptors_are_left_for_stops_and_devices() -> None:
    for descriptors in (256, 512, 1024, 1_000_000):
        shared = shares(descriptors, telescopes=2)
        doors = 3 * (shared.listener + listener_fresh(shared.listener))
        taken = shared.http + shared.stops + shared.fresh + shared.burst + doors
        # nobody goes before what came with him was read
        assert shared.fresh >= 2 * shared.burst
        assert listener_fresh(shared.listener) >= 2 * listener_burst(shared.listener)
        assert taken + 96 + 2 * 8 <= min(descriptors, 1024)
        assert shared.http >= 24
        assert shared.stops >= 4


# -- the gate by itself, with deadlines that a test can wait for ------------------------------------------


async def _application(scope: Scope, receive: Receive, send: Send) -> None:
    """Read the whole body, then answer."""
    if scope["type"] != "http":
        return
    request = Request(scope, receive)
    try:
        answer: Response = PlainTextResponse(f"{scope['path']} {len(await request.body())}")
    except ClientDisconnect:
        return
    if scope["path"] == "/large":
        answer = Response(b"x" * 50_000_000)
    await answer(scope, receive, send)


class _Held:
    """Connections that are let go in the end."""

    def __init__(self) -> None:
        self._writers: list[asyncio.StreamWriter] = []

    async def open(self, address: tuple[str, int]) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection(*address)
        self._writers.append(writer)
        return reader, writer

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        for writer in self._writers:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()


SOON = Deadlines(head_s=0.5, stop_head_s=0.5, body_s=0.5, answer_s=0.5)


@asynccontextmanager
async def _behind(
    gate: Gate, heard: list[str] | None = None, application: ASGIApp | None = None
) -> AsyncIterator[tuple[str, int]]:
    async def noted(scope: Scope, receive: Receive, send: Send) -> None:
        if heard is not None:
            heard.append(scope["path"])
        await (application or _application)(scope, receive, send)

    config = uvicorn.Config(
        noted,
        http=gate.protocol(),  # type: ignore[arg-type]
        ws="none",
        lifespan="off",
        log_level="error",
        backlog=16,
    )
    server = uvicorn.Server(config)
    with bind("127.0.0.1", 0) as listener:
        task = asyncio.create_task(server._serve([listener]))
        while not server.started:
            await asyncio.sleep(0.01)
        try:
            yield listener.getsockname()[:2]
        finally:
            server.should_exit = True
            await task


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"GET / HT",
        b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\nx",
        b"GET / HTTP/1.1\r\nHost: a\r\n\r\nGET",
    ],
    ids=["nothing", "half a head", "half a body", "half a second head"],
)
async def test_who_says_nothing_is_closed(data: bytes) -> None:
    gate = Gate(Bounds(), SOON)
    async with _behind(gate) as address, _Held() as held, asyncio.timeout(60):
        reader, writer = await held.open(address)
        writer.write(data)
        with suppress(ConnectionResetError):
            await reader.read()
        assert gate.count == 0


async def test_who_trickles_a_head_or_a_body_is_closed() -> None:
    gate = Gate(Bounds(), SOON)
    starts = (b"GET / HTTP/1.1\r\nX-A: ", b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 99999\r\n\r\n")
    async with _behind(gate) as address, _Held() as held, asyncio.timeout(60):
        for start in starts:
            _, writer = await held.open(address)
            writer.write(start)
            with suppress(ConnectionError):
                while True:
                    writer.write(b"x")
                    await writer.drain()
                    await asyncio.sleep(0.05)
        assert gate.count == 0


async def test_who_takes_no_answer_is_closed() -> None:
    gate = Gate(Bounds(), SOON)
    async with _behind(gate) as address, _Held() as held, asyncio.timeout(60):
        _, writer = await held.open(address)
        writer.write(b"GET /large HTTP/1.1\r\nHost: a\r\n\r\n")
        await writer.drain()
        while gate.count == 0:
            await asyncio.sleep(0.01)
        while gate.count:
            await asyncio.sleep(0.05)


async def test_a_slow_but_honest_upload_is_taken() -> None:
    gate = Gate(Bounds(), SOON)
    size = 20_000
    async with _behind(gate) as address, _Held() as held, asyncio.timeout(60):
        reader, writer = await held.open(address)
        writer.write(
            f"POST /up HTTP/1.1\r\nHost: a\r\nConnection: close\r\nContent-Length: {size}\r\n\r\n".encode()
        )
        for _ in range(20):
            writer.write(b"x" * (size // 20))
            await asyncio.sleep(0.1)
        assert (await reader.read()).endswith(b"/up 20000")


async def test_beyond_the_bounds_only_a_stop_is_taken() -> None:
    gate = Gate(Bounds(most=8, each_address=4, stops=2))
    busy = b"POST /up HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\nx"
    async with _behind(gate) as address, _Held() as held, asyncio.timeout(60):
        writers = []
        for _ in range(4):
            _, writer = await held.open(address)
            writer.write(busy)
            writers.append(writer)
        while gate.count < 4:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.1)
        reader, writer = await held.open(address)
        writer.write(b"GET /v1/health HTTP/1.1\r\nHost: a\r\n\r\n")
        told = await reader.read()
        assert told.startswith(b"HTTP/1.1 503")
        assert b"too-many-connections" in told
        reader, writer = await held.open(address)
        writer.write(b"POST /v1/stop HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n")
        assert (await reader.read()).endswith(b"/v1/stop 0")


@pytest.mark.long
async def test_an_idle_connection_makes_room_and_one_that_never_asked_goes_first() -> None:
    gate = Gate(Bounds(most=3, each_address=3, stops=2))
    async with _behind(gate) as address, _Held() as held, asyncio.timeout(60):
        asked_reader, asked = await held.open(address)
        asked.write(b"GET /a HTTP/1.1\r\nHost: a\r\n\r\n")
        await asked_reader.readuntil(b"/a 0")
        mute_reader, _ = await held.open(address)
        await held.open(address)
        while gate.count < 3:
            await asyncio.sleep(0.01)
        await asyncio.sleep(0.3)  # they could have said by now what they want
        reader, writer = await held.open(address)
        writer.write(b"GET /b HTTP/1.1\r\nHost: a\r\n\r\n")
        await reader.readuntil(b"/b 0")
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await mute_reader.readexactly(1)
        asked.write(b"GET /c HTTP/1.1\r\nHost: a\r\n\r\n")
        await asked_reader.readuntil(b"/c 0")


@pytest.mark.long
async def test_a_stop_that_has_just_come_makes_no_room_for_a_flood_of_newcomers() -> None:
    gate = Gate(Bounds(most=3, each_address=3, stops=1, fresh=2))
    stop = b"POST /v1/stop HTTP/1.1\r\nHost: a\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    async with _behind(gate) as address, asyncio.timeout(60):
        with ExitStack() as held:
            # all of them are there before the loop has a turn to accept one: the stop is the oldest
            sent = held.enter_context(_from(address, "127.0.0.1", stop))
            for _ in range(4):
                held.enter_context(_from(address, "127.0.0.1", b""))
            sent.setblocking(False)
            told = await asyncio.get_running_loop().sock_recv(sent, 65_536)
    assert told.startswith(b"HTTP/1.1 200"), told
