"""Which Alpaca clients are connected. Counted one by one: no client disconnects a telescope for another one.

What Alpaca calls connecting is here a client's own affair: the mount stays with the service, a night, a
scheduler and the other programs, whatever a client says. A client is its ClientID at its address; one that
never says that it connects (pyobs) is connected from the start, unless ``[alpaca] auto_connect`` is off.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass

_MOST = 1000


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


__all__ = ["Client", "Clients"]
