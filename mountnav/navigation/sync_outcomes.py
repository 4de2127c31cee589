"""What a sync came to, by the readings before and after it: one rule for all mounts and all drivers.

Seen: it believes to be near to where it was told. Else it has ignored the sync if it believes what it did
before, and if not, it has taken another place: half of what was told (one coordinate of two), or a damaged
number. That is the worst of all: slews by such a belief go anywhere.
"""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

from mountnav.devices import MountReading, SyncOutcome
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

FREE_ARCSEC = 5.0
"""So far (and by its step) the reading of a mount that stands may wander. Doubled, a half of a sync of 10″
passes for nothing."""
_SHARE = 0.25
"""So much of a sync's way is left to the mount, so that a small one that was ignored still shows."""
_STEPS = 1.5
"""Both coordinates of a reading may be at the edge of a step at once."""


def near_arcsec(way_arcsec: float, resolution_arcsec: float, most_arcsec: float) -> float:
    """How near to its place a sync was seen.

    Parameters
    ----------
    way_arcsec : float
        From what the mount believed to what it was told.
    resolution_arcsec : float
        Its step.
    most_arcsec : float
        No more than that, unless the step is coarser.
    """
    return max(min(_SHARE * way_arcsec, most_arcsec), resolution_arcsec + FREE_ARCSEC)


def moved_arcsec(before: MountReading, after: MountReading) -> float:
    """By how much the belief of a mount that isn't moved has changed, the turn of the sky left out.

    Whether it follows the sky its place tells: what it says of that may be as wrong as anything else.
    """
    return _apart_arcsec(_turned(before.place, before.utc, after), after.place)


def miss_arcsec(place: Apparent | Icrs, told_utc: datetime, after: MountReading) -> float:
    """How far a mount believes to be from where it was told at `told_utc`, the turn of the sky left out."""
    return _apart_arcsec(_turned(place, told_utc, after), after.place)


def _turned(place: Apparent | Icrs, utc: datetime, after: MountReading) -> Apparent | Icrs:
    """Where one that believed `place` at `utc` is at `after`: there, or if it rests, as the sky turned."""
    # the right ascension of a mount that rests grows so fast
    turned_deg = SIDEREAL_DEG_S * (after.utc - utc).total_seconds()
    turned = replace(place, ra_deg=(place.ra_deg + turned_deg) % 360.0)
    return min(place, turned, key=lambda one: _apart_arcsec(one, after.place))


def unseen(before: MountReading, after: MountReading, resolution_arcsec: float) -> SyncOutcome:
    """What became of a sync that isn't seen: ignored, or another place taken.

    Parameters
    ----------
    before : MountReading
        The last one before the sync.
    after : MountReading
    resolution_arcsec : float
        The mount's step.
    """
    moved = moved_arcsec(before, after) > _STEPS * resolution_arcsec + FREE_ARCSEC
    return SyncOutcome.ELSEWHERE if moved else SyncOutcome.IGNORED


def _apart_arcsec(one: Apparent | Icrs, two: Apparent | Icrs) -> float:
    return separation_arcsec(Icrs(one.ra_deg, one.dec_deg), Icrs(two.ra_deg, two.dec_deg))


__all__ = ["FREE_ARCSEC", "miss_arcsec", "moved_arcsec", "near_arcsec", "unseen"]
