"""The connections to one server: for questions, for orders, and for a stop that passes all others."""

from __future__ import annotations

import ssl

import httpx

from drivers.alpaca.where import Where
from mountnav.errors import DeviceMissing

_KEPT = 8
"""A look at a telescope without DeviceState asks seven questions at once; fewer are opened anew each time."""


class Connections:
    """Three sets of connections, so that no kind waits for another.

    Parameters
    ----------
    where : Where

    Raises
    ------
    DeviceMissing
        If the file of certificates can't be read.

    Attributes
    ----------
    looks, orders, stops : httpx.AsyncClient
        Those of orders and stops are new each time: they never meet one that has just been closed.
    """

    def __init__(self, where: Where) -> None:
        trusted = _trusted(where)
        auth = (where.user, where.password) if where.user or where.password else None

        def client(*, kept: int) -> httpx.AsyncClient:
            return httpx.AsyncClient(
                auth=auth,
                verify=trusted,
                # asyncio.timeout gives each its whole deadline: httpx knows only that of each read
                timeout=None,
                limits=httpx.Limits(max_keepalive_connections=kept),
                headers={"User-Agent": "mountnav"},
                trust_env=False,
            )

        self.looks, self.orders, self.stops = client(kept=_KEPT), client(kept=0), client(kept=0)

    async def close(self) -> None:
        """Release all."""
        for one in (self.looks, self.orders, self.stops):
            await one.aclose()


def _trusted(where: Where) -> ssl.SSLContext:
    """Whose certificates count; over plain http nobody's, which costs nothing to load."""
    if not where.server.startswith("https"):
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusted = ssl.create_default_context()
    if where.ca is not None:
        try:
            trusted.load_verify_locations(where.ca)
        except OSError as cause:
            raise DeviceMissing(
                f"its certificates can't be read from {where.ca}: {cause}",
                device=where.address,
                advice="see the option ca of its URL",
            ) from cause
    return trusted
