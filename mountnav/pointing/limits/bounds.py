"""Where a telescope may point and by which way: all limits of one telescope, as numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Literal

from mountnav.devices import PierSide
from mountnav.errors import BadSettings
from mountnav.pointing.limits import next_time, refusing
from mountnav.pointing.limits.horizon import Horizon
from mountnav.pointing.limits.postures import Mounting
from mountnav.pointing.limits.scene import Scene
from mountnav.pointing.limits.slews import SlewCheck, check_slew
from mountnav.pointing.limits.tracked import Reached, reached
from mountnav.sky.coordinates import Air, Icrs, Site


@dataclass(frozen=True, slots=True)
class Limits:
    """All limits of one telescope; what is None or 0 is not checked. Bounds are included.

    Attributes
    ----------
    min_altitude_deg, max_altitude_deg : float
        Lowest and highest observed (refracted) altitude; the highest for mounts that must keep away from the
        zenith.
    horizon : Horizon or None
        What stands round the telescope.
    hour_angle_deg : (float, float) or None
        Hour angles (west positive) at which the tube may stand and track; slews may pass others on their way.
    declination_deg : (float, float) or None
        Declinations; slews too keep to them.
    past_meridian_deg : (float, float) or None
        German: how far past the meridian the tube may look that hangs east of the pier (the normal posture,
        which looks west), and the one west of it; the same past the lower meridian. That is how far the
        counterweight may rise above the horizontal.
    first_axis_deg, second_axis_deg : (float, float) or None
        How far the axes turn: hour angle and declination axis as `postures` counts them, or azimuth and
        altitude.
    sun_cone_deg : float
        So near to the Sun the tube may not come, ...
    sun_cone_from_altitude_deg : float
        ... when the Sun is this high or higher.
    solar_filter : bool
        Whether a filter in front of the tube is declared: without it the Sun is no target, with or without a
        cone.
    moon_cone_deg : float
        The same for the Moon, when it is above the horizon.
    daylight : {"allow", "refuse"}
        Whether there is slewing and tracking when the Sun is higher than ...
    daylight_from_altitude_deg : float
        ... this.
    way_min_altitude_deg : float or None
        Lowest altitude on the way, if that may be lower: German mounts near the equator pass the low pole.
    rate_ratio : (float, float) or None
        Least and greatest rate of the second axis over that of the first; None: nothing is known of them, and
        a way may be anything between doing one axis first and the other.
    stays_to_deg : float
        German: so far past the meridian the mount was seen to stay on its side where it was expected to
        change; 0: never. No setting.
    margin_deg : float
        Added to all limits of the sky when ways and tracking are checked: for the pointing error.
    slew_takes_s, track_for_s : float
        How long a slew takes at most, and how long afterwards the target must stay inside.
    untrusted_tracking_s : float
        So long a mount whose position can't be trusted may track before it is stopped.

    Raises
    ------
    BadSettings
        Bounds that leave no sky between them, or make no sense.
    """

    min_altitude_deg: float
    max_altitude_deg: float = 90.0
    horizon: Horizon | None = None
    hour_angle_deg: tuple[float, float] | None = None
    declination_deg: tuple[float, float] | None = None
    past_meridian_deg: tuple[float, float] | None = None
    first_axis_deg: tuple[float, float] | None = None
    second_axis_deg: tuple[float, float] | None = None
    sun_cone_deg: float = 0.0
    sun_cone_from_altitude_deg: float = -6.0
    solar_filter: bool = False
    moon_cone_deg: float = 0.0
    daylight: Literal["allow", "refuse"] = "allow"
    daylight_from_altitude_deg: float = -6.0
    way_min_altitude_deg: float | None = None
    rate_ratio: tuple[float, float] | None = (0.5, 2.0)
    stays_to_deg: float = 0.0
    margin_deg: float = 0.0
    slew_takes_s: float = 120.0
    track_for_s: float = 60.0
    untrusted_tracking_s: float = 1800.0

    def __post_init__(self) -> None:
        if not -90.0 <= self.min_altitude_deg < self.max_altitude_deg <= 90.0:
            raise BadSettings(
                f"altitude limits {self.min_altitude_deg}° to {self.max_altitude_deg}° leave no sky",
                advice="set -90 <= min_altitude_deg < max_altitude_deg <= 90",
            )
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name.endswith(("_deg", "_s", "_ratio")) and value is not None:
                _check_numbers(field.name, value)
        for name in ("hour_angle_deg", "declination_deg", "first_axis_deg", "second_axis_deg", "rate_ratio"):
            pair = getattr(self, name)
            if pair is not None and not pair[0] < pair[1]:
                raise BadSettings(f"{name} = {pair} leaves no range", advice="give the lower one first")
        if self.rate_ratio is not None and not self.rate_ratio[0] > 0.0:
            raise BadSettings(f"rate_ratio = {self.rate_ratio} is not a ratio of rates", advice="> 0")
        for name in ("sun_cone_deg", "moon_cone_deg", "margin_deg", "slew_takes_s", "track_for_s"):
            if getattr(self, name) < 0.0:
                raise BadSettings(f"{name} = {getattr(self, name)} is negative", advice=">= 0")
        if max(self.sun_cone_deg, self.moon_cone_deg) >= 90.0:
            raise BadSettings("a cone of 90° or more leaves no sky", advice="20 is usual for the Sun")
        if self.past_meridian_deg is not None and not all(
            0.0 <= one <= 180.0 for one in self.past_meridian_deg
        ):
            raise BadSettings(
                f"past_meridian_deg = {self.past_meridian_deg}", advice="0 to 180 for each side of the pier"
            )

    def allow(self, altitude_deg: float) -> bool:
        """Whether an observed altitude lies within the altitude limits."""
        return self.min_altitude_deg <= altitude_deg <= self.max_altitude_deg

    def check(self, target: Icrs, utc: datetime, site: Site, air: Air) -> None:
        """Refuse a target that lies outside the limits of the sky at `utc`.

        Raises
        ------
        OutsideLimits
            With altitude, azimuth, the limit, and when the target will next be within the limits.
        BadRequest
            The instant is naive.
        """
        refusing.check_place(self, target, utc, site, air)

    def next_allowed(self, target: Icrs, utc: datetime, site: Site, air: Air) -> datetime | None:
        """First instant from `utc` on, within 24 hours, at which the target is within the limits of the sky.

        Returns
        -------
        datetime or None
            To the second, and never too early; None if there is none within 24 hours.

        Raises
        ------
        BadRequest
            `utc` is naive.
        """
        return next_time.next_allowed(self, target, utc, site, air)

    def check_slew(
        self,
        start: Icrs,
        target: Icrs,
        utc: datetime,
        site: Site,
        air: Air,
        *,
        mounting: Mounting | None = None,
        side: PierSide | None = None,
        either: bool = False,
        destination: PierSide | None = None,
        track_for_s: float | None = None,
    ) -> SlewCheck:
        """Check a slew: the target, all ways that the mount may take there, and the tracking afterwards.

        Parameters
        ----------
        start : Icrs
            Where the mount believes to point.
        mounting : {"german", "fork", "altaz"}, optional
            None: not known.
        side : PierSide, optional
            On which the tube hangs now, as far as the mount says.
        either : bool
            It doesn't say, and what was seen of it leaves both. Else the side is taken that faces the place,
            away from the meridian.
        destination : PierSide, optional
            On which it will hang, if the mount tells.
        track_for_s : float, optional
            Instead of the limits' own.

        Returns
        -------
        SlewCheck
            What was checked, for the journal.

        Raises
        ------
        OutsideLimits
            With the limit, the place on the way, when, what is allowed in the other posture, and what to do.
        BadRequest
            The instant is naive.
        """
        return check_slew(
            self,
            start,
            target,
            utc,
            site,
            air,
            mounting=mounting,
            side=side,
            either=either,
            destination=destination,
            track_for_s=self.track_for_s if track_for_s is None else track_for_s,
        )

    def reached(
        self,
        place: Icrs,
        utc: datetime,
        site: Site,
        air: Air,
        *,
        mounting: Mounting | None = None,
        side: PierSide | None = None,
        within_s: float = 43200.0,
    ) -> Reached | None:
        """Which limit tracking on `place` reaches first, and when; None if none within that time.

        Raises
        ------
        BadRequest
            The instant is naive.
        """
        scene = Scene(self, utc, site)
        return reached(scene, place, air, mounting=mounting, side=side, within_s=within_s)


def _check_numbers(name: str, value: object) -> None:
    numbers = value if isinstance(value, tuple) else (value,)
    for number in numbers:
        if not isinstance(number, int | float) or isinstance(number, bool) or not math.isfinite(number):
            raise BadSettings(f"{name} = {value!r} is not a number")
