"""The port of the nova API: an HTTP server of its own, bounded as the service's, with or without TLS.

uvicorn's connections are served here without uvicorn's server: that one would install signal handlers, and
with TLS it gives a client a minute to shake hands, uncounted.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from asyncio.sslproto import SSLProtocol
from collections.abc import Callable
from typing import Any

import uvicorn
from starlette.types import ASGIApp
from uvicorn.server import ServerState

from api.access.keys import open_keys
from api.listeners.admission import NovaShares
from api.nova.app import NovaApp
from api.nova.certificate import own_certificate
from api.service import Service
from mountnav.errors import BadSettings
from mountnav.journal.database import database_url, file_of, state_folder

__all__ = ["NovaServer"]

_log = logging.getLogger(__name__)

_HANDSHAKE_S = 5
"""A client of TLS has so long to shake hands, s; half a second is long already. Doubled, those that never do
hold their place twice as long."""
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
        self._handshakes = _Handshakes(shares.handshakes)
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
        context = await asyncio.to_thread(self._tls)
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
            return made if context is None else _Tls(self._handshakes, loop, made, context)

        self._server = await loop.create_server(client, sock=listening, backlog=self._shares.burst)
        # the backlog is also how many are accepted in one turn; the kernel may keep more waiting
        listening.listen(_WAITING)
        self._address = listening.getsockname()[:2]

    async def stop(self) -> None:
        """Listen no more, and let all clients go."""
        if self._server is not None:
            self._server.close()
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

    def _tls(self) -> ssl.SSLContext | None:
        settings = self._settings
        if settings.tls == "off":
            return None
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        if settings.tls == "files":
            assert settings.certificate is not None
            certificate, key = settings.certificate, settings.certificate_key
        else:
            file = file_of(database_url(self._service.settings.journal.where))
            folder = state_folder() if file is None else file.parent
            certificate, fingerprint = own_certificate(folder, settings.host)
            key = None
            _log.info("nova: its own certificate %s, SHA-256 fingerprint %s", certificate, fingerprint)
        try:
            context.load_cert_chain(certificate, key, password=_no_password)
        except (OSError, ValueError) as fault:
            raise BadSettings(
                f"the certificate can't be used: {getattr(fault, 'strerror', None) or fault}",
                device=str(certificate),
                advice="PEM files of certificate and key, the key without a password",
            ) from fault
        return context


def _no_password() -> str:
    """OpenSSL would ask on the terminal, and the service would wait there."""
    return ""


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


class _Handshakes:
    """Clients that haven't shaken hands yet: beyond so many, who has waited longest goes."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._waiting: dict[_Tls, asyncio.BaseTransport] = {}

    def began(self, one: _Tls, transport: asyncio.BaseTransport) -> None:
        """A client is there."""
        if len(self._waiting) >= self._most:
            oldest = next(iter(self._waiting))
            self._abort(self._waiting.pop(oldest))
        self._waiting[one] = transport

    def ended(self, one: _Tls) -> None:
        """It has shaken hands, or is gone. Twice is fine."""
        self._waiting.pop(one, None)

    def end(self) -> None:
        """Let all go."""
        for transport in [*self._waiting.values()]:
            self._abort(transport)
        self._waiting.clear()

    @staticmethod
    def _abort(transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        transport.abort()


class _Tls(SSLProtocol):
    """A client of TLS before its connection: it counts until it has shaken hands."""

    def __init__(
        self,
        handshakes: _Handshakes,
        loop: asyncio.AbstractEventLoop,
        beyond: asyncio.Protocol,
        context: ssl.SSLContext,
    ) -> None:
        super().__init__(
            loop,
            beyond,
            context,
            None,  # type: ignore[arg-type]  # nobody waits for the handshake
            server_side=True,
            ssl_handshake_timeout=_HANDSHAKE_S,
        )
        self._counted = handshakes
        meet = beyond.connection_made

        def met(transport: asyncio.BaseTransport) -> None:
            handshakes.ended(self)
            meet(transport)

        # asyncio tells the connection of its being made when hands are shaken
        beyond.connection_made = met  # type: ignore[method-assign]

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """It is there, and shakes hands now."""
        self._counted.began(self, transport)
        super().connection_made(transport)

    def connection_lost(self, exc: BaseException | None) -> None:
        """It is gone."""
        self._counted.ended(self)
        super().connection_lost(exc)
