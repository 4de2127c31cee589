"""Hostile bytes are read a piece in each turn of the loop, stops before them; all else is read as before."""

from __future__ import annotations

import asyncio
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from api.access.rate_limits import is_stop
from api.http.connections import Bounds, Gate
from api.http.fair_scheduling import ReadingTurns
from tests.api.http.test_connections import STOP, STOP_S, _behind, _from, _Held, address  # noqa: F401
from tests.pace import slowness


class _Waits:
    """A connection with so many pieces, that notes in which turn each was read."""

    def __init__(self, name: str, pieces: int, read: list[tuple[str, int]], turn: list[int]) -> None:
        self.loop = asyncio.get_running_loop()
        self.is_urgent = name == "stop"
        self._name, self._left, self._read, self._turn = name, pieces, read, turn

    def read_piece(self) -> bool:
        self._left -= 1
        self._read.append((self._name, self._turn[0]))
        return self._left > 0


async def test_one_piece_in_each_turn_and_stops_first() -> None:
    turns, turn = ReadingTurns(), [0]
    read: list[Any] = []

    async def clock() -> None:
        while True:
            turn[0] += 1
            await asyncio.sleep(0)

    counting = asyncio.create_task(clock())
    for number in range(50):
        turns.ask(_Waits(f"{number}", 3, read, turn))
    await asyncio.sleep(0)
    turns.ask(_Waits("stop", 2, read, turn))
    while len(read) < 152:
        await asyncio.sleep(0)
    counting.cancel()
    assert len({when for _, when in read}) == len(read), "two pieces in one turn"
    at = [index for index, (name, _) in enumerate(read) if name == "stop"]
    assert at[1] <= 5
    # the others in turn, not one of them to its end
    assert len({name for name, _ in read[5:45]}) == 40


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/v1/stop"),
        ("POST", "/v1/telescopes/east/stop"),
        ("POST", "/v1/telescopes/east/night/stop"),
        ("DELETE", "/v1/jobs/17"),
        ("POST", "/v1/jobs/17/cancel"),
        ("PUT", "/api/v1/telescope/0/abortslew"),
    ],
)
async def test_every_stop_is_known_by_its_first_bytes(method: str, path: str) -> None:
    assert is_stop(method, path)
    seen: list[bool] = []
    gate = Gate(Bounds())
    ask = gate.turns.ask
    gate.turns.ask = lambda one: (seen.append(one.is_urgent), ask(one))[1]  # type: ignore[method-assign, func-returns-value]
    async with _behind(gate) as where, _Held() as held, asyncio.timeout(60):
        for shown in (path, f"{path}/", f"{path}?x=1", f"{path}x/other"):
            reader, writer = await held.open(where)
            writer.write(f"{method} {shown} HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n".encode())
            await reader.read()
    assert seen[:3] == [True] * 3
    assert seen[3] is is_stop(method, f"{path}x/other")


WHOLE = (
    b"POST /a HTTP/1.1\r\nHost: a\r\nContent-Length: 9000\r\n\r\n" + b"x" * 9000,
    b"POST /b HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n"
    + b"3\r\nabc\r\n" * 900
    + b"0\r\n\r\n",
    b"GET /c HTTP/1.1\r\nHost: a\r\nConnection: close\r\n\r\n",
)
ANSWERS = (b"/a 9000", b"/b 2700", b"/c 0")


@settings(max_examples=15)
@given(cuts=st.lists(st.integers(1, sum(map(len, WHOLE)) - 1), max_size=12))
def test_requests_are_answered_alike_however_they_are_cut(cuts: list[int]) -> None:
    async def asked() -> bytes:
        gate = Gate(Bounds())
        async with _behind(gate) as where, _Held() as held, asyncio.timeout(60):
            reader, writer = await held.open(where)
            data, at = b"".join(WHOLE), 0
            for cut in [*sorted(cuts), len(data)]:
                writer.write(data[at:cut])
                await writer.drain()
                await asyncio.sleep(0)
                at = cut
            return await reader.read()

    told = asyncio.run(asked())
    assert [told.find(answer) >= 0 for answer in ANSWERS] == [True] * 3
    assert told.find(ANSWERS[0]) < told.find(ANSWERS[1]) < told.find(ANSWERS[2])


@pytest.mark.long
async def test_a_stop_of_one_who_hangs_up_at_once_counts_beside_others() -> None:
    gate = Gate(Bounds())
    heard: list[str] = []

    async with _behind(gate, heard) as where, _Held() as held, asyncio.timeout(60):
        for _ in range(20):
            _, writer = await held.open(where)
            writer.write(
                b"POST /x HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n" + b"1\r\na\r\n" * 5000
            )
        _, stopping = await held.open(where)
        stopping.write(b"POST /v1/stop HTTP/1.1\r\nHost: a\r\n\r\n")
        stopping.write_eof()
        while "/v1/stop" not in heard:
            await asyncio.sleep(0.01)


@pytest.mark.parametrize("full", ["of others", "of those who may only stop"])
async def test_a_stop_that_nobody_has_read_yet_does_not_go_for_newcomers(full: str) -> None:
    # no room for a moment: each newcomer's coming is decided on before the stop's bytes are read
    gate = Gate(Bounds(most=1 if full == "of others" else 0, each_address=50, stops=2, fresh=0))
    heard: list[str] = []
    async with _behind(gate, heard) as where, asyncio.timeout(60):
        # the system takes these in while the loop stands
        stop = socket.create_connection(where)
        stop.sendall(b"POST /v1/stop HTTP/1.1\r\nHost: a\r\n\r\n")
        others = [socket.create_connection(where) for _ in range(4)]
        while "/v1/stop" not in heard:
            await asyncio.sleep(0.01)
        for one in (stop, *others):
            one.close()


@pytest.mark.parametrize(
    "head",
    [
        b"GET / HTTP/1.1\r\n" + b"".join(b"x%d: 1\r\n" % number for number in range(6000)) + b"\r\n",
        b"GET / HTTP/1.1\r\n" + b"".join(b"x%d: 1\r\n" % number for number in range(6000)),
        b"GET / HTTP/1.1\r\nX: " + b"a" * 60_000,
        b"GET /" + b"a" * 60_000,
        b"GET /c HTTP/1.1\r\nHost: a\r\n\r\nGET /d HTTP/1.1\r\n" + b"x: 1\r\n" * 2000,
    ],
    ids=["lines", "lines without end", "a line", "an address", "a second head"],
)
async def test_a_head_without_bounds_is_refused_unparsed(head: bytes) -> None:
    gate = Gate(Bounds())
    async with _behind(gate) as where, _Held() as held, asyncio.timeout(60):
        reader, writer = await held.open(where)
        writer.write(head)
        told = b""
        with suppress(ConnectionError):
            while piece := await reader.read(65_536):
                told += piece
        assert b"HTTP/1.1 431 " in told
        while gate.count:
            await asyncio.sleep(0.01)


ATTACKS = {
    "headers": b"GET /v1/telescopes HTTP/1.1\r\n"
    + b"".join(b"x%d: 1\r\n" % n for n in range(6000))
    + b"\r\n",
    "chunks": b"POST /v1/solve HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n"
    + b"1\r\na\r\n" * 10_000,
    "trailers": b"POST /v1/solve HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n"
    + b"".join(b"x%d: 1\r\n" % n for n in range(6000)),
}


@contextmanager
def _flood(where: tuple[str, int], data: bytes, *, clients: int) -> Iterator[None]:
    """So many connections, each made again when it is closed, that send this over and over."""
    over = threading.Event()

    def attack(number: int) -> None:
        while not over.is_set():
            with suppress(OSError), _from(where, f"127.0.1.{1 + number}", data) as one:
                one.settimeout(0.5)
                while not over.is_set():
                    one.sendall(data)

    threads = [threading.Thread(target=attack, args=(number,)) for number in range(clients)]
    for one in threads:
        one.start()
    try:
        yield
    finally:
        over.set()
        for one in threads:
            one.join()


@pytest.mark.long
@pytest.mark.parametrize(
    "data",
    [
        pytest.param(data, id=name, marks=pytest.mark.long if name == "trailers" else ())
        for name, data in ATTACKS.items()
    ],
)
def test_a_stop_gets_through_a_flood(address: tuple[str, int], data: bytes) -> None:  # noqa: F811
    most_s = STOP_S * slowness()
    with _flood(address, data, clients=40):
        time.sleep(1.0)  # the flood is under way
        took_s: list[float] = []
        # a busy machine may take its time once, and answer 202 before it knows what came of it; a flood that
        # is read before stops takes it each time
        for number in range(6):
            begun_s = time.monotonic()
            with _from(address, "127.0.0.1", STOP) as stop:
                answer = stop.recv(65_536)
            assert answer.startswith((b"HTTP/1.1 200", b"HTTP/1.1 202")), answer
            if answer.startswith(b"HTTP/1.1 200"):
                took_s.append(time.monotonic() - begun_s)
            if number >= 2 and took_s and min(took_s) < most_s:
                break
        # told to all mounts, and in time
        assert took_s, "each was answered before it was known what came of it"
        assert min(took_s) < most_s, took_s
