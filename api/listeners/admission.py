"""Who is let in where there is room for so many, and who makes room: one rule for all listeners.

A newcomer beyond what one address or all may hold is let in where somebody else may go. Who never said
anything goes first, then who has been idle for longest; nobody who has just come, while there is a little
room left: it may be a stop whose first bytes are still on their way.

How many there may be follows from the process's file descriptors (``ulimit -n``, often 1,024). Each
connection takes one, and so do serial ports, the journal's files and the solver's pipes: connections get
what these leave, and idle ones leave some for stops and devices.
"""

from __future__ import annotations

import contextlib
import logging
import resource
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

__all__ = [
    "CHANCE_S",
    "Admitted",
    "ConnectionRoom",
    "Guest",
    "NovaShares",
    "Shares",
    "ToldSeldom",
    "ask_for_enough",
    "descriptors_at_hand",
    "listener_burst",
    "listener_fresh",
    "nova_shares",
    "shares",
]


_MOST = 1024
"""No more are counted on: pyserial reads by `select`, which knows no descriptor above 1,023. With twice as
many a serial port that is opened late couldn't be read any more."""
_OWN = 96
"""For the journal, the solver, the loop, files that are being read, calls of other solvers' commands (at most
16); some 30 are open when nothing happens."""
_EACH_TELESCOPE = 8
"""A mount's link, a camera's, a fake's pseudo-terminal and its ends, frames that are read."""
_LISTENERS = 3
"""INDI, LX200, Stellarium."""
_FEWEST_HTTP = 24
"""Connections, however few descriptors there are: a page holds seven, a scheduler one or two."""


@dataclass(frozen=True, slots=True)
class Shares:
    """How many connections there may be at a time.

    Attributes
    ----------
    http : int
        Of HTTP, but for those that may only stop.
    stops : int
        Of HTTP beyond these: they are let in to send a stop, and nothing else.
    fresh : int
        Of HTTP beyond these, for a moment: until they have said what they want.
    listener : int
        Of each other listener (INDI, LX200, Stellarium).
    burst : int
        So many are accepted in one turn of the loop, by HTTP; half of `fresh`, as `ConnectionRoom` wants it.
    """

    http: int
    stops: int
    fresh: int
    listener: int
    burst: int


@dataclass(frozen=True, slots=True)
class NovaShares:
    """What the port of the nova API may hold at a time.

    Attributes
    ----------
    clients, fresh, burst : int
        As of a listener.
    handshakes : int
        Clients of TLS that haven't shaken hands yet.
    images : int
        Uploads that are kept after their job.
    """

    clients: int
    fresh: int
    burst: int
    handshakes: int
    images: int

    def descriptors(self, queue: int) -> int:
        """How many descriptors it holds at the most, with so many uploads at a time."""
        # each client sends or takes a file; jobs hold theirs, and a double while one is solved or drawn
        return 2 * self.clients + self.fresh + self.burst + self.handshakes + self.images + queue + 2


def nova_shares(descriptors: int) -> NovaShares:
    """The share of the nova API of a process that may have so many descriptors open."""
    clients = min(64, max(4, min(descriptors, _MOST) // 16))
    return NovaShares(
        clients=clients,
        fresh=listener_fresh(clients),
        burst=listener_burst(clients),
        handshakes=max(2, clients // 4),
        images=clients // 2,
    )


def shares(descriptors: int, telescopes: int, others: int = 0) -> Shares:
    """Share out the descriptors of a process.

    Parameters
    ----------
    descriptors : int
        How many it may have open.
    others : int
        How many are for a face that isn't always there.
    """
    most = min(descriptors, _MOST)
    sixteenth = most // 16
    listener = min(64, max(4, sixteenth))
    fresh = min(64, max(8, sixteenth))
    stops = min(32, max(4, sixteenth // 2))
    burst = fresh // 2
    listeners = _LISTENERS * (listener + listener_fresh(listener))
    left = most - _OWN - _EACH_TELESCOPE * telescopes - listeners - burst - stops - fresh - others
    return Shares(http=max(_FEWEST_HTTP, left), stops=stops, fresh=fresh, listener=listener, burst=burst)


def listener_burst(clients: int) -> int:
    """How many a listener (INDI, LX200, Stellarium) that may have so many clients accepts in one turn."""
    return max(1, clients // 8)


def listener_fresh(clients: int) -> int:
    """How many more such a listener may have for a moment, as `ConnectionRoom` wants it."""
    return 2 * listener_burst(clients)


def descriptors_at_hand() -> int:
    """How many descriptors this process may have open."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return _MOST if soft == resource.RLIM_INFINITY else soft


def ask_for_enough() -> None:
    """Raise this process's own bound to what is of use, where the system lets it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    want = _MOST if hard == resource.RLIM_INFINITY else min(hard, _MOST)
    if soft != resource.RLIM_INFINITY and soft < want:
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (want, hard))


CHANCE_S = 0.25
"""So long a connection has to say what it wants before it makes room for another one, s: a stop comes with
the first bytes, and these in a turn or two of the loop. Doubled, a flood gives way half as fast."""
_TOLD_AGAIN_S = 60.0
"""So long nothing is logged after it was told that there are too many, s: an attack may last all night."""


class Guest(Protocol):
    """A connection, as far as room is concerned."""

    @property
    def address(self) -> str:
        """Where it comes from."""
        ...

    @property
    def may_go(self) -> bool:
        """Whether it may make room for another one: nothing that it asked would be lost."""
        ...

    @property
    def has_spoken(self) -> bool:
        """Whether it ever asked anything."""
        ...

    @property
    def since_s(self) -> float:
        """When it came, or was last answered; of the loop's clock."""
        ...


G = TypeVar("G", bound=Guest)


@dataclass(frozen=True, slots=True)
class Admitted(Generic[G]):
    """What was decided about a newcomer.

    Attributes
    ----------
    goes : Guest or None
        Who has to go for it; it counts no more already.
    crowded : bool
        Whether there were too many.
    """

    let_in: bool
    goes: G | None = None
    crowded: bool = False


class ConnectionRoom(Generic[G]):
    """Counts who is there. Used from the loop's thread alone.

    Parameters
    ----------
    each_address : int
        How many of these one address may have.
    fresh : int
        So many more may be there for a moment, until they have had a chance to say what they want. With
        twice as many as are accepted in one turn of the loop nobody goes before what he sent with his
        coming was read, however many come.
    """

    def __init__(self, most: int, each_address: int, fresh: int) -> None:
        self._most, self._each_address, self._fresh = most, each_address, fresh
        self._here: dict[str, set[G]] = {}
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[G]:
        return (one for ones in self._here.values() for one in ones)

    def take_in(self, one: G, now_s: float) -> Admitted[G]:
        """Let it in, if there is room or somebody makes room."""
        own = self._here.get(one.address, set())
        if len(own) >= self._each_address:
            crowd, surplus = list(own), len(own) - self._each_address
        elif self._count >= self._most:
            crowd, surplus = list(self), self._count - self._most
        else:
            self._add(one)
            return Admitted(let_in=True)
        goes = min(
            (each for each in crowd if each.may_go),
            key=lambda each: (each.has_spoken, each.since_s),
            default=None,
        )
        if goes is None:
            return Admitted(let_in=False, crowded=True)
        just_came = not goes.has_spoken and now_s - goes.since_s <= CHANCE_S
        if just_came and surplus < self._fresh:
            goes = None
        else:
            self.leave(goes)
        self._add(one)
        return Admitted(let_in=True, goes=goes, crowded=True)

    def leave(self, one: G) -> None:
        """It is gone. Twice is fine."""
        own = self._here.get(one.address)
        if own is None or one not in own:
            return
        own.remove(one)
        self._count -= 1
        if not own:
            del self._here[one.address]

    def _add(self, one: G) -> None:
        self._here.setdefault(one.address, set()).add(one)
        self._count += 1


class ToldSeldom:
    """Logs a warning that anybody could cause without end: once a minute, with how often it was so."""

    def __init__(self, log: logging.Logger) -> None:
        self._log = log
        self._told_s: float | None = None
        self._untold = 0

    def tell(self, now_s: float, words: str, *values: object) -> None:
        """Log it, or count it."""
        if self._told_s is not None and now_s - self._told_s < _TOLD_AGAIN_S:
            self._untold += 1
            return
        if self._untold:
            words += " (and %d times since this was last told)"
            values = (*values, self._untold)
        self._told_s, self._untold = now_s, 0
        self._log.warning(words, *values)
