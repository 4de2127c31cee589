"""How fast a mount's axes turn, by its readings; and whether they can be stopped before a limit."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from mountnav.pointing.limits import Limits
from mountnav.pointing.limits.postures import Standing, Way
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.ways import LATE_START_DEG, Trouble, strays_deg, trouble_on
from mountnav.sky.sphere import half_turn_deg

__all__ = ["HEARD_AFTER_S", "Braking"]


_MOVES_DEG = 0.3
"""An axis must have turned so far between two readings for its rate to mean anything, °. Chosen by hand.
Doubled, slow slews are judged one look later."""
_ARRIVES_S = 2.0
"""An axis that is so near to its end, at its rate, is slowing down, s. Chosen by hand: mounts brake for a
second or two. Halved, a braking axis is taken for one of another rate."""
_JUMPS_DEG = 30.0
"""No axis turns so far between two looks: place and side of the pier were read at different times, °. Halved,
axes of 15°/s and more are never judged."""
_STANDS_DEG = 0.05
"""One that has turned less between two readings stands, °. Chosen by hand, 3′. Doubled, an axis that starts
is taken for one that stands for another look."""
_BESIDE_DEG = 1.0
"""Ways so near to where it stands, °, may be the one that it takes: pointing errors and what it tracks
meanwhile. Doubled, rates that are unlike are seen some tenths of a second later."""
_LOOSE = 1.25
"""Rates are seen to a quarter: readings are some tenths of a second apart from their times. Doubled, a ratio
of rates twice as wrong is let pass."""
_POLE_DEG = 5.0
"""So near to the pole, or the zenith of an alt-az mount, °, a place says too little of the first axis. Chosen
by hand. Doubled, the rates of more slews aren't judged."""
_STEEPEST = 30.0
"""As good as one axis after the other. A ratio of rates beyond it means nothing more."""
_KEPT = 4
"""So many ratios are remembered: an axis that speeds up shows others than its own. Chosen by hand. Doubled,
one that was misread is remembered twice as long."""


@dataclass(frozen=True, slots=True)
class Unlike:
    """Rates that a way was not checked for.

    Attributes
    ----------
    ratio : float
        Of the second axis' rate over the first one's.
    trouble : Trouble or None
        What the rest of the way leads to at these rates.
    """

    ratio: float
    trouble: Trouble | None


class RatesSeen:
    """The rates of one mount's axes, as far as they differ from those that its limits reckon with."""

    def __init__(self) -> None:
        self._ratios: deque[float] = deque(maxlen=_KEPT)

    def reckoned(self, limits: Limits) -> Limits:
        """The limits, with ways for the rates that were seen as well."""
        if limits.rate_ratio is None or not self._ratios:
            return limits
        low, high = limits.rate_ratio
        return replace(
            limits,
            rate_ratio=(min(low, min(self._ratios) / _LOOSE), max(high, max(self._ratios) * _LOOSE)),
        )

    def unlike(
        self,
        ways: Sequence[Way],
        before: Sequence[Standing],
        now: Sequence[Standing],
        scene: Scene,
    ) -> Unlike | None:
        """Compare the rates between two readings with those that the ways were checked for.

        Parameters
        ----------
        ways : sequence of Way
            Those that the mount may take.
        before, now : sequence of Standing
            How it may have stood at each reading; more than one where it doesn't report its side.
        scene : Scene
            Of the later one.

        Returns
        -------
        Unlike or None
            None: as it was checked, or too early or too late to say.
        """
        reckoned = self.reckoned(scene.limits)
        if reckoned.rate_ratio is None or not ways:
            return None
        low, high = reckoned.rate_ratio
        found: list[Unlike] = []
        for way in _near(ways, now):
            then, here = (_on(way, stands) for stands in (before, now))
            ratio = _ratio(way, then, here)
            if not _towards(way, then, here, _MOVES_DEG):
                continue  # it goes elsewhere, whatever its rates: that is judged by where it comes to
            if _towards(way, then, here, _STANDS_DEG) and (ratio is None or low <= ratio <= high):
                # it goes as it may on this one, whatever its place would mean on another
                return None
            if ratio is not None:
                seen = replace(scene.limits, rate_ratio=(ratio / _LOOSE, ratio * _LOOSE))
                found.append(Unlike(ratio, trouble_on(Way(here, way.end), replace(scene, limits=seen))))
        if not found:
            return None
        worst = next((unlike for unlike in found if unlike.trouble is not None), found[0])
        self._ratios.append(worst.ratio)
        return worst


def _near(ways: Sequence[Way], now: Sequence[Standing]) -> list[Way]:
    """The ways on which it may be: those nearest to where it stands."""
    far = [(min(strays_deg([way], at) for at in now), way) for way in ways]
    nearest = min(one for one, _ in far)
    return [way for one, way in far if one <= nearest + _BESIDE_DEG]


def _towards(way: Way, then: Standing, here: Standing, but_deg: float) -> bool:
    """Whether no axis turns away from the way's end, by so much or more."""
    return all(
        (now - before) * math.copysign(1.0, end - before) > -but_deg
        for before, now, end in (
            (then.first_deg, here.first_deg, way.end.first_deg),
            (then.second_deg, here.second_deg, way.end.second_deg),
        )
    )


def _on(way: Way, stands: Sequence[Standing]) -> Standing:
    """The standing that is nearest to a way, its first axis counted as the way counts it."""
    nearest = min(stands, key=lambda one: strays_deg([way], one))
    middle_deg = 0.5 * (way.start.first_deg + way.end.first_deg)
    return replace(nearest, first_deg=middle_deg + half_turn_deg(nearest.first_deg - middle_deg))


def _ratio(way: Way, then: Standing, here: Standing) -> float | None:
    """Second axis' rate over the first one's; None where it can't be said."""
    turned = abs(here.first_deg - then.first_deg), abs(here.second_deg - then.second_deg)
    left = abs(way.end.first_deg - here.first_deg), abs(way.end.second_deg - here.second_deg)
    if not _MOVES_DEG <= max(turned) <= _JUMPS_DEG:
        return None
    if any(abs(90.0 - abs(standing.second_deg)) < _POLE_DEG for standing in (then, here)):
        return None
    # readings on the way are a second apart or so
    if any(to_go < max(_ARRIVES_S * each, LATE_START_DEG) for each, to_go in zip(turned, left, strict=True)):
        return None
    gone = abs(here.first_deg - way.start.first_deg), abs(here.second_deg - way.start.second_deg)
    if min(turned) < _STANDS_DEG and max(gone) <= LATE_START_DEG:
        return None
    return min(max(turned[1] / max(turned[0], 1e-6), 1.0 / _STEEPEST), _STEEPEST)


HEARD_AFTER_S = 2.0
"""So long after a reading a stop takes hold, at most: a look each second, one more question to be sure, the
order and its way, s. Doubled, mounts would be stopped some degrees earlier that go a way they shouldn't."""
_LEAST_DEG_S2 = 0.3
"""A slower braking than this isn't reckoned with, °/s²: what the speeding up is seen as that lay between two
looks. Doubled, a mount that begins its way between two looks would be stopped some degrees later."""
_HALF_A_LOOK_S = 0.5
"""So old is a rate that two looks a second apart give, s. Half the time between two looks of `SLEWING_S`."""
_SHORTEST_S = 0.3
"""Readings nearer to each other than this give no rate, s: their times are some hundredths off. Halved, a
rate may be a third off."""
_TURNS_DEG_S = 0.2
"""Slower than this it tracks, or is about to stand, °/s. Fifty times the sky's turn. Doubled, slow mounts are
stopped a little later."""
_JUMPS_DEG_S = 30.0
"""No axis is as fast, °/s: place and side of the pier were read at different times. Halved, mounts faster
than 15°/s are not judged."""


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
        """Take in a reading; where the axis would come to rest.

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
