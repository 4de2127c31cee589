"""What clients have chosen of ON_COORD_SET: each its own; and what one that came just to choose has left.

In a common INDI server the selection is the device's, so that one client's SYNC can turn another's goto into
a sync. Here it is each connection's. But `indi_setprop` in a script chooses in one connection and sends the
place in the next one: a SYNC that was chosen, not used, and left behind is taken over by the next client of
the same machine that chooses nothing itself. It is shown to that client as its selection.
"""

from __future__ import annotations

import time
from collections.abc import Callable

_LEFT_LIVES_S = 300.0
USUAL, SYNC = "TRACK", "SYNC"


class LeftSelections:
    """Where a SYNC was left behind.

    Parameters
    ----------
    now_s : callable () -> float
        A clock that only goes on.
    """

    def __init__(self, now_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = now_s
        self._left: dict[tuple[str, str], float] = {}

    def leave(self, host: str, device: str) -> None:
        """A client of a machine goes, and has chosen SYNC."""
        self._left = {key: at_s for key, at_s in self._left.items() if self._counts(at_s)}
        self._left[host, device] = self._now_s()

    def is_left(self, host: str, device: str) -> bool:
        """Whether a client of that machine takes over a SYNC."""
        at_s = self._left.get((host, device))
        return at_s is not None and self._counts(at_s)

    def forget(self, host: str, device: str) -> None:
        """Somebody there has chosen since."""
        self._left.pop((host, device), None)

    def _counts(self, at_s: float) -> bool:
        return self._now_s() - at_s < _LEFT_LIVES_S


class Selections:
    """One client's, by device.

    Parameters
    ----------
    left : LeftSelections
        Of all clients.
    host : str
        Its machine.
    """

    def __init__(self, left: LeftSelections, host: str) -> None:
        self._left, self._host = left, host
        self._own: dict[str, str] = {}

    def of(self, device: str) -> str:
        """What its coordinates mean to a device: TRACK, SLEW or SYNC."""
        if device in self._own:
            return self._own[device]
        return SYNC if self._left.is_left(self._host, device) else USUAL

    def choose(self, device: str, mode: str) -> None:
        """It has chosen; or its sync is done."""
        self._own[device] = mode
        self._left.forget(self._host, device)

    def leave(self) -> None:
        """It goes."""
        for device, mode in self._own.items():
            if mode == SYNC:
                self._left.leave(self._host, device)
        self._own.clear()


__all__ = ["SYNC", "USUAL", "LeftSelections", "Selections"]
