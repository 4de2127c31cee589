"""A language without a wire, spoken straight to the mechanics: for tests of what all mounts do alike."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta

from drivers.generic.language import Identity, Readout, Sent, Unskilled, Wanted
from drivers.wire.wire_log import WireLog
from mountnav.clock import utc_now
from mountnav.devices import (
    Direction,
    Epoch,
    MountAxis,
    OffsetRates,
    RateSpan,
    Skill,
    TrackingRate,
)
from mountnav.errors import (
    DeviceError,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    Refusal,
)
from mountnav.simulation.mechanics import Direction as Ways
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.coordinates import Apparent, Icrs, Site


class PlainLanguage(Unskilled):
    """Says what the mechanics say, unless a knob is turned."""

    def __init__(self, mechanics: Mechanics) -> None:
        super().__init__()
        self.mechanics = mechanics
        self.log = WireLog()
        self.orders: list[str] = []
        self.denies: set[str] = set()
        """Orders that it carries out and says no to."""
        self.usable = False
        self.silent = False
        self.absent = False
        self.fresh = False
        self.parked = False
        self.at_home: bool | None = None
        self.sync_ignored = False
        self.sync_late_s = 0.0
        self.slew_answer_lost = False
        self.slew_ignored = False
        self.refuses_silently = False
        self.stops_needed = 0
        self.refuses_settings = False
        self.clock_off_s: float | None = None
        self.its_site: Site | None = None
        self.epoch: Epoch = "apparent"
        self.skills = frozenset(
            {
                Skill.PARK,
                Skill.UNPARK,
                Skill.TRACK,
                Skill.HOME,
                Skill.GUIDE,
                Skill.SET_CLOCK,
                Skill.SET_SITE,
                Skill.OFFSET_RATES,
                Skill.MOVE_AXIS,
            }
        )
        self.tells_motion = True
        self.tells_rates = True
        self.rates_unread: DeviceError | None = None
        """What it answers to the question for its rates instead."""
        self.rates_lost: DeviceError | None = None
        """What becomes of the answer to an order of rates."""
        self.takes_rates: Callable[[OffsetRates], OffsetRates | None] = lambda rates: rates
        """What it makes of an order of rates; None: nothing."""
        self.rates_late_s = 0.0
        self.rates_go_out = asyncio.Event()
        self.rates_go_out.set()
        self.axis_lost: DeviceError | None = None
        self.axis_keeps_on = False
        """Whether it doesn't heed the end of a motion by hand."""
        self.odd: list[Apparent] = []
        self._gone = asyncio.Event()
        self._asked_s: float | None = None

    usual_epoch: Epoch = "apparent"
    resolution_arcsec = 0.1
    most_offset_arcsec_s: OffsetRates | None = OffsetRates(5000.0, 5000.0)
    offset_step_arcsec_s = 0.0

    @property
    def device(self) -> str:
        return "plain"

    @property
    def silent_refusals(self) -> bool:
        return self.refuses_silently

    def unanswered_s(self) -> float:
        return 0.0 if self._asked_s is None else asyncio.get_running_loop().time() - self._asked_s

    def _said(self, order: str) -> None:
        self.log.note("driver->mount", order.encode())
        self.orders.append(order)

    def _denied(self, order: str) -> None:
        if order.partition(" ")[0] in self.denies:
            raise DeviceRefused("below horizon", device=self.device, reason=Refusal.BELOW_HORIZON)

    def lose(self) -> None:
        self.usable = False
        self._gone.set()

    async def open(self) -> Identity:
        self.orders.append("open")
        if self.absent:
            raise DeviceMissing("not there", device=self.device)
        await self._asked()
        self._gone.clear()
        self.usable = True
        return Identity("plain mount 1.0")

    async def close(self) -> None:
        self.usable = False

    async def lost(self) -> str:
        await self._gone.wait()
        return "unplugged"

    async def _asked(self) -> None:
        if not self.silent:
            return
        loop = asyncio.get_running_loop()
        self._asked_s, until = loop.time(), loop.time() + 0.3
        try:
            while self.silent:
                await asyncio.sleep(0.02)
                if loop.time() > until:
                    raise DeviceSilent("no answer", device=self.device)
        finally:
            self._asked_s = None

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        return frozenset(TrackingRate)

    async def readout(self) -> Readout:
        if not self.usable:
            raise DeviceMissing("the line was lost", device=self.device)
        await self._asked()
        if self.odd:
            return Readout(self.odd.pop(0), utc_now(), slewing=False)
        utc = utc_now()
        place = self.mechanics.reported(utc)
        return Readout(
            place,
            utc,
            slewing=self.mechanics.slewing(utc) if self.tells_motion else None,
            tracking=self.mechanics.tracking,
            parked=self.parked,
            at_home=self.at_home,
            fresh=self.fresh,
        )

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        if not wanted():
            return Sent(wire=False)
        self._said("slew")
        assert isinstance(place, Apparent)
        if self.mechanics.believed_altitude_deg(place) < 0.0:
            raise DeviceRefused("below horizon", device=self.device, reason=Refusal.BELOW_HORIZON)
        if not self.slew_ignored:
            self.mechanics.slew(place)
        self._denied("slew")
        if self.slew_answer_lost:
            return Sent(lost=DeviceSilent("no answer to the slew", device=self.device))
        return Sent()

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        self._said("sync")
        assert isinstance(place, Apparent)
        if self.sync_late_s:
            asyncio.get_running_loop().call_later(self.sync_late_s, self.mechanics.sync, place)
        elif not self.sync_ignored:
            self.mechanics.sync(place)
        self._denied("sync")
        return Sent()

    async def send_stop(self, again: int) -> None:
        self.orders.append(f"stop {again}")
        self.log.note("driver->mount", b"stop")
        if again >= self.stops_needed:
            self.mechanics.stop()

    async def send_park(self, wanted: Wanted) -> Sent:
        self._said("park")
        self.mechanics.move("n", 1.0)

        def parked() -> None:
            self.mechanics.stop()
            self.parked = True

        asyncio.get_running_loop().call_later(0.3, parked)
        self._denied("park")
        return Sent()

    async def send_unpark(self) -> None:
        self._said("unpark")
        self.parked = False
        self._denied("unpark")

    async def send_home(self, wanted: Wanted) -> Sent:
        self._said("home")
        self.mechanics.move("n", 1.0)

        def there() -> None:
            self.mechanics.stop()
            self.at_home = True

        asyncio.get_running_loop().call_later(0.3, there)
        self._denied("home")
        return Sent()

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        self._said("tracking")
        self.mechanics.tracking = on
        self._denied("tracking")

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        self._said(f"guide {direction} {duration_s}")
        if "guide" in self.denies:
            # a hand control's key that is never let go
            self.mechanics.move(direction.value, 1.0)
        self._denied("guide")
        return Sent()

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        self._said(f"rates {rates.ra_arcsec_s:g} {rates.dec_arcsec_s:g}")
        await self.rates_go_out.wait()
        taken = self.takes_rates(rates)
        if taken is not None and self.rates_late_s:
            asyncio.get_running_loop().call_later(
                self.rates_late_s, self.mechanics.track_beside, taken.ra_arcsec_s, taken.dec_arcsec_s
            )
        elif taken is not None:
            self.mechanics.track_beside(taken.ra_arcsec_s, taken.dec_arcsec_s)
            # gathering speed for half a millisecond is no slew to a real mount; a quick machine reads in it
            while self.mechanics.slewing():
                await asyncio.sleep(0)
        if self.rates_lost is not None:
            raise self.rates_lost
        if not rates.none:
            self._denied("rates")

    async def read_offset_rates(self) -> OffsetRates | None:
        if self.rates_unread is not None:
            raise self.rates_unread
        return OffsetRates(*self.mechanics.beside_arcsec_s) if self.tells_rates else None

    axis_rates_deg_s: Mapping[MountAxis, tuple[RateSpan, ...]] = {
        "primary": (RateSpan(0.001, 2.0), RateSpan(3.0, 3.0)),
        "secondary": (RateSpan(0.001, 2.0),),
    }

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        if not wanted():
            return Sent(wire=False)
        self._said(f"axis {axis} {rate_deg_s:g}")
        ways: tuple[Ways, Ways] = ("e", "w") if axis == "primary" else ("n", "s")
        if rate_deg_s == 0.0:
            if not self.axis_keeps_on:
                self.mechanics.stop_move(ways[0])
            self._denied("axis-end")
        else:
            self.mechanics.move(ways[rate_deg_s < 0.0], abs(rate_deg_s))
            self._denied("axis")
        return Sent(lost=self.axis_lost)

    async def read_clock(self) -> datetime | None:
        return None if self.clock_off_s is None else utc_now() + timedelta(seconds=self.clock_off_s)

    async def write_clock(self, utc: datetime) -> None:
        if self.refuses_settings:
            raise DeviceRefused("not while aligned", device=self.device)
        self.orders.append("set clock")
        self.clock_off_s = 0.0

    async def read_site(self) -> Site | None:
        return self.its_site

    async def write_site(self, site: Site) -> None:
        if self.refuses_settings:
            raise DeviceRefused("not while aligned", device=self.device)
        self.orders.append("set site")
        self.its_site = site
