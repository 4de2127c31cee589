"""A mount behind INDI, as a language: which properties make an order, and which one shows that it arrived.

Readings stand in `readings`, rates and axes in `rates`; coordinates are given by `CoordinateOrders`, with the
switch that says what they mean.

What an order to the coordinates means depends on a switch of its own (ON_COORD_SET) that every client of the
server can turn. So it is set and seen before each order, set again in the same write as the coordinates, and
never left on SYNC. If another program changed it in between, the order's outcome is not known, and that is
reported.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta

from drivers.generic.language import Identity, Readout, Sent, Unskilled, Wanted
from drivers.generic.options import Timing
from drivers.indi.codec import messages, rates, state
from drivers.indi.codec import messages as orders
from drivers.indi.codec.answers import (
    is_loud,
    parked_refusal,
    refusal,
    slew_was_refused,
    was_refused,
    was_turned,
)
from drivers.indi.codec.messages import Event, Ordered
from drivers.indi.codec.state import COORDINATES, Property
from drivers.indi.device import IndiDevice
from drivers.indi.rates import AxisOrders, RateOrders
from drivers.indi.readings import MountReader
from drivers.wire.wire_log import WireLog
from mountnav.clock import utc_now
from mountnav.devices import Direction, Epoch, MountAxis, OffsetRates, RateSpan, Skill, TrackingRate
from mountnav.errors import DeviceGarbled, DeviceMissing, DeviceSilent
from mountnav.sky.coordinates import Apparent, Icrs, Site

_SWITCH = "ON_COORD_SET"
_SYNCED_ARCSEC = 30.0
"""A sync that was answered counts as taken when the driver reports a place so near to it. Chosen by hand:
above a second of time in right ascension (15), to which some drivers round."""
_SECOND_LEG_ARCSEC = 20.0
"""A mount that rests farther than this from its target is sent once more: some drivers forget how far the
sky turned on the way. Chosen by hand; halved, mounts that round to a second of time are sent in vain."""
_LONGEST_LEG_ARCSEC = 3600.0
"""Farther than this it did not miss its target but stopped for another reason: it is not sent again. Chosen
by hand: one degree, what the sky turns in four minutes."""
_MOST_LEGS = 2
"""How many times it is sent again for one slew. Chosen by hand: one order mostly suffices."""


class CoordinateOrders:
    """Gives coordinates to one device.

    Parameters
    ----------
    reader : MountReader
        Of the same device.
    """

    def __init__(self, device: IndiDevice, reader: MountReader) -> None:
        self._device = device
        self._reader = reader
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
        """Forget what was: the device is up again. A SYNC that the broken link left selected is undone."""
        left, self._sync_left = self._sync_left, False
        self.forget()
        if left and self.sync_is_selected:
            await self._select(self._moving_mode())

    def forget(self) -> None:
        """Another program gives the coordinates now."""
        self._place, self._legs = None, 0

    async def slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew, tracking afterwards."""
        self._legs = _MOST_LEGS
        return await self._order(self._moving_mode(), place, wanted)

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """Once more, if it rests near its place: some drivers forget the turn of the sky on the way."""
        name, get = COORDINATES[self._reader.epoch], self._device.get
        if self._legs == 0 or state.tracking(get) is False or state.parked(get):
            return False
        if not _SECOND_LEG_ARCSEC < state.apart_arcsec(get(name), place) < _LONGEST_LEG_ARCSEC:
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
        name = COORDINATES[self._reader.epoch]
        await self._select(mode)
        if not wanted():
            return Sent(wire=False)
        self._reader.be_restless()
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
            near = state.apart_arcsec(self._device.get(name), self._place) <= _SYNCED_ARCSEC
            if not near and (is_loud(heard) or was_refused(name, heard)):
                raise refusal("the sync", heard, address)
            return Sent()
        if was_turned(mode, name, heard):
            self._reader.doubt()
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


_TRACK_MODES = {
    TrackingRate.SIDEREAL: "TRACK_SIDEREAL",
    TrackingRate.LUNAR: "TRACK_LUNAR",
    TrackingRate.SOLAR: "TRACK_SOLAR",
    TrackingRate.KING: "TRACK_KING",
    TrackingRate.CUSTOM: "TRACK_CUSTOM",
}
_PULSES = {
    Direction.NORTH: ("TELESCOPE_TIMED_GUIDE_NS", "TIMED_GUIDE_N", "TIMED_GUIDE_S"),
    Direction.SOUTH: ("TELESCOPE_TIMED_GUIDE_NS", "TIMED_GUIDE_S", "TIMED_GUIDE_N"),
    Direction.WEST: ("TELESCOPE_TIMED_GUIDE_WE", "TIMED_GUIDE_W", "TIMED_GUIDE_E"),
    Direction.EAST: ("TELESCOPE_TIMED_GUIDE_WE", "TIMED_GUIDE_E", "TIMED_GUIDE_W"),
}
_MOVERS = {
    *COORDINATES.values(),
    "ON_COORD_SET",
    "TELESCOPE_ABORT_MOTION",
    "TELESCOPE_PARK",
    "TELESCOPE_HOME",
    "TELESCOPE_MOTION_NS",
    "TELESCOPE_MOTION_WE",
}


@dataclass(frozen=True, slots=True)
class IndiHabits:
    """What the configuration says of a mount behind INDI.

    Attributes
    ----------
    epoch : {"apparent", "icrs"} or None
        Which coordinates to use; None takes those of date if the device has them, else J2000.
    may_connect : bool
        Whether a device that is not connected may be ordered to connect.
    resolution_arcsec : float
        Coarsest step of the mount: INDI doesn't say.
    rate_step_arcsec_s : float
        Coarsest step to which it rounds offset rates.
    speeds_deg_s : tuple of float
        Speeds of motion by hand, by the switches of TELESCOPE_SLEW_RATE from the first: INDI doesn't say
        them. Empty: those that are known of its driver.
    """

    epoch: Epoch | None = None
    may_connect: bool = True
    resolution_arcsec: float = 1.0
    rate_step_arcsec_s: float = 0.0
    speeds_deg_s: tuple[float, ...] = ()


class IndiLanguage(Unskilled):
    """A `drivers.generic.language.Language` over one device of an `indiserver`.

    Parameters
    ----------
    device : IndiDevice
        Of the mount; its connection is about that device alone.
    """

    def __init__(self, device: IndiDevice, habits: IndiHabits | None = None) -> None:
        super().__init__()
        self._why = "its INDI driver has no such property"
        self._device = device
        self._habits = habits or IndiHabits()
        self._reader = MountReader(device)
        self._reader.epoch = self._habits.epoch or "apparent"
        self._orders = CoordinateOrders(device, self._reader)
        self._offsets = RateOrders(device)
        self._axes = AxisOrders(device, self._reader)
        self._homed = False
        device.client.listen(self._on_event)

    # -- what it is ------------------------------------------------------------------------------

    @property
    def device(self) -> str:
        """Server and name of the device."""
        return self._device.address

    @property
    def log(self) -> WireLog:
        """All that went over its connection lately; BLOBs are abbreviated."""
        return self._device.client.log

    @property
    def usable(self) -> bool:
        """Whether the connection is up, and the device connected ever since."""
        return self._device.usable

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it is used with; known after `open` unless it is set."""
        return self._reader.epoch

    @property
    def usual_epoch(self) -> Epoch:
        """As found: a driver converts by itself."""
        return self._reader.epoch

    @property
    def resolution_arcsec(self) -> float:
        """As set."""
        return self._habits.resolution_arcsec

    @property
    def silent_refusals(self) -> bool:
        """Yes: coordinates that a driver doesn't like may be passed over without a word."""
        return True

    @property
    def skills(self) -> frozenset[Skill]:
        """By the properties that are there."""
        get = self._device.get
        more = {
            Skill.OFFSET_RATES: rates.takes_offsets(get, self._known),
            Skill.MOVE_AXIS: bool(self._axes.speeds),
        }
        return state.skills(get) | {skill for skill, can in more.items() if can}

    @property
    def _known(self) -> rates.Known:
        """What is known of its driver."""
        return rates.known(self._device.driver.partition(" ")[0])

    def unanswered_s(self) -> float:
        """Since when its driver owes the answer to a question."""
        return self._device.unanswered_s()

    # -- the link --------------------------------------------------------------------------------

    async def open(self) -> Identity:
        """Connect to the server, find the device, and have it connect to its mount if it may. Moves nothing.

        Raises
        ------
        DeviceMissing
            If there is no server, no such device, or its driver can't connect.
        DeviceRefused
            If it is not connected and may not be ordered to, or is no mount.
        DeviceSilent
            If its driver doesn't answer.
        """
        habits, device = self._habits, self._device
        names = (COORDINATES[habits.epoch],) if habits.epoch else tuple(COORDINATES.values())
        ours = await device.bring_up(may_connect=habits.may_connect, needed=names)
        found: Epoch = "apparent" if device.get(COORDINATES["apparent"]) else "icrs"
        self._reader.epoch = habits.epoch or found
        self._reader.begin(unread=ours)
        self._homed = False
        problems = []
        if ours:
            problems.append("it was not connected: we connected it")
        if self._orders.sync_is_selected:
            problems.append("SYNC is selected on the server: a slew from another program would be a sync")
        await self._orders.begin()
        self._axes.stopped()
        self._axes.speeds_deg_s = habits.speeds_deg_s or self._known.speeds_deg_s
        if self._known.why and device.get(rates.RATE) is not None:
            problems.append(f"offset rates: {self._known.why}")
        return Identity(f"{device.name} ({device.driver})", tuple(problems))

    async def close(self) -> None:
        """Release the connection; the device stays connected, for others."""
        await self._device.client.close()

    async def lost(self) -> str:
        """Wait until the server, the driver or its connection to the mount is gone, and return why."""
        return await self._device.lost()

    # -- readings --------------------------------------------------------------------------------

    async def readout(self) -> Readout:
        """Have the driver send the place again; see `MountReader.readout`."""
        return await self._reader.readout(homed=self._homed)

    # -- orders ----------------------------------------------------------------------------------

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew: TRACK selected and seen, then TRACK and the coordinates in one write."""
        self._require_unparked("the slew")
        self._homed = False
        return await self._orders.slew(place, wanted)

    async def next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        """Once more, if it rests near its place: some drivers forget the turn of the sky on the way."""
        return await self._orders.next_leg(place, wanted)

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a sync; whatever comes of it, SYNC doesn't stay selected."""
        self._require_unparked("the sync")
        if not self._orders.can_sync:
            raise self._unsupported("sync")
        return await self._orders.sync(place, wanted)

    async def send_stop(self, again: int) -> None:
        """Abort all motion; tracking stays as it was [INDI Telescope: abort restores what it did before]."""
        self._reader.be_restless()
        self._axes.stopped()
        self._device.client.send(
            messages.new_switches(self._device.name, "TELESCOPE_ABORT_MOTION", {"ABORT": True})
        )

    async def send_park(self, wanted: Wanted) -> Sent:
        """Order parking."""
        if not wanted():
            return Sent(wire=False)
        self._homed = False
        return await self._switch("TELESCOPE_PARK", {"PARK": True, "UNPARK": False}, "parking")

    async def send_unpark(self) -> None:
        """Order unparking."""
        await self._now("TELESCOPE_PARK", {"PARK": False, "UNPARK": True}, "unparking")

    async def send_set_park(self) -> None:
        """Take the present place for the park position, and have it written."""
        await self._now("TELESCOPE_PARK_OPTION", {"PARK_CURRENT": True}, "setting the park position")
        option = self._device.get("TELESCOPE_PARK_OPTION")
        if option is not None and option.on("PARK_WRITE_DATA") is not None:
            await self._now("TELESCOPE_PARK_OPTION", {"PARK_WRITE_DATA": True}, "keeping the park position")

    async def send_home(self, wanted: Wanted) -> Sent:
        """Order homing: to the home it knows, else to find it [INDI 2: TELESCOPE_HOME]."""
        home = self._device.get("TELESCOPE_HOME")
        if home is None:
            raise self._unsupported("home")
        if not wanted():
            return Sent(wire=False)
        self._homed = True
        return await self._switch(
            "TELESCOPE_HOME", {"GO" if home.on("GO") is not None else "FIND": True}, "homing"
        )

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be ordered to track."""
        modes = self._device.get("TELESCOPE_TRACK_MODE")
        if modes is None:
            can = self._device.get("TELESCOPE_TRACK_STATE") is not None
            return frozenset({TrackingRate.SIDEREAL} if can else ())
        return frozenset(rate for rate, name in _TRACK_MODES.items() if modes.on(name) is not None)

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Order tracking, the mode first."""
        modes = self._device.get("TELESCOPE_TRACK_MODE")
        wanted = _TRACK_MODES[rate]
        if on and modes is not None and (rate is not TrackingRate.SIDEREAL or modes.on(wanted) is False):
            if modes.on(wanted) is None:
                raise self._unsupported(f"track at the {rate} rate")
            await self._device.set_switches(
                "TELESCOPE_TRACK_MODE", {key: key == wanted for key in modes.values}
            )
        await self._now("TELESCOPE_TRACK_STATE", {"TRACK_ON": on, "TRACK_OFF": not on}, "switching tracking")

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Order a pulse, which the driver times; refused when parked, for some drivers move all the same."""
        self._require_unparked("the pulse")
        name, element, other = _PULSES[direction]
        if self._device.get(name) is None:
            raise self._unsupported("guide")
        if not wanted():
            return Sent(wire=False)
        order = messages.new_numbers(self._device.name, name, {element: 1000.0 * duration_s, other: 0.0})
        try:
            heard = await self._device.ordered(order, asking=name, echo=name)
        except (DeviceSilent, DeviceMissing) as failure:
            return Sent(lost=failure)
        if was_refused(name, heard):
            raise refusal("the pulse", heard, self.device)
        return Sent()

    async def guiding(self) -> bool | None:
        """Whether a pulse still runs: its property is busy until then; None where there is none."""
        pulses = [self._device.get(name) for name, _, _ in _PULSES.values()]
        return any(pulse is not None and pulse.state == "Busy" for pulse in pulses) if any(pulses) else None

    # -- rates and axes --------------------------------------------------------------------------

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """What INDI takes, and what is known of its driver."""
        return OffsetRates(self._known.ra_most_arcsec_s, self._known.dec_most_arcsec_s)

    @property
    def offset_step_arcsec_s(self) -> float:
        """As set."""
        return self._habits.rate_step_arcsec_s

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Order rates of its own, or the mode of a star."""
        await self._offsets.order(rates)

    async def read_offset_rates(self) -> OffsetRates | None:
        """What its driver was told: it doesn't ask its mount."""
        return await self._offsets.read()

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """As set, or as known of its driver."""
        return rates.spans(self._axes.speeds)

    def direction_unsure(self, axis: MountAxis) -> bool:
        """Whether nobody has seen yet which way this axis goes: drivers had their mounts wrong in that."""
        return self._axes.unsure(axis)

    def direction_seen(self, axis: MountAxis, *, rightly: bool) -> None:
        """Keep which way it goes."""
        self._axes.seen(axis, rightly=rightly)

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Hold a button at a speed, or let it go; refused when parked, for some drivers move all the same."""
        if rate_deg_s:
            self._require_unparked("moving an axis")
        return await self._axes.order(axis, rate_deg_s, wanted)

    async def _switch(self, name: str, switches: dict[str, bool], what: str) -> Sent:
        """Order something that takes a while."""
        if self._device.get(name) is None:
            raise self._unsupported(what)
        self._reader.be_restless()
        try:
            heard = await self._device.ordered(
                messages.new_switches(self._device.name, name, switches), asking=name, echo=name
            )
        except (DeviceSilent, DeviceMissing) as failure:
            return Sent(lost=failure)
        if was_refused(name, heard):
            raise refusal(what, heard, self.device)
        return Sent()

    async def _now(self, name: str, switches: dict[str, bool], what: str) -> None:
        """Order something that is done at once; an answer that doesn't come is an error."""
        sent = await self._switch(name, switches, what)
        if sent.lost is not None:
            raise sent.lost

    def _require_unparked(self, what: str) -> None:
        if state.parked(self._device.get):
            raise parked_refusal(what, self.device)

    # -- clock and site --------------------------------------------------------------------------

    async def read_clock(self) -> datetime | None:
        """Its clock, if its driver ever sent it unasked."""
        return state.clock(self._device.get, utc_now())

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock; its zone becomes UTC."""
        await self._write(
            "TIME_UTC",
            messages.new_texts(
                self._device.name,
                "TIME_UTC",
                {"UTC": (utc + timedelta(seconds=0.5)).strftime("%Y-%m-%dT%H:%M:%S"), "OFFSET": "0.00"},
            ),
            "a time",
        )

    async def read_site(self) -> Site | None:
        """Where its driver believes to stand; None where that was never set."""
        return state.site(self._device.get)

    async def write_site(self, site: Site) -> None:
        """Set its site; INDI counts longitudes from 0 to 360 east."""
        values = {"LAT": site.latitude_deg, "LONG": site.longitude_deg % 360.0, "ELEV": site.height_m}
        await self._write(
            "GEOGRAPHIC_COORD",
            messages.new_numbers(self._device.name, "GEOGRAPHIC_COORD", values),
            "a site",
        )

    async def _write(self, name: str, order: bytes, what: str) -> None:
        if not state.writable(self._device.get(name)):
            raise self._unsupported(f"take {what}")
        heard = await self._device.ordered(order, asking=name, echo=name)
        if was_refused(name, heard):
            raise refusal(f"taking {what}", heard, self.device)

    # -- others ----------------------------------------------------------------------------------

    def _on_event(self, event: Event, now: Property | None) -> None:
        """Notice when another program orders something: the server passes it on to us."""
        if isinstance(event, Ordered) and event.device == self._device.name and event.name in _MOVERS:
            self.log.note("event", meaning=f"another program ordered {event.name}")
            self._reader.be_restless()
            if event.name in COORDINATES.values():
                self._orders.forget()


TIMING = Timing(start_grace_s=4.0, rest_s=2.5, sync_wait_s=6.0, late_s=3.5)
"""A driver looks at its mount once a second, and two looks make a reading that is believed."""
