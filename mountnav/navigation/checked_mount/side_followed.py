"""On which side of the pier a German mount hangs that doesn't tell it: followed from reading to reading.

A place can be looked at from both sides, with the first axis half a turn apart. No axis turns that far
between two readings that follow soon on each other, so one that is known to hang on a side is known to do so
until its declination axis is seen to pass the pole.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from mountnav.navigation.devices import PierSide
from mountnav.pointing.limits.postures import Standing
from mountnav.sky.sphere import half_turn_deg
from mountnav.sky.turning import SIDEREAL_DEG_S

FASTEST_DEG_S = 30.0
"""No German mount turns an axis faster (the fastest have 15 to 20). Doubled, readings have to follow within
1.4 s to tell anything."""
_SLACK_DEG = 3.0
"""So much, °, the angles of two readings differ besides: by pointing errors that the pole makes large."""
_RESTS_DEG = 1.0
"""One that has moved less, °, tracking besides, has not changed sides meanwhile. Doubled, a change for a
place so near might be overlooked if nobody looks for so long as it takes."""
_LONGEST_S = 60.0
"""Whatever happened in a longer pause, s, nobody has seen. Doubled, a change within it may be overlooked."""


class SideFollowed:
    """Of one mount."""

    def __init__(self) -> None:
        self._possible: dict[PierSide, Standing] = {}
        self._utc: datetime | None = None

    @property
    def side(self) -> PierSide | None:
        """On which side it hangs; None if it may be either."""
        sides = [*self._possible]
        return sides[0] if len(sides) == 1 else None

    def seen(self, utc: datetime, stands: dict[PierSide, Standing], *, told_anew: bool = False) -> None:
        """Take in a reading.

        Parameters
        ----------
        utc : datetime
        stands : dict of PierSide to Standing
            How it would stand on each side.
        told_anew : bool
            Its place may have changed without a motion, by a sync.
        """
        before, then = self._possible, self._utc
        self._utc = utc
        seconds = _LONGEST_S if then is None else abs((utc - then).total_seconds())
        if not before or seconds >= _LONGEST_S:
            self._possible = stands
            return
        if told_anew:
            self._possible = {side: stands[side] for side in before}
            return
        moved = max(_apart_deg(before[side], stands[side]) for side in before)
        if moved <= _RESTS_DEG + SIDEREAL_DEG_S * seconds:
            self._possible = {side: stands[side] for side in before}
            return
        far_deg = FASTEST_DEG_S * seconds + _SLACK_DEG
        reached = {
            side: one
            for side, one in stands.items()
            if any(_apart_deg(was, one) <= far_deg for was in before.values())
        }
        self._possible = reached or stands

    def arrived(self, sides: Iterable[PierSide]) -> None:
        """A slew has ended that should end on one of these sides: that tells where nothing else does."""
        left = {side: one for side, one in self._possible.items() if side in sides}
        if len(self._possible) != 1 and len(left) == 1:
            self._possible = left

    def lost(self) -> None:
        """Nobody knows what it did meanwhile."""
        self._possible, self._utc = {}, None


def _apart_deg(one: Standing, other: Standing) -> float:
    """How far one of the axes has to turn at least."""
    first = abs(half_turn_deg(other.first_deg - one.first_deg))
    return max(first, abs(half_turn_deg(other.second_deg - one.second_deg)))
