"""A TCP port and its clients, each in a task of its own, read fairly; going down, it waits for none.

A loop has one thread: while it reads what one client sends, nobody's stop is heard. So what is read at once
is short, many clients take turns, one part in each turn of the loop, and each has its allowance: the loop's
longest turn doesn't grow with their number.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

from api.listeners.admission import (
    ConnectionRoom,
    ToldSeldom,
    descriptors_at_hand,
    listener_burst,
    listener_fresh,
    shares,
)
from mountnav.errors import BadSettings

__all__ = ["STOPS_AT_ONCE", "Allowance", "Serve", "TcpPort", "Turns"]


Part = TypeVar("Part")

_BURST_BYTES = 1 << 20
"""What a client may send at once; 5,000 messages that may wait are half of it."""
STOPS_AT_ONCE = 8
"""Stops of one client that may be under way; the next one is read when one of them is over. A program in
panic sends two or three; without a bound a client could begin 40,000 in a second."""
_STEADY_BYTES_S = 131_072
"""What it may send for ever; a planetarium sends some hundreds. Doubled, 64 clients take twice the time."""


class Turns:
    """Who reads next, among the clients of a port."""

    def __init__(self) -> None:
        self._mine = asyncio.Lock()

    async def mine(self) -> None:
        """Wait for a turn of the loop that no other client of the port has."""
        async with self._mine:
            await asyncio.sleep(0)

    async def each(self, parts: Iterator[Part]) -> AsyncIterator[Part]:
        """Give out parts, each in a turn of the loop in which no other client's part is made."""
        while True:
            async with self._mine:
                part = next(parts, None)
                await asyncio.sleep(0)
            if part is None:
                return
            yield part


class Allowance:
    """What one client may send: beyond it nothing more is read for a while, and only its own line waits."""

    def __init__(self) -> None:
        self._left = float(_BURST_BYTES)
        self._then_s = asyncio.get_running_loop().time()

    async def spend(self, count: int) -> None:
        """Take so many bytes off, and wait as long as it is overdrawn; others have a turn in any case."""
        now_s = asyncio.get_running_loop().time()
        self._left = min(_BURST_BYTES, self._left + (now_s - self._then_s) * _STEADY_BYTES_S) - count
        self._then_s = now_s
        await asyncio.sleep(max(0.0, -self._left / _STEADY_BYTES_S))


_log = logging.getLogger(__name__)

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
_MOST_BUFFERED_BYTES = 65_536
"""Read ahead of what is understood; a planetarium's message has 20 bytes. It is the most for each client."""
_MOST_UNTAKEN_BYTES = 65_536
"""What may wait to be sent to a client before its writer waits, bytes. Doubled, 64 clients that take
nothing hold 8 MB."""
_WAITING = 128
"""Connections that the kernel keeps until they are accepted; beyond it clients try again after a second."""
_GOODBYE_S = 2.0
"""Longest wait for the clients' tasks to end when the port is shut, s; chosen by hand. Doubled, a shutdown
with a stuck client takes 2 s more."""
_SILENT_S, _ASKED_AGAIN_S, _ASKED_TIMES = 60, 15, 4
"""A phone that left the network is noticed after two minutes; the system's own default is two hours."""


class TcpPort:
    """Listens, and has each client served.

    Parameters
    ----------
    port : int
        0: any free one.
    serve : callable (reader, writer) -> awaitable
        Serves one client to its end, and closes its writer.
    name : str
        For messages.
    full : callable (int) -> bytes, optional
        What a client is told that comes when so many are here already; it is let go.
    speaks_first : bool
        Whether clients of this protocol say something as soon as they come. When there are too many, one
        that never did, though it could have, makes room (`api.listeners.admission`): it may be a stop that
        comes.
    lets_in : callable (str) -> bool, optional
        Whether clients of an address are served; others are told, logged and let go.
    refused : bytes
        What those are told.
    most : int, optional
        How many clients at a time, half of them from one address; by what the system allows if left out.
    """

    def __init__(
        self,
        host: str,
        port: int,
        serve: Serve,
        *,
        name: str,
        full: Callable[[int], bytes] | None = None,
        speaks_first: bool = True,
        lets_in: Callable[[str], bool] = lambda _: True,
        refused: bytes = b"",
        most: int | None = None,
    ) -> None:
        self._host, self._port = host, port
        self._serve = serve
        self._name = name
        self._full = full
        self._speaks_first = speaks_first
        self._lets_in, self._refused = lets_in, refused
        self._strangers = ToldSeldom(_log)
        self.most = shares(descriptors_at_hand(), 0).listener if most is None else most
        self._burst = listener_burst(self.most)
        self._here: ConnectionRoom[_Client] = ConnectionRoom(
            self.most, max(1, self.most // 2), listener_fresh(self.most)
        )
        self._turned_away = ToldSeldom(_log)
        self._server: asyncio.Server | None = None

    @property
    def address(self) -> tuple[str, int]:
        """Host and port it listens at; the port is the settings' until it listens."""
        if self._server is None or not self._server.sockets:
            return self._host, self._port
        found = self._server.sockets[0].getsockname()
        return str(found[0]), int(found[1])

    async def start(self) -> None:
        """Listen.

        Raises
        ------
        BadSettings
            The address can't be had.
        """
        try:
            self._server = await asyncio.get_running_loop().create_server(
                self._protocol, self._host, self._port, backlog=self._burst
            )
        except OSError as error:
            raise BadSettings(
                f"can't listen on {self._host} port {self._port}: {error.strerror or error}",
                device=self._name,
                advice="is another program there? choose another port",
            ) from error
        for listener in self._server.sockets:
            # asyncio's backlog is also how many are accepted in one turn; the kernel may keep more waiting
            with listener.dup() as same:
                same.listen(_WAITING)
        _log.info("%s listens on %s port %d", self._name, *self.address)

    async def stop(self) -> None:
        """Listen no more, and let all clients go."""
        if self._server is not None:
            self._server.close()
        clients = [client.task for client in self._here]
        for client in clients:
            client.cancel()
        if clients:
            await asyncio.wait(clients, timeout=_GOODBYE_S)

    def _protocol(self) -> asyncio.StreamReaderProtocol:
        return asyncio.StreamReaderProtocol(_Reader(_MOST_BUFFERED_BYTES), self._accept)

    def _has_room(self, one: _Client) -> bool:
        """Whether a newcomer can be served; a client that never spoke may make room."""
        now_s = asyncio.get_running_loop().time()
        taken = self._here.take_in(one, now_s)
        if taken.goes is not None:
            taken.goes.writer.transport.abort()
            taken.goes.task.cancel()
        if not taken.let_in:
            words = "%s lets a client from %s go: %d are here already"
            self._turned_away.tell(now_s, words, self._name, one.address, len(self._here))
        return taken.let_in

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        address = str((writer.get_extra_info("peername") or ("",))[0])
        if not self._lets_in(address):
            # before it is counted: it takes nobody's place
            words = "%s lets nobody in from %s: its settings don't allow that address"
            self._strangers.tell(asyncio.get_running_loop().time(), words, self._name, address or "nowhere")
            if self._refused:
                writer.write(self._refused)
            writer.close()
            return
        task = asyncio.current_task()
        assert task is not None
        assert isinstance(reader, _Reader)
        client = _Client(address, reader, writer, task, self._speaks_first, asyncio.get_running_loop().time())
        if not self._has_room(client):
            if self._full is not None:
                writer.write(self._full(len(self._here)))
            writer.close()
            return
        try:
            _keep_alive(writer.get_extra_info("socket"))
            writer.transport.set_write_buffer_limits(high=_MOST_UNTAKEN_BYTES)
            await self._serve(reader, writer)
        except (OSError, TimeoutError, asyncio.CancelledError):
            # it went, or we do
            pass
        except Exception:
            # one client's fault is not the others'
            _log.exception("a client of %s failed unexpectedly", self._name)
        finally:
            self._here.leave(client)
            with contextlib.suppress(OSError):
                writer.close()


class _Reader(asyncio.StreamReader):
    """Knows whether its client ever said anything."""

    heard = False

    def feed_data(self, data: bytes) -> None:  # type: ignore[override]
        """Something came."""
        self.heard = True
        super().feed_data(data)


@dataclass(frozen=True, slots=True, eq=False)
class _Client:
    address: str
    reader: _Reader
    writer: asyncio.StreamWriter
    task: asyncio.Task[None]
    speaks_first: bool
    since_s: float

    @property
    def has_spoken(self) -> bool:
        return self.reader.heard

    @property
    def may_go(self) -> bool:
        return self.speaks_first and not self.reader.heard


def _keep_alive(connection: socket.socket) -> None:
    """Send at once, and notice a client that is gone without a word."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    # not every system has all of them
    named = {"TCP_KEEPIDLE": _SILENT_S, "TCP_KEEPINTVL": _ASKED_AGAIN_S, "TCP_KEEPCNT": _ASKED_TIMES}
    for name, value in named.items():
        if (option := getattr(socket, name, None)) is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
