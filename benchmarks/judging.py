"""The judge of the proofs: by the simulator's truth at all times, never by what the service believes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum
from threading import Lock

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.worlds import AIR, Observatory, World, sun_at
from mountnav.devices import PierSide
from mountnav.simulation.geometry import perfect_direction, true_direction
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.posture import axes_at, side_for
from mountnav.simulation.sky_script import Incident
from mountnav.sky.chain import icrs_to_apparent, icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

STEP_S = 1.0


class Place(StrEnum):
    """Where a target stands towards the limits."""

    INSIDE = "inside"
    EDGE = "at the edge"
    OUTSIDE = "outside"


@dataclass(frozen=True, slots=True)
class Violation:
    """Where the tube was, and should never have been.

    Attributes
    ----------
    utc : datetime
    what : str
    by_deg : float
        Beyond the limit, the slack included.
    """

    utc: datetime
    what: str
    by_deg: float


def violations(made: Observatory, since: datetime, until: datetime) -> list[Violation]:
    """The worst violation of each kind, by where the tube truly was each second.

    What the mount can't know is its own pointing error at first: so much slack, its worst and no more. When
    an axis is blocked on its way the other one goes on alone: what it takes to notice that and to brake.
    """
    world, mechanics, limits = made.world, made.mechanics, made.world.limits
    slack_deg = world.worst_error_deg + 0.05
    if any(one.what.startswith("block") for one in incidents_between(world, since, until)):
        rate, acceleration = world.machine.slew_rate_deg_s, world.machine.acceleration_deg_s2
        slack_deg += 1.5 * rate + rate * rate / (2.0 * acceleration)
    worst: dict[str, Violation] = {}
    stood: dict[str, float] = {}

    def note(what: str, by_deg: float, utc: datetime) -> None:
        # one that stands outside already, by whoever left it so, may come in; it must not go further out
        allowed = max(slack_deg, stood.setdefault(what, by_deg) + 0.3)
        if by_deg > allowed and (what not in worst or by_deg > worst[what].by_deg):
            worst[what] = Violation(utc, what, by_deg)

    sun, sun_of = None, since
    for utc in _each_step(since, until):
        place = mechanics.true_observed(utc)
        note("altitude", limits.min_altitude_deg - place.alt_deg, utc)
        if limits.past_meridian_deg is not None:
            side, past_deg = past_meridian(mechanics, utc)
            note("meridian", past_deg - limits.past_meridian_deg[side], utc)
        if limits.sun_cone_deg and world.sun_up:
            if sun is None or utc - sun_of > timedelta(minutes=2):
                sun, sun_of = icrs_to_observed(sun_at(utc), utc, world.site, AIR), utc
            if sun.alt_deg > limits.sun_cone_from_altitude_deg:
                here = Icrs(place.az_deg, place.alt_deg)
                apart = separation_arcsec(here, Icrs(sun.az_deg, sun.alt_deg)) / 3600.0
                note("sun", limits.sun_cone_deg - apart, utc)
    return list(worst.values())


def incidents_between(world: World, since: datetime, until: datetime) -> list[Incident]:
    """What happened to the mount in a span of time."""
    first, last = ((utc - world.start).total_seconds() / 60.0 for utc in (since, until))
    return [
        one for one in world.script.incidents if one.at_min < last and one.at_min + one.for_s / 60.0 > first
    ]


def past_meridian(mechanics: Mechanics, utc: datetime) -> tuple[int, float]:
    """Which posture (0: tube east of the pier, the normal one; 1: west), and how far past the meridian.

    Counted at the counterweight: the tube looks past the upper or the lower meridian by as much as the
    counterweight stands above the horizontal.
    """
    ha_deg, dec_deg = mechanics.true_axes(utc)
    beyond = abs(half_turn_deg(dec_deg)) > 90.0
    # the counterweight points down at 90 in both postures, and is level at 0 and 180
    raised_deg = -90.0 + abs(half_turn_deg(ha_deg - 90.0))
    return (1 if beyond else 0), raised_deg


def standing(world: World, target: Icrs, utc: datetime, for_s: float) -> Place:
    """Where a target stands towards the limits, from `utc` on for so long; both ends and the middle."""
    room_deg = world.limits.margin_deg + world.worst_error_deg + 0.3
    least = first = math.inf
    for share in (0.0, 0.5, 1.0):
        at = utc + timedelta(seconds=share * for_s)
        observed = icrs_to_observed(target, at, world.site, AIR)
        least = min(least, observed.alt_deg - world.limits.min_altitude_deg)
        sun = sun_at(at)
        height = icrs_to_observed(sun, at, world.site, AIR).alt_deg
        if world.limits.sun_cone_deg and height > world.limits.sun_cone_from_altitude_deg:
            least = min(least, separation_arcsec(sun, target) / 3600.0 - world.limits.sun_cone_deg)
        first = least if share == 0.0 else first
    if least > room_deg:
        return Place.INSIDE
    return Place.OUTSIDE if first < -0.02 else Place.EDGE


def way_is_clear(made: Observatory, target: Icrs) -> bool:
    """Whether the mount would go straight to a target within the limits, as it truly moves.

    A twin of its mechanics goes there, in no time; nobody learns of it. What the service has to leave to
    its ignorance - its margin, the pointing error, a side that the mount doesn't tell - is left here too.
    """
    world, now = made.world, made.clock.utc()
    sides: list[PierSide | None] = [None]
    if world.machine.mounting == "german" and not world.behavior.tells_destination:
        sides = [PierSide.EAST, PierSide.WEST]
    return all(_clear(made, target, side, now) for side in sides)


def _clear(made: Observatory, target: Icrs, side: PierSide | None, now: datetime) -> bool:
    world, limits = made.world, made.world.limits
    room_deg = limits.margin_deg + world.worst_error_deg + 0.5
    twin = copy(made.mechanics)
    twin._lock = Lock()
    twin._clock = lambda: now
    if side is not None:
        # nobody knows the mount's own limits either
        twin.machine = replace(twin.machine, meridian_limits_deg=None, at_limit="ignore")
    twin.slew(icrs_to_apparent(target, now), side)
    sun = icrs_to_observed(sun_at(now), now, world.site, AIR)
    for utc in _each_step(now, now + timedelta(seconds=150.0)):
        place = twin.true_observed(utc)
        if place.alt_deg < limits.min_altitude_deg + room_deg:
            return False
        if limits.past_meridian_deg is not None:
            posture, past_deg = past_meridian(twin, utc)
            if past_deg > limits.past_meridian_deg[posture] - room_deg:
                return False
        if world.sun_up:
            here, there = Icrs(place.az_deg, place.alt_deg), Icrs(sun.az_deg, sun.alt_deg)
            if separation_arcsec(here, there) / 3600.0 < limits.sun_cone_deg + room_deg + 1.0:
                return False
    return True


def can_look_at(made: Observatory, target: Icrs) -> bool:
    """Whether the mount can be made to look there at all: near the pole its choice of side may not let it.

    For each side the axis angles are sought that truly look at the target; the mount, sent to what it takes
    them for, must choose that side itself.
    """
    mechanics, world, now = made.mechanics, made.world, made.clock.utc()
    if world.machine.mounting != "german" or abs(target.dec_deg) < 88.0:
        return True
    place = icrs_to_hour_angle(target, now, world.site, AIR)
    wanted = _vector(place.ha_deg, place.dec_deg)
    belief = mechanics._motion.belief_at(mechanics._seconds(now))

    def miss(axes: NDArray[np.float64]) -> NDArray[np.float64]:
        seen = true_direction(float(axes[0]), float(axes[1]), world.errors, world.site.latitude_deg)
        return (_vector(*seen) - wanted) * 206264.8

    for side in (PierSide.EAST, PierSide.WEST):
        for turn_deg in (0.0, 60.0, 120.0, 180.0, 240.0, 300.0):
            start = axes_at(
                place.ha_deg + turn_deg, place.dec_deg, world.machine, side, world.site.latitude_deg
            )
            found = least_squares(miss, start, x_scale=(100.0, 1.0))
            if np.hypot.reduce(found.fun) > 2.0:
                continue
            ha_deg, dec_deg = found.x[0] + belief.ha_shift_deg, found.x[1] + belief.dec_shift_deg
            sent = perfect_direction(ha_deg, dec_deg)
            chosen = side_for(*sent, world.machine, mechanics.pier_side(), world.site.latitude_deg)
            taken = axes_at(*sent, world.machine, chosen, world.site.latitude_deg)
            if abs(half_turn_deg(taken[1] - dec_deg)) < 1e-6:
                return True
    return False


def _vector(ha_deg: float, dec_deg: float) -> NDArray[np.float64]:
    ha, dec = math.radians(ha_deg), math.radians(dec_deg)
    return np.array([math.cos(dec) * math.cos(ha), math.cos(dec) * math.sin(ha), math.sin(dec)])


def hour_angle_deg(world: World, target: Icrs, utc: datetime) -> float:
    """Of a target, for the report."""
    return icrs_to_hour_angle(target, utc, world.site, AIR).ha_deg


def wrong_syncs(made: Observatory, since: datetime) -> list[tuple[datetime, float]]:
    """Syncs on a place where the tube did not look.

    A right one may be off by what the mount's steps, its play and its worm hide between frame and order.
    """
    world = made.world
    allowed = (
        45.0
        + 2.0 * math.hypot(world.behavior.ra_step_arcsec, world.behavior.dec_step_arcsec)
        + (60.0 if world.wire else 0.0)
        + 1.5 * world.errors.backlash_arcsec
        + 2.0 * world.errors.periodic_amplitude_arcsec
    )
    return [(utc, off) for utc, off in made.syncs if utc >= since and off > allowed]


def _each_step(since: datetime, until: datetime) -> Iterator[datetime]:
    utc = since
    while utc < until:
        yield utc
        utc += timedelta(seconds=STEP_S)
    yield until
