"""Where the tube looks now, by the last looks and what the mount was told since; how it drifts besides."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

from mountnav.devices import OffsetRates
from mountnav.navigation.rates_measured import OrderedRates, ordered_between
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, turn_deg

__all__ = ["TubeEstimate"]

DRIFT_SIGMA_ARCSEC_S = 0.05
"""Drift beside what was ordered before any was seen, ″/s, one sigma: a polar axis 10′ off and refraction.
Doubled, the first looks move the rates twice as much."""
DRIFT_CHANGES_ARCSEC_S = 0.02
"""How much it changes in ten minutes, one sigma: a worm's slope, averaged. Doubled, old looks say less."""
MOST_DRIFT_ARCSEC_S = 0.4
"""More than this no mount drifts: what seems so is another fault, and rates are not bent to it. Doubled,
rates of the wrong sign are followed up to 0.4″/s."""
WANDERS_ARCSEC_S, WANDERS_MOST_ARCSEC = 0.03, 5.0
"""How far from its line a tube comes, ″ for each second since the last look, and at most: worms and flexure.
Doubled, each look counts for more than those before it."""
JUMP_SIGMAS = 6.0
"""A look so many sigmas from where the tube was thought is a jump: nothing of the drift is learned from
it."""


@dataclass(frozen=True, slots=True)
class _Axis:
    """One coordinate on the sky: variances of the position and of the drift, and how they hang together."""

    drift: float = 0.0
    position2: float = 0.0
    mixed: float = 0.0
    drift2: float = DRIFT_SIGMA_ARCSEC_S**2

    def later(self, seconds: float) -> _Axis:
        wanders = min(WANDERS_ARCSEC_S * seconds, WANDERS_MOST_ARCSEC)
        return replace(
            self,
            position2=self.position2 + 2.0 * seconds * self.mixed + seconds**2 * self.drift2 + wanders**2,
            mixed=self.mixed + seconds * self.drift2,
            drift2=self.drift2 + DRIFT_CHANGES_ARCSEC_S**2 * seconds / 600.0,
        )

    def seen(self, off_arcsec: float, sigma_arcsec: float) -> tuple[_Axis, float]:
        """After a look so far from where it was thought; and how far the position moves by it."""
        total = self.position2 + sigma_arcsec**2
        if off_arcsec**2 > JUMP_SIGMAS**2 * total:
            return replace(self, position2=sigma_arcsec**2, mixed=0.0), off_arcsec
        of_position, of_drift = self.position2 / total, self.mixed / total
        drift = max(-MOST_DRIFT_ARCSEC_S, min(MOST_DRIFT_ARCSEC_S, self.drift + of_drift * off_arcsec))
        after = _Axis(
            drift,
            self.position2 * (1.0 - of_position),
            self.mixed * (1.0 - of_position),
            self.drift2 - of_drift * self.mixed,
        )
        return after, of_position * off_arcsec


@dataclass(frozen=True, slots=True)
class TubeEstimate:
    """Where the tube looked at the last look, in the mount's kind of coordinates, and how it drifts."""

    place: Apparent | Icrs
    utc: datetime
    east: _Axis
    north: _Axis

    @classmethod
    def of(cls, place: Apparent | Icrs, utc: datetime, sigma_arcsec: float) -> TubeEstimate:
        """By a first look."""
        axis = _Axis(position2=sigma_arcsec**2)
        return cls(place, utc, axis, axis)

    @property
    def drift_arcsec_s(self) -> tuple[float, float]:
        """Beside what was ordered, east and north on the sky."""
        return self.east.drift, self.north.drift

    def at(self, utc: datetime, ordered: Sequence[OrderedRates]) -> Apparent | Icrs:
        """Where it looks at a later instant, by what the mount kept since (oldest first)."""
        seconds = (utc - self.utc).total_seconds()
        ra, dec = ordered_between(ordered, self.utc, utc)
        moved = _moved(self.place, ra, dec)
        moved = _displaced(moved, self.east.drift * seconds, self.north.drift * seconds)
        return replace(moved, utc=utc) if isinstance(moved, Apparent) else moved

    def seen(
        self, place: Apparent | Icrs, utc: datetime, sigma_arcsec: float, ordered: Sequence[OrderedRates]
    ) -> TubeEstimate:
        """After a look."""
        seconds = max(0.0, (utc - self.utc).total_seconds())
        thought = self.at(utc, ordered)
        if isinstance(place, Apparent) and isinstance(thought, Apparent):
            off = offset_arcsec(place, thought)
        else:
            assert isinstance(place, Icrs)
            assert isinstance(thought, Icrs)
            off = offset_arcsec(place, thought)
        sigma = sigma_arcsec if math.isfinite(sigma_arcsec) else WANDERS_MOST_ARCSEC
        east, by_east = self.east.later(seconds).seen(off.east_arcsec, sigma)
        north, by_north = self.north.later(seconds).seen(off.north_arcsec, sigma)
        return TubeEstimate(_displaced(thought, by_east, by_north), utc, east, north)

    def moved_to(self, place: Apparent | Icrs, utc: datetime, sigma_arcsec: float) -> TubeEstimate:
        """After a slew: its drift is known still."""
        east, north = (replace(one, position2=sigma_arcsec**2, mixed=0.0) for one in (self.east, self.north))
        return TubeEstimate(place, utc, east, north)


def _displaced(place: Apparent | Icrs, east_arcsec: float, north_arcsec: float) -> Apparent | Icrs:
    if isinstance(place, Icrs):
        return displaced(place, east_arcsec, north_arcsec)
    return displaced(place, east_arcsec, north_arcsec)


def _moved(place: Apparent | Icrs, ra_arcsec: float, dec_arcsec: float) -> Apparent | Icrs:
    ra_deg = turn_deg(place.ra_deg + ra_arcsec / 3600.0)
    return replace(place, ra_deg=ra_deg, dec_deg=max(-90.0, min(90.0, place.dec_deg + dec_arcsec / 3600.0)))


def rates_on_sky(east_arcsec_s: float, north_arcsec_s: float, dec_deg: float) -> OffsetRates:
    """A velocity on the sky as rates of the coordinates."""
    cosine = max(1e-3, math.cos(math.radians(dec_deg)))
    return OffsetRates(east_arcsec_s / cosine, north_arcsec_s)
