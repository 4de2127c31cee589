"""The iOptron language: the only place that knows how its commands make a reading, a slew or a park.

A `1` is not believed when a stop went out while it was awaited: it may be the stop's. What became of the
order then shows in the readings.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from drivers.generic.language import Sent, Wanted
from drivers.ioptron import exchange
from drivers.ioptron.codec import v3
from drivers.ioptron.codec.values import MountState, TrackingRate
from drivers.ioptron.exchange import destination_side, why_not
from drivers.ioptron.rates import MOST, SPANS, STEP_ARCSEC_S, move_ra, order_rates, told_rates
from drivers.ioptron.readings import SLEWING, IoptronReading
from drivers.wire.command import Command
from mountnav import devices
from mountnav.devices import Direction, MountAxis, OffsetRates, RateSpan, Skill
from mountnav.errors import DeviceGarbled, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site

_RATES = {
    devices.TrackingRate.SIDEREAL: TrackingRate.SIDEREAL,
    devices.TrackingRate.LUNAR: TrackingRate.LUNAR,
    devices.TrackingRate.SOLAR: TrackingRate.SOLAR,
    devices.TrackingRate.KING: TrackingRate.KING,
    devices.TrackingRate.CUSTOM: TrackingRate.CUSTOM,
}


class IoptronLanguage(IoptronReading):
    """What iOptron mounts of the v2 and v3 command sets can say."""

    # -- orders that move or sync ------------------------------------------------------------------

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew to the normal posture; the mount tracks afterwards [IOPTRON310 :MS1#].

        Raises
        ------
        DeviceRefused
            When it is parked or says 0: below its altitude limit, or beyond a mechanical one.
        """
        status = await self._exchange.settled("the slew")
        await self._aim(place, wanted)
        if not wanted():
            return Sent(wire=False)
        self._home_ordered = False
        taken, lost = await self._exchange.told(self._words.slew)
        if taken is False and wanted():
            raise await why_not(self._exchange, place, status)
        # after a stop the answer may have been the stop's: what became of it shows in the readings
        return Sent(lost=lost)

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a sync [IOPTRON310 :CM#]; a slewing mount would answer 1 and ignore it.

        Raises
        ------
        DeviceRefused
            When it slews, is parked, is an alt-azimuth mount, or says 0.
        """
        if not self._model.equatorial:
            raise self._exchange.no(
                "can't sync: alt-azimuth models take altitude and azimuth for it", Refusal.UNSUPPORTED
            )
        status = await self._exchange.settled("the sync")
        if status.state in SLEWING:
            raise self._exchange.no("the sync refused: it slews", Refusal.BUSY, "wait until it has arrived")
        await self._aim(place, wanted)
        if not wanted():
            return Sent(wire=False)
        taken, lost = await self._exchange.told(v3.SYNC)
        if not wanted():
            lost = lost or DeviceGarbled(
                "the answer to the sync may be that of a stop",
                device=self.device,
                advice="read the place back",
            )
        elif taken is False:
            raise self._exchange.no("refused the sync: 0", Refusal.OTHER)
        return Sent(lost=lost)

    async def send_stop(self, again: int) -> None:
        """Stop: `:Q#` ends all slewing and leaves tracking; repeated, the ends of arrow keys come with it."""
        if again == 0:
            await self._link.send_now(v3.STOP)
        else:
            await self._link.send_now(v3.STOP, v3.STOP_RA, v3.STOP_DEC)

    async def send_park(self, wanted: Wanted) -> Sent:
        """Order parking at the position set before [IOPTRON310 :MP1#].

        Raises
        ------
        DeviceRefused
            When the model can't, or says 0.
        """
        self._need(Skill.PARK, "park")
        status = await self._exchange.settled("parking", moves=False)
        if status.state is MountState.PARKED:
            return Sent()
        return await self._sent_once(v3.PARK, "to park", wanted)

    async def send_unpark(self) -> None:
        """Order unparking; without effect on an unparked mount. Raises `DeviceRefused`."""
        self._need(Skill.UNPARK, "unpark")
        await self._exchange.settled("unparking", moves=False)
        await self._exchange.obeyed(v3.UNPARK, "to unpark")
        # it may have been parked there
        self._rests_at_home = True

    async def send_home(self, wanted: Wanted) -> Sent:
        """Order it to search its home by its sensors, or to go where it believes it, if it has none.

        Raises
        ------
        DeviceRefused
            When it is parked or says 0.
        """
        await self._exchange.settled("going home")
        searches = self._model.searches_home
        sent = await self._sent_once(v3.FIND_HOME if searches else v3.HOME, "to go home", wanted)
        self._home_ordered = sent.wire
        return sent

    async def _sent_once(self, command: Command[bool], what: str, wanted: Wanted) -> Sent:
        if not wanted():
            return Sent(wire=False)
        taken, lost = await self._exchange.told(command)
        if taken is False and wanted():
            raise self._exchange.no(f"refused {what}: 0", Refusal.OTHER)
        return Sent(lost=lost)

    async def _aim(self, place: Apparent | Icrs, wanted: Wanted) -> None:
        for command, what in (
            (self._words.set_ra(place.ra_deg), f"a right ascension of {place.ra_deg:.5f}°"),
            (self._words.set_dec(place.dec_deg), f"a declination of {place.dec_deg:.5f}°"),
        ):
            if not await self._exchange.ask(command) and wanted():
                raise self._exchange.no(f"refused {what}: 0", Refusal.OTHER)

    # -- tracking, guiding, park position ----------------------------------------------------------

    @property
    def tracking_rates(self) -> frozenset[devices.TrackingRate]:
        """At which rates it can be ordered to track."""
        return frozenset(rate for rate in _RATES if rate is not devices.TrackingRate.CUSTOM)

    async def send_tracking(self, on: bool, rate: devices.TrackingRate) -> None:
        """Order the rate, and tracking. Raises `DeviceRefused`."""
        await self._exchange.settled("switching tracking", moves=on)
        if on:
            await self._exchange.obeyed(v3.set_rate(_RATES[rate]), f"the {rate} rate")
        await self._exchange.obeyed(v3.set_tracking(on), "to switch tracking")

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Order guide pulses, which the mount times itself and doesn't answer.

        Raises
        ------
        DeviceRefused
            When it is parked or slews, or is an alt-azimuth mount.
        """
        self._need(Skill.GUIDE, "guide")
        status = await self._exchange.settled("guiding")
        if status.state in SLEWING:
            raise self._exchange.no("guiding refused: it slews", Refusal.BUSY, "wait until it has arrived")
        if not wanted():
            return Sent(wire=False)
        duration_ms = round(duration_s * 1000.0)
        if duration_ms > self._words.longest_pulse_ms:
            raise self._exchange.no(
                f"can't guide for {duration_s} s: at most {self._words.longest_pulse_ms / 1000.0} s",
                Refusal.UNSUPPORTED,
            )
        await self._exchange.ask(self._words.pulse(direction.value, duration_ms))
        return Sent()

    async def guiding(self) -> bool | None:
        """Whether a pulse still runs [IOPTRON310 :GLS# system status 3]."""
        return (await self._exchange.ask(self._words.status)).state is MountState.GUIDING

    async def send_set_park(self) -> None:
        """Tell it the present altitude and azimuth for the park position.

        Raises
        ------
        DeviceRefused
            When it looks below the horizon: the protocol has no word for that.
        """
        self._need(Skill.SET_PARK, "set a park position")
        place = await self._exchange.ask(v3.HORIZONTAL)
        if place.alt_deg < 0.0:
            raise self._exchange.no(
                f"can't set a park position {place.alt_deg:.2f}° below the horizon", Refusal.BELOW_HORIZON
            )
        await self._exchange.obeyed(v3.set_park_altitude(place.alt_deg), "the park altitude")
        await self._exchange.obeyed(v3.set_park_azimuth(place.az_deg), "the park azimuth")

    # -- what moves --------------------------------------------------------------------------------

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """0.9 of the sidereal rate in right ascension, none in declination."""
        return MOST if self._follows else None

    @property
    def offset_step_arcsec_s(self) -> float:
        """Four decimals of the sidereal rate."""
        return STEP_ARCSEC_S if self._follows else 0.0

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Order the custom rate. Raises `DeviceRefused` for a part in declination, too."""
        if not self._follows:
            raise self._unsupported("track at offset rates")
        await order_rates(self._exchange, rates)

    async def read_offset_rates(self) -> OffsetRates | None:
        """What it is set to track at."""
        return await told_rates(self._exchange) if self._follows else None

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """Speeds of the arrow keys, of right ascension alone."""
        return {"primary": SPANS} if self._follows else {}

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Press an arrow key, or let go of it. Raises `DeviceRefused`."""
        if axis not in self.axis_rates_deg_s:
            raise self._unsupported(f"move its {axis} axis by hand")
        return await move_ra(self._exchange, rate_deg_s, wanted)

    # -- clock, site and sides ---------------------------------------------------------------------

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock. Raises `DeviceRefused`."""
        await exchange.write_clock(self._exchange, utc)

    async def write_site(self, site: Site) -> None:
        """Tell it where it stands. Raises `DeviceRefused`."""
        await exchange.write_site(self._exchange, site)

    async def destination_side(self, place: Apparent | Icrs) -> devices.PierSide | None:
        """On which side it would look at a place; None near the meridian, and where it has no sides."""
        if Skill.DESTINATION_SIDE not in self.skills:
            return None
        return await destination_side(self._exchange, place, self._flips_past_deg)

    def _need(self, skill: Skill, what: str) -> None:
        if skill not in self.skills:
            raise self._exchange.no(
                f"can't {what}: a {self._model.name} has no such command", Refusal.UNSUPPORTED
            )


BAUD = 115_200
"""Of v3 mounts; hand controllers 8407 and 8408, and most v2 mounts, speak at 9600 [IOPTRON, INDI ieqpro]."""
