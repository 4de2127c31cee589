"""A Sky-Watcher motor controller as a `drivers.generic.language.Language`: goto, tracking and sync are ours.

The controller counts steps and knows no sky, no clock, no site and no limits; the sky is computed here from
our site and our clock. Connecting asks only: the motors are energized by the first order that moves them. If
this program dies the motors go on as they were ordered last: the controller has no watchdog.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from datetime import datetime

from drivers.generic.language import Sent, Wanted
from drivers.skywatcher import codec
from drivers.skywatcher.axes import (
    HOME,
    RATES_DEG_S,
    Turns,
    altitude_deg,
    hour_angle_of,
    raises_dec,
    side_for,
    sight,
    sky_sign,
    turns_at,
)
from drivers.skywatcher.codec import Axis
from drivers.skywatcher.rates import ground_rates, most_beside, rates_of, spans_of, step_beside
from drivers.skywatcher.readings import SkywatcherReading
from drivers.skywatcher.steering import Aim
from drivers.wire.exchange import Patience
from mountnav.clock import pause, utc_now
from mountnav.devices import (
    STARS_RATES,
    Direction,
    MountAxis,
    OffsetRates,
    PierSide,
    RateSpan,
    TrackingRate,
)
from mountnav.errors import BadRequest, DeviceError, DeviceRefused, Refusal
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

_SYNC_FREE_DEG = 5.0
"""A sync may turn the hour angle axis by so much, and `_SYNC_STRETCH` times its miss on the sky. Beyond
that the place is so near the pole that it says too little of that axis. Chosen by hand."""
_SYNC_STRETCH = 3.0
"""See `_SYNC_FREE_DEG`: 3 is a declination of about 70°. Doubled, a sync 10° from the pole is taken."""


class SkywatcherLanguage(SkywatcherReading):
    """A German mount on a motor controller, over a link; parameters as of `SkywatcherReading`."""

    # -- slews -----------------------------------------------------------------------------------

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Send both axes towards a place; `next_leg` brings them there and begins to track.

        Raises
        ------
        DeviceRefused
            Below the horizon, or further round than the axes go.
        """
        place = _apparent(place)
        now = utc_now()
        angles = hour_angle_of(place, now, self._site)
        altitude = altitude_deg(angles, self._site)
        if altitude < self._settings.lowest_altitude_deg:
            raise DeviceRefused(
                f"the place is at an altitude of {altitude:.1f}°, the lowest allowed is "
                f"{self._settings.lowest_altitude_deg:g}°",
                device=self.device,
                reason=Refusal.BELOW_HORIZON,
            )
        self._side = self._side_for(angles.ha_deg, angles.dec_deg, await self._turns())
        return await self._send(self._aim(place), wanted)

    def _side_for(self, ha_deg: float, dec_deg: float, now: Turns) -> PierSide:
        latitude_deg, past_deg = self._site.latitude_deg, self._settings.past_meridian_deg
        present = sight(now, latitude_deg).side
        return side_for(ha_deg, dec_deg, present, latitude_deg, past_deg=past_deg)

    def _aim(self, place: Apparent) -> Aim:
        def aim(utc: datetime) -> Turns:
            angles = hour_angle_of(place, utc, self._site)
            side = self._side or PierSide.EAST
            return turns_at(angles.ha_deg, angles.dec_deg, side, self._site.latitude_deg)

        return aim

    async def _send(self, aim: Aim, wanted: Wanted) -> Sent:
        """Send the axes on their way, energized first if they aren't."""
        if not wanted():
            return Sent(wire=False)
        # before anything moves: whether the board can count so far
        self._axis_counts.counts(aim(utc_now()))
        self._drop_tasks()
        self._as_for_a_star()
        self._parking = self._parked = False
        stops, starts = self._motors.stops, self._motors.starts

        def still() -> bool:
            # when one axis has set out the other one follows, unless a stop comes
            return self._motors.stops == stops and (self._motors.starts > starts or wanted())

        await self._energize()
        started, lost = await self._steering.set_out(aim, still)
        # a stop that came meanwhile has the last word: what follows this order sends another one
        return Sent(wire=started or wanted(), lost=lost)

    def _while_no_stop(self, wanted: Wanted) -> Callable[[], bool]:
        stops = self._motors.stops
        return lambda: wanted() and self._motors.stops == stops

    async def _energize(self) -> None:
        """Before the first motion since power-up; see `drivers.skywatcher.axes`."""
        # an order to move means that the position is trusted
        self._zero_known = True
        if self._energized:
            return
        await self._motors.energize()
        self._energized = True
        before = (await self._motors.count(Axis.DECLINATION)).value
        await self._motors.order(codec.set_position(Axis.DECLINATION, before + self._axis_counts.quarter))
        after = (await self._motors.count(Axis.DECLINATION)).value
        self._axis_counts.second_moved(before, after)
        self._motors.forget()
        self.log.note("event", meaning="motors energized, the declination axis counted as EQMod does")

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """At rest: another goto if it is far, else tracking, else the last arcseconds."""
        place = _apparent(place)
        still = self._while_no_stop(wanted)
        rate = self._rate or TrackingRate.SIDEREAL
        more = await self._steering.refine(self._aim(place), RATES_DEG_S[rate], still)
        if still():
            self._rate = rate
            await self._watch_limit()
        return more

    # -- sync ------------------------------------------------------------------------------------

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Take over what the sky says; nothing goes over the wire but questions.

        Raises
        ------
        DeviceRefused
            Near the pole, when the place says next to nothing of the hour angle axis.
        """
        place = _apparent(place)
        first, second = await self._counts()
        if not wanted():
            return Sent(wire=False)
        angles = hour_angle_of(place, first.utc, self._site)
        offsets = self._axis_counts.offsets
        counted = self._axis_counts.counted(first.value, second.value)
        seen = offsets.sight(counted)
        shift = offsets.shift(counted, angles.ha_deg, angles.dec_deg)
        here, there = Icrs(seen.ha_deg, seen.dec_deg), Icrs(angles.ha_deg, angles.dec_deg)
        miss_deg = separation_arcsec(here, there) / 3600.0
        if abs(shift.first_deg) > _SYNC_STRETCH * miss_deg + _SYNC_FREE_DEG:
            raise DeviceRefused(
                f"so near the pole a miss of {miss_deg:.2f}° would turn the hour angle axis by "
                f"{abs(shift.first_deg):.0f}°: the position says too little about it",
                device=self.device,
                advice="sync at least 20° away from the pole",
                reason=Refusal.LIMIT,
            )
        offsets.learn(counted, angles.ha_deg, angles.dec_deg)
        self._zero_known = True
        return Sent()

    # -- stop ------------------------------------------------------------------------------------

    async def send_stop(self, again: int) -> None:
        """Stop both motors past everything, and track again once all rests and no stop comes any more.

        The controller has no stop that leaves tracking alone.
        """
        self._drop_tasks()
        self._as_for_a_star()
        self._parking = False
        rate = self._rate
        try:
            await self._motors.send_stop(again)
        finally:
            if rate is not None and self.usable:
                self._begin("restore", self._restore(rate))

    async def _restore(self, rate: TrackingRate) -> None:
        """Track again after a stop."""
        still = self._while_no_stop(lambda: True)
        with contextlib.suppress(DeviceError):
            await pause(self._settings.settle_s)
            await self._motors.at_rest()
            if still() and await self._steering.track(RATES_DEG_S[rate], still):
                self.log.note("event", meaning="tracking begun again after the stop")
                await self._watch_limit()

    # -- tracking, guiding -----------------------------------------------------------------------

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be ordered to track."""
        return frozenset(RATES_DEG_S)

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Let the first axis follow the sky, or rest.

        Raises
        ------
        DeviceRefused
            For a rate that it doesn't have, or when it is parked.
        """
        if rate not in RATES_DEG_S:
            raise self._unsupported(f"track at the {rate} rate")
        self._drop_tasks()
        still = self._while_no_stop(lambda: True)
        if self._offsets is not None or self._moved:
            self._as_for_a_star()
            await self._motors.halt(Axis.DECLINATION, still)
        if not on:
            self._rate = None
            await self._motors.halt(Axis.HOUR_ANGLE, still)
            return
        if self._parked:
            raise DeviceRefused(
                "tracking refused: it is parked",
                device=self.device,
                advice="unpark it first",
                reason=Refusal.PARKED,
            )
        await self._energize()
        if await self._steering.track(RATES_DEG_S[rate], still):
            self._rate = rate
            await self._watch_limit()

    async def _watch_limit(self, along_deg_s: float = SIDEREAL_DEG_S) -> None:
        """Have tracking stopped when the counterweight has risen too far: the board wouldn't.

        Parameters
        ----------
        along_deg_s : float
            How fast the first axis runs with the sky; negative: against it.
        """
        self._begin("limit", self._stop_at_limit(await self._until_limit_deg(along_deg_s), along_deg_s))

    async def _until_limit_deg(self, along_deg_s: float) -> float:
        along_deg = sky_sign(self._site.latitude_deg) * (await self._rough_turns()).first_deg
        return 90.0 + self._settings.tracking_past_deg - math.copysign(along_deg, along_deg * along_deg_s)

    async def _stop_at_limit(self, left_deg: float, along_deg_s: float) -> None:
        with contextlib.suppress(DeviceError):
            while left_deg > 0.0:
                await pause(left_deg / max(abs(along_deg_s), SIDEREAL_DEG_S))
                left_deg = await self._until_limit_deg(along_deg_s)
            self._rate = None
            self._as_for_a_star()
            self.log.note("event", meaning="tracking stopped: the counterweight has risen to its limit")
            await self._motors.send_stop()

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Run otherwise for a time that is counted here, and end it in every case.

        Raises
        ------
        DeviceRefused
            When it doesn't track.
        """
        if not self._follows(await self._motors.status(Axis.HOUR_ANGLE)):
            raise DeviceRefused(
                "a guide pulse refused: it doesn't track", device=self.device, reason=Refusal.NOT_TRACKING
            )
        still = self._while_no_stop(wanted)
        guide_deg_s = self._settings.guide_rate * SIDEREAL_DEG_S
        sky, north = await self._ways()
        base_deg_s = SIDEREAL_DEG_S if self._offsets else self._base_deg_s
        ground = ground_rates(self._offsets or STARS_RATES, base_deg_s, sky, north)
        self._guiding = True
        try:
            if direction in (Direction.EAST, Direction.WEST):
                usual_deg_s = sky * ground.first_deg_s
                more_deg_s = guide_deg_s if direction is Direction.WEST else -guide_deg_s
                if self._offsets is not None and min(usual_deg_s, usual_deg_s + more_deg_s) <= 0.0:
                    raise self._unsupported("guide at such rates: the first motor would turn round")
                faster = (usual_deg_s + more_deg_s) / usual_deg_s
                sent = await self._steering.pulse_along(faster, usual_deg_s, duration_s, still)
            else:
                rate = north * (guide_deg_s if direction is Direction.NORTH else -guide_deg_s)
                across = ground.second_deg_s
                sent = await self._steering.pulse_across(across + rate, duration_s, still)
                if sent and across and self._offsets is not None:
                    await self._following.run(Axis.DECLINATION, across, still)
        finally:
            self._guiding = False
        return Sent(wire=sent)

    # -- what moves ------------------------------------------------------------------------------

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """What the motors can run at in their low speed range, tracking taken off; known after `open`."""
        gears = self._motors.gears
        return most_beside(gears) if gears else None

    @property
    def offset_step_arcsec_s(self) -> float:
        """One tick of the step period, at the rates in force: it grows with them."""
        gears = self._motors.gears
        return step_beside(gears, self._offsets or STARS_RATES) if gears else 0.0

    @property
    def _base_deg_s(self) -> float:
        return RATES_DEG_S[self._rate or TrackingRate.SIDEREAL]

    async def _ways(self) -> tuple[int, int]:
        """Which way the first axis runs with the sky, and which way the second one to the north."""
        latitude_deg = self._site.latitude_deg
        return sky_sign(latitude_deg), raises_dec(await self._rough_turns(), latitude_deg)

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Run both motors as what moves among the stars wants it; `STARS_RATES` ends that.

        Raises
        ------
        DeviceRefused
            If it doesn't track, or the board says no.
        """
        still = self._while_no_stop(lambda: True)
        if rates.none and self._offsets is None:
            stray = await self._strays()
            if not stray:
                return
            if self._rate is None and Axis.HOUR_ANGLE in stray:
                # it follows something: as for a star from here on
                self._rate = TrackingRate.SIDEREAL
            elif self._rate is None:
                await self._motors.halt(Axis.DECLINATION, still)
                return
        if self._rate is None:
            raise DeviceRefused(
                "can't track at offset rates: it doesn't track",
                device=self.device,
                reason=Refusal.NOT_TRACKING,
            )
        before, self._offsets = self._offsets, None if rates.none else rates
        sky, north = await self._ways()
        base_deg_s = self._base_deg_s if rates.none else SIDEREAL_DEG_S
        ground = ground_rates(rates, base_deg_s, sky, north)
        was = ground_rates(before or STARS_RATES, SIDEREAL_DEG_S, sky, north)
        try:
            if not await self._following.follow(ground, was, still):
                return  # a stop has the last word
        except DeviceRefused:
            self._offsets = before
            raise
        if still():
            await self._watch_limit(sky * ground.first_deg_s)

    async def _strays(self) -> frozenset[Axis]:
        """Motors that run on by themselves, as a program before us may have left them."""
        found = set()
        for axis in Axis:
            motor = await self._motors.status(axis)
            known = axis is Axis.HOUR_ANGLE and self._rate is not None
            if motor.running and not (motor.goto or motor.fast or known):
                found.add(axis)
        return frozenset(found)

    async def read_offset_rates(self) -> OffsetRates | None:
        """By the step periods and directions that the board tells; rest and tracking are those of a star."""
        first, second = [await self._motors.status(axis) for axis in Axis]
        if not first.running and self._offsets is None:
            return STARS_RATES
        ground = await self._following.in_force(first, second)
        if ground is None:
            return None
        base_deg_s = self._base_deg_s if self._offsets is None else SIDEREAL_DEG_S
        sky, north = await self._ways()
        told = rates_of(ground, base_deg_s, sky, north)
        gear = self._motors.gears[Axis.HOUR_ANGLE]
        # the tick nearest to the tracking rate is that rate
        half_arcsec_s = 0.5000001 * gear.rate_step_deg_s(base_deg_s) * 3600.0
        if self._offsets is None and abs(told.ra_arcsec_s) <= half_arcsec_s:
            told = OffsetRates(0.0, told.dec_arcsec_s)
        return told

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """What the motors can run at in their low speed range; known after `open`."""
        gears = self._motors.gears
        if not gears:
            return {}
        return {"primary": spans_of(gears[Axis.HOUR_ANGLE]), "secondary": spans_of(gears[Axis.DECLINATION])}

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Run one motor faster, more slowly or the other way round; 0: as it was before.

        Raises
        ------
        DeviceRefused
            If the board says no.
        """
        still = self._while_no_stop(wanted)
        if not wanted():
            return Sent(wire=False)
        await self._energize()
        motor = Axis.HOUR_ANGLE if axis == "primary" else Axis.DECLINATION
        sky, north = await self._ways()
        offsets = self._offsets or STARS_RATES
        resting_deg_s = 0.0 if self._rate is None else SIDEREAL_DEG_S if self._offsets else self._base_deg_s
        ground = ground_rates(offsets, resting_deg_s, sky, north)
        if rate_deg_s == 0.0:
            self._moved.pop(motor, None)
        else:
            self._moved[motor] = rate_deg_s
        if motor is Axis.HOUR_ANGLE:
            along_deg_s = sky * ground.first_deg_s - rate_deg_s
            sent = await self._following.run(motor, sky * along_deg_s, still)
            if sent and still() and (along_deg_s or self._rate is not None):
                await self._watch_limit(along_deg_s or SIDEREAL_DEG_S)
        else:
            sent = await self._following.run(motor, ground.second_deg_s + north * rate_deg_s, still)
        return Sent(wire=sent)

    # -- park, home ------------------------------------------------------------------------------

    async def send_park(self, wanted: Wanted) -> Sent:
        """Send both axes to the park position and leave them at rest; that it is parked is held by us."""
        stops = self._motors.stops
        sent = await self._send_to(self._park, wanted)
        self._parking = sent.wire and self._motors.stops == stops
        return sent

    async def send_home(self, wanted: Wanted) -> Sent:
        """Send both axes home and leave them at rest."""
        return await self._send_to(HOME, wanted)

    async def _send_to(self, turns: Turns, wanted: Wanted) -> Sent:
        if wanted():
            self._rate = None
        return await self._send(lambda _utc: turns, wanted)

    async def send_unpark(self) -> None:
        """Be ready to move again; nothing goes over the wire."""
        self._parking = self._parked = False

    async def send_set_park(self) -> None:
        """Take how the axes stand for the park position, until this program ends."""
        self._park = await self._turns()

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side it would look at a place."""
        angles = hour_angle_of(_apparent(place), utc_now(), self._site)
        return self._side_for(angles.ha_deg, angles.dec_deg, await self._turns())


def _apparent(place: Apparent | Icrs) -> Apparent:
    if isinstance(place, Apparent):
        return place
    raise BadRequest("an astrometric place given to a mount that is computed in apparent ones")


BAUD = 9600
"""Of EQDIR cables; mounts with a USB socket speak at 115200 [SKYWATCHER]."""

PATIENCE = Patience(deadline_s=3.0, try_s=0.8, quiet_s=0.05)
"""A real board answers within 17 ms (an owner's 2000 exchanges); datagrams are lost now and then."""
