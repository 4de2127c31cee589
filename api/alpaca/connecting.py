"""Connecting in the background: under way until it is over, and how it failed, told to whoever asked for it.

A failed Connect is told where its end is told: reading Connecting raises, once [Alpaca §4].
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable

from api.alpaca.clients import Client
from api.alpaca.refusals import AlpacaError, error_of
from api.http.faults import internal_problem
from mountnav.tasks import begun

_log = logging.getLogger(__name__)


class Connecting:
    """Connects clients to one telescope.

    Parameters
    ----------
    open_mount : callable
        Makes sure that the mount answers; raises `AlpacaError`.
    count_in : callable
        Makes a client a connected one.
    name : str
        Of the telescope, for its tasks.
    """

    def __init__(
        self, open_mount: Callable[[], Awaitable[None]], count_in: Callable[[Client], None], name: str
    ) -> None:
        self._open = open_mount
        self._count_in = count_in
        self._name = name
        self._wanted: set[Client] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._failures: dict[Client, AlpacaError] = {}

    @property
    def under_way(self) -> bool:
        """Whether some client is being connected."""
        return bool(self._wanted)

    def begin(self, client: Client) -> None:
        """Connect it; once more while that is under way is harmless."""
        self._failures.pop(client, None)
        if client in self._wanted:
            return
        self._wanted.add(client)
        task = begun(self._run(client), f"alpaca connects {self._name}", died=lambda _: self._died(client))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def give_up(self, client: Client) -> None:
        """It is not to be connected any more. A mount that is being opened is opened all the same."""
        self._wanted.discard(client)
        self._failures.pop(client, None)

    def failed_before(self, client: Client) -> AlpacaError | None:
        """How it failed to be connected, if it hasn't been told; it counts as told then."""
        return self._failures.pop(client, None)

    def close(self) -> None:
        """Connect nobody any more."""
        for task in self._tasks:
            task.cancel()

    def _died(self, client: Client) -> None:
        self._wanted.discard(client)
        self._failures[client] = error_of(internal_problem())

    async def _run(self, client: Client) -> None:
        failure: AlpacaError | None = None
        try:
            await self._open()
        except AlpacaError as error:
            failure = error
        except Exception:
            _log.exception("unforeseen error while %s is connected", self._name)
            failure = error_of(internal_problem())
        if client not in self._wanted:
            return
        self._wanted.discard(client)
        if failure is None:
            self._count_in(client)
        else:
            self._failures[client] = failure


__all__ = ["Connecting"]
