"""What a mount's readings mean to its limits: where it stands, whether it may go, when it has to stop.

On which side of the pier a German mount's tube hangs is what its readings say; where they don't, it is
taken to be where the last slew should have led, and before the first one where German mounts usually are.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from mountnav.errors import LimitKind, OutsideLimits
from mountnav.navigation.devices import Epoch, MountReading, PierSide
from mountnav.navigation.kinds import for_mount, from_mount
from mountnav.pointing.limits import Limits, Mounting, Reached, SlewCheck
from mountnav.pointing.limits.bodies import SUN_DEG_PER_S, bodies
from mountnav.pointing.limits.detours import legs_to
from mountnav.pointing.limits.directions import of_body
from mountnav.pointing.limits.refusing import require_night, why
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.tracked import standing_for, tracked_depths
from mountnav.pointing.limits.ways import strays_deg
from mountnav.sky.chain import icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Air, Apparent, Icrs, Observed, Site

BELOW_GROUND_DEG = -2.0
"""Lower than this no telescope looks, whatever refraction and an uneven horizon do."""

_SIDES = (PierSide.EAST, PierSide.WEST)
_STRAYS_DEG = 3.0


@dataclass(frozen=True, slots=True)
class Plan:
    """A slew that may be made.

    Attributes
    ----------
    legs : tuple of Icrs
        Places to slew to, one after the other; the last one is the target.
    check : SlewCheck
        Of the first leg.
    """

    legs: tuple[Icrs, ...]
    check: SlewCheck


class Guard:
    """The limits of one mount, applied to its readings.

    Parameters
    ----------
    limits : Limits
    site, air : Site, Air
    mounting : {"german", "fork", "altaz"} or None
    """

    def __init__(self, limits: Limits, site: Site, air: Air, mounting: Mounting | None) -> None:
        self.limits = limits
        self.site = site
        self.air = air
        self.mounting = mounting
        self._expected_side: PierSide | None = None

    def side(self, reading: MountReading) -> PierSide | None:
        """On which side the tube hangs: as the mount says, or as the last slew should have left it."""
        return reading.pier_side if reading.pier_side in _SIDES else self._expected_side

    def arrived(self, check: SlewCheck) -> None:
        """A slew has ended as it was checked: keep where the tube should hang now."""
        self._expected_side = check.sides[0] if len(check.sides) == 1 else None

    async def plan(
        self, reading: MountReading, target: Icrs, utc: datetime, destination: PierSide | None
    ) -> Plan:
        """How to get to a target: directly, or by way of other places if that isn't allowed.

        Raises
        ------
        OutsideLimits
            Of the direct way, if no other is allowed.
        """
        try:
            return Plan((target,), self.check_slew(reading, target, utc, destination))
        except OutsideLimits as refusal:
            start, side = from_mount(reading.place), self.side(reading)
            # it may take some tenths of a second, and a stop doesn't wait for it
            legs = await asyncio.to_thread(
                legs_to, self.limits, start, target, utc, self.site, self.air, self.mounting, side
            )
            if not legs:
                raise
            try:
                return Plan(legs, self.check_slew(reading, legs[0], utc, None))
            except OutsideLimits:
                raise refusal from None

    def check_slew(
        self, reading: MountReading, target: Icrs, utc: datetime, destination: PierSide | None
    ) -> SlewCheck:
        """Check one slew from where the mount stands. Raises `OutsideLimits`."""
        return self.limits.check_slew(
            from_mount(reading.place),
            target,
            utc,
            self.site,
            self.air,
            mounting=self.mounting,
            side=self.side(reading),
            destination=destination,
        )

    @staticmethod
    def for_mount(place: Icrs, epoch: Epoch, utc: datetime) -> Apparent | Icrs:
        """A place as the mount wants it."""
        return for_mount(place, epoch, utc)

    def require_above_ground(self, place: Icrs, utc: datetime) -> None:
        """Refuse a place where no telescope at this site can point at this hour. Raises `OutsideLimits`."""
        seen = icrs_to_observed(place, utc, self.site, self.air)
        if seen.alt_deg < BELOW_GROUND_DEG:
            raise OutsideLimits(
                f"the place is at altitude {seen.alt_deg:.1f}° at this hour: nothing can point there",
                advice="nothing was synced; check this machine's clock, the site and the frame's time",
            )

    def require_night(self, utc: datetime) -> None:
        """Refuse what isn't done by day, if the limits say so. Raises `OutsideLimits`."""
        require_night(self.limits, utc, self.site)

    def reached(self, reading: MountReading, *, within_s: float = 43200.0) -> Reached | None:
        """Which limit tracking from where the mount stands reaches first, and when."""
        return self.limits.reached(
            from_mount(reading.place),
            reading.utc,
            self.site,
            self.air,
            mounting=self.mounting,
            side=self.side(reading),
            within_s=within_s,
        )

    def check_tracking(self, reading: MountReading, utc: datetime, lead_s: float) -> None:
        """Refuse to begin to track where that leads out of the limits at once. Raises `OutsideLimits`."""
        soon = self.reached(reading, within_s=max(lead_s, 60.0))
        if soon is None or soon.after_s > lead_s:
            return
        place = Observed(soon.az_deg, soon.alt_deg, utc)
        raise OutsideLimits(
            f"tracking here leads in {soon.after_s:.0f} s to altitude {soon.alt_deg:.1f}°, azimuth "
            f"{soon.az_deg:.0f}°, {why(self.limits, soon.limit, 0.0, place)}",
            advice="slew to a place within the limits first",
            limit=soon.limit,
        )

    def depths(self, reading: MountReading, *, passing: bool) -> dict[LimitKind, float]:
        """How deep outside each limit the mount stands (above 0: outside), margins left out.

        Parameters
        ----------
        reading : MountReading
        passing : bool
            Whether it is on its way: what holds for standing only is left out.
        """
        scene = Scene(self.limits, reading.utc, self.site)
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        depths, _ = tracked_depths(
            scene, here, np.zeros(1), mounting=self.mounting, side=self.side(reading), standing=not passing
        )
        found = {limit: float(depth[0]) for limit, depth in depths.items()}
        if passing:
            gone = [LimitKind.HOUR_ANGLE, LimitKind.DAYLIGHT]
            if self.mounting == "german" and reading.pier_side not in _SIDES:
                # on which side it is on its way nobody knows
                gone += [LimitKind.MERIDIAN, LimitKind.UNREACHABLE]
            for limit in gone:
                found.pop(limit, None)
        return found

    def strays(self, reading: MountReading, check: SlewCheck) -> bool:
        """Whether a mount of which the way had to be guessed goes another one."""
        if check.sure:
            return False
        scene = Scene(self.limits, reading.utc, self.site)
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        told = reading.pier_side if reading.pier_side in _SIDES else None
        stands = [standing_for(scene, here, check.mounting, side) for side in ([told] if told else _SIDES)]
        return min(strays_deg(check.expected, one) for one in stands) > _STRAYS_DEG

    def sun_would_come(self, reading: MountReading, within_s: float = 10800.0) -> bool:
        """Whether a tube that stands still where it is would have the Sun come nearer."""
        latitude_deg = self.site.latitude_deg
        here = icrs_to_hour_angle(from_mount(reading.place), reading.utc, self.site, self.air)
        later = np.linspace(0.0, within_s * SUN_DEG_PER_S, 37)
        sun = of_body(bodies(reading.utc, self.site).sun, latitude_deg, later)
        apart = sun.separation_deg(of_body(here, latitude_deg))
        return float(apart.min()) < float(apart[0]) - 1.0

    def seen(self, reading: MountReading) -> Observed:
        """Where the mount points, as the horizon counts."""
        return icrs_to_observed(from_mount(reading.place), reading.utc, self.site, self.air)
