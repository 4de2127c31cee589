"""Whether a motion can still be stopped before a limit of the first axis, at the rate at which it turns.

By the pole the watch sees only late that a mount takes another way than expected: the tube hardly moves on
the sky while the hour angle axis turns by any amount. There, and everywhere else, a stop has to be ordered so
much before the limit as the axis goes on until it rests.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from mountnav.pointing.limits.postures import Standing
from mountnav.sky.sphere import half_turn_deg

HEARD_AFTER_S = 2.0
"""So long after a reading a stop takes hold, at most: a look each second, one more question to be sure, the
order and its way, s. Doubled, mounts would be stopped some degrees earlier that go a way they shouldn't."""
_LEAST_DEG_S2 = 0.3
"""A slower braking than this isn't reckoned with, °/s²: what the speeding up is seen as that lay between two
looks. Doubled, a mount that begins its way between two looks would be stopped some degrees later."""
_HALF_A_LOOK_S = 0.5
"""So old is a rate that two looks of a second tell, s."""
_SHORTEST_S = 0.3
"""Readings nearer to each other than this tell no rate, s: their times are some hundredths off."""
_TURNS_DEG_S = 0.2
"""Slower than this it tracks, or is about to stand, °/s."""
_JUMPS_DEG_S = 30.0
"""No axis is as fast, °/s: place and side of the pier were read at different times."""


@dataclass(frozen=True, slots=True)
class _Seen:
    utc: datetime
    first_deg: float
    rate_deg_s: float
    growing_deg_s2: float


class Braking:
    """The first axis on one order's way: how fast it turns, and where it would rest if it were stopped now.

    It brakes as fast as it was seen to speed up. The first reading has to be one at rest.
    """

    def __init__(self) -> None:
        self._last: _Seen | None = None
        self._grows_deg_s2 = 0.0

    def rests_at_deg(self, utc: datetime, stands: Standing) -> float | None:
        """Take in a reading, and tell where the axis would come to rest.

        Parameters
        ----------
        utc : datetime
            Of the reading.
        stands : Standing
            As it says.

        Returns
        -------
        float or None
            Angle of the first axis, counted on from where it stands; None where it doesn't turn.
        """
        last, first_deg = self._last, stands.first_deg
        if last is None:
            self._last = _Seen(utc, first_deg, 0.0, 0.0)
            return None
        passed_s = (utc - last.utc).total_seconds()
        # an axis angle counts on through both sides of the pier
        turned_deg = half_turn_deg(first_deg - last.first_deg)
        if abs(turned_deg) > _JUMPS_DEG_S * max(passed_s, _SHORTEST_S):
            self._last = None
            return None
        if passed_s < _SHORTEST_S:
            rate, growing = last.rate_deg_s, last.growing_deg_s2
        else:
            rate = turned_deg / passed_s
            growing = (abs(rate) - abs(last.rate_deg_s)) / passed_s
            self._last = _Seen(utc, first_deg, rate, growing)
            self._grows_deg_s2 = max(self._grows_deg_s2, growing)
        if abs(rate) < _TURNS_DEG_S:
            return None
        # what still speeds up is faster already than since the last reading on the whole, and goes on until
        # the stop is heard
        faster = abs(rate) + max(growing, 0.0) * (HEARD_AFTER_S + _HALF_A_LOOK_S)
        brakes = max(self._grows_deg_s2, _LEAST_DEG_S2)
        goes_deg = faster * HEARD_AFTER_S + faster * faster / (2.0 * brakes)
        return first_deg + (goes_deg if rate > 0.0 else -goes_deg)


__all__ = ["HEARD_AFTER_S", "Braking"]
