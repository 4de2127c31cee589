"""A field rotator that turns in its clock's time, as ordered or wrong in one of the known ways."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass
from datetime import datetime

from mountnav.clock import Clock
from mountnav.sky.sphere import half_turn_deg, turn_deg

__all__ = ["RotatorBehavior", "RotatorMechanics"]


@dataclass(frozen=True, slots=True)
class RotatorBehavior:
    """How a rotator is built, and what is wrong with it.

    Attributes
    ----------
    step_deg : float
        To which its angles are rounded.
    sense : {1, -1}
        Whether the position angle of the image grows with the mechanism's angle.
    way : {"shortest", "never-through-zero"}
        Which way round it takes to an ordered angle.
    ignores : bool
        It says yes and doesn't move.
    slips : float
        Share of each turn that the camera doesn't follow.
    stalls_at_deg : float or None
        Here, by its own count, it is blocked.
    backlash_deg : float
        The camera is turned only after so much at each change of direction.
    """

    rate_deg_s: float = 3.0
    step_deg: float = 0.01
    sense: int = 1
    way: str = "shortest"
    ignores: bool = False
    slips: float = 0.0
    stalls_at_deg: float | None = None
    backlash_deg: float = 0.0
    deaf_to_stop: bool = False


class RotatorMechanics:
    """The mechanism: its own count, and how the camera truly stands.

    Parameters
    ----------
    starts_deg : float
        By its own count.
    zero_deg : float
        How the camera stands in the tube when the count is 0: position angle of +y minus the tube's north.
    """

    def __init__(
        self,
        clock: Clock,
        behavior: RotatorBehavior | None = None,
        *,
        starts_deg: float = 0.0,
        zero_deg: float = 0.0,
    ) -> None:
        self.behavior = behavior or RotatorBehavior()
        self._clock = clock
        self._zero_deg = zero_deg
        self._count_deg = starts_deg
        self._camera_deg = starts_deg
        self._wanted_deg: float | None = None
        self._since = clock.utc()
        # its camera draws in a thread
        self._lock = threading.RLock()
        self.orders: list[float] = []
        self.travel: list[float] = [starts_deg]
        """Its count at each look at it, not brought into one turn: by it cables are wound up."""

    def _run(self) -> None:
        with self._lock:
            self._run_on()

    def _run_on(self) -> None:
        now, behavior = self._clock.utc(), self.behavior
        passed_s, self._since = max(0.0, (now - self._since).total_seconds()), now
        if self._wanted_deg is None or behavior.ignores:
            return
        way_deg = self._wanted_deg - self._count_deg
        step_deg = math.copysign(min(abs(way_deg), behavior.rate_deg_s * passed_s), way_deg)
        stall = behavior.stalls_at_deg
        if stall is not None and (self._count_deg - stall) * (self._count_deg + step_deg - stall) <= 0.0:
            step_deg = stall - self._count_deg
        self._count_deg += step_deg
        self.travel.append(self._count_deg)
        self._follow(step_deg)
        if self._count_deg == self._wanted_deg:
            self._wanted_deg = None

    def _follow(self, step_deg: float) -> None:
        """Turn the camera by what the play leaves of a step."""
        half = self.behavior.backlash_deg / 2.0
        driven = (
            self._count_deg
            if self.behavior.slips == 0.0
            else self._camera_deg + step_deg * (1.0 - self.behavior.slips)
        )
        self._camera_deg = min(max(self._camera_deg, driven - half), driven + half)

    @property
    def count_deg(self) -> float:
        """Its count, as it tells it: within 0 to 360, in its steps."""
        self._run()
        step = self.behavior.step_deg
        return turn_deg(round(self._count_deg / step) * step)

    @property
    def moving(self) -> bool:
        """Whether it says that it turns."""
        self._run()
        return self._wanted_deg is not None and not self.behavior.ignores

    def turn(self, mechanical_deg: float) -> None:
        """Begin to turn to an angle in 0 to 360, by its own way round."""
        self._run()
        self.orders.append(mechanical_deg)
        here = self._count_deg
        if self.behavior.way == "shortest":
            self._wanted_deg = here + half_turn_deg(mechanical_deg - here)
        else:
            self._wanted_deg = mechanical_deg

    def stop(self) -> None:
        """Stop where it is."""
        self._run()
        if not self.behavior.deaf_to_stop:
            self._wanted_deg = None

    def set_count(self, count_deg: float) -> None:
        """Let it lose its count, as after a power failure; the camera stands as it stood."""
        self._run()
        self._zero_deg += self.behavior.sense * (self._camera_deg - count_deg)
        self._count_deg = self._camera_deg = count_deg
        self._wanted_deg = None

    def camera_deg(self, utc: datetime | None = None) -> float:
        """How the camera truly stands in the tube: position angle of +y minus that of the tube's north."""
        self._run()
        return turn_deg(self._zero_deg + self.behavior.sense * self._camera_deg)
