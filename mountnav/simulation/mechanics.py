"""The mechanics of a telescope that points wrong: what the mount believes, and where the tube truly looks.

Two motor axes move along closed formulas of time (`axes`). The belief reads them as perfect geometry, through
the sync offset, without refraction. The truth adds backlash, periodic error and geometry errors (`geometry`),
and takes the result as the observed, refracted direction. A sync changes the belief, never the truth.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Literal

from mountnav.errors import BadSettings
from mountnav.simulation.axes import PAST_PIECES, AxisPath
from mountnav.simulation.geometry import perfect_direction, true_direction
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.sky.chain import apparent_to_icrs, hour_angle_to_icrs, icrs_to_apparent, icrs_to_hour_angle
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Icrs, MountAxes, Site, utc_now
from mountnav.sky.sphere import half_turn_deg

__all__ = ["Direction", "Mechanics", "PointingErrors"]

Direction = Literal["n", "s", "e", "w"]

SIDEREAL_DEG_S = 360.0 / 86164.0905
"""Rotation of the Earth against the equinox."""

_NO_AIR = Air(pressure_hpa=0.0)


@dataclass(frozen=True, slots=True)
class _Sync:
    """From `start_s` on the believed axes are the motor's plus these offsets (deg)."""

    start_s: float
    ha_deg: float
    dec_deg: float


@dataclass(frozen=True, slots=True)
class _Motion:
    """Everything that orders change, in one value, so that a question sees one consistent state."""

    ha: AxisPath
    dec: AxisPath
    syncs: tuple[_Sync, ...]
    tracking: bool

    def sync_at(self, t_s: float) -> _Sync:
        """Find the sync in force at `t_s`."""
        index = bisect_right(self.syncs, t_s, key=lambda sync: sync.start_s) - 1
        return self.syncs[max(index, 0)]


class Mechanics:
    """An equatorial mount without pier flip; hour angle and declination axis, each moving the shortest way.

    Parameters
    ----------
    site, air : Site, Air
        Where it stands; `air.pressure_hpa` = 0 leaves refraction out of the truth.
    errors : PointingErrors
        How wrong it points.
    slew_rate_deg_s, acceleration_deg_s2 : float
        Of both axes, > 0.
    clock : callable
        Gives the present instant, aware UTC. Orders take effect then; questions default to it.
    start : Apparent, optional
        What it believes to point at when made; the zenith if None. It tracks from the start.

    Raises
    ------
    BadSettings
        When a rate is not positive.

    Notes
    -----
    Thread-safe. Any question may be asked of any instant: the past is kept for some hundred orders, the
    future is the one that follows if no further order comes.
    """

    def __init__(
        self,
        site: Site,
        air: Air,
        errors: PointingErrors,
        *,
        slew_rate_deg_s: float = 4.0,
        acceleration_deg_s2: float = 2.0,
        clock: Callable[[], datetime] = utc_now,
        start: Apparent | None = None,
    ) -> None:
        for name, value in (
            ("slew_rate_deg_s", slew_rate_deg_s),
            ("acceleration_deg_s2", acceleration_deg_s2),
        ):
            if not (math.isfinite(value) and value > 0.0):
                raise BadSettings(f"{name} = {value} can't move a mount", advice="> 0")
        self.site, self.air, self.errors = site, air, errors
        self.slew_rate_deg_s, self.acceleration_deg_s2 = slew_rate_deg_s, acceleration_deg_s2
        self._clock = clock
        self._lock = threading.Lock()
        self._origin_utc = clock()
        ha_deg, dec_deg = 0.0, site.latitude_deg
        if start is not None:
            ha_deg, dec_deg = self._perfect_axes(start, self._origin_utc)
        play_deg = errors.backlash_arcsec / 3600.0
        self._motion = _Motion(
            AxisPath.resting(0.0, ha_deg, SIDEREAL_DEG_S, play_deg),
            AxisPath.resting(0.0, dec_deg, 0.0, play_deg),
            (_Sync(0.0, 0.0, 0.0),),
            True,
        )

    # -- questions -------------------------------------------------------------------------------

    def reported(self, utc: datetime | None = None) -> Apparent:
        """Where the mount believes it points: the axes as perfect geometry, synced, no refraction."""
        utc, t_s, motion = self._asked(utc)
        sync = motion.sync_at(t_s)
        ha_deg, dec_deg = perfect_direction(
            motion.ha.angle_at(t_s) + sync.ha_deg, motion.dec.angle_at(t_s) + sync.dec_deg
        )
        # the same chain as the truth's, so that a mount without errors reports exactly where it looks
        return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), self.site, _NO_AIR), utc)

    def truth(self, utc: datetime | None = None) -> Icrs:
        """Where the optical axis really looks, errors and refraction included."""
        utc, t_s, motion = self._asked(utc)
        worm_turn_deg = SIDEREAL_DEG_S * self.errors.periodic_period_s
        periodic_deg = (self.errors.periodic_amplitude_arcsec / 3600.0) * math.sin(
            math.tau * motion.ha.angle_at(t_s) / worm_turn_deg
        )
        ha_deg, dec_deg = true_direction(
            motion.ha.driven_at(t_s) + periodic_deg,
            motion.dec.driven_at(t_s),
            self.errors,
            self.site.latitude_deg,
        )
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), self.site, self.air)

    def axes(self, utc: datetime | None = None) -> MountAxes:
        """Read the motors' encoders: no sync, no errors."""
        _, t_s, motion = self._asked(utc)
        return MountAxes(half_turn_deg(motion.ha.angle_at(t_s)), motion.dec.angle_at(t_s))

    def slewing(self, utc: datetime | None = None) -> bool:
        """Whether an axis does anything but track or rest."""
        _, t_s, motion = self._asked(utc)
        return not (motion.ha.steady_at(t_s) and motion.dec.steady_at(t_s))

    def believed_altitude_deg(self, place: Apparent, utc: datetime | None = None) -> float:
        """Altitude of an apparent place as the mount computes it now: no refraction, no errors."""
        utc, _, _ = self._asked(utc)
        ha_deg, dec_deg = self._perfect_axes(place, utc)
        h, d, lat = math.radians(ha_deg), math.radians(dec_deg), math.radians(self.site.latitude_deg)
        sine = math.sin(lat) * math.sin(d) + math.cos(lat) * math.cos(d) * math.cos(h)
        return math.degrees(math.asin(max(-1.0, min(1.0, sine))))

    @property
    def tracking(self) -> bool:
        """Whether the hour angle axis follows the sky when nothing else is ordered."""
        return self._motion.tracking

    # -- orders ----------------------------------------------------------------------------------

    @tracking.setter
    def tracking(self, on: bool) -> None:
        with self._lock:
            ha = self._motion.ha
            last = ha.pieces[-1]
            if last.steady:  # during a slew: when it has arrived
                t_s = max(self._now_s(), last.start_s)
                ha = ha.to_velocity(t_s, self._rest_deg_s(on), self.acceleration_deg_s2, steady=True)
            self._motion = replace(self._motion, ha=ha, tracking=on)

    def slew(self, target: Apparent) -> None:
        """Set out for a place the shortest way in each axis, and track it from then on.

        The place's numbers are taken as of date now, as a mount does. Its altitude is not looked at.
        """
        with self._lock:
            now_utc = self._clock()
            t_s = self._seconds(now_utc)
            motion = self._motion
            sync = motion.sync_at(t_s)
            ha_deg, dec_deg = self._perfect_axes(target, now_utc)
            limits = (self.slew_rate_deg_s, self.acceleration_deg_s2)
            ha_now, dec_now = motion.ha.angle_at(t_s), motion.dec.angle_at(t_s)
            ha_aim = ha_now + half_turn_deg(ha_deg - sync.ha_deg - ha_now)
            dec_aim = dec_now + half_turn_deg(dec_deg - sync.dec_deg - dec_now)
            self._motion = replace(
                motion,
                ha=motion.ha.to_angle(t_s, ha_aim, SIDEREAL_DEG_S, *limits),
                dec=motion.dec.to_angle(t_s, dec_aim, 0.0, *limits),
                tracking=True,
            )

    def sync(self, place: Apparent) -> None:
        """From now on believe to point at `place`. The truth doesn't change."""
        with self._lock:
            now_utc = self._clock()
            t_s = self._seconds(now_utc)
            motion = self._motion
            ha_deg, dec_deg = self._perfect_axes(place, now_utc)
            sync = _Sync(
                t_s,
                half_turn_deg(ha_deg - motion.ha.angle_at(t_s)),
                half_turn_deg(dec_deg - motion.dec.angle_at(t_s)),
            )
            kept = tuple(old for old in motion.syncs if old.start_s < t_s)[-PAST_PIECES:]
            self._motion = replace(motion, syncs=(*kept, sync))

    def stop(self) -> None:
        """Slow both axes down to tracking (or rest, if tracking is off)."""
        with self._lock:
            t_s = self._now_s()
            self._motion = self._still(t_s, ha=True, dec=True)

    def move(self, direction: Direction, rate_deg_s: float) -> None:
        """Move on at a rate (relative to tracking, at most the slew rate) until `stop_move` or `stop`.

        North raises the declination axis, west the hour angle.
        """
        rate = min(abs(rate_deg_s), self.slew_rate_deg_s)
        with self._lock:
            t_s = self._now_s()
            motion, a = self._motion, self.acceleration_deg_s2
            signed = rate if direction in ("n", "w") else -rate
            if direction in ("n", "s"):
                dec = motion.dec.to_velocity(t_s, signed, a, steady=False)
                self._motion = replace(motion, dec=dec)
            else:
                base = self._rest_deg_s(motion.tracking)
                self._motion = replace(motion, ha=motion.ha.to_velocity(t_s, base + signed, a, steady=False))

    def stop_move(self, direction: Direction) -> None:
        """End a `move` in this direction; the other axis is left alone."""
        with self._lock:
            polar = direction in ("e", "w")
            self._motion = self._still(self._now_s(), ha=polar, dec=not polar)

    # -- inside ----------------------------------------------------------------------------------

    def _still(self, t_s: float, *, ha: bool, dec: bool) -> _Motion:
        motion, a = self._motion, self.acceleration_deg_s2
        if ha and not motion.ha.steady_at(t_s):
            rest = self._rest_deg_s(motion.tracking)
            motion = replace(motion, ha=motion.ha.to_velocity(t_s, rest, a, steady=True))
        if dec and not motion.dec.steady_at(t_s):
            motion = replace(motion, dec=motion.dec.to_velocity(t_s, 0.0, a, steady=True))
        return motion

    def _rest_deg_s(self, tracking: bool) -> float:
        return SIDEREAL_DEG_S if tracking else 0.0

    def _perfect_axes(self, place: Apparent, utc: datetime) -> tuple[float, float]:
        """Axis angles (deg) at which a perfect, unsynced mount believes to point at these numbers."""
        angles = icrs_to_hour_angle(apparent_to_icrs(replace(place, utc=utc)), utc, self.site, _NO_AIR)
        return angles.ha_deg, angles.dec_deg

    def _seconds(self, utc: datetime) -> float:
        return (utc - self._origin_utc) / timedelta(seconds=1)

    def _now_s(self) -> float:
        return self._seconds(self._clock())

    def _asked(self, utc: datetime | None) -> tuple[datetime, float, _Motion]:
        with self._lock:
            motion = self._motion
            utc = self._clock() if utc is None else utc
        return utc, self._seconds(utc), motion
