"""A TCP port and its clients, each in a task of its own; going down, nobody is waited for."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Awaitable, Callable

from mountnav.errors import BadSettings

_log = logging.getLogger(__name__)

Serve = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]
MOST_CLIENTS = 64
_MOST_UNTAKEN_BYTES = 65_536
_GOODBYE_S = 2.0
_SILENT_S, _ASKED_AGAIN_S, _ASKED_TIMES = 60, 15, 4
"""A phone that left the network is noticed after two minutes; the system's own default is two hours."""


class Listening:
    """Listens, and has each client served.

    Parameters
    ----------
    host : str
    port : int
        0: any free one.
    serve : callable (reader, writer) -> awaitable
        Serves one client to its end, and closes its writer.
    name : str
        For messages.
    full : callable () -> bytes, optional
        What a client is told that comes when `MOST_CLIENTS` are here; it is let go.
    """

    def __init__(
        self, host: str, port: int, serve: Serve, *, name: str, full: Callable[[], bytes] = bytes
    ) -> None:
        self._host, self._port = host, port
        self._serve = serve
        self._name = name
        self._full = full
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.Task[None]] = set()

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
            self._server = await asyncio.start_server(self._accept, self._host, self._port)
        except OSError as error:
            raise BadSettings(
                f"can't listen on {self._host} port {self._port}: {error.strerror or error}",
                device=self._name,
                advice="is another program there? choose another port",
            ) from error
        _log.info("%s listens on %s port %d", self._name, *self.address)

    async def stop(self) -> None:
        """Listen no more, and let all clients go."""
        if self._server is not None:
            self._server.close()
        clients = list(self._clients)
        for client in clients:
            client.cancel()
        if clients:
            await asyncio.wait(clients, timeout=_GOODBYE_S)

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(self._clients) >= MOST_CLIENTS:
            _log.warning("%s lets a client go: %d are here already", self._name, MOST_CLIENTS)
            writer.write(self._full())
            writer.close()
            return
        task = asyncio.current_task()
        assert task is not None
        self._clients.add(task)
        try:
            _keep_alive(writer.get_extra_info("socket"))
            writer.transport.set_write_buffer_limits(high=_MOST_UNTAKEN_BYTES)
            await self._serve(reader, writer)
        except (OSError, TimeoutError, asyncio.CancelledError):
            # it went, or we do
            pass
        except Exception:
            # one client's fault is not the others'
            _log.exception("a client of %s hit a fault", self._name)
        finally:
            self._clients.discard(task)
            with contextlib.suppress(OSError):
                writer.close()


def _keep_alive(connection: socket.socket) -> None:
    """Send at once, and notice a client that is gone without a word."""
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    # not every system has all of them
    named = {"TCP_KEEPIDLE": _SILENT_S, "TCP_KEEPINTVL": _ASKED_AGAIN_S, "TCP_KEEPCNT": _ASKED_TIMES}
    for name, value in named.items():
        if (option := getattr(socket, name, None)) is not None:
            connection.setsockopt(socket.IPPROTO_TCP, option, value)


__all__ = ["MOST_CLIENTS", "Listening", "Serve"]
