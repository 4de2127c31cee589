"""Questions to a simulated mount: what it believes and what it is doing, at any instant."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Literal

from mountnav.devices import PierSide
from mountnav.simulation.belief import Belief
from mountnav.simulation.geometry import perfect_direction
from mountnav.simulation.machine import AxisAngles, Machine
from mountnav.simulation.motion import Axis, AxisName, Limits, Motion, Stage
from mountnav.simulation.motion_limits import limited
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.posture import side_of
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, MountAxes, Site
from mountnav.sky.sphere import half_turn_deg

# A mount within so many degrees of its home is at home (36″). Chosen by hand.
_AT_HOME_DEG = 0.01


class MechanicsReadings:
    """The state of a simulated mount, and all that can be asked of it; see `Mechanics`."""

    def __init__(
        self,
        site: Site,
        air: Air,
        errors: PointingErrors,
        machine: Machine,
        clock: Callable[[], datetime],
        start: Apparent | None,
    ) -> None:
        self.site, self.air, self.errors, self.machine = site, air, errors, machine
        self.boots = 0
        self._rates_deg_s = {
            "ha": machine.slew_rate_deg_s,
            "dec": machine.dec_slew_rate_deg_s or machine.slew_rate_deg_s,
        }
        self._accelerations_deg_s2 = {
            "ha": machine.acceleration_deg_s2,
            "dec": machine.dec_acceleration_deg_s2 or machine.acceleration_deg_s2,
        }
        self._clock = clock
        self._lock = threading.Lock()
        self._origin_utc = clock()
        belief = Belief(
            0.0, site, clock_off_s=machine.clock_offset_s, clock_drift_ppm=machine.clock_drift_ppm
        )
        axes = {
            "zenith": (0.0, site.latitude_deg),
            "home": machine.home_at(site.latitude_deg),
            "park": machine.park_at(site.latitude_deg),
        }[machine.starts_at]
        if start is not None:
            axes = belief.hour_angle(start, self._origin_utc, 0.0)
        parked = machine.starts_at == "park" and start is None
        tracking = machine.tracks_at_start and not parked
        play_deg = errors.backlash_arcsec / 3600.0
        velocity = SIDEREAL_DEG_S if tracking else 0.0
        ha = Axis.resting(axes[0], velocity, play_deg, self._limits("ha"))
        dec = Axis.resting(axes[1], 0.0, play_deg, self._limits("dec"))
        if parked:  # at the goal of having been parked
            ha = replace(ha, goal=replace(ha.goal, angle_deg=axes[0]))
            dec = replace(dec, goal=replace(dec.goal, angle_deg=axes[1]))
        self._motion = Motion(
            Stage(0.0, ha, dec, tracking),
            (belief,),
            machine.park_at(site.latitude_deg),
            bound_for="park" if parked else "",
        )
        self._motion = self._limited(self._motion, 0.0)

    # -- where it is -----------------------------------------------------------------------------

    def reported(self, utc: datetime | None = None) -> Apparent:
        """Where the mount believes it points: the axes as perfect geometry, synced, no refraction.

        The numbers are those of its own clock and site; their instant is the true one.
        """
        utc, t_s, motion = self._asked(utc)
        belief = motion.belief_at(t_s)
        return belief.place(*perfect_direction(*self._believed_axes(motion, belief, t_s)), utc, t_s)

    def axes(self, utc: datetime | None = None) -> MountAxes:
        """Read the motors' encoders: no sync, no errors."""
        _, t_s, motion = self._asked(utc)
        ha_deg, dec_deg = self._encoders(motion, motion.belief_at(t_s), t_s)
        return MountAxes(half_turn_deg(ha_deg), dec_deg)

    def axis_angle(self, axis: AxisName, utc: datetime | None = None) -> float:
        """Read one encoder, deg, over all turns."""
        _, t_s, motion = self._asked(utc)
        return self._encoders(motion, motion.belief_at(t_s), t_s)[0 if axis == "ha" else 1]

    def axis_velocity(self, axis: AxisName, utc: datetime | None = None) -> float:
        """Velocity of one axis, deg/s."""
        _, t_s, motion = self._asked(utc)
        return self._path(motion, axis).path.velocity_at(t_s)

    def axis_moving(self, axis: AxisName, utc: datetime | None = None) -> bool:
        """Whether one motor runs (tracking counts), or tries to."""
        _, t_s, motion = self._asked(utc)
        path = self._path(motion, axis).path
        return path.velocity_at(t_s) != 0.0 or not path.steady_at(t_s)

    # -- what it does ----------------------------------------------------------------------------

    def slewing(self, utc: datetime | None = None) -> bool:
        """Whether an axis does anything but track, rest or carry out a guide pulse."""
        _, t_s, motion = self._asked(utc)
        return not (motion.last.ha.quiet_at(t_s) and motion.last.dec.quiet_at(t_s))

    def guiding(self, utc: datetime | None = None) -> bool:
        """Whether a guide pulse runs."""
        _, t_s, motion = self._asked(utc)
        return motion.last.ha.path.guiding_at(t_s) or motion.last.dec.path.guiding_at(t_s)

    @property
    def at_limit(self) -> bool:
        """Whether a limit has ended the last motion or the tracking."""
        _, t_s, motion = self._asked(None)
        return motion.stage_at(t_s).at_limit

    @property
    def parked(self) -> bool:
        """Whether it stands parked, until `unpark`."""
        _, t_s, motion = self._asked(None)
        return motion.bound_for == "park" and motion.arrived_at(t_s)

    @property
    def parking(self) -> bool:
        """Whether it is on its way to park; stays true when it doesn't get there."""
        _, t_s, motion = self._asked(None)
        return motion.bound_for == "park" and not motion.arrived_at(t_s)

    @property
    def homing(self) -> bool:
        """Whether it is on its way home; stays true while it doesn't get there."""
        utc, _, motion = self._asked(None)
        return motion.bound_for == "home" and self.slewing(utc)

    @property
    def at_home(self) -> bool:
        """Whether it stands still at what it believes to be its home."""
        _, t_s, motion = self._asked(None)
        believed = self._believed_axes(motion, motion.belief_at(t_s), t_s)
        home = self.machine.home_at(self.site.latitude_deg)
        moving = any(axis.path.velocity_at(t_s) for axis in (motion.last.ha, motion.last.dec))
        return not moving and all(
            abs(half_turn_deg(a - b)) < _AT_HOME_DEG for a, b in zip(believed, home, strict=True)
        )

    def pier_side(self, utc: datetime | None = None) -> PierSide:
        """On which side the mount believes its tube to hang; a fork doesn't know any."""
        _, t_s, motion = self._asked(utc)
        return side_of(self._believed_axes(motion, motion.belief_at(t_s), t_s)[1], self.machine)

    # -- clock, site, altitude -------------------------------------------------------------------

    def believed_utc(self, utc: datetime | None = None) -> datetime:
        """What its own clock shows."""
        utc, t_s, motion = self._asked(utc)
        return motion.belief_at(t_s).utc(utc, t_s)

    @property
    def believed_site(self) -> Site:
        """Where it believes to stand."""
        _, t_s, motion = self._asked(None)
        return motion.belief_at(t_s).site

    def believed_altitude_deg(self, place: Apparent, utc: datetime | None = None) -> float:
        """Altitude of an apparent place as the mount computes it now: no refraction, no errors."""
        utc, t_s, motion = self._asked(utc)
        belief = motion.belief_at(t_s)
        return belief.altitude_deg(*belief.hour_angle(place, utc, t_s))

    # -- inside ----------------------------------------------------------------------------------

    @staticmethod
    def _path(motion: Motion, axis: AxisName) -> Axis:
        return motion.last.ha if axis == "ha" else motion.last.dec

    def _encoders(self, motion: Motion, belief: Belief, t_s: float) -> AxisAngles:
        ha_deg = motion.last.ha.path.angle_at(t_s) + belief.ha_counts_deg
        dec_deg = motion.last.dec.path.angle_at(t_s) + belief.dec_counts_deg
        if self.machine.encoder_arcsec > 0.0:
            step_deg = self.machine.encoder_arcsec / 3600.0
            ha_deg, dec_deg = round(ha_deg / step_deg) * step_deg, round(dec_deg / step_deg) * step_deg
        return ha_deg, dec_deg

    def _tracking(self) -> bool:
        _, t_s, motion = self._asked(None)
        return motion.stage_at(t_s).tracking

    def _believed_axes(self, motion: Motion, belief: Belief, t_s: float) -> AxisAngles:
        ha_deg, dec_deg = self._encoders(motion, belief, t_s)
        return ha_deg + belief.ha_sync_deg, dec_deg + belief.dec_sync_deg

    def _limits(self, axis: Literal["ha", "dec"]) -> Limits:
        return Limits(self._rates_deg_s[axis], self._accelerations_deg_s2[axis])

    def _limited(self, motion: Motion, t_s: float) -> Motion:
        return limited(motion, t_s, self.machine, self._limits("ha"), self._limits("dec"))

    def _seconds(self, utc: datetime) -> float:
        return (utc - self._origin_utc) / timedelta(seconds=1)

    def _asked(self, utc: datetime | None) -> tuple[datetime, float, Motion]:
        with self._lock:
            motion = self._motion
            utc = self._clock() if utc is None else utc
        return utc, self._seconds(utc), motion
