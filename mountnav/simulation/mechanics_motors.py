"""Orders below the sky: single axes as a motor controller drives them, faults, power."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from mountnav.devices import TrackingRate
from mountnav.errors import BadSettings
from mountnav.simulation.belief import Belief, believing, without_homing
from mountnav.simulation.mechanics_truth import MechanicsTruth
from mountnav.simulation.motion import AxisName, Goal, Limits, Motion
from mountnav.simulation.rate_faults import RateFault
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site
from mountnav.sky.sphere import half_turn_deg

_BOOT_UTC = datetime(2000, 1, 1, tzinfo=UTC)
_AXES: tuple[AxisName, AxisName] = ("ha", "dec")


@dataclass(slots=True)
class Order:
    """An order being carried out: when, and the motion that it changes."""

    utc: datetime
    t_s: float
    motion: Motion
    parked: bool


_Change = Callable[[Belief], Belief]


class MechanicsMotors(MechanicsTruth):
    """Single axes, faults and power of a simulated mount; see `Mechanics`."""

    # -- rates -----------------------------------------------------------------------------------

    @property
    def slew_rate_deg_s(self) -> float:
        """Of the hour angle axis; setting it sets both axes, for orders to come."""
        return self._rates_deg_s["ha"]

    @slew_rate_deg_s.setter
    def slew_rate_deg_s(self, rate_deg_s: float) -> None:
        self._rates_deg_s = dict.fromkeys(_AXES, positive("slew_rate_deg_s", rate_deg_s))

    @property
    def acceleration_deg_s2(self) -> float:
        """Of the hour angle axis; setting it sets both axes, for orders to come."""
        return self._accelerations_deg_s2["ha"]

    @acceleration_deg_s2.setter
    def acceleration_deg_s2(self, acceleration_deg_s2: float) -> None:
        value = positive("acceleration_deg_s2", acceleration_deg_s2)
        self._accelerations_deg_s2 = dict.fromkeys(_AXES, value)

    # -- single axes -----------------------------------------------------------------------------

    def drive(
        self,
        axis: AxisName,
        velocity_deg_s: float,
        acceleration_deg_s2: float | None = None,
        *,
        follows: bool = False,
    ) -> None:
        """Run one motor at a velocity (over the ground, at most the slew rate) from now on.

        Tracking is off then: the controller that drives single axes knows no sky.

        Parameters
        ----------
        follows : bool
            It is meant to follow something in the sky: then faults of rates spoil it, by what it differs
            from following a star.
        """
        rate = self._rates_deg_s[axis]
        velocity = max(-rate, min(rate, velocity_deg_s))
        limits = self._limits_with(axis, rate, acceleration_deg_s2)
        with self._order(raw=True) as order:
            self._note_driven(order, axis, velocity if follows else None)
            goal = Goal(order.t_s, velocity, limits, steady=velocity == 0.0)
            self._send(order, axis, goal)
            if follows:
                self._spoil_driven(order)

    def drive_to(
        self,
        axis: AxisName,
        angle_deg: float,
        rate_deg_s: float | None = None,
        acceleration_deg_s2: float | None = None,
    ) -> None:
        """Turn one motor until its encoder (`axis_angle`) shows an angle, and rest there."""
        rate = min(abs(rate_deg_s or math.inf), self._rates_deg_s[axis])
        limits = self._limits_with(axis, rate, acceleration_deg_s2)
        with self._order(raw=True) as order:
            self._note_driven(order, axis, None)
            belief = order.motion.belief_at(order.t_s)
            counts_deg = belief.ha_counts_deg if axis == "ha" else belief.dec_counts_deg
            self._send(order, axis, Goal(order.t_s, 0.0, limits, angle_deg - counts_deg))

    def halt(self, axis: AxisName, instant: bool = False) -> None:
        """Stop one motor: slowing down, or at once; counts as a stop for `run_away`."""
        with self._order(raw=True) as order:
            self._note_driven(order, axis, None)
            one, goal = order.motion.axis(axis), Goal(order.t_s, 0.0, self._limits(axis))
            heeded = one.deaf_stops == 0
            one = one.stopped(order.t_s, goal)
            if instant and heeded:
                one = one.halted(order.t_s, goal)
            order.motion = order.motion.with_axis(axis, one)

    def set_encoder(self, axis: AxisName, angle_deg: float) -> None:
        """Let one encoder show an angle from now on: the counts are labeled again, the tube doesn't move."""
        with self._order(moves=False) as order:
            motor_deg = order.motion.axis(axis).path.angle_at(order.t_s)
            counts_deg = angle_deg - motor_deg
            if axis == "ha":
                self._believe(order, lambda belief: replace(belief, ha_counts_deg=counts_deg))
            else:
                self._believe(order, lambda belief: replace(belief, dec_counts_deg=counts_deg))

    # -- faults ----------------------------------------------------------------------------------

    def stick(self, axis: AxisName) -> None:
        """Block one axis: it stands still, at once, whatever is ordered; the encoder sees it.

        Orders are taken; one that can't be carried out leaves `slewing` true.
        """
        with self._order(moves=False) as order:
            one = order.motion.axis(axis)
            order.motion = order.motion.with_axis(axis, replace(one, stuck=True).retried(order.t_s))
            order.motion = self._not_homing(order)

    def unstick(self, axis: AxisName) -> None:
        """Free an axis: it goes after what it was last ordered to do."""
        with self._order(moves=False) as order:
            one = order.motion.axis(axis)
            if one.stuck:
                order.motion = order.motion.with_axis(axis, replace(one, stuck=False).retried(order.t_s))

    def run_away(self, axis: AxisName, *, past_target: bool = True, deaf_stops: int = 0) -> None:
        """Let one axis run away.

        Parameters
        ----------
        past_target : bool
            A slew (also the present one) doesn't end at its target but goes on at its rate, until a stop
            is heeded; that ends the fault.
        deaf_stops : int
            So many stops (each of `stop`, `stop_move`, `halt`) are not heeded.
        """
        with self._order(moves=False) as order:
            one = order.motion.axis(axis)
            chasing = one.goal.angle_deg is not None and one.arrives_s > order.t_s and not one.stuck
            one = replace(one, past_target=past_target, deaf_stops=deaf_stops)
            order.motion = order.motion.with_axis(axis, one.retried(order.t_s) if chasing else one)
            order.motion = self._not_homing(order)

    def fail_rates(self, fault: RateFault) -> Callable[[], None]:
        """Get rates beside the sidereal one wrong from now on, those in force as well.

        Several faults come one after the other.

        Returns
        -------
        callable
            Ends this fault; harmless when it has ended.
        """

        def change(added: tuple[RateFault, ...]) -> None:
            with self._order(moves=False) as order:
                # by identity: of two equal faults each ends for itself
                others = tuple(one for one in order.motion.rate_faults if one is not fault)
                order.motion = replace(order.motion, rate_faults=others + added)
                if order.motion.rate is TrackingRate.CUSTOM and order.motion.now.tracking:
                    self._track(order, True)
                self._spoil_driven(order)

        fault = replace(fault)
        change((fault,))
        return lambda: change(())

    @property
    def fails_rates(self) -> bool:
        """Whether a fault of rates is in force."""
        return bool(self._motion.rate_faults)

    def align(self) -> None:
        """Somebody sets both axes by their marks: what it believes of them is right from now on.

        A sync can't do that: it tells a place, and neither the posture nor, at the pole, the hour angle.
        """
        with self._order(moves=False) as order:
            self._believe(
                order,
                lambda belief: replace(
                    belief, ha_counts_deg=0.0, dec_counts_deg=0.0, ha_sync_deg=0.0, dec_sync_deg=0.0
                ),
            )

    # -- power -----------------------------------------------------------------------------------

    def power_loss(self, *, coasts: bool = False) -> None:
        """Lose power: all motion ends, at once or slowing down; what it forgets shows after `reboot`."""
        with self._order() as order:
            self._unpowered(order, coasts)

    def reboot(self, *, coasts: bool = False) -> None:
        """Lose power and get it back: motion ends, and the machine forgets what it is built to forget."""
        with self._order(moves=False) as order:
            kept_parked = order.parked and self.machine.remembers_park
            self._unpowered(order, coasts)
            self._believe(order, lambda belief: self._booted(belief, order, kept_parked))
            order.motion = replace(
                order.motion, beliefs=tuple(one for one in order.motion.beliefs if one.start_s <= order.t_s)
            )
            order.motion = replace(order.motion, rate=TrackingRate.SIDEREAL).with_rates_kept()
            if not kept_parked:
                order.motion = replace(order.motion, bound_for="")
                if self.machine.tracks_at_boot:
                    self._track(order, True)
            self.boots += 1

    def _unpowered(self, order: Order, coasts: bool) -> None:
        if order.parked:
            return  # at rest already, and to be remembered
        motion, t_s = self._not_homing(order), order.t_s
        for name in _AXES:
            one, goal = motion.axis(name), Goal(t_s, 0.0, self._limits(name))
            one = replace(one, past_target=False, deaf_stops=0)
            one = one.ordered(t_s, goal) if coasts else one.halted(t_s, goal)
            motion = motion.with_axis(name, one)
        now = replace(motion.now, tracking=False)
        order.motion = replace(motion, now=now, driven_deg_s=(None, None), bound_for="")

    def _booted(self, belief: Belief, order: Order, parked: bool) -> Belief:
        machine, motion, t_s = self.machine, order.motion, order.t_s
        parked_at = self._believed_axes(motion, belief, t_s)
        if not machine.remembers_sync:
            belief = replace(belief, ha_sync_deg=0.0, dec_sync_deg=0.0)
        if parked or machine.boots_believing == "home":
            stands = parked_at if parked else machine.home_at(self.site.latitude_deg)
            ha_deg = motion.now.ha.path.pieces[-1].angle_deg  # after coasting down
            dec_deg = motion.now.dec.path.pieces[-1].angle_deg
            belief = replace(
                belief,
                ha_counts_deg=stands[0] - ha_deg - belief.ha_sync_deg,
                dec_counts_deg=stands[1] - dec_deg - belief.dec_sync_deg,
            )
        if not machine.remembers_clock:
            off_s = ((machine.boot_utc or _BOOT_UTC) - order.utc).total_seconds()
            belief = replace(belief, clock_off_s=off_s, clock_since_s=t_s)
        if not machine.remembers_site:
            belief = replace(belief, site=Site(*(machine.boot_site or (0.0, 0.0))))
        return belief

    # -- inside ----------------------------------------------------------------------------------

    @contextmanager
    def _order(self, *, moves: bool = True, raw: bool = False) -> Iterator[Order]:
        """Carry out one order now: holds the lock, starts from the present, applies the limits at the end.

        `moves`: it ends parking and homing; `raw`: it ends tracking and being parked as well.
        """
        with self._lock:
            utc = self._clock()
            t_s = self._seconds(utc)
            motion = self._motion
            parked = motion.bound_for == "park" and motion.arrived_at(t_s)
            order = Order(utc, t_s, replace(motion, now=motion.stage_at(t_s), later=()), parked)
            if raw or (moves and not parked):
                order.motion = self._not_homing(order)
                order.motion = replace(order.motion, bound_for="")
            if raw and order.motion.now.tracking:
                self._track(order, False)
            yield order
            self._motion = self._limited(order.motion, t_s)

    def _send(self, order: Order, axis: AxisName, goal: Goal) -> None:
        motion = replace(order.motion, now=replace(order.motion.now, at_limit=False))
        order.motion = motion.with_axis(axis, motion.axis(axis).ordered(order.t_s, goal))

    def _believe(self, order: Order, change: _Change) -> None:
        beliefs = believing(order.motion.beliefs, order.t_s, change)
        order.motion = replace(order.motion, beliefs=beliefs)

    @staticmethod
    def _not_homing(order: Order) -> Motion:
        return replace(order.motion, beliefs=without_homing(order.motion.beliefs, order.t_s))

    def _limits_with(self, axis: AxisName, rate: float, acceleration: float | None) -> Limits:
        return Limits(rate, acceleration or self._accelerations_deg_s2[axis])

    def _north_here(self, order: Order) -> float:
        """-1 where north lowers the declination axis: here, or where it is slewing to."""
        dec = order.motion.now.dec
        aim = dec.goal.angle_at(order.t_s) if dec.arrives_s > order.t_s else None
        dec_deg = dec.path.angle_at(order.t_s) if aim is None else aim
        return self._north_at(dec_deg + order.motion.belief_at(order.t_s).dec_shift_deg)

    def _north_at(self, dec_axis_deg: float) -> float:
        past_pole = self.machine.mounting == "german" and abs(half_turn_deg(dec_axis_deg)) > 90.0
        return -1.0 if past_pole else 1.0

    @staticmethod
    def _note_driven(order: Order, axis: AxisName, velocity_deg_s: float | None) -> None:
        """Note at which velocity a controller of single axes follows the sky with one; None: with none."""
        ha, dec = order.motion.driven_deg_s
        driven = (velocity_deg_s, dec) if axis == "ha" else (ha, velocity_deg_s)
        order.motion = replace(order.motion, driven_deg_s=driven)

    def _spoil_driven(self, order: Order) -> None:
        """Let the faults of rates change the velocities of axes that follow the sky."""
        motion, north = order.motion, self._north_here(order)
        ha, dec = motion.driven_deg_s
        kept = motion.followed_deg_s(
            SIDEREAL_DEG_S if ha is None else ha, 0.0 if dec is None else north * dec, north
        )
        for name, ordered, velocity in zip(_AXES, (ha, dec), kept, strict=True):
            goal, most = motion.axis(name).goal, self._rates_deg_s[name]
            velocity = max(-most, min(most, velocity))
            if ordered is not None and goal.velocity_deg_s != velocity:
                goal = Goal(order.t_s, velocity, goal.limits, steady=velocity == 0.0)
                self._send(order, name, goal)

    def _track(self, order: Order, on: bool) -> None:
        """Track or rest from now on; during a slew, when it has arrived."""
        rests = order.motion.tracking_deg_s(on, self._north_here(order))
        motion = replace(order.motion, now=replace(order.motion.now, tracking=on))
        for name, rest_deg_s in zip(_AXES, rests, strict=True):
            one = motion.axis(name)
            motion = motion.with_axis(name, one.steadied(order.t_s, rest_deg_s, self._limits(name)))
        order.motion = motion


def positive(name: str, value: float) -> float:
    """Refuse a rate that can't move a mount."""
    if not (math.isfinite(value) and value > 0.0):
        raise BadSettings(f"{name} = {value} can't move a mount", advice="> 0")
    return value
