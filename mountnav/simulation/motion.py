"""What orders change: the motion of both axes with what they are out for, as values of one instant.

An `Axis` knows its goal besides its path, so that it can take it up again after it was stuck. A `Motion` is
what was ordered last, and in `later` what comes of it by itself when a limit is reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from mountnav.devices import TRACKING_DEG_S, TrackingRate
from mountnav.simulation.axes import AxisPath
from mountnav.simulation.belief import Belief
from mountnav.simulation.machine import AxisAngles
from mountnav.simulation.rate_faults import RateFault, kept_rates
from mountnav.sky.coordinates import SIDEREAL_DEG_S

AxisName = Literal["ha", "dec"]
# An axis within so many degrees of its aim has arrived (0.004″): above the rounding of its path.
_THERE_DEG = 1e-6


@dataclass(frozen=True, slots=True)
class Limits:
    """Fastest motion of an axis."""

    rate_deg_s: float
    acceleration_deg_s2: float


@dataclass(frozen=True, slots=True)
class Goal:
    """What an axis is out for: an angle that runs at `velocity_deg_s`, then `after_deg_s`; or a velocity."""

    since_s: float
    velocity_deg_s: float
    limits: Limits
    angle_deg: float | None = None
    after_deg_s: float = 0.0
    steady: bool = True

    def angle_at(self, t_s: float) -> float | None:
        """Where the target is at `t_s`, while it is chased."""
        if self.angle_deg is None:
            return None
        return self.angle_deg + self.velocity_deg_s * (t_s - self.since_s)


@dataclass(frozen=True, slots=True)
class Axis:
    """One axis: its path, its goal and its faults.

    Attributes
    ----------
    arrives_s : float
        When the goal is reached; infinite when it won't be.
    stuck : bool
        It stands still, whatever is ordered; the encoder sees that.
    past_target : bool
        A slew goes on past its target.
    deaf_stops : int
        So many stops are not heeded.
    """

    path: AxisPath
    goal: Goal
    arrives_s: float = 0.0
    stuck: bool = False
    past_target: bool = False
    deaf_stops: int = 0

    @classmethod
    def resting(cls, angle_deg: float, velocity_deg_s: float, play_deg: float, limits: Limits) -> Axis:
        """Make an axis in steady motion at instant 0."""
        path = AxisPath.resting(0.0, angle_deg, velocity_deg_s, play_deg)
        return cls(path, Goal(0.0, velocity_deg_s, limits))

    def ordered(self, t_s: float, goal: Goal) -> Axis:
        """Set out for a goal at `t_s`, as far as the faults let it."""
        aim = goal.angle_at(t_s)
        limits = goal.limits
        if self.stuck:
            idle = goal.steady if aim is None else abs(aim - self.path.angle_at(t_s)) < _THERE_DEG
            return replace(
                self, path=self.path.halted(t_s, steady=idle), goal=goal, arrives_s=t_s if idle else math.inf
            )
        if aim is None:
            path = self.path.to_velocity(
                t_s, goal.velocity_deg_s, limits.acceleration_deg_s2, steady=goal.steady
            )
            return replace(self, path=path, goal=goal, arrives_s=path.pieces[-1].start_s)
        if self.past_target:
            away = math.copysign(limits.rate_deg_s, aim - self.path.angle_at(t_s))
            path = self.path.to_velocity(t_s, away, limits.acceleration_deg_s2, steady=False)
            return replace(self, path=path, goal=goal, arrives_s=math.inf)
        path = self.path.to_angle(
            t_s, aim, goal.velocity_deg_s, limits.rate_deg_s, limits.acceleration_deg_s2
        )
        arrives_s = path.pieces[-1].start_s
        if goal.after_deg_s != goal.velocity_deg_s:
            path = path.to_velocity(arrives_s, goal.after_deg_s, limits.acceleration_deg_s2, steady=True)
        return replace(self, path=path, goal=goal, arrives_s=arrives_s)

    def steadied(self, t_s: float, velocity_deg_s: float, limits: Limits) -> Axis:
        """Rest or track at `velocity_deg_s` from `t_s` on; during a slew or a pulse, when that is over."""
        if self.goal.angle_deg is not None and self.arrives_s > t_s:
            after = replace(self.goal, after_deg_s=velocity_deg_s)
            return replace(self, goal=after).followed(self.arrives_s, velocity_deg_s)
        last = self.path.pieces[-1]
        if not last.steady:
            return self
        goal = Goal(t_s, velocity_deg_s, limits)
        return self.ordered(max(t_s, last.start_s), goal)

    def followed(self, t_s: float, velocity_deg_s: float) -> Axis:
        """Having arrived, go on at another velocity from `t_s` on."""
        if velocity_deg_s == self.path.pieces[-1].velocity_deg_s or not math.isfinite(self.arrives_s):
            return replace(self, goal=replace(self.goal, after_deg_s=velocity_deg_s))
        path = self.path.to_velocity(
            max(t_s, self.arrives_s), velocity_deg_s, self.goal.limits.acceleration_deg_s2, steady=True
        )
        return replace(self, path=path, goal=replace(self.goal, after_deg_s=velocity_deg_s))

    def stopped(self, t_s: float, goal: Goal) -> Axis:
        """Heed a stop, or not; one that is heeded ends a runaway."""
        if self.deaf_stops > 0:
            return replace(self, deaf_stops=self.deaf_stops - 1)
        return replace(self, past_target=False).ordered(t_s, goal)

    def pulsed(self, t_s: float, rate_deg_s: float, goal: Goal, duration_s: float) -> Axis:
        """Run a guide pulse on top of the goal's velocity."""
        if self.stuck:
            return self.ordered(t_s, goal)
        path = self.path.pulsed(
            t_s, rate_deg_s, goal.velocity_deg_s, goal.limits.acceleration_deg_s2, duration_s
        )
        return replace(self, path=path, goal=goal, arrives_s=path.pieces[-1].start_s)

    def halted(self, t_s: float, goal: Goal) -> Axis:
        """Stand still at once, as without power."""
        return replace(self, path=self.path.halted(t_s), goal=goal, arrives_s=t_s)

    def retried(self, t_s: float) -> Axis:
        """Take up the goal again, under the faults as they are now."""
        return self.ordered(t_s, self.goal)

    def quiet_at(self, t_s: float) -> bool:
        """Whether it does nothing but track, rest or guide."""
        return self.path.steady_at(t_s) or self.path.guiding_at(t_s)

    def there_at(self, t_s: float) -> bool:
        """Whether it has arrived at the angle it was sent to, and stays there."""
        aim = self.goal.angle_at(t_s)
        if aim is None or t_s < self.arrives_s or not self.path.steady_at(t_s):
            return False
        return abs(self.path.angle_at(t_s) - aim) < _THERE_DEG


@dataclass(frozen=True, slots=True)
class Stage:
    """Motion from `start_s` on.

    `at_limit`: a limit has ended what was ordered; `rates_lost`: a fault has made it forget custom rates.
    """

    start_s: float
    ha: Axis
    dec: Axis
    tracking: bool
    at_limit: bool = False
    rates_lost: bool = False


@dataclass(frozen=True, slots=True)
class Motion:
    """Everything that orders change, in one value, so that a question sees one consistent state.

    Attributes
    ----------
    now : Stage
        What was ordered, as if there were no limits.
    later : tuple of Stage
        What the limits will make of it, in order of time.
    beliefs : tuple of Belief
        In order of time, future ones at the end.
    custom_deg_s : (float, float)
        Custom rates as they were ordered: of the hour angle axis, and of declination (north positive).
    driven_deg_s : (float or None, float or None)
        At which velocities a controller of single axes was last told to follow the sky; None: at none.
    rate_faults : tuple of RateFault
        How it gets custom rates wrong.
    bound_for : {"", "park", "home"}
        Station that it is on its way to or stands at.
    park_axes : (float, float)
        Believed axis angles of the park position.
    """

    now: Stage
    beliefs: tuple[Belief, ...]
    park_axes: AxisAngles
    later: tuple[Stage, ...] = ()
    rate: TrackingRate = TrackingRate.SIDEREAL
    custom_deg_s: tuple[float, float] = (TRACKING_DEG_S[TrackingRate.SIDEREAL], 0.0)
    driven_deg_s: tuple[float | None, float | None] = (None, None)
    rate_faults: tuple[RateFault, ...] = ()
    bound_for: Literal["", "park", "home"] = ""

    @property
    def last(self) -> Stage:
        """The stage whose paths hold all of past and plan."""
        return self.later[-1] if self.later else self.now

    def stage_at(self, t_s: float) -> Stage:
        """Find the stage in force at `t_s`."""
        reached = [stage for stage in self.later if stage.start_s <= t_s]
        return reached[-1] if reached else self.now

    def axis(self, name: AxisName) -> Axis:
        """Look up an axis as ordered."""
        return self.now.ha if name == "ha" else self.now.dec

    def with_axis(self, name: AxisName, axis: Axis) -> Motion:
        """Replace an axis."""
        now = replace(self.now, ha=axis) if name == "ha" else replace(self.now, dec=axis)
        return replace(self, now=now)

    def belief_at(self, t_s: float) -> Belief:
        """Find the belief in force at `t_s`."""
        for belief in reversed(self.beliefs):
            if belief.start_s <= t_s:
                return belief
        return self.beliefs[0]

    def tracking_deg_s(self, on: bool, north: float) -> AxisAngles:
        """Velocities of the axes when they track; `north` is -1 where north lowers the declination axis."""
        if not on:
            return 0.0, 0.0
        if self.rate is not TrackingRate.CUSTOM:
            return TRACKING_DEG_S[self.rate], 0.0
        if self.now.rates_lost:
            return SIDEREAL_DEG_S, 0.0
        return self.followed_deg_s(*self.custom_deg_s, north)

    def followed_deg_s(self, ha_deg_s: float, dec_deg_s: float, north: float) -> AxisAngles:
        """Velocities of the axes when it is to follow at these rates (declination: north positive)."""
        if not self.rate_faults:
            return ha_deg_s, north * dec_deg_s
        ra_deg_s, dec_deg_s = kept_rates(self.rate_faults, (SIDEREAL_DEG_S - ha_deg_s, dec_deg_s))
        if any(fault.unturned for fault in self.rate_faults):
            north = 1.0
        return SIDEREAL_DEG_S - ra_deg_s, north * dec_deg_s

    def with_rates_kept(self) -> Motion:
        """The same motion, with custom rates that are not lost: they were ordered again."""
        return replace(self, now=replace(self.now, rates_lost=False))

    def changed_sides(self, stage: Stage) -> Stage:
        """The same stage, of a mount that changes sides in it."""
        lost = any(fault.lost_by_flip for fault in self.rate_faults)
        return replace(stage, rates_lost=stage.rates_lost or lost)

    def arrived_at(self, t_s: float) -> bool:
        """Whether it stands where its last slew, park or home was to lead."""
        stage = self.stage_at(t_s)
        return stage.ha.there_at(t_s) and stage.dec.there_at(t_s)
