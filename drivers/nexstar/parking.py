"""What is known of a park position: the hand control knows none, so it is remembered here."""

from __future__ import annotations

import math
from dataclasses import dataclass

NEAR_DEG = 0.1
"""So near to its place a resting mount counts as parked: `z` moves while it settles."""


@dataclass(frozen=True, slots=True)
class Horizon:
    """Azimuth and altitude as the hand control counts them: German mounts may mean their axes [INDI park]."""

    az_deg: float
    alt_deg: float


class Parking:
    """Whether the mount is parked, as far as one can know.

    Parameters
    ----------
    place : Horizon or None
        Where it parks.
    """

    def __init__(self, place: Horizon | None) -> None:
        self.place = place
        self.under_way = False
        self.parked = False

    @property
    def concerned(self) -> bool:
        """Whether there is anything to look after."""
        return self.under_way or self.parked

    def began(self) -> None:
        """It was sent there."""
        self.under_way, self.parked = True, False

    def stopped(self) -> None:
        """It was stopped, or unparked."""
        self.under_way = self.parked = False

    def near(self, now: Horizon) -> bool:
        """Whether a place is the park position."""
        if self.place is None:
            return False
        az_deg = (now.az_deg - self.place.az_deg + 180.0) % 360.0 - 180.0
        across_deg = az_deg * math.cos(math.radians(self.place.alt_deg))
        return math.hypot(across_deg, now.alt_deg - self.place.alt_deg) <= NEAR_DEG

    def seen(self, *, there: bool, resting: bool, tracking: bool) -> bool:
        """Take note of a look at the mount; return whether it is parked now."""
        if self.under_way and there and resting and not tracking:
            self.under_way, self.parked = False, True
        elif self.parked and (tracking or not resting or not there):
            # somebody has moved it at its hand control, or it has lost its alignment
            self.parked = False
        return self.parked
