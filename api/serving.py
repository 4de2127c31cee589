"""`mountnav serve`: uvicorn with one worker, which stops the mounts before it lets go of the clients."""

from __future__ import annotations

import socket

import uvicorn
from fastapi import FastAPI

from api.app import create_app
from api.service import Service
from mountnav.errors import BadSettings
from mountnav.settings import Settings

_GOODBYE_S = 5


class ObservatoryServer(uvicorn.Server):
    """A uvicorn server whose first act of going down is to stop what moves.

    uvicorn alone waits for open connections first (an event stream never ends by itself) and only then
    tells the application: a slewing mount would slew on.
    """

    def __init__(self, config: uvicorn.Config, app: FastAPI) -> None:
        super().__init__(config)
        self._observatory_app = app

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop the mounts, end the event streams, then go down as uvicorn does."""
        service: Service | None = getattr(self._observatory_app.state, "service", None)
        if service is not None:
            await service.halt()
        await super().shutdown(sockets)


def make_server(app: FastAPI, *, log_level: str = "info") -> ObservatoryServer:
    """Make the server; the socket is bound by the caller."""
    config = uvicorn.Config(
        app, log_level=log_level, timeout_graceful_shutdown=_GOODBYE_S, server_header=False
    )
    return ObservatoryServer(config, app)


def bind(host: str, port: int) -> socket.socket:
    """Take the address before anything else is started, so that a taken port is told plainly.

    Raises
    ------
    BadSettings
        The address can't be had.
    """
    try:
        listener = socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
        # asyncio does this for sockets of its own making; without it each answer waits 40 ms for an ACK
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listener
    except (OSError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise BadSettings(
            f"can't listen on {host} port {port}: {why}",
            device="service",
            advice="set service.host and service.port to an address of this machine that is free",
        ) from error


def serve(settings: Settings) -> int:
    """Serve until interrupted; the exit code."""
    listener = bind(settings.service.host, settings.service.port)
    with listener:
        server = make_server(create_app(settings))
        server.run(sockets=[listener])
    return 0 if server.started else 1
