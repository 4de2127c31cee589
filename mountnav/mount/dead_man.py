"""Who ends what goes on by itself when the service is dead: a guard, of which only this is known here.

Rates beside the sidereal one and axes that are moved on end by an order of the service. One that is killed
orders nothing any more, so a guard outside of it has to (`api.observatory.dead_man`).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from typing import Literal, Protocol

from mountnav.errors import DeviceError
from mountnav.journal.records import CommandEnd, CommandRecord, Outcome

SelfActing = Literal["offset-rates", "move-axis"]
"""What goes on by itself once it was ordered."""


class Deadman(Protocol):
    """The guard of one mount."""

    def arm(self, until_utc: datetime, what: Collection[SelfActing]) -> None:
        """Have it end all this if the service dies, or is not heard of until then.

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


LEFT_S = 600.0
"""What an earlier run has left is this one's for so long, s: then the guard tries as well. Chosen by hand: a
mount that takes ten minutes to answer is rather one that only another process can reach. Doubled, it waits
longer."""

Row = tuple[CommandRecord, CommandEnd | None]

_NEVER_OUT = frozenset({Outcome.REFUSED, Outcome.NOT_SENT})
"""Outcomes of orders that changed nothing."""


@dataclass(frozen=True, slots=True)
class LeftGoing:
    """Something that an earlier run of the service has left going.

    Attributes
    ----------
    speed_deg_s : float
        How fast it leads the mount away from where it was seen, at most.
    """

    words: str
    speed_deg_s: float


def left_going(rates: Sequence[Row], axes: Sequence[Row]) -> dict[SelfActing, LeftGoing]:
    """What an earlier run of the service has left going at a mount, by its journal, with what is known of it.

    Parameters
    ----------
    rates, axes : sequence of (CommandRecord, CommandEnd or None)
        The latest orders "offset-rates" and "move-axis", the latest first.
    """
    left: dict[SelfActing, LeftGoing] = {}
    known = next((row for row in rates if _tells(row, ("ra_arcsec_s", "dec_arcsec_s"))), None)
    if known is not None and not _over(known, ("ra_arcsec_s", "dec_arcsec_s")):
        facts = known[0].facts
        both = [_number(facts.get(name)) for name in ("ra_arcsec_s", "dec_arcsec_s")]
        left["offset-rates"] = LeftGoing(
            f"rates of {both[0]:g} and {both[1]:g} ″/s were in force that were ordered at "
            f"{known[0].utc:%H:%M:%S} UTC",
            math.hypot(*both) / 3600.0,
        )
    for axis in dict.fromkeys(str(row[0].facts.get("axis")) for row in axes):
        moved = next(
            (row for row in axes if row[0].facts.get("axis") == axis and _tells(row, ("rate_deg_s",))), None
        )
        if moved is not None and not _over(moved, ("rate_deg_s",)):
            speed = _number(moved[0].facts.get("rate_deg_s"))
            left["move-axis"] = LeftGoing(
                f"its {axis} axis was moved at {speed:g}°/s, by an order of {moved[0].utc:%H:%M:%S} UTC",
                abs(speed),
            )
    return left


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _none(facts: Mapping[str, object], names: Sequence[str]) -> bool:
    return all(facts.get(name) == 0.0 for name in names)


def _tells(row: Row, names: Sequence[str]) -> bool:
    """Whether what is in force after an order is known by it: one that was refused changes nothing."""
    command, end = row
    return _none(command.facts, names) or end is None or end.outcome not in _NEVER_OUT


def _over(row: Row, names: Sequence[str]) -> bool:
    command, end = row
    return _none(command.facts, names) and end is not None and end.outcome is Outcome.DONE


class NoGuard:
    """No guard, where the mount dies with the service, or the settings want none."""

    def arm(self, until_utc: datetime, what: Collection[SelfActing]) -> None:
        """Nothing."""

    def disarm(self) -> None:
        """Nothing."""

    def take_over(self) -> None:
        """Nothing."""


class Armed:
    """Keeps a guard armed for as long as anything goes on by itself; both rates and axes may."""

    def __init__(self, guard: Deadman) -> None:
        self._guard = guard
        self._until: dict[SelfActing, datetime] = {}

    def need(self, what: SelfActing, until_utc: datetime) -> None:
        """Something goes on until then. Raises `DeviceError`: it may not."""
        wanted = self._until | {what: until_utc}
        self._guard.arm(max(wanted.values()), wanted)
        self._until = wanted

    def free(self, what: SelfActing) -> None:
        """It has ended; once is enough."""
        if self._until.pop(what, None) is None:
            return
        if self._until:
            with suppress(DeviceError):  # it was armed for both
                self._guard.arm(max(self._until.values()), self._until)
        else:
            self._guard.disarm()

    def let_go(self) -> None:
        """The mount is let go; what has not ended is the guard's."""
        if self._until:
            self._guard.take_over()
