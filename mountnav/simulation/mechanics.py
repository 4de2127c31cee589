"""The mechanics of a telescope that points wrong: what the mount believes, and where the tube truly looks.

Two motor axes move along closed formulas of time (`axes`), up to their limits (`motion_limits`). The belief
(`belief`) reads them as perfect geometry, through the sync offset, without refraction, by its own clock. The
truth adds backlash, periodic error and geometry errors (`geometry`), and takes the result as the observed,
refracted direction. A sync changes the belief, never the truth.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from typing import Literal

from mountnav.clock import utc_now
from mountnav.devices import PierSide
from mountnav.errors import Refusal
from mountnav.simulation.belief import believing, with_future
from mountnav.simulation.geometry import perfect_direction
from mountnav.simulation.machine import Machine, Mounting
from mountnav.simulation.mechanics_motors import Order, positive
from mountnav.simulation.mechanics_stations import MechanicsStations
from mountnav.simulation.motion import AxisName, Goal, Stage
from mountnav.simulation.pointing_errors import PointingErrors
from mountnav.simulation.posture import axes_at, side_for, side_of, turned_near, within_reach
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, Apparent, Site
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

__all__ = [
    "AxisName",
    "Direction",
    "Machine",
    "Mechanics",
    "Mounting",
    "PointingErrors",
    "SyncBehavior",
]

Direction = Literal["n", "s", "e", "w"]
SyncBehavior = Literal[
    "normal", "ignore", "refuse", "late", "double", "reverse", "half", "dec-only", "elsewhere"
]
_TAKEN = {"double": 2.0, "reverse": -1.0, "half": 0.5}
"""How much of what a sync asks for is taken by a mount that does it wrongly."""
_DAMAGED_DEG = 18310.0 / 3600.0
"""So far off was a mount that took a ``:Sd`` with a damaged digit."""


class Mechanics(MechanicsStations):
    """An equatorial mount on a fork (each axis moves the shortest way) or a German one (it changes sides).

    Parameters
    ----------
    site, air : Site, Air
        Where it stands; `air.pressure_hpa` = 0 leaves refraction out of the truth.
    errors : PointingErrors
        How wrong it points.
    machine : Machine, optional
        How it is built; a fork without limits if None.
    slew_rate_deg_s, acceleration_deg_s2 : float, optional
        Of both axes, > 0; instead of the machine's.
    clock : callable
        Gives the present instant, aware UTC. Orders take effect then; questions default to it.
    start : Apparent, optional
        What it believes to point at when made; as the machine says if None. It tracks from the start,
        unless the machine says otherwise.

    Attributes
    ----------
    boots : int
        How often it was rebooted.
    sync_behavior : SyncBehavior
        What it does with syncs; may be set at any time. "dec-only": right ascension stays as it was.
        "elsewhere": it takes the place 5.1° further south, as if a digit were damaged on the way.
    sync_late_s : float
        How long a late sync takes.

    Raises
    ------
    BadSettings
        When a rate is not positive.

    Notes
    -----
    Thread-safe. Any question may be asked of any instant: the past is kept for some hundred orders, the
    future is the one that follows if no further order comes. Orders while it is parked change nothing,
    except `unpark`, faults and power.
    """

    def __init__(
        self,
        site: Site,
        air: Air,
        errors: PointingErrors,
        *,
        machine: Machine | None = None,
        slew_rate_deg_s: float | None = None,
        acceleration_deg_s2: float | None = None,
        clock: Callable[[], datetime] = utc_now,
        start: Apparent | None = None,
    ) -> None:
        machine = machine or Machine()
        if slew_rate_deg_s is not None:
            rate = positive("slew_rate_deg_s", slew_rate_deg_s)
            machine = replace(machine, slew_rate_deg_s=rate, dec_slew_rate_deg_s=None)
        if acceleration_deg_s2 is not None:
            acceleration = positive("acceleration_deg_s2", acceleration_deg_s2)
            machine = replace(machine, acceleration_deg_s2=acceleration, dec_acceleration_deg_s2=None)
        super().__init__(site, air, errors, machine, clock, start)
        self.sync_behavior: SyncBehavior = "normal"
        self.sync_late_s = 5.0

    # -- before an order -------------------------------------------------------------------------

    def refusal(self, place: Apparent, side: PierSide | None = None) -> Refusal | None:
        """Why a careful controller would not slew there now (parked, below horizon, limit), or None.

        `slew` itself is careless: it looks at nothing but being parked, and ends at the limits.
        """
        utc, t_s, motion = self._asked(None)
        if motion.bound_for == "park" and motion.arrived_at(t_s):
            return Refusal.PARKED
        belief = motion.belief_at(t_s)
        ha_deg, dec_deg = belief.hour_angle(place, utc, t_s)
        lowest_deg = self.machine.lowest_altitude_deg
        if lowest_deg is not None and belief.altitude_deg(ha_deg, dec_deg) < lowest_deg:
            return Refusal.BELOW_HORIZON
        side = side or self._side_for(ha_deg, dec_deg, self.pier_side())
        axes = axes_at(ha_deg, dec_deg, self.machine, side, belief.site.latitude_deg)
        return None if within_reach(axes, self.machine) else Refusal.LIMIT

    def destination_side(self, place: Apparent) -> PierSide:
        """On which side the tube would hang after a slew there; a fork doesn't know any."""
        utc, t_s, motion = self._asked(None)
        return self._side_for(*motion.belief_at(t_s).hour_angle(place, utc, t_s), self.pier_side())

    # -- slew, sync, stop ------------------------------------------------------------------------

    def slew(self, target: Apparent, side: PierSide | None = None) -> Refusal | None:
        """Set out for a place, and track it from then on; says no only when it is parked.

        The place's numbers are taken as of date now, as a mount does. Its altitude is not looked at.
        A German mount takes the `side` that is asked for, or else `destination_side`.
        """
        with self._order() as order:
            if order.parked:
                return Refusal.PARKED
            t_s, motion = order.t_s, order.motion
            belief = motion.belief_at(t_s)
            ha_deg, dec_deg = belief.hour_angle(target, order.utc, t_s)
            near = motion.now.ha.path.angle_at(t_s), motion.now.dec.path.angle_at(t_s)
            present = side_of(near[1] + belief.dec_shift_deg, self.machine)
            side = side or self._side_for(ha_deg, dec_deg, present)
            ha_aim, dec_aim = axes_at(ha_deg, dec_deg, self.machine, side, belief.site.latitude_deg)
            aim = turned_near(
                (ha_aim - belief.ha_shift_deg, dec_aim - belief.dec_shift_deg),
                near,
                self.machine,
                belief.ha_shift_deg,
            )
            if any(fault.lost_by_slew for fault in motion.rate_faults):
                motion = replace(motion, now=replace(motion.now, rates_lost=True))
            if side is not present:
                motion = replace(motion, now=motion.changed_sides(motion.now))
            order.motion = motion
            after = motion.tracking_deg_s(True, -1.0 if side is PierSide.WEST else 1.0)
            self._send(order, "ha", Goal(t_s, SIDEREAL_DEG_S, self._limits("ha"), aim[0], SIDEREAL_DEG_S))
            self._send(order, "dec", Goal(t_s, 0.0, self._limits("dec"), aim[1]))
            ha, dec = order.motion.now.ha, order.motion.now.dec
            both_s = max(one.arrives_s if math.isfinite(one.arrives_s) else t_s for one in (ha, dec))
            ha, dec = ha.followed(both_s, after[0]), dec.followed(both_s, after[1])
            now = Stage(t_s, ha, dec, True, rates_lost=motion.now.rates_lost)
            order.motion = replace(order.motion, now=now)
        return None

    def sync(self, place: Apparent) -> Refusal | None:
        """From now on believe to point at `place`, in the present posture. The truth doesn't change.

        Says no when it is parked, when `sync_behavior` is "refuse", and beyond the machine's reach.
        """
        with self._order(moves=False) as order:
            if order.parked:
                return Refusal.PARKED
            t_s, motion = order.t_s, order.motion
            belief = motion.belief_at(t_s)
            ha_deg, dec_deg = self._encoders(motion, belief, t_s)
            seen = ha_deg + belief.ha_sync_deg, dec_deg + belief.dec_sync_deg
            reach_deg = self.machine.sync_reach_deg
            if reach_deg is not None:
                now = belief.place(*perfect_direction(*seen), order.utc, t_s)
                if separation_arcsec(now, replace(place, utc=order.utc)) > reach_deg * 3600.0:
                    return Refusal.OTHER
            if self.sync_behavior == "refuse":
                return Refusal.OTHER
            if self.sync_behavior == "ignore":
                return None
            if self.sync_behavior == "elsewhere":
                place = replace(place, dec_deg=max(-90.0, place.dec_deg - _DAMAGED_DEG))
            wanted = axes_at(
                *belief.hour_angle(place, order.utc, t_s),
                self.machine,
                side_of(seen[1], self.machine),
                belief.site.latitude_deg,
            )
            taken = _TAKEN.get(self.sync_behavior, 1.0)
            ha_change, dec_change = (
                taken * half_turn_deg(aim - now) for aim, now in zip(wanted, seen, strict=True)
            )
            synced = replace(
                belief,
                ha_sync_deg=(
                    belief.ha_sync_deg
                    if self.sync_behavior == "dec-only"
                    else half_turn_deg(belief.ha_sync_deg + ha_change)
                ),
                dec_sync_deg=half_turn_deg(belief.dec_sync_deg + dec_change),
            )
            if self.sync_behavior == "late":
                synced = replace(synced, start_s=t_s + self.sync_late_s)
                beliefs = with_future(motion.beliefs, synced)
            else:
                # a homing under way finds its home all the same
                beliefs = believing(
                    motion.beliefs, t_s, lambda one: one if one.by_homing and one.start_s > t_s else synced
                )
            order.motion = replace(motion, beliefs=beliefs)
        return None

    def stop(self) -> None:
        """Slow both axes down to tracking (or rest, if tracking is off); parking and homing end."""
        with self._order() as order:
            if not order.parked:
                self._still(order, "ha")
                self._still(order, "dec")

    # -- motion by hand --------------------------------------------------------------------------

    def move(self, direction: Direction, rate_deg_s: float) -> None:
        """Move on at a rate (relative to tracking, at most the slew rate) until `stop_move` or `stop`.

        North raises the declination axis (lowers it where a German mount looks through the pole), west the
        hour angle.
        """
        with self._order() as order:
            if not order.parked:
                name, signed, base = self._directed(order, direction, rate_deg_s)
                goal = Goal(order.t_s, base + signed, self._limits(name), steady=False)
                self._send(order, name, goal)

    def stop_move(self, direction: Direction) -> None:
        """End a `move` in this direction; the other axis is left alone."""
        with self._order() as order:
            if not order.parked:
                self._still(order, "ha" if direction in ("e", "w") else "dec")

    def pulse(self, direction: Direction, rate_deg_s: float, duration_s: float) -> bool:
        """Carry out a guide pulse: exactly rate times duration, its end planned at once.

        Both axes may be pulsed at once; a new pulse takes the place of one that runs. False, and nothing
        happens, when it is parked, parking or slewing.
        """
        with self._order(moves=False) as order:
            name, signed, base = self._directed(order, direction, rate_deg_s)
            now = order.motion.now
            if order.motion.bound_for == "park" or not (
                now.ha.quiet_at(order.t_s) and now.dec.quiet_at(order.t_s)
            ):
                return False
            if signed and duration_s > 0.0:
                goal = Goal(order.t_s, base, self._limits(name))
                pulsed = order.motion.axis(name).pulsed(order.t_s, signed, goal, duration_s)
                order.motion = order.motion.with_axis(name, pulsed)
        return True

    # -- inside ----------------------------------------------------------------------------------

    def _side_for(self, ha_deg: float, dec_deg: float, present: PierSide) -> PierSide:
        return side_for(ha_deg, dec_deg, self.machine, present, self.site.latitude_deg)

    def _directed(
        self, order: Order, direction: Direction, rate_deg_s: float
    ) -> tuple[AxisName, float, float]:
        """Axis, signed rate and rate of rest for a direction on the sky."""
        name: AxisName = "ha" if direction in ("e", "w") else "dec"
        north = self._north_here(order)
        rests = order.motion.tracking_deg_s(order.motion.now.tracking, north)
        rate = min(abs(rate_deg_s), self._rates_deg_s[name])
        sign = {"n": north, "s": -north, "w": 1.0, "e": -1.0}[direction]
        return name, sign * rate, rests[0 if name == "ha" else 1]
