"""Alpaca's connections: which clients are connected, connecting, and whether the mount answers [Alpaca §4].

What Alpaca calls connecting is here a client's own affair: the mount stays with the service, a night, a
scheduler and the other programs, whatever a client says. Clients are counted one by one: none disconnects a
telescope for another one. A client is its ClientID at its address; one that never says that it connects
(pyobs) is connected from the start, unless ``[alpaca] auto_connect`` is off. A Connect that failed is
reported where its end is: reading Connecting raises, once. One lost answer of a mount is no lost mount.
"""

from __future__ import annotations

import asyncio
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from api.alpaca.errors import AlpacaError, error_of
from api.observatory.observatory import Telescope
from api.orders.watching import Watch
from api.problems import internal_problem, problem_of
from mountnav.errors import MountnavError
from mountnav.tasks import begun

__all__ = ["GRACE_S", "Client", "Clients", "Connecting", "MountLink"]


_MOST = 1000
"""Clients of which it is remembered whether they connected; chosen by hand. The one unheard for longest is
forgotten: halved, 500 numbers in turn push a real client out."""


@dataclass(frozen=True, slots=True)
class Client:
    """Who asks: the number that it gave itself (0: none), and where it is."""

    address: str
    client_id: int

    def __str__(self) -> str:
        return f"Alpaca client {self.client_id} at {self.address}"


class Clients:
    """The clients of one telescope.

    Parameters
    ----------
    auto_connect : bool
        Whether one that says nothing counts as connected.
    """

    def __init__(self, *, auto_connect: bool) -> None:
        self._auto = auto_connect
        self._said: OrderedDict[Client, bool] = OrderedDict()

    def connected(self, client: Client) -> bool:
        """Whether this client is."""
        return self._said.get(client, self._auto)

    def said_so(self, client: Client) -> bool:
        """Whether this client has connected and has not disconnected since."""
        return self._said.get(client, False)

    def connect(self, client: Client) -> None:
        """It is from now on."""
        self._say(client, True)

    def disconnect(self, client: Client) -> None:
        """It is no more; nobody else notices."""
        self._say(client, False)

    def _say(self, client: Client, connected: bool) -> None:
        self._said[client] = connected
        self._said.move_to_end(client)
        while len(self._said) > _MOST:
            self._said.popitem(last=False)


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
        """How it failed to be connected, if it hasn't been reported to this client; it is from now on."""
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
            _log.exception("unexpected error while %s is connected", self._name)
            failure = error_of(internal_problem())
        if client not in self._wanted:
            return
        self._wanted.discard(client)
        if failure is None:
            self._count_in(client)
        else:
            self._failures[client] = failure


GRACE_S = 10.0
"""So long after the last good reading a telescope counts as connected."""
_TRY_AGAIN_S = 10.0
"""Between tries to open a mount that was lost, s; chosen by hand, each may take seconds. Doubled, clients
see it back that much later."""


class MountLink:
    """The mount of one telescope, as somebody at the other end of a cable knows it.

    Parameters
    ----------
    watch : Watch
        Who reads it.
    now_s : callable
        Seconds of the machine that never run back.
    """

    def __init__(self, telescope: Telescope, watch: Watch, now_s: Callable[[], float]) -> None:
        self._telescope = telescope
        self._watch = watch
        self._now_s = now_s
        self._good_s: float | None = None
        self._good_revision = -1
        self._tried_s: float | None = None
        self._reopening: asyncio.Task[None] | None = None

    def is_up(self) -> bool:
        """Whether the mount answers, or did until just now."""
        snapshot = self._watch.latest
        if snapshot.state.connected and snapshot.state.reading is not None:
            if snapshot.revision != self._good_revision:
                self._good_s, self._good_revision = self._now_s(), snapshot.revision
            return True
        return self._good_s is not None and self._now_s() - self._good_s < GRACE_S

    async def open(self) -> None:
        """Open the mount if it is not open.

        Raises
        ------
        AlpacaError
            It can't be opened, or doesn't answer.
        """
        telescope = self._telescope
        try:
            await telescope.ready()
        except MountnavError as error:
            _log.warning("%s could not be opened for an Alpaca client: %s", telescope.id, error)
            raise error_of(problem_of(error)) from None
        if not self.is_up() and (await self._watch.refresh()).state.reading is None:
            state = self._watch.latest.state
            raise AlpacaError(0x502, f"{telescope.id}: {state.problem or 'the mount does not answer'}")

    def reopen_soon(self) -> None:
        """Look for a mount that was lost, in the background, and not too often."""
        now_s = self._now_s()
        if self._reopening is not None and not self._reopening.done():
            return
        if self._tried_s is not None and now_s - self._tried_s < _TRY_AGAIN_S:
            return
        self._tried_s = now_s
        name = f"alpaca reopens {self._telescope.id}"
        # the mount stays away, as clients see; the next look tries again
        self._reopening = begun(self._reopen(), name, died=lambda _: self._watch.wake())

    async def _reopen(self) -> None:
        try:
            await self._telescope.ready()
        except MountnavError as error:
            _log.info("%s is still not connected: %s", self._telescope.id, error)
        self._watch.wake()

    def close(self) -> None:
        """Look for it no more."""
        if self._reopening is not None:
            self._reopening.cancel()
