"""What a mount believes: encoder counts, sync, clock and site; wrong ones make its coordinates wrong."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from mountnav.simulation.axes import PAST_PIECES
from mountnav.sky.chain import apparent_to_icrs, hour_angle_to_icrs, icrs_to_apparent, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Site

_NO_AIR = Air(pressure_hpa=0.0)


@dataclass(frozen=True, slots=True)
class Belief:
    """The belief from `start_s` on.

    Attributes
    ----------
    site : Site
        Where it believes to stand.
    ha_counts_deg, dec_counts_deg : float
        Encoder minus motor angle: how the counts are labeled.
    ha_sync_deg, dec_sync_deg : float
        Believed axis angle minus encoder.
    clock_off_s : float
        Its clock minus UTC at `clock_since_s`.
    clock_drift_ppm : float
        What that gains.
    by_homing : bool
        It comes only if a homing under way ends.
    """

    start_s: float
    site: Site
    ha_counts_deg: float = 0.0
    dec_counts_deg: float = 0.0
    ha_sync_deg: float = 0.0
    dec_sync_deg: float = 0.0
    clock_off_s: float = 0.0
    clock_drift_ppm: float = 0.0
    clock_since_s: float = 0.0
    by_homing: bool = False

    @property
    def ha_shift_deg(self) -> float:
        """Believed minus motor angle of the hour angle axis."""
        return self.ha_counts_deg + self.ha_sync_deg

    @property
    def dec_shift_deg(self) -> float:
        """Believed minus motor angle of the declination axis."""
        return self.dec_counts_deg + self.dec_sync_deg

    def utc(self, utc: datetime, t_s: float) -> datetime:
        """What its clock shows at `utc`."""
        wrong_s = self.clock_off_s + self.clock_drift_ppm * 1e-6 * (t_s - self.clock_since_s)
        return utc + timedelta(seconds=wrong_s) if wrong_s else utc

    def place(self, ha_deg: float, dec_deg: float, utc: datetime, t_s: float) -> Apparent:
        """Coordinates that it makes of an hour angle and a declination; their instant is the true one."""
        shown = self.utc(utc, t_s)
        # the same chain as the truth's, so that a mount without errors reports exactly where it looks
        place = icrs_to_apparent(
            hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, shown), self.site, _NO_AIR), shown
        )
        return place if shown is utc else replace(place, utc=utc)

    def hour_angle(self, place: Apparent, utc: datetime, t_s: float) -> tuple[float, float]:
        """Inverse of `place`: hour angle and declination (deg) that it makes of these numbers now."""
        shown = self.utc(utc, t_s)
        angles = icrs_to_hour_angle(apparent_to_icrs(replace(place, utc=shown)), shown, self.site, _NO_AIR)
        return angles.ha_deg, angles.dec_deg

    def altitude_deg(self, ha_deg: float, dec_deg: float) -> float:
        """Altitude of an hour angle and a declination at its site."""
        h, d, lat = math.radians(ha_deg), math.radians(dec_deg), math.radians(self.site.latitude_deg)
        sine = math.sin(lat) * math.sin(d) + math.cos(lat) * math.cos(d) * math.cos(h)
        return math.degrees(math.asin(max(-1.0, min(1.0, sine))))


def believing(
    beliefs: tuple[Belief, ...], t_s: float, change: Callable[[Belief], Belief]
) -> tuple[Belief, ...]:
    """Change the belief from `t_s` on, those still to come as well."""
    past = [belief for belief in beliefs if belief.start_s < t_s][-PAST_PIECES:]
    present = [belief for belief in beliefs if belief.start_s <= t_s][-1:] or [beliefs[0]]
    future = [belief for belief in beliefs if belief.start_s > t_s]
    changed = (replace(change(belief), start_s=belief.start_s) for belief in future)
    return (*past, replace(change(present[0]), start_s=t_s), *changed)


def without_homing(beliefs: tuple[Belief, ...], t_s: float) -> tuple[Belief, ...]:
    """Forget what a homing that doesn't end would have brought."""
    return tuple(belief for belief in beliefs if belief.start_s <= t_s or not belief.by_homing)


def with_future(beliefs: tuple[Belief, ...], belief: Belief) -> tuple[Belief, ...]:
    """Add a belief that comes into force later; what was to come after it comes no more."""
    return (*[one for one in beliefs if one.start_s < belief.start_s][-PAST_PIECES:], belief)
