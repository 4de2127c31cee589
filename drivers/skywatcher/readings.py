"""A Sky-Watcher motor controller as it is asked: who it is, how its axes stand, what its motors do."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine

from drivers.generic.language import Identity, Readout
from drivers.generic.serial_language import SerialLanguage
from drivers.skywatcher import codec
from drivers.skywatcher.axes import HOME, RATES_DEG_S, AxisCounts, SkywatcherSettings, Turns, place_of, sight
from drivers.skywatcher.codec import NOT_EQUATORIAL, Axis, MotorStatus
from drivers.skywatcher.exchange import Count, Motors
from drivers.skywatcher.rates import Following
from drivers.skywatcher.steering import Steering
from drivers.wire.link import Link
from mountnav.devices import Epoch, OffsetRates, PierSide, Skill, TrackingRate
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Site
from mountnav.tasks import begun, fault_words

_SKILLS = frozenset(
    {
        Skill.PARK,
        Skill.UNPARK,
        Skill.HOME,
        Skill.SET_PARK,
        Skill.TRACK,
        Skill.TRACKING_RATES,
        Skill.GUIDE,
        Skill.PIER_SIDE,
        Skill.DESTINATION_SIDE,
        Skill.OFFSET_RATES,
        Skill.MOVE_AXIS,
    }
)
_THERE_DEG = 0.01
"""Axes so near to the park or home position are there. Chosen by hand: above what a goto leaves over, far
below what matters to a parked tube."""
_FASTER = 3.0
"""A count is taken for another axis's answer if the axis can't have come there at this many times its goto
speed. Chosen by hand: mounts differ from the speed that the settings say."""
_SAME_RATE = 0.003
"""A motor found running tracks at one of our rates if it differs from that by less than this part. Chosen
by hand: the Sun's and the stars' rate differ by 0.0027, so the nearest of them is taken first."""


_SLOWEST_DEG_S = 1e-6
"""A first motor that follows so slowly may be found at rest. Chosen by hand: a step in half a minute."""


class SkywatcherReading(SerialLanguage):
    """What can be asked of a German mount on a motor controller, and what we hold of it.

    Parameters
    ----------
    site : Site
        Where the mount stands: without it there is no sky for it.
    """

    def __init__(self, link: Link, site: Site, settings: SkywatcherSettings | None = None) -> None:
        super().__init__(link)
        self._site = site
        self._settings = settings or SkywatcherSettings()
        self._motors = Motors(link, _FASTER * self._settings.goto_deg_s)
        self._axis_counts = AxisCounts(site.latitude_deg)
        self._steering = Steering(self._motors, self._axis_counts, site.latitude_deg, self._settings)
        self._following = Following(self._motors)
        self._offsets: OffsetRates | None = None
        """Rates beside the sidereal one that we ordered; None: none."""
        self._moved: dict[Axis, float] = {}
        """Axes that are moved by hand, and how fast (east and north positive)."""
        self._energized = False
        self._zero_known = False
        self._rate: TrackingRate | None = None
        self._side: PierSide | None = None
        self._park = HOME
        self._parking = self._parked = self._guiding = False
        self._tasks: dict[str, asyncio.Task[None]] = {}

    # -- what it is ------------------------------------------------------------------------------

    @property
    def epoch(self) -> Epoch:
        """Apparent: the place is computed here."""
        return "apparent"

    @property
    def usual_epoch(self) -> Epoch:
        """Apparent."""
        return "apparent"

    @property
    def resolution_arcsec(self) -> float:
        """One count of the coarser axis; 0.14 for most."""
        return max((gear.step_arcsec for gear in self._motors.gears.values()), default=0.15)

    @property
    def skills(self) -> frozenset[Skill]:
        """All that two motors allow."""
        return _SKILLS

    # -- the link --------------------------------------------------------------------------------

    async def open(self) -> Identity:
        """Open the link and ask who is there, how it is geared and what the motors do; changes nothing.

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks so.
        DeviceRefused
            If it is no equatorial mount.
        """
        return await self._greeted(self._identify)

    async def _identify(self) -> Identity:
        motors = self._motors
        board, _ = await motors.meet()
        if board.model in NOT_EQUATORIAL:
            raise DeviceRefused(
                f"{board.text} is not an equatorial mount", device=self.device, reason=Refusal.UNSUPPORTED
            )
        self._axis_counts.geared(motors.gears)
        for axis in Axis:
            await motors.count(axis)
        status = {axis: await motors.status(axis) for axis in Axis}
        self._rate = None
        self._as_for_a_star()
        problems = [await self._running(axis, status[axis]) for axis in Axis if status[axis].running]
        if not all(motor.initialized for motor in status.values()):
            self._power_up_seen()
        elif not self._energized:
            self._energized = True
            self._axis_counts.begin_as_eqmod()
            problems.append(
                "its motors are energized already, by whom is not known: the counts are taken as EQMod sets "
                "them (declination axis on the equator: 0x800000); the position is not trusted before a sync"
            )
        if self._parked and any(motor.running for motor in status.values()):
            self._parked = False
        gear = motors.gears[Axis.HOUR_ANGLE]
        text = f"{board.text}, {gear.counts} counts per turn ({gear.step_arcsec:.2f}″)"
        return Identity(text, (*problems, *motors.refining.notes))

    async def _running(self, axis: Axis, status: MotorStatus) -> str:
        """Say what a motor does that was found running; tracking is taken over."""
        gear, way = self._motors.gears[axis], "backward" if status.backward else "forward"
        if status.goto:
            return f"motor {int(axis)} runs to a target, {way} since before this connecting"
        period = await self._motors.refining.known(codec.step_period(axis))
        if period is None:
            return f"motor {int(axis)} runs {way} since before this connecting, how fast it doesn't tell"
        rate_deg_s = gear.rate_deg_s(period, fast=status.fast)
        text = f"motor {int(axis)} runs {way} at {rate_deg_s * 3600.0:.2f}″/s since before this connecting"
        if axis is not Axis.HOUR_ANGLE or not self._follows(status):
            return text
        self._rate = min(RATES_DEG_S, key=lambda rate: abs(RATES_DEG_S[rate] - rate_deg_s))
        if abs(RATES_DEG_S[self._rate] / rate_deg_s - 1.0) > _SAME_RATE:
            self._rate = None
            return text
        return f"{text}: it tracks ({self._rate})"

    def _power_up_seen(self) -> None:
        """The board was switched on since: nothing that we held of it is true any more."""
        self._energized = self._zero_known = False
        self._rate = self._side = None
        self._as_for_a_star()
        self._parking = self._parked = False
        self._axis_counts.begin_at_home()

    def _as_for_a_star(self) -> None:
        """Whatever was ordered beside tracking is over."""
        self._offsets = None
        self._moved.clear()

    async def close(self) -> None:
        """Release the link; motors that run go on."""
        self._drop_tasks()
        await super().close()

    def _begin(self, what: str, work: Coroutine[object, object, None]) -> None:
        old = self._tasks.pop(what, None)
        if old is not None:
            old.cancel()
        self._tasks[what] = begun(work, f"skywatcher-{what}", died=self._died)

    def _died(self, fault: Exception) -> None:
        """What was to stop a motor or to set it going again is gone: the link ends, and is opened again."""
        self._link.lose(fault_words(fault))

    def _drop_tasks(self) -> None:
        for task in self._tasks.values():
            task.cancel()
        self._tasks.clear()

    # -- readings --------------------------------------------------------------------------------

    async def readout(self) -> Readout:
        """Look at both axes: their counts, then what their motors do."""
        motors, troubles = self._motors, self._link.troubles
        first, second = await motors.count(Axis.HOUR_ANGLE), await motors.count(Axis.DECLINATION)
        hour_angle, declination = await motors.status(Axis.HOUR_ANGLE), await motors.status(Axis.DECLINATION)
        energized = hour_angle.initialized and declination.initialized
        if self._energized and not energized:
            self._power_up_seen()
        odd = [
            motors.odd(axis, count, running=status.running)
            for axis, count, status in (
                (Axis.HOUR_ANGLE, first, hour_angle),
                (Axis.DECLINATION, second, declination),
            )
        ]
        turns = self._axis_counts.turns(first.value, second.value)
        seen = sight(turns, self._site.latitude_deg)
        tracking = self._follows(hour_angle)
        across = self._guiding or self._runs_across(declination)
        resting = not hour_angle.running and not declination.running
        self._judge_park(turns, resting=resting)
        return Readout(
            place=place_of(seen.ha_deg, seen.dec_deg, first.utc, self._site),
            utc=first.utc,
            span_s=(second.utc - first.utc).total_seconds() + second.span_s,
            slewing=bool(self._moved)
            or (hour_angle.running and not tracking)
            or (declination.running and not across),
            tracking=tracking,
            parked=self._parked,
            at_home=resting and _near(turns, HOME),
            pier_side=seen.side,
            fresh=not (energized and self._zero_known),
            doubtful=any(odd) or self._link.troubles != troubles,
        )

    def _runs_across(self, second: MotorStatus) -> bool:
        """Whether the second motor runs after what moves among the stars."""
        return self._offsets is not None and not second.goto and not second.fast

    def _follows(self, first: MotorStatus) -> bool:
        if Axis.HOUR_ANGLE in self._moved:
            return self._rate is not None
        if self._offsets is not None and not first.goto and not first.fast:
            # it may run the other way, or rest: what it follows decides
            along_deg_s = SIDEREAL_DEG_S - self._offsets.ra_arcsec_s / 3600.0
            return first.running or abs(along_deg_s) < _SLOWEST_DEG_S
        return self._steering.is_tracking(first.running, first.goto, first.fast, first.backward)

    def _judge_park(self, turns: Turns, *, resting: bool) -> None:
        there = resting and _near(turns, self._park)
        if self._parking and there:
            self._parking, self._parked = False, True
        elif self._parked and not there:
            # something else has moved it
            self._parked = False

    async def _counts(self) -> tuple[Count, Count]:
        return await self._motors.sharp_count(Axis.HOUR_ANGLE), await self._motors.count(Axis.DECLINATION)

    async def _rough_turns(self) -> Turns:
        """How the axes stand, by one look at each: good to what they turn in an exchange."""
        counts = [(await self._motors.count(axis)).value for axis in Axis]
        return self._axis_counts.turns(*counts)

    async def _turns(self) -> Turns:
        first, second = await self._counts()
        return self._axis_counts.turns(first.value, second.value)


def _near(turns: Turns, other: Turns) -> bool:
    apart = turns.minus(other)
    return max(abs(apart.first_deg), abs(apart.second_deg)) < _THERE_DEG
