"""Goto and tracking for a controller that has neither of a sky: legs, rates, and the last arcseconds.

A goto takes both motors off the sky: the first axis is sent to where its target will be when both have
arrived. Then tracking begins, and what is left along the hour angle is made up by running a little faster or
slower for a moment. As a rule that comes from the east, with the gears on the side on which they track.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta

from drivers.skywatcher import codec
from drivers.skywatcher.axes import AxisCounts, SkywatcherSettings, Turns, goto_s, sky_sign
from drivers.skywatcher.codec import Axis
from drivers.skywatcher.exchange import Motors
from mountnav.clock import utc_now
from mountnav.errors import DeviceError
from mountnav.sky.coordinates import SIDEREAL_DEG_S

Aim = Callable[[datetime], Turns]
"""How the axes shall stand at an instant."""

_LEG_S = 0.3
"""What starting and ending a goto takes beyond its ramps, in seconds. Chosen by hand; what is wrong with it
is made up by the trim."""
_NEW_LEG_DEG = 0.25
"""Farther than this from its target it is sent by another goto; nearer, running faster or slower makes it
up. Chosen by hand; doubled, the trim takes too long."""
_LONGEST_TRIM_S = 6.0
"""How long one trim runs at most before the place is looked at again. Chosen by hand."""
_TRIM_S = 1.2
"""How long a trim should take: its rate follows from that, within the two limits below. Chosen by hand."""
_FASTEST_TRIM, _SLOWEST_TRIM = 8.0, 0.2
"""Limits of how much faster or slower than tracking a trim runs, in times sidereal. Chosen by hand: still
in the low speed range, and enough to gain anything."""
_MOST_LEGS = 5
"""Gotos for one slew at most. Chosen by hand: two or three suffice; it ends a slew that never arrives."""
_MOST_TRIMS = 8
"""Trims for one slew at most. Chosen by hand, for the same reason."""


class Steering:
    """Moves both axes.

    Parameters
    ----------
    latitude_deg : float
        Of the site.
    """

    def __init__(
        self, motors: Motors, axis_counts: AxisCounts, latitude_deg: float, settings: SkywatcherSettings
    ) -> None:
        self._motors = motors
        self._axis_counts = axis_counts
        self._sign = sky_sign(latitude_deg)
        self._near_deg = settings.near_arcsec / 3600.0
        self._goto = settings.goto_deg_s, settings.goto_deg_s2
        self._legs = self._trims = 0

    async def set_out(self, aim: Aim, wanted: Callable[[], bool]) -> tuple[bool, DeviceError | None]:
        """Send both axes on their way; return whether a motor was started, and what went wrong after that."""
        self._legs, self._trims = 1, 0
        return await self._leg(aim, wanted)

    async def _leg(self, aim: Aim, wanted: Callable[[], bool]) -> tuple[bool, DeviceError | None]:
        motors = self._motors
        for axis in Axis:
            if not await motors.halt(axis, wanted):
                return False, None
        first = (await motors.count(Axis.HOUR_ANGLE)).value
        second = (await motors.count(Axis.DECLINATION)).value
        now = self._axis_counts.turns(first, second)
        way = aim(utc_now()).minus(now)
        # the target of the hour angle axis goes on meanwhile: that changes the way by next to nothing
        there_s = max(goto_s(way.first_deg, *self._goto), goto_s(way.second_deg, *self._goto)) + _LEG_S
        goal = self._axis_counts.counts(aim(utc_now() + timedelta(seconds=there_s)))
        started = False
        try:
            started = await motors.goto(Axis.DECLINATION, goal[1], wanted)
            if wanted():
                started = await motors.goto(Axis.HOUR_ANGLE, goal[0], wanted) or started
        except DeviceError as lost:
            # its answer may be lost, not the order
            return True, lost
        return started, None

    async def refine(self, aim: Aim, rate_deg_s: float, wanted: Callable[[], bool]) -> bool:
        """At rest: do the next thing that brings it nearer, and return whether there was one."""
        motors, axis_counts = self._motors, self._axis_counts
        first_axis = await motors.status(Axis.HOUR_ANGLE)
        second = await motors.count(Axis.DECLINATION)
        first = await motors.sharp_count(Axis.HOUR_ANGLE)
        goal = aim(first.utc)
        way = goal.minus(axis_counts.turns(first.value, second.value))
        # near the pole a wide angle of the first axis is little on the sky
        first_near_deg = self._near_deg / max(abs(math.cos(math.radians(goal.second_deg))), 1e-4)
        far = abs(way.first_deg) > max(_NEW_LEG_DEG, first_near_deg) or abs(way.second_deg) > _NEW_LEG_DEG
        if far and self._legs < _MOST_LEGS:
            self._legs += 1
            return (await self._leg(aim, wanted))[0]
        moved = False
        second_near_deg = max(self._near_deg / 2.0, 1.5 / 3600.0 * axis_counts.second_gear.step_arcsec)
        if abs(way.second_deg) > second_near_deg and self._trims < _MOST_TRIMS:
            _, count = axis_counts.counts(goal)
            if await motors.halt(Axis.DECLINATION, wanted):
                moved = await motors.goto(Axis.DECLINATION, count, wanted)
        if not self.is_tracking(first_axis.running, first_axis.goto, first_axis.fast, first_axis.backward):
            return await self.track(rate_deg_s, wanted) or moved
        left_deg = self._sign * way.first_deg
        if abs(left_deg) > first_near_deg and self._trims < _MOST_TRIMS and wanted():
            self._trims += 1
            await self._trim(left_deg, rate_deg_s, wanted)
            moved = True
        elif moved:
            self._trims += 1
        return moved

    def is_tracking(self, running: bool, goto: bool, fast: bool, backward: bool) -> bool:
        """Whether a first motor that runs so follows the sky, as far as its status says."""
        return running and not goto and not fast and backward is (self._sign < 0)

    async def track(self, rate_deg_s: float, wanted: Callable[[], bool]) -> bool:
        """Let the first axis follow the sky; False when no longer wanted."""
        return await self._motors.run(Axis.HOUR_ANGLE, self._sign * rate_deg_s, wanted)

    async def _trim(self, left_deg: float, rate_deg_s: float, wanted: Callable[[], bool]) -> None:
        """Make up for what is left along the hour angle of a tracking mount (west: positive)."""
        gear = self._motors.gears[Axis.HOUR_ANGLE]
        usual = gear.period(rate_deg_s)
        times = min(max(abs(left_deg) / (SIDEREAL_DEG_S * _TRIM_S), _SLOWEST_TRIM), _FASTEST_TRIM)
        faster = 1.0 + times if left_deg > 0.0 else 1.0 - min(times, 0.9)
        changed = gear.period(faster * rate_deg_s)
        gain_deg_s = abs(gear.rate_deg_s(changed) - gear.rate_deg_s(usual))
        duration_s = min(abs(left_deg) / gain_deg_s, _LONGEST_TRIM_S)
        await self._run_otherwise(changed, usual, duration_s, wanted)

    async def pulse_along(
        self, faster: float, rate_deg_s: float, duration_s: float, wanted: Callable[[], bool]
    ) -> bool:
        """Run the tracking first axis at so many times its rate for a time; False when no longer wanted."""
        gear = self._motors.gears[Axis.HOUR_ANGLE]
        changed, usual = gear.period(faster * rate_deg_s), gear.period(rate_deg_s)
        return await self._run_otherwise(changed, usual, duration_s, wanted)

    async def _run_otherwise(
        self, changed: int, usual: int, duration_s: float, wanted: Callable[[], bool]
    ) -> bool:
        async def begin() -> bool:
            if wanted():
                await self._motors.order(codec.period(Axis.HOUR_ANGLE, changed))
                return True
            return False

        back = codec.period(Axis.HOUR_ANGLE, usual)
        return await self._motors.for_a_time(Axis.HOUR_ANGLE, begin, duration_s, back)

    async def pulse_across(self, rate_deg_s: float, duration_s: float, wanted: Callable[[], bool]) -> bool:
        """Run the second axis (signed: forward counts) for a time; False when no longer wanted."""

        async def begin() -> bool:
            return await self._motors.run(Axis.DECLINATION, rate_deg_s, wanted)

        return await self._motors.for_a_time(Axis.DECLINATION, begin, duration_s)
