"""Where the telescope may point: a target outside is refused before anything moves, and told when to come."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from itertools import pairwise

from mountnav.errors import BadSettings, OutsideLimits
from mountnav.sky.chain import hour_angle_to_observed, icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site

SIDEREAL_DEG_PER_DAY = 360.98564736629
_PRECISION = timedelta(seconds=1)


@dataclass(frozen=True, slots=True)
class Limits:
    """Altitudes between which the telescope may point, bounds included.

    Attributes
    ----------
    min_altitude_deg : float
        Lowest observed (refracted) altitude.
    max_altitude_deg : float
        Highest observed altitude, for mounts that must keep away from the zenith.

    Raises
    ------
    BadSettings
        The bounds leave no sky between them.
    """

    min_altitude_deg: float
    max_altitude_deg: float = 90.0

    def __post_init__(self) -> None:
        if not -90.0 <= self.min_altitude_deg < self.max_altitude_deg <= 90.0:
            raise BadSettings(
                f"altitude limits {self.min_altitude_deg}° to {self.max_altitude_deg}° leave no sky",
                advice="set -90 <= min_altitude_deg < max_altitude_deg <= 90",
            )

    def allow(self, altitude_deg: float) -> bool:
        """Whether an observed altitude lies within the limits."""
        return self.min_altitude_deg <= altitude_deg <= self.max_altitude_deg

    def check(self, target: Icrs, utc: datetime, site: Site, air: Air) -> None:
        """Refuse a target that lies outside the limits at `utc`.

        Raises
        ------
        OutsideLimits
            With altitude, azimuth, the limit, and when the target will next be within the limits.
        BadRequest
            The instant is naive.
        """
        place = icrs_to_observed(target, utc, site, air)
        if self.allow(place.alt_deg):
            return
        if place.alt_deg < self.min_altitude_deg:
            side = f"below the limit of {self.min_altitude_deg:g}°"
        else:
            side = f"above the limit of {self.max_altitude_deg:g}°"
        when = self.next_allowed(target, utc, site, air)
        if when is None:
            advice = "it doesn't come within the limits during the next 24 hours: choose another target"
        else:
            hour = f"{when.astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}"
            advice = f"it comes within the limits at {hour}: wait, or choose another target"
        raise OutsideLimits(
            f"the target stands at altitude {place.alt_deg:.2f}°, azimuth {place.az_deg:.2f}°, {side}",
            advice=advice,
        )

    def next_allowed(self, target: Icrs, utc: datetime, site: Site, air: Air) -> datetime | None:
        """First instant from `utc` on, within 24 hours, at which the target is within the limits.

        Between one culmination and the next the altitude only rises or only falls, so that one crossing
        at most lies between two of them, and is found by halving.

        Returns
        -------
        datetime or None
            To the second, and never too early; None if there is none within 24 hours.

        Raises
        ------
        BadRequest
            `utc` is naive.
        """

        def altitude_deg(at: datetime) -> float:
            return icrs_to_observed(target, at, site, air).alt_deg

        now = icrs_to_hour_angle(target, utc, site, air)
        if self.allow(hour_angle_to_observed(now, site).alt_deg):
            return utc
        end = utc + timedelta(days=1)
        to_culmination_deg = (-now.ha_deg) % 180.0
        half_turn = timedelta(days=180.0 / SIDEREAL_DEG_PER_DAY)
        first = utc + timedelta(days=to_culmination_deg / SIDEREAL_DEG_PER_DAY)
        marks = [utc, *(first + i * half_turn for i in range(3))]
        marks = [mark for mark in marks if mark < end] + [end]
        for start, stop in pairwise(marks):
            before_deg, after_deg = altitude_deg(start), altitude_deg(stop)
            if before_deg < self.min_altitude_deg <= after_deg:
                return _first_true(lambda at: altitude_deg(at) >= self.min_altitude_deg, start, stop)
            if before_deg > self.max_altitude_deg >= after_deg:
                return _first_true(lambda at: altitude_deg(at) <= self.max_altitude_deg, start, stop)
        return None


def _first_true(holds: Callable[[datetime], bool], start: datetime, stop: datetime) -> datetime:
    """When a condition begins to hold that does not at `start` but does at `stop`; to the second."""
    while stop - start > _PRECISION:
        middle = start + (stop - start) / 2
        if holds(middle):
            stop = middle
        else:
            start = middle
    whole = stop.replace(microsecond=0) + _PRECISION
    return whole if holds(whole) else stop
