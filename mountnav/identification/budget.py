"""What a search may spend: processor time, so that a busy machine refuses nothing; and a wall limit."""

from __future__ import annotations

import time
from dataclasses import dataclass

WALL_FACTOR = 8.0
"""Wall time allowed for each second of processor time. A machine that gives a search less than an eighth of a
core is overloaded; doubled, a caller waits twice as long for its answer there."""

WALL_LEAST_S = 10.0
"""Wall time allowed beside that, for short budgets: catalogs on slow disks and over the network. Chosen by
hand."""


def wall_limit_s(budget_s: float) -> float:
    """Wall time that a search with this budget may take at most."""
    return WALL_FACTOR * budget_s + WALL_LEAST_S


@dataclass(frozen=True, slots=True)
class Budget:
    """Ends of a search that is under way, in the thread that made it.

    Attributes
    ----------
    cpu_end_s : float
        Value of `time.thread_time` at which it ends.
    wall_end_s : float
        Value of `time.monotonic` at which it ends whatever it has computed.
    """

    cpu_end_s: float
    wall_end_s: float

    @classmethod
    def of(cls, budget_s: float) -> Budget:
        """A budget of so many seconds of processor time, from now on."""
        return cls(time.thread_time() + budget_s, time.monotonic() + wall_limit_s(budget_s))

    @property
    def left_s(self) -> float:
        """Seconds of processor time that are left; 0 when it is over."""
        if time.monotonic() > self.wall_end_s:
            return 0.0
        return max(0.0, self.cpu_end_s - time.thread_time())

    @property
    def spent(self) -> bool:
        """Whether it is over."""
        return time.thread_time() > self.cpu_end_s or time.monotonic() > self.wall_end_s
