"""On which side of the pier a German mount hangs that doesn't tell it: followed from reading to reading.

A place can be looked at from both sides, with the first axis half a turn apart. No axis turns that far
between two readings that follow soon on each other, so one that is known to hang on a side is known to do so
until its declination axis is seen to pass the pole.

What shows a side at first: a mount that was switched on at its home, at the pole with the counterweight down,
leaves it on another hour circle for each side. One that is seen to change its side comes to the one that
faces the place. And where a slew could lead to one side only, it hangs there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime

from mountnav.devices import PierSide
from mountnav.pointing.limits.postures import Standing, side_by_rule
from mountnav.sky.coordinates import SIDEREAL_DEG_S
from mountnav.sky.sphere import half_turn_deg

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


_AT_POLE_DEG = 0.5
"""Nearer to the pole, °, a place tells too little of the first axis: at 0.1° refraction alone turns it by 10°
and more. Doubled, a slow axis that crosses it is out of sight for half a second longer."""
_FROM_HOME_DEG = 60.0
"""No farther than this, °, its first axis is taken to have turned from home to the first reading beside the
pole. One that stood there otherwise, up to 30° past the meridian, would be as near by the wrong side from
60° on; doubled, its side would be told wrongly."""
_SIDES = (PierSide.EAST, PierSide.WEST)


class SideFollowed:
    """Of one mount.

    Attributes
    ----------
    home : bool
        Whether it is taken to stand at its home still.
    """

    def __init__(self) -> None:
        self._possible: dict[PierSide, Standing] = {}
        self._from: dict[PierSide, set[PierSide]] = {}
        self._utc: datetime | None = None
        self._either = False
        self._supposed: PierSide | None = None
        self.home = False

    @property
    def side(self) -> PierSide | None:
        """On which side it hangs; None if it may be either."""
        sides = [*self._possible]
        return sides[0] if len(sides) == 1 else None

    @property
    def either(self) -> bool:
        """Whether it isn't to be taken to hang on the usual side.

        What was seen leaves both, and on the one on which it was supposed to hang it would look the other
        way now.
        """
        return self._either and self.side is None

    def at_home(self, utc: datetime, stands: Standing) -> None:
        """It stands at home, as it was switched on: its axes stand there, on whichever side."""
        self._possible = {side: replace(stands, side=side) for side in _SIDES}
        self._utc, self._either, self.home = utc, False, True
        self._set_out()

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
        before, then, home = self._possible, self._utc, self.home
        self._utc, self.home = utc, False
        seconds = _LONGEST_S if then is None else abs((utc - then).total_seconds())
        if not before or seconds >= _LONGEST_S:
            self._possible = stands
            self._set_out()
            return
        if told_anew:
            self._possible = {side: stands[side] for side in before}
            return
        moved = math.inf if home else max(_apart_deg(before[side], stands[side]) for side in before)
        if moved <= _RESTS_DEG + SIDEREAL_DEG_S * seconds:
            self._possible = {side: stands[side] for side in before}
            return
        if any(abs(90.0 - abs(one.second_deg)) < _AT_POLE_DEG for one in stands.values()):
            # what it has come to is told by the next reading beside the pole
            self._utc, self.home = then, home
            return
        far_deg = FASTEST_DEG_S * seconds + _SLACK_DEG
        if home:
            far_deg = min(far_deg, _FROM_HOME_DEG)
        came = {
            side: [was for was, stood in before.items() if _apart_deg(stood, one) <= far_deg]
            for side, one in stands.items()
        }
        reached = {side: one for side, one in stands.items() if came[side]}
        self._possible = reached or stands
        self._from = {
            side: set().union(*(self._from.get(was, {*_SIDES}) for was in came[side])) or {*_SIDES}
            for side in self._possible
        }

    def _set_out(self) -> None:
        self._from = {side: {side} for side in self._possible}
        self._supposed = self._usual

    @property
    def _usual(self) -> PierSide | None:
        """The side on which German mounts usually look there; None while nothing was seen."""
        for one in self._possible.values():
            return side_by_rule(one.first_deg - (180.0 if one.side is PierSide.WEST else 0.0))
        return None

    def arrived(self, sides: Iterable[PierSide], faces: PierSide | None = None) -> None:
        """A slew has ended: that tells the side where nothing else does.

        Parameters
        ----------
        sides : iterable of PierSide
            On which it should end.
        faces : PierSide or None
            The one that faces the place, if it stands well away from the meridian.
        """
        if self.home:
            # still by the pole, and its axes anywhere
            self._possible, self.home = {}, False
        changed = self._possible and all(side not in self._from[side] for side in self._possible)
        if changed and faces in self._possible:
            # none changes to the side that looks the other way
            self._possible = {faces: self._possible[faces]}
        left = {side: one for side, one in self._possible.items() if side in sides}
        if len(self._possible) != 1 and len(left) == 1:
            self._possible = left
        usual = self._usual
        kept = not self._either and usual is not None and self._from.get(usual) == {self._supposed}
        self._either = len(self._possible) > 1 and not kept
        self._set_out()

    def lost(self, *, astray: bool = False) -> None:
        """Nobody knows what it did meanwhile.

        `astray`: it didn't begin on the side on which it was supposed to hang.
        """
        self._possible, self._from, self._utc, self.home = {}, {}, None, False
        self._either = astray


def _apart_deg(one: Standing, other: Standing) -> float:
    """How far one of the axes has to turn at least."""
    first = abs(half_turn_deg(other.first_deg - one.first_deg))
    return max(first, abs(half_turn_deg(other.second_deg - one.second_deg)))
