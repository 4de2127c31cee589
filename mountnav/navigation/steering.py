"""Where to send a mount that looks beside its target: from what was sent and what was seen, on the sphere.

Places are taken as arcs from the target (length and direction, east and north at the target), so nothing is
divided by cos δ. The pole itself has its own geometry: `polar_steering`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum

from mountnav.devices import PierSide
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec

Vector = tuple[float, float]


class Followed(StrEnum):
    """Whether the tube did what the last correction asked."""

    FIRST = "nothing was corrected before"
    YES = "followed"
    UNTOLD = "the correction was too small to tell"
    POLAR = "near the pole steps are learned from, not judged"
    STUCK = "did not follow"
    """The mount says that it moved; the tube hardly did: backlash, a clutch, a blocked axis."""
    ELSEWHERE = "went elsewhere"
    """It moved, and not where it was sent: a slip, a late sync, a belief that jumped."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """One look, as far as steering needs it.

    Attributes
    ----------
    sent : Icrs
        Where the mount was sent, in what it believed when it was seen: where it says it points, if a sync or
        a jump came between.
    seen : Icrs
        Where the tube looked.
    side : PierSide
        On which the tube hung.
    """

    sent: Icrs
    seen: Icrs
    side: PierSide = PierSide.UNKNOWN


class Steering:
    """The corrections of one centering: the tube moves as the mount is sent.

    Parameters
    ----------
    target : Icrs
    noise_arcsec : float
        Below this nothing is told from a step: the mount's resolution, and what looks scatter.
    """

    polar = False

    def __init__(self, target: Icrs, noise_arcsec: float) -> None:
        self.target = target
        self._noise_arcsec = noise_arcsec
        self._last: Sighting | None = None

    def sighted(self, sighting: Sighting, utc: datetime) -> Followed:
        """Take in a look of that instant; tell whether the tube followed the correction before it."""
        before, self._last = self._last, sighting
        if before is None:
            return Followed.FIRST
        asked = _minus(self._arc(sighting.sent), self._arc(before.sent))
        moved = _minus(self._arc(sighting.seen), self._arc(before.seen))
        length = math.hypot(*asked)
        if length <= 2.0 * self._noise_arcsec:
            return Followed.UNTOLD
        if math.hypot(*_minus(moved, asked)) <= 0.5 * length + self._noise_arcsec:
            return Followed.YES
        if math.hypot(*moved) <= 0.3 * length + self._noise_arcsec:
            return Followed.STUCK
        return Followed.ELSEWHERE

    def forget(self) -> None:
        """What was sent before counts no more: a flip, a new segment."""
        self._last = None

    def believed(self, place: Icrs) -> None:
        """A sync was seen: what the mount believes is what was seen."""
        self._last = Sighting(place, place)

    def disbelieve(self) -> None:
        """The last look was wrong."""
        self._last = None

    def next_aim(self, utc: datetime, side: PierSide = PierSide.UNKNOWN) -> Icrs:
        """Where to send the mount next, after a look."""
        if self._last is None:
            return self.target
        sent, seen = self._arc(self._last.sent), self._arc(self._last.seen)
        return displaced(self.target, sent[0] - seen[0], sent[1] - seen[1])

    def _arc(self, place: Icrs) -> Vector:
        offset = offset_arcsec(place, self.target)
        return offset.east_arcsec, offset.north_arcsec


def sent_as_believed(aim: Icrs, believed: Icrs, bound_arcsec: float) -> Icrs:
    """What a look's steps are counted from: the aim, unless the mount says it points elsewhere.

    Parameters
    ----------
    aim : Icrs
        Where it was sent.
    believed : Icrs
        Its reading at mid-exposure.
    bound_arcsec : float
        Misses of arriving up to this belong to the mount: it will miss again by as much. A reading further
        off has jumped since: a sync that took hold late.
    """
    return aim if separation_arcsec(aim, believed) <= bound_arcsec else believed


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1]


__all__ = ["Followed", "Sighting", "Steering", "sent_as_believed"]
