"""Who ends what goes on by itself when the service is dead: a guard, of which only this is known here.

Rates beside the sidereal one and axes that are moved on end by an order of the service. One that is killed
orders nothing any more, so a guard outside of it has to (`api.observatory.dead_man`).
"""

from __future__ import annotations

from datetime import datetime
from typing import Protocol


class Deadman(Protocol):
    """The guard of one mount."""

    def arm(self, until_utc: datetime) -> None:
        """Have it end rates and moved axes if the service dies, or is not heard of until then.

        Called before an order goes over the wire, and again for each that prolongs it; never waits.

        Raises
        ------
        DeviceError
            There is no guard: nothing may be ordered that would outlive the service.
        """
        ...

    def disarm(self) -> None:
        """Nothing goes on by itself any more. Never raises."""
        ...

    def take_over(self) -> None:
        """The service lets the mount go without having been able to end it: to be ended now. Never raises."""
        ...


class NoGuard:
    """No guard, where the mount dies with the service, or the settings want none."""

    def arm(self, until_utc: datetime) -> None:
        """Nothing."""

    def disarm(self) -> None:
        """Nothing."""

    def take_over(self) -> None:
        """Nothing."""


class Armed:
    """Keeps a guard armed for as long as anything goes on by itself; both rates and axes may."""

    def __init__(self, guard: Deadman) -> None:
        self._guard = guard
        self._until: dict[str, datetime] = {}

    def need(self, what: str, until_utc: datetime) -> None:
        """Something goes on until then. Raises `DeviceError`: it may not."""
        wanted = self._until | {what: until_utc}
        self._guard.arm(max(wanted.values()))
        self._until = wanted

    def free(self, what: str) -> None:
        """It has ended; once is enough."""
        if self._until.pop(what, None) is None:
            return
        if self._until:
            self._guard.arm(max(self._until.values()))
        else:
            self._guard.disarm()

    def let_go(self) -> None:
        """The mount is let go; what has not ended is the guard's."""
        if self._until:
            self._guard.take_over()
