"""How a dialect is told to follow what moves among the stars, and to move an axis on by hand: values only."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from mountnav.devices import Direction, MountAxis, OffsetRates, RateSpan

if TYPE_CHECKING:
    from drivers.lx200.codec.dialect import Ask, Order


@dataclass(frozen=True, slots=True)
class OffsetWords:
    """Rates beside the sidereal one.

    Attributes
    ----------
    set : callable (OffsetRates) -> tuple of Order
        In the protocol's units and signs; of those that it takes in one axis only the other part is 0.
    most_arcsec_s : OffsetRates
        The largest ones, both positive; 0 where an axis takes none.
    step_arcsec_s : float
        To which they are rounded.
    read : callable (Ask) -> awaitable OffsetRates or None, optional
        Those that the mount says it has; asked at opening too, with `Ask.known`: firmware may lack the words.
    why_one : str
        Why one axis takes none, where that is so.
    """

    set: Callable[[OffsetRates], tuple[Order, ...]]
    most_arcsec_s: OffsetRates
    step_arcsec_s: float
    read: Callable[[Ask], Awaitable[OffsetRates | None]] | None = None
    why_one: str = ""


@dataclass(frozen=True, slots=True)
class MotionKeys:
    """The keys of a hand control, pressed over the wire.

    Attributes
    ----------
    speeds : mapping of float to tuple of Order
        What chooses each speed (°/s, on top of tracking).
    press, let_go : mapping of Direction to Order
        Axes without these can't be moved.
    never : callable (Ask) -> awaitable str, optional
        In words, why this mount can't be moved so; empty where it can.
    """

    speeds: Mapping[float, tuple[Order, ...]]
    press: Mapping[Direction, Order]
    let_go: Mapping[Direction, Order]
    never: Callable[[Ask], Awaitable[str]] | None = None

    @property
    def spans(self) -> dict[MountAxis, tuple[RateSpan, ...]]:
        """At which speeds each axis can be moved."""
        spans = tuple(RateSpan(speed, speed) for speed in sorted(self.speeds))
        ways: dict[MountAxis, Direction] = {"primary": Direction.EAST, "secondary": Direction.NORTH}
        return {axis: spans for axis, way in ways.items() if way in self.press}

    def pressed(self, axis: MountAxis, rate_deg_s: float) -> tuple[Order, ...]:
        """Orders that move an axis on, to greater right ascension or declination where positive.

        Raises
        ------
        ValueError
            If it can't be moved so.
        """
        speed = min(self.speeds, key=lambda one: abs(one - abs(rate_deg_s)))
        way = direction_of(axis, rate_deg_s)
        if abs(speed - abs(rate_deg_s)) > _SPEED_FREE * speed or way not in self.press:
            raise ValueError(f"the {axis} axis can't be moved at {rate_deg_s}°/s")
        return (*self.speeds[speed], self.press[way])

    def let_go_of(self, axis: MountAxis) -> tuple[Order, ...]:
        """Orders that end the motion of an axis, whichever way it goes."""
        ways = (Direction.EAST, Direction.WEST) if axis == "primary" else (Direction.NORTH, Direction.SOUTH)
        return tuple(dict.fromkeys(self.let_go[way] for way in ways if way in self.let_go))


_SPEED_FREE = 1e-6
"""Share by which a speed may differ from one of those listed: what rounding leaves of one that was copied
from the list. Doubled, nothing shows."""


def direction_of(axis: MountAxis, rate_deg_s: float) -> Direction:
    """Where an axis moves the tube at a signed speed: east and north are positive."""
    if axis == "primary":
        return Direction.EAST if rate_deg_s > 0.0 else Direction.WEST
    return Direction.NORTH if rate_deg_s > 0.0 else Direction.SOUTH
