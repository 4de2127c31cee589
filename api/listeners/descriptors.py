"""How the process's file descriptors are shared out: idle connections leave some for stops and devices.

A process may have so many descriptors open and no more (``ulimit -n``, often 1,024). Each connection takes
one, and so do serial ports, the journal's files and the solver's pipes: connections get what these leave.
"""

from __future__ import annotations

import contextlib
import resource
from dataclasses import dataclass

_MOST = 1024
"""No more are counted on: pyserial reads by `select`, which knows no descriptor above 1,023. With twice as
many a serial port that is opened late couldn't be read any more."""
_OWN = 96
"""For the journal, the solver, the loop, files that are being read; some 30 are open when nothing happens."""
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


def shares(descriptors: int, telescopes: int) -> Shares:
    """Share out the descriptors of a process.

    Parameters
    ----------
    descriptors : int
        How many it may have open.
    telescopes : int
    """
    most = min(descriptors, _MOST)
    sixteenth = most // 16
    listener = min(64, max(4, sixteenth))
    fresh = min(64, max(8, sixteenth))
    stops = min(32, max(4, sixteenth // 2))
    burst = fresh // 2
    listeners = _LISTENERS * (listener + listener_fresh(listener))
    left = most - _OWN - _EACH_TELESCOPE * telescopes - listeners - burst - stops - fresh
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


__all__ = ["Shares", "ask_for_enough", "descriptors_at_hand", "listener_burst", "listener_fresh", "shares"]
