"""What a hand control shows of its mount: who it is, where it points, whether it tracks or is parked."""

from __future__ import annotations

from datetime import datetime

from drivers.generic.language import Identity, Readout
from drivers.generic.serial_language import SerialLanguage
from drivers.nexstar.codec import base
from drivers.nexstar.codec.dialect import Handset, Tracking, Version
from drivers.nexstar.codec.greeting import Greeting, greet
from drivers.nexstar.codec.passthrough import side_of
from drivers.nexstar.codec.replies import LONG_STEP_ARCSEC, SHORT_STEP_ARCSEC, WirePair
from drivers.nexstar.codec.site_and_time import clock_of, goes_on, site_of
from drivers.nexstar.exchange import HandsetExchange
from drivers.nexstar.parking import Horizon, Parking
from drivers.nexstar.rates import Following
from drivers.wire.link import Link
from mountnav.clock import utc_now
from mountnav.devices import Epoch, PierSide, Skill, TrackingRate
from mountnav.sky.coordinates import Apparent, Icrs, Site

EQUATORIAL = (Tracking.EQUATORIAL_NORTH, Tracking.EQUATORIAL_SOUTH)
"""Modes in which one motor alone follows the stars."""


class NexstarReading(SerialLanguage):
    """What can be asked of a hand control, and what we hold of its mount.

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

    def _usual_mode(self) -> Tracking:
        return self._mode or self.handset.usual_mode(self._latitude_deg)

    @property
    def _follows(self) -> bool:
        """Whether its motors can be told rates of their own, and their signs are known."""
        handset = self.handset
        if handset.synscan or not handset.tells_tracking or self._usual_mode() not in EQUATORIAL:
            return False
        return not handset.german or (
            handset.tells_pier_side and not self._exchange.refining.lacks(base.PIER_SIDE)
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
