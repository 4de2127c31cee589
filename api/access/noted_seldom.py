"""What may be written down for whoever repeats something: so often a minute, then counted."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass

EACH_S = 60.0
"""How long is counted before it is noted again, s. Doubled, half as many rows, each a minute later."""
_MOST_KEPT = 1000
"""Of whom counts are kept: some 100 bytes each. Who is forgotten is noted as if he were new."""


@dataclass(slots=True)
class Unnoted:
    """What was not noted since the last time.

    Attributes
    ----------
    same : int
        Of the same key.
    others : int
        Of other keys, that were too many together.
    """

    same: int = 0
    others: int = 0


@dataclass(slots=True)
class _Count:
    since_s: float
    noted: int = 0
    unnoted: int = 0


class Seldom:
    """Counts by keys, and says when one is due to be noted.

    Parameters
    ----------
    each : int
        So often a minute each key is noted.
    all_together : int
        So often a minute anything is.
    clock_s : callable, optional
    """

    def __init__(self, each: int, all_together: int, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._each, self._all_together = each, all_together
        self._clock_s = clock_s
        self._counts: OrderedDict[Hashable, _Count] = OrderedDict()
        self._together = _Count(-EACH_S)

    def due(self, key: Hashable) -> Unnoted | None:
        """Whether this one is to be noted, with what was not before it; None: it is counted."""
        now_s = self._clock_s()
        if now_s - self._together.since_s >= EACH_S:
            self._together = _Count(now_s, unnoted=self._together.unnoted)
        count = self._counts.setdefault(key, _Count(now_s))
        self._counts.move_to_end(key)
        while len(self._counts) > _MOST_KEPT:
            _, forgotten = self._counts.popitem(last=False)
            self._together.unnoted += forgotten.unnoted
        if now_s - count.since_s >= EACH_S:
            count.since_s, count.noted = now_s, 0
        if count.noted >= self._each or self._together.noted >= self._all_together:
            count.unnoted += 1
            return None
        found = Unnoted(count.unnoted, self._together.unnoted)
        count.noted, count.unnoted = count.noted + 1, 0
        self._together.noted, self._together.unnoted = self._together.noted + 1, 0
        return found


__all__ = ["EACH_S", "Seldom", "Unnoted"]
