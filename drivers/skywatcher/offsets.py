"""What syncs have taught: how far the axes' counts are off, on each side of the pier, in this session.

The controller has no sync. The difference between where the counts say the axes stand and where the sky says
they do is kept here, per side, because the errors of a German mount change over with the side. A side without
a sync of its own takes that of the other one: most of it is where the counting began.
"""

from __future__ import annotations

from drivers.skywatcher.postures import Sight, Turns, other_side, side_of, sight, turns_at
from mountnav.devices import PierSide
from mountnav.sky.sphere import half_turn_deg

STALE_DEG = 1.0
"""A sync that changes more than that means that the axes were turned by hand: the other side's is void."""


class Offsets:
    """True turns minus counted ones.

    Parameters
    ----------
    latitude_deg : float
        Of the site.
    """

    def __init__(self, latitude_deg: float) -> None:
        self._latitude_deg = latitude_deg
        self._known: dict[PierSide, Turns] = {}

    @property
    def known(self) -> bool:
        """Whether there was a sync."""
        return bool(self._known)

    def forget(self) -> None:
        """After a power-up the counts begin elsewhere."""
        self._known.clear()

    def at(self, side: PierSide) -> Turns:
        """The offset on one side."""
        return self._known.get(side) or self._known.get(other_side(side)) or Turns(0.0, 0.0)

    def true_turns(self, counted: Turns) -> Turns:
        """Where the axes stand that are counted so."""
        side = side_of(counted, self._latitude_deg)
        # an offset may carry them past the pole, to the other side
        side = side_of(counted.plus(self.at(side)), self._latitude_deg)
        return counted.plus(self.at(side))

    def counted_turns(self, true: Turns) -> Turns:
        """How axes are counted that shall stand so."""
        return true.minus(self.at(side_of(true, self._latitude_deg)))

    def shift(self, counted: Turns, ha_deg: float, dec_deg: float) -> Turns:
        """By how much the axes would be believed elsewhere after a sync; of both stands the nearer one."""
        now = self.true_turns(counted)

        def moved(side: PierSide) -> Turns:
            there = turns_at(ha_deg, dec_deg, side, self._latitude_deg).minus(now)
            return Turns(half_turn_deg(there.first_deg), there.second_deg)

        here = side_of(now, self._latitude_deg)
        return min(
            (moved(here), moved(other_side(here))), key=lambda one: abs(one.first_deg) + abs(one.second_deg)
        )

    def learn(self, counted: Turns, ha_deg: float, dec_deg: float) -> None:
        """Take over a sync: the axes that are counted so look at this place."""
        shift = self.shift(counted, ha_deg, dec_deg)
        true = self.true_turns(counted).plus(shift)
        side = side_of(true, self._latitude_deg)
        if max(abs(shift.first_deg), abs(shift.second_deg)) > STALE_DEG:
            self._known.clear()
        self._known[side] = true.minus(counted)
        if side_of(self.true_turns(counted), self._latitude_deg) is not side:
            # so near the pole that the two sides' offsets would take turns
            self._known = {side: true.minus(counted)}

    def sight(self, counted: Turns) -> Sight:
        """What axes that are counted so look at."""
        return sight(self.true_turns(counted), self._latitude_deg)
