"""Where a series is dithered to, step by step, and when the telescope has come to rest there.

Steps are offsets from where the series began, in order; none is farther from it than the bound. A pattern is
a function of its seed and the number of the step alone: what was dithered before a restart can be told again.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mountnav.errors import BadRequest

Pattern = Literal["random", "spiral", "ring"]

LARGEST_ARCSEC = 600.0
"""No dither is bound farther, ″: more is another field. Doubled, a mistyped bound moves the target out of a
narrow one."""
MOST_STEPS = 100_000
"""Largest number of a step."""
_GOLDEN_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""The golden angle: with it, and radii that grow as roots, points fill a disk evenly."""
_LEAST_SHARE = 0.25
"""A random step is at least this share of the bound away from the step before it, or the dither would be
none."""
_TRIES = 64
"""Draws of a random step before the farthest of them is taken."""


@dataclass(frozen=True, slots=True)
class DitherPlan:
    """A pattern of steps.

    Attributes
    ----------
    pattern : {"random", "spiral", "ring"}
        Anywhere within the bound; outwards and round, evenly, and again from the middle after `steps`; on a
        circle of the bound's radius.
    bound_arcsec : float
        No step is farther from where the series began.
    steps : int
        Of one turn of a ring, or of one spiral.
    seed : int
        Of the random pattern, and of where a ring begins.
    """

    pattern: Pattern = "random"
    bound_arcsec: float = 10.0
    steps: int = 9
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.bound_arcsec) and 0.0 < self.bound_arcsec <= LARGEST_ARCSEC):
            raise BadRequest(
                f"a dither is bound between 0 and {LARGEST_ARCSEC:.0f}″",
                advice=f"got {self.bound_arcsec}: a few pixels of the camera are usual",
            )
        if not 2 <= self.steps <= 1000:
            raise BadRequest("a pattern has 2 to 1000 steps", advice=f"got {self.steps}")

    def step(self, number: int) -> tuple[float, float]:
        """Offset of a step from where the series began, ″ east and north.

        Parameters
        ----------
        number : int
            From 1 on; 0 is where it began.
        """
        if not 0 <= number <= MOST_STEPS:
            raise BadRequest(f"a step's number lies between 0 and {MOST_STEPS}", advice=f"got {number}")
        if number == 0:
            return 0.0, 0.0
        if self.pattern == "ring":
            begin = 2.0 * math.pi * float(np.random.default_rng(self.seed).random())
            angle = begin + 2.0 * math.pi * (number - 1) / self.steps
            return self.bound_arcsec * math.cos(angle), self.bound_arcsec * math.sin(angle)
        if self.pattern == "spiral":
            turn = (number - 1) % self.steps
            radius = self.bound_arcsec * math.sqrt((turn + 1) / self.steps)
            return radius * math.cos(turn * _GOLDEN_RAD), radius * math.sin(turn * _GOLDEN_RAD)
        last = self._drawn(number - 1)
        drawn, best, farthest = np.random.default_rng((self.seed, number)), (0.0, 0.0), -1.0
        for _ in range(_TRIES):
            here = _in_disk(drawn, self.bound_arcsec)
            apart = math.hypot(here[0] - last[0], here[1] - last[1])
            if apart >= _LEAST_SHARE * self.bound_arcsec:
                return here
            if apart > farthest:
                best, farthest = here, apart
        return best

    def _drawn(self, number: int) -> tuple[float, float]:
        """Where the step before is by its first draw: near enough to keep away from it."""
        if number == 0:
            return 0.0, 0.0
        return _in_disk(np.random.default_rng((self.seed, number)), self.bound_arcsec)


def _in_disk(drawn: np.random.Generator, radius: float) -> tuple[float, float]:
    angle = 2.0 * math.pi * float(drawn.random())
    away = radius * math.sqrt(float(drawn.random()))
    return away * math.cos(angle), away * math.sin(angle)


@dataclass
class Settle:
    """Whether the telescope has come to rest where it should look, judged by looks alone.

    Parameters
    ----------
    within_arcsec : float
        How near a look must be.
    looks : int
        How many in a row.
    """

    within_arcsec: float
    looks: int = 2
    _last: deque[float] = field(default_factory=deque)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.within_arcsec) and self.within_arcsec > 0.0) or not 1 <= self.looks <= 20:
            raise BadRequest(
                "settled is within more than 0″ for 1 to 20 looks",
                advice=f"got {self.within_arcsec}″ and {self.looks} looks",
            )

    def saw(self, off_arcsec: float) -> bool:
        """Take in how far off a look was; whether it counts as settled now."""
        self._last.append(off_arcsec)
        while len(self._last) > self.looks:
            self._last.popleft()
        return self.settled

    def missed(self) -> None:
        """A look was not solved: those in a row begin again."""
        self._last.clear()

    @property
    def settled(self) -> bool:
        """Whether the last looks in a row were near enough."""
        return len(self._last) == self.looks and all(
            math.isfinite(off) and off <= self.within_arcsec for off in self._last
        )


__all__ = ["LARGEST_ARCSEC", "DitherPlan", "Pattern", "Settle"]
