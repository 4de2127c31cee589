"""NexStar as a `drivers.generic.language.Language`: which letters make a reading or an order.

Celestron's hand controls and Sky-Watcher's SynScan share the letters; what differs stands in `codec.dialect`.
A hand control answers every order with ``#``, carried out or not: what became of it is seen in the sky. One
``#`` is like another. So before each order that is sent once a letter is asked back which was not used just
before: no ``#`` that was owed from earlier can be taken for its answer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from datetime import datetime
from typing import Any

from drivers.generic.language import Sent, Wanted
from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Tracking
from drivers.nexstar.codec.greeting import Ask
from drivers.nexstar.codec.passthrough import (
    LONGEST_PULSE_S,
    LUNAR,
    SIDEREAL,
    SOLAR,
    Axis,
    motor_for,
)
from drivers.nexstar.codec.site_and_time import time_for, wire_site
from drivers.nexstar.rates import MOST_ARCSEC_S, SPANS, STEP_ARCSEC_S, Turning, rounded
from drivers.nexstar.readings import EQUATORIAL, NexstarReading
from drivers.wire.command import Command
from drivers.wire.exchange import Patience
from mountnav.clock import pause
from mountnav.devices import (
    STARS_RATES,
    Direction,
    MountAxis,
    OffsetRates,
    PierSide,
    RateSpan,
    TrackingRate,
)
from mountnav.errors import DeviceGarbled, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site

_SLOWEST_KEY = 1
"""Number of the slowest rate of the hand control's keys: it guides mounts whose motors time no pulses
[NexStar P 0x24]."""
_LOOK_S = 0.05
"""Pause between questions whether a pulse still runs. Chosen by hand."""
_LONGER_S = 1.0
"""A pulse that runs for so much longer than ordered is ended. Chosen by hand; halved, a slow line looks
like it."""


class Guiding:
    """One pulse.

    Parameters
    ----------
    ask : callable
        Asks a question, in step.
    once : callable
        Sends an order a single time.
    send_now : callable
        Sends past everything else.
    percent : int
        Of the sidereal rate, for pulses of the motors.
    """

    def __init__(
        self,
        ask: Ask,
        once: Callable[[Command[None], Wanted], Awaitable[Sent]],
        send_now: Callable[..., Awaitable[Any]],
        percent: int,
    ) -> None:
        self._ask, self._once, self._send_now = ask, once, send_now
        self._percent = percent

    async def by_motor(self, axis: Axis, sign: int, duration_s: float, wanted: Wanted) -> Sent:
        """Order pulses of at most 2.55 s one after the other, and wait for each [NexStar P 0x26, 0x27]."""
        left_s, sent = duration_s, Sent(wire=False)
        while left_s >= 0.005:
            part_s = min(left_s, LONGEST_PULSE_S)
            now = await self._once(base.guide(axis, sign * self._percent, part_s), wanted)
            if not now.wire:
                return sent
            sent = now
            await pause(part_s)
            await self._over(axis)
            if sent.lost is not None:
                # not known whether it was taken up: the rest of a long pulse would make it worse
                return sent
            left_s -= part_s
        return sent

    async def _over(self, axis: Axis) -> None:
        loop = asyncio.get_running_loop()
        until = loop.time() + _LONGER_S
        while await self._ask(base.guiding(axis)):
            if loop.time() > until:
                await self._send_now(base.press(axis, 0))
                return
            await asyncio.sleep(_LOOK_S)

    async def by_key(self, axis: Axis, sign: int, duration_s: float, wanted: Wanted) -> Sent:
        """Press the slowest key for so long, and let go of it in every case [NexStar P 0x24, 0x25].

        Both go past everything else, or the moment would last as long as another question.
        """
        if not wanted():
            return Sent(wire=False)
        try:
            await self._send_now(base.press(axis, sign * _SLOWEST_KEY))
            await pause(duration_s)
        finally:
            await self._send_now(base.press(axis, 0))
        # and again, with an answer: it has let go
        await self._ask(base.move(axis, 0))
        return Sent()


_RATES = {TrackingRate.SIDEREAL: SIDEREAL, TrackingRate.SOLAR: SOLAR, TrackingRate.LUNAR: LUNAR}


class NexstarLanguage(NexstarReading):
    """NexStar over a link."""

    # -- orders ------------------------------------------------------------------------------------

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a goto [NexStar r, R], tracking first if it is off: a goto leaves that as it is."""
        await self._require_alignment("the slew")
        if self._parking.parked:
            raise DeviceRefused("the slew refused: it is parked", device=self.device, reason=Refusal.PARKED)
        self._following.forget()
        if self.handset.tells_tracking and wanted():
            tracking = await self._exchange.asked_if_known(base.get_tracking(self.handset))
            if tracking is Tracking.OFF and wanted():
                await self._exchange.asked(base.set_tracking(self.handset.number(self._usual_mode())))
        short = self._greeting.short
        return await self._exchange.once(base.slew(place.ra_deg, place.dec_deg, short=short), wanted)

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a sync [NexStar s, S]; whole: half of one keeps the hand control waiting [INDI #473]."""
        if not self.handset.knows_sync:
            raise DeviceRefused(
                f"its hand control {self.handset.version} has no sync command",
                device=self.device,
                advice="4.10 or later does (SynScan: 3.37 or 4.37)",
                reason=Refusal.UNSUPPORTED,
            )
        await self._require_alignment("the sync")
        short = self._greeting.short
        return await self._exchange.once(base.sync(place.ra_deg, place.dec_deg, short=short), wanted)

    async def send_stop(self, again: int) -> None:
        """Cancel the goto and halt both axes, past everything; tracking goes on as it was."""
        self._parking.stopped()
        await self._link.send_now(base.SYNSCAN_STOP if self.handset.synscan else base.STOP)

    async def send_park(self, wanted: Wanted) -> Sent:
        """Switch tracking off and order a goto in azimuth and altitude [NexStar T, b]."""
        place = self._parking.place
        if place is None:
            raise DeviceRefused(
                "it has no park position",
                device=self.device,
                advice="point it where it should park and set that, or give park_az_deg and park_alt_deg",
                reason=Refusal.UNSUPPORTED,
            )
        await self._require_alignment("parking")
        if not wanted():
            return Sent(wire=False)
        self._following.forget()
        await self._exchange.asked(base.set_tracking(self.handset.number(Tracking.OFF)))
        self._parking.began()
        short = self._greeting.short
        return await self._exchange.once(base.slew_horizon(place.az_deg, place.alt_deg, short=short), wanted)

    async def send_unpark(self) -> None:
        """Take it as not parked; tracking stays off until a slew or `send_tracking`."""
        self._parking.stopped()

    async def send_set_park(self) -> None:
        """Remember where it points now, as it counts that itself [NexStar z]."""
        self._parking.place = await self._horizon()

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be ordered to track."""
        if self.handset.has_rates and self._usual_mode() in EQUATORIAL:
            return frozenset(_RATES)
        return frozenset({TrackingRate.SIDEREAL})

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Order tracking in the mode it had, or its hemisphere's [NexStar T], and its rate [NexStar P]."""
        handset = self.handset
        if self._following.under_way:
            # what the motors were told takes the place of the rate that they had
            self._following.forget()
            self._rate = None
        if not on:
            await self._exchange.asked(base.set_tracking(handset.number(Tracking.OFF)))
            return
        mode, number = self._usual_mode(), _RATES.get(rate)
        has_rates = handset.has_rates and mode in EQUATORIAL
        if number is None or (rate is not TrackingRate.SIDEREAL and not has_rates):
            raise self._unsupported(f"track at the {rate} rate")
        if self._parking.parked:
            raise DeviceRefused("tracking refused: it is parked", device=self.device, reason=Refusal.PARKED)
        await self._exchange.asked(base.set_tracking(handset.number(mode)))
        if has_rates and rate is not self._rate:
            south = mode is Tracking.EQUATORIAL_SOUTH
            await self._exchange.asked(base.set_tracking_rate(number, south=south))
            self._rate = rate

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Let the motors time a pulse [NexStar P 0x26], or press the slowest key for so long."""
        if self._parking.parked:
            raise DeviceRefused("the pulse refused: it is parked", device=self.device, reason=Refusal.PARKED)
        guiding = Guiding(
            self._exchange.asked, self._exchange.once, self._link.send_now, self._greeting.pulse_percent
        )
        axis, sign = motor_for(direction, self._pier_side, self._mode)
        if self.handset.times_pulses:
            return await guiding.by_motor(axis, sign, duration_s, wanted)
        return await guiding.by_key(axis, sign, duration_s, wanted)

    # -- what moves --------------------------------------------------------------------------------

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """A degree a second."""
        return OffsetRates(MOST_ARCSEC_S, MOST_ARCSEC_S) if self._follows else None

    @property
    def offset_step_arcsec_s(self) -> float:
        """A quarter of an arcsecond a second."""
        return STEP_ARCSEC_S if self._follows else 0.0

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Switch tracking off and run both motors; or switch it on again [NexStar T, P 0x06].

        Raises
        ------
        DeviceRefused
            If its motors can't be told such rates, or its side of the pier isn't known.
        """
        if not self._follows:
            raise self._unsupported("track at offset rates")
        if rates.none and not self._following.under_way:
            mode = await self._exchange.asked_if_known(base.get_tracking(self.handset))
            if self._parking.parked or mode not in (None, Tracking.OFF):
                return
            # a program before us may have left its motors running: how they do can't be asked
            await self._following.take_back(self._modes())
            self._rate = None
            return
        turning = await self._turning() if not rates.none else Turning(None, self._usual_mode())
        await self._following.offset(rates, turning, self._modes())
        self._rate = None

    def rounded_rates(self, rates: OffsetRates) -> OffsetRates:
        """What both motors make of them: they are told quarters."""
        return rounded(rates)

    async def read_offset_rates(self) -> OffsetRates | None:
        """None: it can't say; but that it tracks by itself again it says."""
        if self._following.offsets is None:
            return None
        mode = await self._exchange.asked_if_known(base.get_tracking(self.handset))
        if mode is None or mode is Tracking.OFF:
            return None
        self._following.forget()
        return STARS_RATES

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """Any speed that the motors can be told."""
        return {"primary": SPANS, "secondary": SPANS} if self._follows else {}

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Run one motor at another rate, or again as before. Raises `DeviceRefused`."""
        if not self._follows:
            raise self._unsupported("move an axis")
        turning = await self._turning()
        if not wanted():
            return Sent(wire=False)
        try:
            await self._following.move(axis, rate_deg_s, turning, self._modes())
        except (DeviceSilent, DeviceGarbled) as failure:
            return Sent(lost=failure)
        self._rate = None
        return Sent()

    def _modes(self) -> tuple[int, int]:
        return self.handset.number(Tracking.OFF), self.handset.number(self._usual_mode())

    async def _turning(self) -> Turning:
        """How the motors lie on the sky now. Raises `DeviceRefused` where that isn't known."""
        if self.handset.german:
            await self.readout()
            if self._pier_side in (None, PierSide.UNKNOWN):
                raise DeviceRefused(
                    "can't run its motors at rates of their own: its side of the pier isn't known",
                    device=self.device,
                )
        return Turning(self._pier_side, self._usual_mode())

    async def _require_alignment(self, what: str) -> None:
        if await self._exchange.asked_if_known(base.ALIGNED) is False:
            raise DeviceRefused(
                f"{what} refused: it is not aligned",
                device=self.device,
                advice="align it at its hand control",
                reason=Refusal.NOT_ALIGNED,
            )

    # -- clock and site ----------------------------------------------------------------------------

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock, and its zone to UTC [NexStar H, I]; refused once it is aligned."""
        await self._require_no_alignment("a time")
        fine = self.handset.quarter_zones
        await self._sent_whole(base.set_time(time_for(utc), fine=fine))

    async def write_site(self, site: Site) -> None:
        """Tell it where it stands [NexStar W]; refused once it is aligned."""
        await self._require_no_alignment("a site")
        await self._sent_whole(base.set_site(wire_site(site)))
        self._latitude_deg = site.latitude_deg

    async def _require_no_alignment(self, what: str) -> None:
        if not self.handset.keeps_time:
            raise self._unsupported(f"take {what}")
        if await self._exchange.asked_if_known(base.ALIGNED):
            raise DeviceRefused(
                f"is not given {what}: it was aligned with the one that it has",
                device=self.device,
                advice="set clock and site at the hand control before its alignment",
            )

    async def _sent_whole(self, order: Command[None]) -> None:
        sent = await self._exchange.once(order, lambda: True)
        if sent.lost is not None:
            raise sent.lost


def patience_of(timeout_s: float) -> Patience:
    """Return the times of one question: two tries, since an answer may be held back for 3.5 s [NexStar]."""
    return Patience(deadline_s=timeout_s, try_s=0.45 * timeout_s)
