"""What limits make of a motion: the instants at which they are reached are closed formulas, like the motion.

An axis brakes so that it comes to rest on its limit. Tracking ends there, and where the place sets below the
lowest altitude; or a German mount changes sides there and tracks on.
"""

from __future__ import annotations

import math
from dataclasses import replace

from mountnav.devices import PierSide
from mountnav.simulation.axes import AxisPath
from mountnav.simulation.belief import Belief
from mountnav.simulation.geometry import perfect_direction
from mountnav.simulation.machine import AxisAngles, Machine
from mountnav.simulation.motion import Axis, Goal, Limits, Motion, Stage
from mountnav.simulation.posture import flipped, side_of, within_reach
from mountnav.sky.coordinates import SIDEREAL_DEG_S

# Most limits that one motion is followed through. Chosen by hand as an end for the loop.
_MOST_EVENTS = 6
# An axis within so many degrees of its end touches it: above the rounding of its path.
_TOUCHING_DEG = 1e-7
# Setting at rates of its own is looked for at places so far apart along the way, degrees: doubled, a dip
# below the horizon shorter than a degree may be passed over.
_SETTING_STEP_DEG = 0.5
# ... as many of them as lead once all round; more look at the same again, in the simplest case.
_SETTING_STEPS = 720
# ... and then so exactly, s: far below what a place changes by in it.
_SETTING_S = 1e-3


def braking_s(path: AxisPath, t_s: float, low: float, high: float, acceleration_deg_s2: float) -> float:
    """When, from `t_s` on, the axis has to brake lest it run past an end; infinite when never."""
    return min(
        _braking_s(path, t_s, 1.0, high, acceleration_deg_s2),
        _braking_s(path, t_s, -1.0, -low, acceleration_deg_s2),
    )


def _braking_s(path: AxisPath, t_s: float, sign: float, end: float, a: float) -> float:
    if math.isinf(end):
        return math.inf
    for piece, from_s, until_s in path.next_pieces(t_s):
        velocity = sign * piece.velocity_at(from_s)
        change = sign * piece.acceleration_deg_s2
        growth = 1.0 + change / a
        if growth <= 1e-9 or (velocity <= 0.0 and change <= 0.0):
            continue  # it brakes already, or goes the other way
        if velocity < 0.0:  # it turns round
            from_s, velocity = from_s - velocity / change, 0.0
            if from_s >= until_s:
                continue
        # where it would come to rest, minus the end: excess + b dt + c dt²
        excess = sign * piece.angle_at(from_s) + velocity * velocity / (2.0 * a) - end
        if excess >= -_TOUCHING_DEG:
            return from_s
        b, c = velocity * growth, 0.5 * change * growth
        root = b * b - 4.0 * c * excess
        if root < 0.0 or b + math.sqrt(root) <= 0.0:
            continue
        braking = from_s + max(-2.0 * excess / (b + math.sqrt(root)), 0.0)
        if braking < until_s:
            return braking
    return math.inf


def setting_s(stage: Stage, t_s: float, belief: Belief, lowest_altitude_deg: float) -> float:
    """When, from `t_s` on, tracking leads below the lowest altitude; infinite when never or if below."""
    arrival = max(t_s, stage.ha.arrives_s, stage.dec.arrives_s)
    if not stage.tracking or math.isinf(arrival):
        return math.inf
    velocity = stage.ha.path.velocity_at(arrival)
    dec_velocity = stage.dec.path.velocity_at(arrival)
    steady = stage.ha.path.steady_at(arrival) and stage.dec.path.steady_at(arrival)
    if not steady or velocity == dec_velocity == 0.0:  # by hand it may go below
        return math.inf
    axes = (
        stage.ha.path.angle_at(arrival) + belief.ha_shift_deg,
        stage.dec.path.angle_at(arrival) + belief.dec_shift_deg,
    )
    if dec_velocity or velocity <= 0.0:  # not along a parallel to the west: no closed formula
        return arrival + _sets_in_s(axes, (velocity, dec_velocity), belief, lowest_altitude_deg)
    ha_deg, dec_deg = perfect_direction(*axes)
    d, lat = math.radians(dec_deg), math.radians(belief.site.latitude_deg)
    across = math.cos(lat) * math.cos(d)
    if across < 1e-12:
        return math.inf
    cosine = (math.sin(math.radians(lowest_altitude_deg)) - math.sin(lat) * math.sin(d)) / across
    if not -1.0 < cosine < 1.0:
        return math.inf
    sets_deg = math.degrees(math.acos(cosine))
    if abs(ha_deg) > sets_deg:
        return math.inf
    return arrival + (sets_deg - ha_deg) / velocity


_SLOWEST_DEG_S = 1e-9
"""Slower than this an axis stands, °/s: it takes thirty years for a degree. Doubled, nothing changes in a
night; without it a time is sought that no number is fine enough for."""


def _sets_in_s(axes: AxisAngles, velocities: AxisAngles, belief: Belief, lowest_altitude_deg: float) -> float:
    """After how long axes that turn steadily lead below the lowest altitude; infinite when not in a turn."""

    def above(t_s: float) -> bool:
        ha_deg, dec_deg = perfect_direction(*(a + v * t_s for a, v in zip(axes, velocities, strict=True)))
        return belief.altitude_deg(ha_deg, dec_deg) >= lowest_altitude_deg

    if not above(0.0) or math.hypot(*velocities) < _SLOWEST_DEG_S:
        return math.inf
    step_s = _SETTING_STEP_DEG / math.hypot(*velocities)
    for number in range(1, _SETTING_STEPS + 1):
        if not above(number * step_s):
            high_s, low_s = number * step_s, (number - 1) * step_s
            while high_s - low_s > _SETTING_S:
                middle_s = 0.5 * (low_s + high_s)
                low_s, high_s = (middle_s, high_s) if above(middle_s) else (low_s, middle_s)
            return low_s
    return math.inf


def limited(motion: Motion, t_s: float, machine: Machine, ha: Limits, dec: Limits) -> Motion:
    """Find what the limits make of the motion ordered at `t_s`: fills `Motion.later`."""
    if machine.at_limit == "ignore":
        return replace(motion, later=())
    belief = motion.belief_at(t_s)
    stage, later = motion.now, []
    for _ in range(_MOST_EVENTS):
        following = _next_event(stage, max(t_s, stage.start_s), belief, machine, ha, dec, motion)
        if following is None:
            break
        stage = following
        later.append(stage)
    return replace(motion, later=tuple(later))


def _next_event(
    stage: Stage, t_s: float, belief: Belief, machine: Machine, ha: Limits, dec: Limits, motion: Motion
) -> Stage | None:
    """Stage after the first limit that is reached from `t_s` on."""
    low, high = (end - belief.ha_shift_deg for end in machine.ha_range_deg)
    ha_s = braking_s(stage.ha.path, t_s, low, high, ha.acceleration_deg_s2)
    low, high = (end - belief.dec_shift_deg for end in machine.dec_range_deg)
    dec_s = braking_s(stage.dec.path, t_s, low, high, dec.acceleration_deg_s2)
    set_s = math.inf
    if machine.lowest_altitude_deg is not None:
        set_s = setting_s(stage, t_s, belief, machine.lowest_altitude_deg)
    first_s = min(ha_s, dec_s, set_s)
    if math.isinf(first_s):
        return None
    if first_s == dec_s:
        return replace(stage, start_s=first_s, dec=_ended(stage.dec, first_s, dec), at_limit=True)
    if machine.at_limit == "flip" and first_s == ha_s:
        turned = _flip(stage, first_s, belief, machine, ha, dec, motion)
        if turned is not None:
            return turned
    return replace(
        stage,
        start_s=first_s,
        ha=_ended(stage.ha, first_s, ha),
        dec=_still(stage.dec, first_s, dec),
        tracking=False,
        at_limit=True,
    )


def _ended(axis: Axis, t_s: float, limits: Limits) -> Axis:
    return axis.ordered(t_s, Goal(t_s, 0.0, limits))


def _still(axis: Axis, t_s: float, limits: Limits) -> Axis:
    """End a custom rate in declination together with tracking; leave other motion alone."""
    return _ended(axis, t_s, limits) if axis.path.steady_at(t_s) and axis.path.velocity_at(t_s) else axis


def _flip(
    stage: Stage, t_s: float, belief: Belief, machine: Machine, ha: Limits, dec: Limits, motion: Motion
) -> Stage | None:
    """Change sides while tracking; None when it isn't, or the other side doesn't reach."""
    if not (stage.tracking and stage.ha.path.steady_at(t_s) and stage.dec.path.steady_at(t_s)):
        return None
    seen = (
        stage.ha.path.angle_at(t_s) + belief.ha_shift_deg,
        stage.dec.path.angle_at(t_s) + belief.dec_shift_deg,
    )
    if side_of(seen[1], machine) is PierSide.UNKNOWN:
        return None
    aim = flipped(seen, belief.site.latitude_deg)
    if not within_reach(aim, machine):
        return None
    north = -1.0 if side_of(aim[1], machine) is PierSide.WEST else 1.0
    stage = motion.changed_sides(stage)
    after = replace(motion, now=stage).tracking_deg_s(True, north)
    goals = (
        Goal(t_s, SIDEREAL_DEG_S, ha, aim[0] - belief.ha_shift_deg, after[0]),
        Goal(t_s, 0.0, dec, aim[1] - belief.dec_shift_deg, after[1]),
    )
    ha_axis, dec_axis = stage.ha.ordered(t_s, goals[0]), stage.dec.ordered(t_s, goals[1])
    return Stage(t_s, ha_axis, dec_axis, True, rates_lost=stage.rates_lost)
