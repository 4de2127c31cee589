"""Where to send a mount for a target that moves: to where it will be when the next exposure is half over.

How long slews take, and how long it is from their end to the middle of an exposure, is learned from those
that were made; before that, usual mounts are assumed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from datetime import datetime, timedelta

from mountnav.clock import Clock
from mountnav.ephemeris import Ephemeris, SkyRates, sky_rates
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs, Site
from mountnav.sky.sphere import separation_arcsec

__all__ = ["MovingTarget", "Pace", "Target", "path_of", "place_now"]

Target = Icrs | Ephemeris
"""A place that doesn't move among the stars, or one that does."""

_KEPT = 12
"""So many slews are remembered. Chosen by hand; doubled, a mount that was made faster is believed
slow for longer."""
_USUAL_OVERHEAD_S, _USUAL_S_DEG = 4.0, 0.4
"""What a slew takes besides its way, and for each degree of it, before any was measured: mounts of 2.5°/s.
Doubled, the first aim at a fast target leads by twice as much."""
_OVERHEAD_SIGMA_S, _S_DEG_SIGMA = 5.0, 0.6
"""How much mounts differ in that: the prior's one sigma. Doubled, single slews count for more."""
_SLEW_SIGMA_S, _SLEW_SHARE = 1.0, 0.1
"""How evenly a mount slews: its polling, and a share of the time. Doubled, more slews are needed to know
it."""
_USUAL_READING_S = 0.5
"""From the end of a slew to the begin of an exposure, besides settling, before any was measured, s."""
_ROUNDS = 4
"""So often the way to where a target will be is computed again; each time what is left is the ratio of its
speed to the mount's."""
_MOST_LEAD_S = 600.0
"""No slew is believed to take longer: a guess that came out so is wrong, s."""


class Pace:
    """How long a telescope takes from an order to slew to the middle of the next exposure."""

    def __init__(self) -> None:
        self._slews: deque[tuple[float, float]] = deque(maxlen=_KEPT)
        self._waits: deque[float] = deque(maxlen=_KEPT)

    @property
    def slews(self) -> int:
        """So many slews it was learned from."""
        return len(self._slews)

    def slewed(self, way_arcsec: float, elapsed_s: float) -> None:
        """Take in a slew that arrived."""
        if math.isfinite(way_arcsec) and math.isfinite(elapsed_s) and 0.0 <= elapsed_s <= _MOST_LEAD_S:
            self._slews.append((way_arcsec / 3600.0, elapsed_s))

    def looked(self, waited_s: float, exposure_s: float) -> None:
        """Take in how long it was from the end of a slew to the middle of an exposure of that length."""
        wait_s = waited_s - 0.5 * exposure_s
        if math.isfinite(wait_s) and 0.0 <= wait_s <= _MOST_LEAD_S:
            self._waits.append(wait_s)

    def slew_s(self, way_arcsec: float) -> float:
        """How long a slew over that way will take, s."""
        way_deg = way_arcsec / 3600.0
        # normal equations of overhead and time per degree, with the usual mount as a prior
        a, b, c = 1.0 / _OVERHEAD_SIGMA_S**2, 0.0, 1.0 / _S_DEG_SIGMA**2
        p, q = _USUAL_OVERHEAD_S * a, _USUAL_S_DEG * c
        for one_deg, elapsed_s in self._slews:
            weight = 1.0 / (_SLEW_SIGMA_S**2 + (_SLEW_SHARE * elapsed_s) ** 2)
            a, b, c = a + weight, b + weight * one_deg, c + weight * one_deg**2
            p, q = p + weight * elapsed_s, q + weight * one_deg * elapsed_s
        overhead_s, s_deg = (p * c - q * b) / (a * c - b * b), (q * a - p * b) / (a * c - b * b)
        return min(_MOST_LEAD_S, max(0.0, overhead_s) + max(0.0, s_deg) * way_deg)

    def until_exposed_s(self, settle_s: float) -> float:
        """How long from the end of a slew to the begin of the next exposure, s: the median of those seen."""
        if not self._waits:
            return settle_s + _USUAL_READING_S
        waits = sorted(self._waits)
        return waits[len(waits) // 2]


def place_now(target: Target, utc: datetime, site: Site) -> Icrs:
    """Where a target is at an instant. Raises `BadRequest` outside of its span."""
    return target if isinstance(target, Icrs) else target.icrs(utc, site)


def path_of(target: Ephemeris, site: Site) -> Callable[[datetime], Icrs]:
    """Where a target is, for those that ask by the instant alone."""

    def path(utc: datetime) -> Icrs:
        return target.icrs(utc, site)

    return path


class MovingTarget:
    """A target as a centering has it: one that moves is led, a fixed one isn't.

    Parameters
    ----------
    exposure_s, settle_s : float
        Of the looks.

    Attributes
    ----------
    moves : bool
        Whether it is an ephemeris.
    """

    def __init__(
        self, target: Target, *, site: Site, clock: Clock, pace: Pace, exposure_s: float, settle_s: float
    ) -> None:
        self.moves = not isinstance(target, Icrs)
        self._target, self._site, self._clock, self._pace = target, site, clock, pace
        self._exposure_s, self._settle_s = exposure_s, settle_s

    @property
    def name(self) -> str:
        """What people call it; empty of a fixed one."""
        return "" if isinstance(self._target, Icrs) else self._target.name

    def at(self, utc: datetime) -> Icrs:
        """Where it is at an instant. Raises `BadRequest` outside of its span."""
        return place_now(self._target, utc, self._site)

    def sigma_arcsec(self, utc: datetime) -> float:
        """How uncertain that is, one sigma."""
        return 0.0 if isinstance(self._target, Icrs) else self._target.sigma_arcsec(utc)

    def rates(self, utc: datetime) -> SkyRates | None:
        """How fast it moves among the stars; None of a fixed one."""
        return None if isinstance(self._target, Icrs) else sky_rates(self._target, utc, self._site)

    def ahead(self, here: Icrs | None, *, exposed: bool = True) -> Icrs:
        """Where it will be in the middle of the exposure after a slew that begins now; or at its end.

        Parameters
        ----------
        here : Icrs or None
            Where the mount points; None if that isn't known.
        exposed : bool
            Whether an exposure follows.

        Raises
        ------
        BadRequest
            Its ephemeris has ended by then.
        """
        now = self._clock.utc()
        if isinstance(self._target, Icrs):
            return self._target
        place = self._target.icrs(now, self._site)
        after_s = 0.0
        if exposed:
            after_s = self._pace.until_exposed_s(self._settle_s) + 0.5 * self._exposure_s
        for _ in range(_ROUNDS):
            way = 0.0 if here is None else separation_arcsec(here, place)
            utc = now + timedelta(seconds=self._pace.slew_s(way) + after_s)
            ends = self._target.ends_utc
            if ends is not None and utc > ends:
                raise BadRequest(
                    f"{self._target.name}: its ephemeris ends at {ends:%Y-%m-%d %H:%M:%S} UTC, before the "
                    "telescope could be there",
                    advice="give one that goes on for longer",
                )
            place = self._target.icrs(utc, self._site)
        return place
