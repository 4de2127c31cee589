"""One device of a server of many: what the cameras and rotators of such protocols share."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Generic, Protocol, TypeVar

from drivers.wire.wire_log import WireLog


class Connection(Protocol):
    """The connection to the server."""

    @property
    def log(self) -> WireLog:
        """All that went over it lately."""
        ...

    async def close(self) -> None:
        """Release it."""
        ...


class Device(Protocol):
    """The device as the protocol's room knows it."""

    @property
    def address(self) -> str:
        """Server and device, for messages."""
        ...

    @property
    def client(self) -> Connection:
        """Its connection; nobody else uses it."""
        ...


D = TypeVar("D", bound=Device)


class ServedDevice(Generic[D]):
    """Base of a language over one device of a server.

    Parameters
    ----------
    device : Device
        On a connection of its own.
    name : str, optional
        For messages; the device's address by default.
    """

    def __init__(self, device: D, *, name: str | None = None) -> None:
        self._device = device
        self._name = name or device.address

    @property
    def name(self) -> str:
        """Name and address."""
        return self._name

    @property
    def log(self) -> WireLog:
        """All that went over its connection lately; images are abbreviated."""
        return self._device.client.log

    @asynccontextmanager
    async def _or_closed(self) -> AsyncIterator[D]:
        """The device, to be brought up; its connection is closed again if that fails."""
        try:
            yield self._device
        except BaseException:
            await self._device.client.close()
            raise

    async def close(self) -> None:
        """Release the connection; the device stays connected, for others."""
        await self._device.client.close()
