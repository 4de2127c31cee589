"""A protocol for one telescope: which one it serves, and the port's life, whatever is spoken there."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod

from api.access.callers import Role
from api.listeners.doors import Door
from api.listeners.tcp import TcpPort
from api.orders.goto_orders import GotoOrders
from api.service import Service
from mountnav.errors import BadSettings
from mountnav.settings.faces import Lx200ServerSettings, StellariumSettings

AT_ONCE_BYTES = 4096
"""Bytes taken in one read; chosen by hand. `Allowance` bounds what a client may send in all."""
LONGEST_SILENCE_S = 10.0
"""A client that takes nothing for so long is let go, s; chosen by hand. Doubled, its task and buffer stay
twice as long."""


class OneTelescopeServer(ABC):
    """Serves one telescope to anyone who connects.

    Parameters
    ----------
    section : str
        Of the settings, for messages.
    name : str
        Of the port, for messages.
    speaks_first : bool
        Whether its clients say something as soon as they come; see `TcpPort`.

    Raises
    ------
    BadSettings
        There is no such telescope.
    """

    def __init__(
        self,
        service: Service,
        settings: Lx200ServerSettings | StellariumSettings,
        *,
        section: str,
        name: str,
        speaks_first: bool = True,
    ) -> None:
        self._role = Role.VIEW if settings.read_only else Role.OPERATE
        """Of whoever comes: the protocol knows no keys."""
        self._id = telescope_of(service, settings.telescope, section)
        self._watch = service.dispatcher.watch(self._id)
        self._ordering = GotoOrders(service.dispatcher, service.audit, self._id)
        self._listening = TcpPort(
            settings.host,
            settings.port,
            self._serve,
            name=name,
            speaks_first=speaks_first,
            lets_in=Door(settings.admits, service.audit, section).lets_in,
        )

    @property
    def address(self) -> tuple[str, int]:
        """Host and port it listens at; known once it was started."""
        return self._listening.address

    async def start(self) -> None:
        """Listen. Raises `BadSettings`."""
        await self._listening.start()

    async def stop(self) -> None:
        """Let all clients go, and listen no more. Jobs go on."""
        await self._listening.stop()

    @abstractmethod
    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client to its end."""


def telescope_of(service: Service, named: str | None, section: str) -> str:
    """Return the id of the telescope that is named, else of the first.

    Parameters
    ----------
    named : str or None
        As the settings have it.
    section : str
        Of the settings, for messages.

    Raises
    ------
    BadSettings
        There is none, or none of that id.
    """
    ids = [telescope.id for telescope in service.settings.telescope]
    if named is None and ids:
        return ids[0]
    if named not in ids:
        raise BadSettings(
            f"{section}.telescope names {named!r}, which does not exist",
            advice=f"there is: {', '.join(ids) or 'none'}",
        )
    return named


__all__ = ["AT_ONCE_BYTES", "LONGEST_SILENCE_S", "OneTelescopeServer", "telescope_of"]
