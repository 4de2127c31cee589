"""The port of the nova API: an HTTP server of its own, bounded as the service's, with or without TLS.

uvicorn's connections are served here without uvicorn's server: that one would install signal handlers, and
with TLS it gives a client a minute to shake hands, uncounted.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.server import ServerState

from api.access.keys import open_keys
from api.listeners.admission import NovaShares
from api.listeners.tls import Certificate, Handshakes, ShakingHands
from api.nova.app import NovaApp
from api.service import Service
from mountnav.errors import BadSettings

__all__ = ["NovaServer"]

_GOODBYE_S = 2.0
"""How long answers that are being sent may take when the service goes down, s; chosen by hand."""
_WAITING = 128
"""Connections that the kernel keeps until they are accepted; beyond it clients try again after a second."""

Protocol = Callable[..., asyncio.Protocol]
"""Makes the connection of one client, as uvicorn's ``Config(http=...)`` takes it."""


class NovaServer:
    """Implements `api.listeners.listeners.Listener`.

    Parameters
    ----------
    protocol : callable
        Makes connections that are bounded in number and patience; from the room of HTTP.
    guarded : callable
        Puts before an application what stands before all of the service's; from the room of HTTP.
    shares : NovaShares
        What of the process's file descriptors is for this port.
    """

    def __init__(
        self,
        service: Service,
        *,
        protocol: Protocol,
        guarded: Callable[[ASGIApp], ASGIApp],
        shares: NovaShares,
    ) -> None:
        self._service, self._settings = service, service.settings.nova
        self._protocol, self._guarded, self._shares = protocol, guarded, shares
        self._keys = open_keys(
            service.settings, wide=not self._settings.is_loopback and not self._settings.open
        )
        self._app: NovaApp | None = None
        self._server: asyncio.Server | None = None
        self._state = ServerState()
        self._handshakes = Handshakes(shares.handshakes)
        settings = self._settings
        self._certificate = Certificate(
            settings.tls,
            (settings.certificate, settings.certificate_key),
            service.settings.journal.where,
            settings.host,
            "nova",
        )
        self._renewing: asyncio.Task[None] | None = None
        self._address = (self._settings.host, self._settings.port)

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens on."""
        return self._address

    @property
    def app(self) -> NovaApp | None:
        """The application, once it listens."""
        return self._app

    async def start(self) -> None:
        """Listen.

        Raises
        ------
        BadSettings
            The address or the certificate can't be had.
        """
        context = await asyncio.to_thread(self._certificate.context)
        listening = _bound(*self._address)
        self._app = NovaApp(self._service, self._settings, self._keys, images=self._shares.images)
        config = uvicorn.Config(
            self._guarded(self._app),
            # the service's own logging stands
            log_config=None,
            lifespan="off",
            http=self._protocol,  # type: ignore[arg-type]
            ws="none",
            server_header=False,
        )
        config.load()
        loop = asyncio.get_running_loop()

        def client() -> asyncio.BaseProtocol:
            made = self._protocol(config=config, server_state=self._state, app_state={}, _loop=loop)
            return made if context is None else ShakingHands(self._handshakes, loop, made, context)

        self._server = await loop.create_server(client, sock=listening, backlog=self._shares.burst)
        # the backlog is also how many are accepted in one turn; the kernel may keep more waiting
        listening.listen(_WAITING)
        self._address = listening.getsockname()[:2]
        self._renewing = self._certificate.kept_up()

    async def stop(self) -> None:
        """Listen no more, and let all clients go."""
        if self._server is not None:
            self._server.close()
        if self._renewing is not None:
            self._renewing.cancel()
        if self._app is not None:
            await self._app.close()
        clients: list[Any] = [*self._state.connections]
        for client in clients:
            client.shutdown()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(_GOODBYE_S):
                while self._state.connections:
                    await asyncio.gather(*self._state.tasks, return_exceptions=True)
                    await asyncio.sleep(0)
                    if not self._state.tasks:
                        break
        for left in [*self._state.connections]:
            left.transport.abort()
        self._handshakes.end()
        for task in [*self._state.tasks]:
            task.cancel()
        await asyncio.gather(*self._state.tasks, return_exceptions=True)


def _bound(host: str, port: int) -> socket.socket:
    try:
        listening = socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise BadSettings(
            f"can't listen on {host} port {port}: {why}",
            device="nova",
            advice="set nova.host and nova.port to an address of this machine that is free",
        ) from error
    # asyncio does this for sockets of its own making; without it each answer waits 40 ms for an ACK
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listening
