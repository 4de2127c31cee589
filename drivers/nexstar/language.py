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

from drivers.generic.language import Identity, Readout, Sent, Wanted
from drivers.generic.serial_language import SerialLanguage
from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Handset, Tracking, Version
from drivers.nexstar.codec.greeting import Ask, Greeting, greet
from drivers.nexstar.codec.passthrough import (
    LONGEST_PULSE_S,
    LUNAR,
    SIDEREAL,
    SOLAR,
    Axis,
    motor_for,
    side_of,
)
from drivers.nexstar.codec.replies import LONG_STEP_ARCSEC, SHORT_STEP_ARCSEC, WirePair
from drivers.nexstar.codec.site_and_time import clock_of, goes_on, site_of, time_for, wire_site
from drivers.nexstar.exchange import HandsetExchange
from drivers.nexstar.parking import Horizon, Parking
from drivers.nexstar.rates import MOST_ARCSEC_S, SPANS, STEP_ARCSEC_S, Following, Turning
from drivers.wire.command import Command
from drivers.wire.exchange import Patience
from drivers.wire.line import ByteLine, ControlLines, SerialLine
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.clock import pause, utc_now
from mountnav.devices import (
    STARS_RATES,
    Direction,
    Epoch,
    MountAxis,
    OffsetRates,
    PierSide,
    RateSpan,
    Skill,
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
_EQUATORIAL = (Tracking.EQUATORIAL_NORTH, Tracking.EQUATORIAL_SOUTH)


class NexstarLanguage(SerialLanguage):
    """NexStar over a link.

    Parameters
    ----------
    epoch : {"apparent", "icrs"}
        Kind of coordinates it is taken to speak; no answer says which. Usual: JNow for Celestron, J2000 for
        SynScan.
    park : Horizon, optional
        Where it parks, as its own `z` counts; there is no usual place for all mounts [INDI SetDefaultPark].
    """

    def __init__(self, link: Link, *, epoch: Epoch = "apparent", park: Horizon | None = None) -> None:
        super().__init__(link)
        self._why = "this hand control has no such command"
        self._exchange = HandsetExchange(link)
        self._epoch = epoch
        self._greeting = Greeting(Handset(Version(0, 0)), short=False)
        self._parking = Parking(park)
        self._following = Following(self._exchange.asked, self.device)
        self._latitude_deg = 0.0
        self._mode: Tracking | None = None
        self._rate: TrackingRate | None = None
        self._pier_side: PierSide | None = None

    # -- what it is --------------------------------------------------------------------------------

    @property
    def handset(self) -> Handset:
        """Who answered, known after `open`."""
        return self._greeting.handset

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it is set to speak."""
        return self._epoch

    @property
    def usual_epoch(self) -> Epoch:
        """J2000 for SynScan [INDI synscandriver], JNow for Celestron."""
        if not self._greeting.known:
            return self._epoch
        return "icrs" if self.handset.synscan else "apparent"

    @property
    def resolution_arcsec(self) -> float:
        """0.08 in the eight-digit form, 20 in the four-digit one of the first hand controls."""
        return SHORT_STEP_ARCSEC if self._greeting.short else LONG_STEP_ARCSEC

    @property
    def skills(self) -> frozenset[Skill]:
        """What it can do. It parks once a place for that is known; that it is parked only we know."""
        if not self._greeting.known:
            return frozenset()
        handset = self.handset
        skills = {Skill.SET_PARK, Skill.UNPARK}
        if not handset.short_places:
            # as old as the short places: nothing is passed on to the motors
            skills.add(Skill.GUIDE)
        if handset.tells_tracking:
            skills.add(Skill.TRACK)
        if self._parking.place is not None:
            skills.add(Skill.PARK)
        if handset.keeps_time:
            skills |= {Skill.SET_CLOCK, Skill.SET_SITE}
            lacks = self._exchange.refining.lacks
            if not lacks(base.GET_FINE_TIME if handset.quarter_zones else base.GET_TIME):
                skills.add(Skill.CLOCK)
            if not lacks(base.GET_SITE):
                skills.add(Skill.SITE)
        if handset.has_rates:
            skills.add(Skill.TRACKING_RATES)
        if self._follows:
            skills |= {Skill.OFFSET_RATES, Skill.MOVE_AXIS}
        if handset.tells_pier_side and not self._exchange.refining.lacks(base.PIER_SIDE):
            skills.add(Skill.PIER_SIDE)
        return frozenset(skills)

    @property
    def silent_refusals(self) -> bool:
        """A goto into its limits is answered, and that is all [Celestron's manual, RS-232]."""
        return True

    # -- the link ----------------------------------------------------------------------------------

    async def open(self) -> Identity:
        """Open the link and find out who is there; moves, syncs and sets nothing.

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks NexStar.
        """
        return await self._greeted(self._identify)

    async def _identify(self) -> Identity:
        self._exchange.opened()
        self._rate = None
        self._following.forget()
        await self._exchange.step()
        self._greeting = await greet(self._exchange.agreed, self._exchange.agreed_if_known, self.handset)
        handset, problems = self.handset, []
        await self.read_site()
        await self.read_clock()
        await self._place()
        await self._state()
        aligned, doubt = await self._exchange.asked_if_known(base.ALIGNED), ""
        if aligned is None:
            doubt = "it doesn't say whether it is aligned"
        elif not aligned:
            problems.append("it is not aligned: it goes nowhere until that is done at its hand control")
        if not handset.knows_sync:
            problems.append(f"its hand control {handset.version} has no sync command")
        return Identity(handset.text, (*problems, *self._exchange.refining.notes), doubt)

    # -- readings ----------------------------------------------------------------------------------

    async def readout(self) -> Readout:
        """Look at the mount: place, goto, tracking, alignment, side of pier.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If there is no answer, none that makes sense, or no link.
        """
        handset = self.handset
        await self._exchange.back_in_step()
        troubles, before = self._link.troubles, utc_now()
        pair = await self._place()
        span = utc_now() - before
        utc = before + span / 2
        slewing, mode, letter = await self._state()
        # one that can't say so is taken as aligned, as it was before hand controls could
        aligned = await self._exchange.asked_if_known(base.ALIGNED) is not False
        if letter is not None:
            mirrored = handset.mirrors_pier_side and self._latitude_deg < 0.0
            self._pier_side = side_of(letter, pair.second_deg, mirrored=mirrored)
        if mode:
            self._mode = mode
            # it tracks by itself again
            self._following.forget()
        if not aligned:
            self._following.forget()
            # switched on again: whatever was set is gone
            self._rate = None
        parked = await self._parked(slewing, mode, aligned)
        ra_deg, dec_deg = pair.first_deg, pair.second_deg
        return Readout(
            Icrs(ra_deg, dec_deg) if self._epoch == "icrs" else Apparent(ra_deg, dec_deg, utc),
            utc,
            span.total_seconds(),
            slewing=slewing,
            tracking=None if mode is None else mode is not Tracking.OFF or self._following.under_way,
            parked=parked,
            pier_side=self._pier_side,
            fresh=not aligned,
            doubtful=self._link.troubles != troubles,
        )

    async def _place(self) -> WirePair:
        return await self._link.ask(base.GET_PLACE_SHORT if self._greeting.short else base.GET_PLACE)

    async def _state(self) -> tuple[bool | None, Tracking | None, str | None]:
        """Whether it slews, how it tracks, its pier side's letter; None for what it lacks."""
        handset, known = self.handset, self._exchange.asked_if_known
        slewing = await known(base.SLEWING)
        mode = await known(base.get_tracking(handset)) if handset.tells_tracking else None
        letter = await known(base.PIER_SIDE) if handset.tells_pier_side else None
        return slewing, mode, letter

    async def _parked(self, slewing: bool | None, mode: Tracking | None, aligned: bool) -> bool:
        """Whether it is parked: sent to its place, seen there, tracking off, and nothing since."""
        parking = self._parking
        if not parking.concerned:
            return False
        there = False
        if aligned and not slewing:
            there = parking.near(await self._horizon())
            if parking.under_way and there and mode is not Tracking.OFF:
                await self._exchange.asked(base.set_tracking(self.handset.number(Tracking.OFF)))
                mode = Tracking.OFF
        return parking.seen(there=there, resting=not slewing, tracking=mode not in (None, Tracking.OFF))

    async def _horizon(self) -> Horizon:
        pair = await self._exchange.asked(
            base.GET_HORIZON_SHORT if self._greeting.short else base.GET_HORIZON
        )
        return Horizon(pair.first_deg, pair.second_deg)

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
        if self.handset.has_rates and self._usual_mode() in _EQUATORIAL:
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
        has_rates = handset.has_rates and mode in _EQUATORIAL
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
    def _follows(self) -> bool:
        """Whether its motors can be told rates of their own, and their signs are known."""
        handset = self.handset
        if handset.synscan or not handset.tells_tracking or self._usual_mode() not in _EQUATORIAL:
            return False
        return not handset.german or (
            handset.tells_pier_side and not self._exchange.refining.lacks(base.PIER_SIDE)
        )

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

    def _usual_mode(self) -> Tracking:
        return self._mode or self.handset.usual_mode(self._latitude_deg)

    async def _require_alignment(self, what: str) -> None:
        if await self._exchange.asked_if_known(base.ALIGNED) is False:
            raise DeviceRefused(
                f"{what} refused: it is not aligned",
                device=self.device,
                advice="align it at its hand control",
                reason=Refusal.NOT_ALIGNED,
            )

    # -- clock and site ----------------------------------------------------------------------------

    async def read_clock(self) -> datetime | None:
        """Its clock; it shows whole seconds [NexStar h, i]."""
        if not self.handset.keeps_time:
            return None
        command = base.GET_FINE_TIME if self.handset.quarter_zones else base.GET_TIME
        earlier = await self._exchange.agreed_if_known(command, alike=goes_on)
        if earlier is None:
            return None
        before = utc_now()
        shown = await self._exchange.asked(command)
        way = utc_now() - before
        # a flipped bit now: the one before was seen twice
        return clock_of(shown, way) if goes_on(earlier, shown) else clock_of(earlier, way)

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock, and its zone to UTC [NexStar H, I]; refused once it is aligned."""
        await self._require_no_alignment("a time")
        fine = self.handset.quarter_zones
        await self._sent_whole(base.set_time(time_for(utc), fine=fine))

    async def read_site(self) -> Site | None:
        """Where it believes to stand [NexStar w]."""
        if not self.handset.keeps_time:
            return None
        wire = await self._exchange.agreed_if_known(base.GET_SITE)
        if wire is None:
            return None
        site = site_of(wire)
        self._latitude_deg = site.latitude_deg
        return site

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


def nexstar_language(
    line: str | Callable[[], ByteLine],
    *,
    baud: int = 9600,
    control: ControlLines | None = None,
    epoch: Epoch = "apparent",
    patience: Patience | None = None,
    park: Horizon | None = None,
) -> NexstarLanguage:
    """Make the language over a line of its own; nothing is opened yet.

    Parameters
    ----------
    line : str or callable
        Address for a `SerialLine`, or a function that makes a `ByteLine`.
    baud : int
        Speed of a serial port.
    control : ControlLines, optional
        Of a serial port.
    epoch : {"apparent", "icrs"}
        Kind of coordinates: JNow for Celestron, J2000 for SynScan.
    patience : Patience, optional
        For one question.
    park : Horizon, optional
        Where it parks.
    """
    log = WireLog()
    made = SerialLine(line, baud=baud, log=log, control=control) if isinstance(line, str) else line()
    return NexstarLanguage(Link(made, patience or patience_of(8.0), log), epoch=epoch, park=park)
