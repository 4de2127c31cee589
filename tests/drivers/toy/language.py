"""The toy as a `drivers.generic.language.Language`: which words make a reading or an order."""

from __future__ import annotations

from drivers.generic.language import Identity, Readout, Sent, Wanted
from drivers.generic.serial_language import SerialLanguage
from drivers.wire.command import Command
from mountnav.clock import utc_now
from mountnav.devices import Epoch, Skill, TrackingRate
from mountnav.errors import DeviceGarbled, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import Apparent, Icrs
from tests.drivers.toy import codec


class ToyLanguage(SerialLanguage):
    """The toy over a link; what it can't do (park, guide, keep a clock) `SerialLanguage` refuses."""

    epoch: Epoch = "apparent"
    usual_epoch: Epoch = "apparent"
    resolution_arcsec = codec.STEP_ARCSEC
    skills: frozenset[Skill] = frozenset()
    tracking_rates: frozenset[TrackingRate] = frozenset()

    async def open(self) -> Identity:
        return await self._greeted(self._identify)

    async def _identify(self) -> Identity:
        name = await self._link.ask(codec.WHO)
        await self._link.ask(codec.WHERE)
        return Identity(name)

    async def readout(self) -> Readout:
        before = utc_now()
        where = await self._link.ask(codec.WHERE)
        span = utc_now() - before
        utc = before + span / 2
        return Readout(
            Apparent(where.ra_deg, where.dec_deg, utc),
            utc,
            span.total_seconds(),
            slewing=where.slewing,
            tracking=where.tracking,
        )

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        return await self._once(codec.slew(place.ra_deg, place.dec_deg), wanted)

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        return await self._once(codec.sync(place.ra_deg, place.dec_deg), wanted)

    async def _once(self, order: Command[str | None], wanted: Wanted) -> Sent:
        if not wanted():
            return Sent(wire=False)
        try:
            refusal = await self._link.ask(order)
        except (DeviceSilent, DeviceGarbled) as failure:
            return Sent(lost=failure)
        if refusal is not None:
            below = Refusal.BELOW_HORIZON if "horizon" in refusal else Refusal.OTHER
            raise DeviceRefused(f"refused the {order.meaning}: {refusal}", device=self.device, reason=below)
        return Sent()

    async def send_stop(self, again: int) -> None:
        await self._link.send_now(codec.STOP)
