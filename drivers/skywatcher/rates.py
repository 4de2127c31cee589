"""How fast an axis turns for a step period, how long a goto takes: the arithmetic of one motor.

A motor makes one step every `period` ticks of the board's timer, in the high speed range as many more as its
ratio says [SKYWATCHER :I :g]: rate = timer · 360° / (counts per turn · period). Gotos don't obey the period;
the board ramps them by itself (measured by an owner of an HEQ5: 3.5°/s, 2.2°/s²).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.skywatcher.words import LARGEST, Board
from mountnav.devices import TrackingRate
from mountnav.sky.turning import SIDEREAL_DEG_S

RATES_DEG_S = {
    TrackingRate.SIDEREAL: SIDEREAL_DEG_S,
    # the mean Moon, as INDI has it; the mean Sun
    TrackingRate.LUNAR: 14.511415 / 3600.0,
    TrackingRate.SOLAR: 15.0 / 3600.0,
}
_HEQ5_SLOW_TIMER = (Board(1, 6, 1), 64935, 64640)


@dataclass(frozen=True, slots=True)
class Gearing:
    """What one motor's numbers are.

    Attributes
    ----------
    counts : int
        Per turn of the axis.
    timer_hz : int
        Ticks per second.
    ratio : int
        Steps at once in the high speed range.
    """

    counts: int
    timer_hz: int
    ratio: int

    @property
    def step_arcsec(self) -> float:
        """One count."""
        return 1_296_000.0 / self.counts

    def period(self, rate_deg_s: float) -> int:
        """Step period for a rate (deg/s, > 0) in the low speed range."""
        return min(max(1, round(self.timer_hz * 360.0 / (self.counts * rate_deg_s))), LARGEST)

    def rate_deg_s(self, period: int, *, fast: bool = False) -> float:
        """Rate that a step period gives."""
        return self.timer_hz * 360.0 / (self.counts * max(period, 1)) * (self.ratio if fast else 1)

    def turn_deg(self, counts: float) -> float:
        """Angle of some counts."""
        return counts * 360.0 / self.counts

    def counts_of(self, turn_deg: float) -> int:
        """Whole counts of an angle."""
        return round(turn_deg * self.counts / 360.0)


def true_timer_hz(board: Board, told_hz: int) -> int:
    """Put right what one firmware tells wrong: the HEQ5 of 1.06 drifts 4″ a minute by it [INDI eqmod]."""
    known, told, true = _HEQ5_SLOW_TIMER
    return true if board == known and told_hz == told else told_hz


def goto_s(turn_deg: float, rate_deg_s: float, acceleration_deg_s2: float) -> float:
    """How long a goto by an angle takes: a trapezoid."""
    size = abs(turn_deg)
    if size < rate_deg_s**2 / acceleration_deg_s2:
        return 2.0 * math.sqrt(size / acceleration_deg_s2)
    return size / rate_deg_s + rate_deg_s / acceleration_deg_s2
