"""The listeners besides HTTP: all are started with the service, and one that fails holds up no other."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from mountnav.errors import MountnavError

_log = logging.getLogger(__name__)


class Listener(Protocol):
    """A server of a protocol of its own."""

    async def start(self) -> None:
        """Listen. Raises OSError or `MountnavError` where it can't."""
        ...

    async def stop(self) -> None:
        """Listen no more, and let all clients go."""
        ...

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that it listens on."""
        ...


@runtime_checkable
class Renewing(Protocol):
    """A listener that shows other telescopes without letting its clients go."""

    async def renew(self, touched: Collection[str]) -> None:
        """Show what the service has now; `touched` are the ids that have come, changed or gone."""
        ...


@dataclass(frozen=True, slots=True)
class ListenerState:
    """The state of a listener.

    Attributes
    ----------
    host, port
        None while it is shut.
    problem : str or None
        Why it could not be opened.
    """

    host: str | None
    port: int | None
    problem: str | None


class Listeners:
    """All listeners of a service.

    Parameters
    ----------
    made : dict of str to callable
        By their names: ``indi``, ``lx200``, ``stellarium``, ``nova``, ``alpaca-discovery``.
    """

    def __init__(self, made: dict[str, Callable[[], Listener]]) -> None:
        self._made = made
        self._open: dict[str, Listener] = {}
        self._problems: dict[str, str] = {}

    @property
    def states(self) -> dict[str, ListenerState]:
        """How each of them stands."""
        states = {}
        for name in self._made:
            listener = self._open.get(name)
            host, port = (None, None) if listener is None else listener.address
            states[name] = ListenerState(host, port, self._problems.get(name))
        return states

    async def start(self) -> None:
        """Open them all. One that can't be opened is logged, and shown by `states`."""
        for name in self._made:
            await self._begin(name)

    async def _begin(self, name: str) -> None:
        try:
            listener = self._made[name]()
            await listener.start()
        except (OSError, MountnavError) as error:
            # a planetarium's port that somebody else holds is no reason to lose the night
            self._problems[name] = str(error)
            _log.error("%s can't be opened: %s", name, error)
        else:
            self._open[name] = listener
            _log.info("%s listens on %s port %d", name, *listener.address)

    async def renew(self, name: str, touched: Collection[str]) -> None:
        """Have one show the telescopes that there are now; where it can't, its clients are let go once.

        Parameters
        ----------
        touched : collection of str
            Ids of the telescopes that have come, changed or gone.
        """
        if name not in self._made:
            return
        listener: object = self._open.get(name)
        if isinstance(listener, Renewing):
            await listener.renew(touched)
            return
        if (before := self._open.pop(name, None)) is not None:
            await before.stop()
        self._problems.pop(name, None)
        await self._begin(name)

    async def stop(self) -> None:
        """Shut them all."""
        ended = await asyncio.gather(
            *(listener.stop() for listener in self._open.values()), return_exceptions=True
        )
        for name, end in zip(self._open, ended, strict=True):
            if isinstance(end, Exception):
                _log.error("%s could not be closed cleanly", name, exc_info=end)
        self._open.clear()


__all__ = ["Listener", "ListenerState", "Listeners", "Renewing"]
