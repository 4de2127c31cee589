"""What navigation asks of a pointing model: where to send the mount so that the tube looks at the target."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from typing import Protocol

from mountnav.devices import PierSide
from mountnav.pointing.observation import PointingObservation
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset


@dataclass(frozen=True, slots=True)
class Expected:
    """What a pointing model expects at a target, before anything has moved.

    Attributes
    ----------
    offset : Offset
        Seen minus believed that is expected there; east and north positive.
    sigma_arcsec : float
        How far from it (on the sky, one sigma per coordinate) the tube may look.
    """

    offset: Offset
    sigma_arcsec: float


class Pointing(Protocol):
    """A pointing model in force, with the zero points of the present segment."""

    @property
    def model_id(self) -> str | None:
        """Which model; None when there is none and only the last sync is known."""
        ...

    def expected(self, target: Icrs, utc: datetime, side: PierSide) -> Expected:
        """Offset (seen minus believed) expected at `target`.

        Raises
        ------
        ModelRefused
            The target can't be reached with this geometry, or is too near a pole of the model.
        """
        ...

    def aim(self, target: Icrs, utc: datetime, side: PierSide) -> Icrs:
        """Where to send the mount so that the tube looks at `target`. Raises `ModelRefused`."""
        ...

    def observed(self, observation: PointingObservation) -> None:
        """Learn the zero points of the observation's segment from it."""
        ...

    def new_segment(self, segment_id: str, synced: PointingObservation | None) -> None:
        """The mount's zero points have changed; by a sync on `synced`, if one is given."""
        ...


def one_point_sigma_arcsec(away_deg: float) -> float:
    """How far off a mount without a model may be so far from the one place where it was right.

    5 m: 6.5″ at 10°, 50″ at 50°; 8 m: 82″ at 50° [POINTING §4]; small mounts are some times worse.
    """
    return math.hypot(5.0, 10.0 * away_deg)


class NoModel:
    """Without a model: no offset is expected; how far off the tube may be grows with the way since a sync.

    The growth is what one-point syncs are worth on real telescopes [POINTING §4]; as long as nothing was seen
    in this segment, all is possible that the configuration allows.
    """

    def __init__(self, unseen_sigma_arcsec: float = 3600.0) -> None:
        self._unseen_sigma_arcsec = unseen_sigma_arcsec
        self._last: Icrs | None = None
        self._side = PierSide.UNKNOWN
        self._segment: str | None = None

    @property
    def model_id(self) -> str | None:
        """None."""
        return None

    def expected(self, target: Icrs, utc: datetime, side: PierSide) -> Expected:
        """No offset, with a sigma that grows with the distance from what was seen last."""
        from mountnav.sky.sphere import separation_arcsec

        sigma = self._unseen_sigma_arcsec
        # a sync on the other side of the pier is worth nothing: twice the cone lies between [POINTING §5]
        flipped = {self._side, side} == {PierSide.EAST, PierSide.WEST}
        if self._last is not None and not flipped:
            away_deg = separation_arcsec(self._last, target) / 3600.0
            sigma = one_point_sigma_arcsec(away_deg)
        return Expected(Offset(0.0, 0.0), min(sigma, self._unseen_sigma_arcsec))

    def aim(self, target: Icrs, utc: datetime, side: PierSide) -> Icrs:
        """The target itself."""
        return target

    def observed(self, observation: PointingObservation) -> None:
        """Nothing is learned without a sync: the mount's belief stays as wrong as it is."""

    def new_segment(self, segment_id: str, synced: PointingObservation | None) -> None:
        """From a sync on, what lies near it is right."""
        self._segment = segment_id
        self._last = None if synced is None else synced.seen
        self._side = PierSide.UNKNOWN if synced is None else synced.side
