"""Coordinates given to a mount behind INDI, and the switch that says what is done with them.

What an order to the coordinates means depends on a switch of its own (ON_COORD_SET) that every client of the
server can turn. So it is set and seen before each order, set again in the same write as the coordinates, and
never left on SYNC. If somebody turned it in between, the order's outcome is not known, and that is told.
"""

from __future__ import annotations

from drivers.generic.language import Sent, Wanted
from drivers.indi import claims, orders
from drivers.indi.answers import is_loud, refusal, slew_was_refused, was_refused, was_turned
from drivers.indi.claims import COORDINATES
from drivers.indi.codec import Event
from drivers.indi.device import IndiDevice
from drivers.indi.looking import Looking
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceSilent
from mountnav.sky.coordinates import Apparent, Icrs

_SWITCH = "ON_COORD_SET"
_SYNCED_ARCSEC = 30.0
_SECOND_LEG_ARCSEC = 20.0
_LONGEST_LEG_ARCSEC = 3600.0
_MOST_LEGS = 2


class Aiming:
    """Gives coordinates to one device.

    Parameters
    ----------
    device : IndiDevice
    looking : Looking
        Of the same device.
    """

    def __init__(self, device: IndiDevice, looking: Looking) -> None:
        self._device = device
        self._looking = looking
        self._place: Apparent | Icrs | None = None
        self._legs = 0
        self._sync_left = False

    @property
    def can_sync(self) -> bool:
        """Whether coordinates may be synced."""
        switch = self._device.get(_SWITCH)
        return switch is not None and switch.on("SYNC") is not None

    @property
    def sync_is_selected(self) -> bool:
        """Whether an order to the coordinates would be a sync now."""
        switch = self._device.get(_SWITCH)
        return switch is not None and switch.on("SYNC") is True

    async def begin(self) -> None:
        """Forget what was: the device is up anew. A SYNC that the broken link left selected is undone."""
        left, self._sync_left = self._sync_left, False
        self.forget()
        if left and self.sync_is_selected:
            await self._select(self._moving_mode())

    def forget(self) -> None:
        """Somebody else gives the coordinates now."""
        self._place, self._legs = None, 0

    async def slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew, tracking afterwards."""
        self._legs = _MOST_LEGS
        return await self._order(self._moving_mode(), place, wanted)

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """Once more, if it rests near its place: some drivers forget the turn of the sky on the way."""
        name, get = COORDINATES[self._looking.epoch], self._device.get
        if self._legs == 0 or claims.tracking(get) is False or claims.parked(get):
            return False
        if not _SECOND_LEG_ARCSEC < claims.apart_arcsec(get(name), place) < _LONGEST_LEG_ARCSEC:
            return False
        self._legs -= 1
        sent = await self._order(self._moving_mode(), place, wanted)
        if sent.lost is not None:
            raise sent.lost
        return sent.wire

    async def sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a sync; whatever comes of it, SYNC doesn't stay selected."""
        self._legs, self._sync_left = 0, True
        try:
            return await self._order("SYNC", place, wanted)
        finally:
            if self._device.usable:
                self._device.client.send(self._turn(self._moving_mode()))
                self._sync_left = False

    async def _order(self, mode: str, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        name = COORDINATES[self._looking.epoch]
        await self._select(mode)
        if not wanted():
            return Sent(wire=False)
        self._looking.be_restless()
        self._place = place
        coordinates = {"RA": (place.ra_deg / 15.0) % 24.0, "DEC": place.dec_deg}
        messages = [self._turn(mode), orders.new_numbers(self._device.name, name, coordinates)]
        if mode == "SYNC":
            messages.append(self._turn(self._moving_mode()))
        asking = _SWITCH if self._device.get(_SWITCH) else name
        try:
            heard = await self._device.ordered(*messages, asking=asking, echo=asking)
        except (DeviceSilent, DeviceMissing) as failure:
            return Sent(lost=failure)
        return self._sent(mode, name, heard)

    def _sent(self, mode: str, name: str, heard: list[Event]) -> Sent:
        """Judge what a driver did with coordinates by what it said of them."""
        address = self._device.address
        if mode == "SYNC":
            near = claims.apart_arcsec(self._device.get(name), self._place) <= _SYNCED_ARCSEC
            if not near and (is_loud(heard) or was_refused(name, heard)):
                raise refusal("the sync", heard, address)
            return Sent()
        if was_turned(mode, name, heard):
            self._looking.doubt()
            return Sent(
                lost=DeviceGarbled(
                    f"another program turned {_SWITCH} while coordinates were sent: maybe they were synced",
                    device=address,
                    advice="let one program alone move the mount; look at the sky before the next slew",
                )
            )
        if slew_was_refused(name, heard):
            raise refusal("the slew", heard, address)
        return Sent()

    def _moving_mode(self) -> str:
        switch = self._device.get(_SWITCH)
        if switch is None or switch.on("TRACK") is not None:
            return "TRACK"
        return "SLEW" if switch.on("SLEW") is not None else next(iter(switch.values))

    def _turn(self, on: str) -> bytes:
        switch = self._device.get(_SWITCH)
        if switch is None:
            return b""
        return orders.new_switches(self._device.name, _SWITCH, {key: key == on for key in switch.values})

    async def _select(self, on: str) -> None:
        switch = self._device.get(_SWITCH)
        if switch is not None:
            await self._device.set_switches(_SWITCH, {key: key == on for key in switch.values})
