"""An Alpaca telescope, as a language: which members make a reading or an order, and what their answers mean.

Readings stand in `readings`, rates in `rates`, bringing it up in `device`, HTTP in `client`.

An order goes out once. Old drivers answer some of them only when the motion is over: then the answer is
awaited in the background, and an error in it is kept for the reading that follows the motion.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeVar

from drivers.alpaca.client import AlpacaClient, require_known
from drivers.alpaca.codec import base, state
from drivers.alpaca.codec.base import PARKED, AlpacaRefused, Malformed, Parameters, reason_of
from drivers.alpaca.device import AlpacaDevice, Found
from drivers.alpaca.rates import CAN_OFFSET, AxisOrders, OffsetRateOrders
from drivers.alpaca.readings import MountReader
from drivers.generic.language import Identity, Readout, Sent, Unskilled, Wanted
from drivers.generic.options import Timing
from drivers.wire.wire_log import WireLog
from mountnav.clock import utc_now
from mountnav.devices import (
    Direction,
    Epoch,
    MountAxis,
    OffsetRates,
    PierSide,
    RateSpan,
    Skill,
    TrackingRate,
)
from mountnav.errors import DeviceError, DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent, Refusal
from mountnav.sky.coordinates import Apparent, Icrs, Site
from mountnav.tasks import begun

T = TypeVar("T")
_SOON_S = 1.0
"""A refusal comes at once; so long it is waited for where the answer may take minutes, and for a stop's."""
_MOST_STOPS = 4
"""So many stops may be unanswered: more of them would only wait behind each other."""


class Moving:
    """Sends one telescope's orders to move.

    Parameters
    ----------
    reader : MountReader
        Keeps what failed.
    longest_s : float
        For an answer that comes at the end of the motion.
    """

    def __init__(self, client: AlpacaClient, reader: MountReader, longest_s: float) -> None:
        self._client = client
        self._reader = reader
        self._longest_s = longest_s
        self._orders: set[asyncio.Task[DeviceError | None]] = set()
        self._stops: set[asyncio.Task[None]] = set()

    async def order(self, member: str, parameters: Parameters, *, at_once: bool) -> Sent:
        """Give an order to move, once.

        Parameters
        ----------
        at_once : bool
            Whether it answers when the motion begins; else it may answer at its end.

        Raises
        ------
        DeviceRefused
            If it says no.
        DeviceMissing
            If it can't have reached it.
        """
        number = self._reader.ordered()
        if at_once:
            try:
                await self._client.put(member, parameters)
            except (DeviceSilent, DeviceGarbled) as failure:
                return Sent(lost=failure)
            return Sent()
        sending = begun(
            self._to_its_end(member, parameters, number), f"alpaca-{member}", died=self._client.died
        )
        self._orders.add(sending)
        sending.add_done_callback(self._orders.discard)
        try:
            done, _ = await asyncio.wait({sending}, timeout=_SOON_S)
        except asyncio.CancelledError:
            sending.cancel()
            raise
        ended = self._outcome(sending) if done else None
        if isinstance(ended, (DeviceRefused, DeviceMissing)):
            raise ended
        return Sent(lost=ended)

    async def _to_its_end(self, member: str, parameters: Parameters, number: int) -> DeviceError | None:
        try:
            await self._client.put(member, parameters, deadline_s=self._longest_s)
        except DeviceError as failure:
            if isinstance(failure, AlpacaRefused):
                self._reader.fail(number, failure.words or failure.what)
            # of any other the readings show what came of it
            self._client.log.note("event", meaning=f"{member}: {failure.what}")
            return failure
        return None

    async def stop(self) -> None:
        """Abort all motion, beside every other exchange; a slow answer is not waited for.

        Raises
        ------
        DeviceRefused
            If it can't be stopped at all.
        DeviceMissing, DeviceSilent, DeviceGarbled
            If the stop can't be sent, or the answer says nothing.
        """
        if len(self._stops) >= _MOST_STOPS:
            return
        stopping = begun(self._abort(), "alpaca-abortslew", died=self._stop_failed)
        self._stops.add(stopping)
        stopping.add_done_callback(self._stops.discard)
        done, _ = await asyncio.wait({stopping}, timeout=_SOON_S)
        if done:
            self._outcome(stopping)

    def _outcome(self, ended: asyncio.Task[T]) -> T:
        """What an ended order came to; one that ended with its connections is no cancellation of ours."""
        if ended.cancelled():
            raise DeviceMissing(
                "the connection was closed meanwhile", device=self._client.address, advice="connect again"
            )
        return ended.result()

    async def _abort(self) -> None:
        try:
            await self._client.put_past_all("abortslew")
        except AlpacaRefused as refused:
            if refused.unsupported:
                raise
            # a parked one has nothing to stop; of any other the readings show it, and it is sent again
            if refused.number != PARKED:
                self._client.log.note("event", meaning=f"the stop was refused: {refused.words}")

    def _stop_failed(self, fault: Exception) -> None:
        self._client.log.note("event", meaning=f"a stop failed: {fault}")
        if not isinstance(fault, DeviceError):
            self._client.died(fault)

    async def end(self) -> None:
        """Wait for no answer any more."""
        running = [*self._orders, *self._stops]
        for task in running:
            task.cancel()
        for task in running:
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await task


_HEIGHTS_M = (-1000.0, 20_000.0)
"""What the height of a site may be, m: an answer beyond is none."""
_FASTEST_PULSE_DEG_S = 0.1
"""Faster guide rates are nonsense, perhaps arcseconds instead of degrees: 24 times sidereal. Chosen by
hand."""
_PROBED = ("utcdate", "sitelatitude")
_RETURNS_AT_ONCE = 4
"""From this version of the interface on park and home begin, where older ones may take their whole time."""


@dataclass(frozen=True, slots=True)
class AlpacaHabits:
    """What the configuration says of an Alpaca telescope.

    Attributes
    ----------
    epoch : {"apparent", "icrs"} or None
        Which coordinates it speaks; None believes its EquatorialSystem, and refuses one we don't speak.
    may_connect : bool
        Whether a device that is not connected may be ordered to connect.
    finds_home : bool
        Whether its home is found by a sensor, so that its position counts afterwards.
    resolution_arcsec : float
        Coarsest step of the mount: Alpaca doesn't say.
    rate_step_arcsec_s : float
        Coarsest step to which it rounds offset rates: Alpaca doesn't say that either.
    axis_signs : mapping of MountAxis to float
        Which sign of a speed moves each axis to greater coordinates, on the normal side of the pier; what is
        not stated is seen in the readings.
    """

    epoch: Epoch | None = None
    may_connect: bool = True
    finds_home: bool = False
    resolution_arcsec: float = 1.0
    rate_step_arcsec_s: float = 0.0
    axis_signs: Mapping[MountAxis, float] = field(default_factory=dict)


class AlpacaLanguage(Unskilled):
    """A `drivers.generic.language.Language` over one telescope of an Alpaca server.

    Parameters
    ----------
    longest_order_s : float
        For orders of old drivers that answer only when the motion is over.
    """

    def __init__(
        self, device: AlpacaDevice, habits: AlpacaHabits | None = None, *, longest_order_s: float = 300.0
    ) -> None:
        super().__init__()
        self._why = "its driver says that it can't"
        self._device = device
        self._habits = habits or AlpacaHabits()
        self._reader = MountReader(device)
        self._reader.epoch = self._habits.epoch or "apparent"
        self._moving = Moving(device.client, self._reader, longest_order_s)
        self._offsets = OffsetRateOrders(device)
        self._axes = AxisOrders(device, self._habits.axis_signs)
        self._can: dict[str, bool] = {}
        self._rates: frozenset[int] = frozenset()
        self._guide_rates_deg_s: tuple[float, float] | None = None
        self._at_once = True

    # -- what it is ------------------------------------------------------------------------------

    @property
    def _client(self) -> AlpacaClient:
        return self._device.client

    @property
    def device(self) -> str:
        """Server and device."""
        return self._device.address

    @property
    def log(self) -> WireLog:
        """All that was asked and answered lately."""
        return self._client.log

    @property
    def usable(self) -> bool:
        """Whether its server could be reached, and its driver was connected, whenever it was asked."""
        return self._client.usable

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it speaks; known after `open` unless it is set."""
        return self._reader.epoch

    @property
    def usual_epoch(self) -> Epoch:
        """As found; where the settings say otherwise than the telescope, `open` reports it."""
        return self._reader.epoch

    @property
    def resolution_arcsec(self) -> float:
        """As set."""
        return self._habits.resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """By what it says it can, and what was seen to be implemented."""
        said = state.skills(self._can, self._reader.implemented, finds_home=self._habits.finds_home)
        return said | ({Skill.MOVE_AXIS} if self._axes.spans else set())

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be ordered to track."""
        if not self._can.get("cansettracking"):
            return frozenset()
        told = frozenset(rate for rate, number in state.RATES.items() if number in self._rates)
        return told or frozenset({TrackingRate.SIDEREAL})

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """As it says."""
        return self._guide_rates_deg_s

    def unanswered_s(self) -> float:
        """Since when the oldest question waits."""
        return self._client.unanswered_s()

    # -- the link --------------------------------------------------------------------------------

    async def open(self) -> Identity:
        """Reach the server, have the telescope connected if it may be, and find out what it can.

        Moves, syncs and sets nothing.

        Raises
        ------
        DeviceMissing
            If there is no server, no such telescope, or it can't be connected.
        DeviceRefused
            If it is not connected and may not be, or speaks coordinates that we don't.
        DeviceSilent, DeviceGarbled
            If its answers don't come or make no sense.
        """
        device, problems = self._device, []
        found = await device.bring_up(may_connect=self._habits.may_connect)
        if found.connected_by_us:
            problems.append("it was not connected: we connected it")
        system = await device.maybe("equatorialsystem", lambda value: base.integer(value, 0, 99))
        self._reader.epoch = self._epoch_of(system, problems)
        self._can = await device.asked_all((*state.CAN, *CAN_OFFSET), base.truth)
        if not (self._can.get("canslewasync") or self._can.get("canslew")):
            problems.append("it says that it can't slew")
        await self._reader.begin(found.version, _PROBED)
        self._rates = await self._rates_of(device)
        self._guide_rates_deg_s = await self._guide_rates_of(device)
        problems += await self._axes.begin()
        await self._see_what_else_it_has()
        self._at_once = found.version >= _RETURNS_AT_ONCE
        return Identity(self._identity(found, system), tuple(problems))

    def _identity(self, found: Found, system: int | None) -> str:
        spoken = state.SYSTEMS.get(-1 if system is None else system, "unknown")
        return f"{found.name} ({found.driver}; ITelescopeV{found.version}, {spoken} coordinates)"

    def _epoch_of(self, system: int | None, problems: list[str]) -> Epoch:
        told = None if system is None else state.EPOCHS.get(system)
        spoken = "doesn't say which" if system is None else f"says {state.SYSTEMS.get(system, system)}"
        wanted = self._habits.epoch
        if wanted is None and told is None:
            raise DeviceRefused(
                f"can't be used as it is: it speaks neither coordinates of date nor J2000 (it {spoken})",
                device=self.device,
                advice='set it to JNow or J2000 in its driver, or say epoch = "apparent" or "icrs"',
                reason=Refusal.UNSUPPORTED,
            )
        if wanted is not None and wanted != told:
            problems.append(f"it is set to speak {wanted} coordinates, and {spoken} itself")
        return wanted or told or "apparent"

    async def _rates_of(self, device: AlpacaDevice) -> frozenset[int]:
        told = await device.maybe("trackingrates", lambda value: value)
        if not isinstance(told, list) or not await device.has("trackingrate"):
            return frozenset()
        return frozenset(rate for rate in told if type(rate) is int)

    async def _guide_rates_of(self, device: AlpacaDevice) -> tuple[float, float] | None:
        try:
            ra_deg_s = await device.maybe("guideraterightascension", _guide_rate)
            dec_deg_s = await device.maybe("guideratedeclination", _guide_rate)
        except (AlpacaRefused, DeviceGarbled):
            # it can be guided all the same
            return None
        return None if ra_deg_s is None or dec_deg_s is None else (ra_deg_s, dec_deg_s)

    async def _see_what_else_it_has(self) -> None:
        more = set()
        if len(self._rates) > 1:
            more.add("trackingrates")
        here = state.said_place((await self._reader.readout()).place)
        if await self._device.has("destinationsideofpier", here):
            more.add("destinationsideofpier")
        self._reader.implemented |= more

    async def close(self) -> None:
        """Release the connections; the telescope stays connected, for others."""
        await self._moving.end()
        await self._client.close()

    async def lost(self) -> str:
        """Wait until the server can't be reached or its driver says it is not connected, and return why."""
        return await self._client.lost()

    # -- readings --------------------------------------------------------------------------------

    async def readout(self) -> Readout:
        """Ask where it is and what it does; see `MountReader.readout`."""
        return await self._reader.readout()

    # -- orders ----------------------------------------------------------------------------------

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a slew; tracking is switched on before if it is off: Alpaca slews to the sky only so."""
        at_once = self._can.get("canslewasync", False)
        if not (at_once or self._can.get("canslew")):
            raise self._unsupported("slew")
        if not await self._tracks() and self._can.get("cansettracking"):
            if not wanted():
                return Sent(wire=False)
            await self._client.put("tracking", {"Tracking": True})
        if not wanted():
            return Sent(wire=False)
        member = "slewtocoordinatesasync" if at_once else "slewtocoordinates"
        return await self._moving.order(member, state.said_place(place), at_once=at_once)

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Order a sync."""
        if not self._can.get("cansync"):
            raise self._unsupported("sync")
        if not wanted():
            return Sent(wire=False)
        try:
            await self._client.put("synctocoordinates", state.said_place(place))
        except (DeviceSilent, DeviceGarbled) as failure:
            return Sent(lost=failure)
        except AlpacaRefused as refused:
            await self._say_if_it_does_not_track(refused)
            raise
        return Sent()

    async def send_stop(self, again: int) -> None:
        """Abort all motion, on a connection of its own; tracking stays as it was."""
        self._axes.stopped()
        await self._moving.stop()

    async def send_park(self, wanted: Wanted) -> Sent:
        """Order parking."""
        return await self._away("park", wanted)

    async def send_home(self, wanted: Wanted) -> Sent:
        """Order homing."""
        return await self._away("findhome", wanted)

    async def _away(self, member: str, wanted: Wanted) -> Sent:
        if not wanted():
            return Sent(wire=False)
        return await self._moving.order(member, {}, at_once=self._at_once)

    async def send_unpark(self) -> None:
        """Order unparking."""
        await self._client.put("unpark")

    async def send_set_park(self) -> None:
        """Take the present place for the park position."""
        await self._client.put("setpark")

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Order tracking, the rate first."""
        if on and self._rates:
            wanted = state.RATES.get(rate)
            if wanted is None or wanted not in self._rates:
                raise self._unsupported(f"track at the {rate} rate")
            if await self._device.value("trackingrate", base.integer) != wanted:
                await self._client.put("trackingrate", {"TrackingRate": wanted})
        if Skill.TRACK in self.skills:
            await self._client.put("tracking", {"Tracking": on})

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Order a pulse, which the mount times; old drivers answer when it is over."""
        if not wanted():
            return Sent(wire=False)
        deadline_s = self._client.deadline_s + duration_s
        pulse = {"Direction": state.PULSES[direction], "Duration": round(1000.0 * duration_s)}
        try:
            await self._client.put("pulseguide", pulse, deadline_s=deadline_s)
        except (DeviceSilent, DeviceGarbled) as failure:
            return Sent(lost=failure)
        return Sent()

    async def guiding(self) -> bool | None:
        """Whether a pulse still runs; None where it doesn't say [ASCOM IsPulseGuiding]."""
        return await self._device.maybe("ispulseguiding", base.truth)

    # -- rates and axes --------------------------------------------------------------------------

    @property
    def offset_step_arcsec_s(self) -> float:
        """As set."""
        return self._habits.rate_step_arcsec_s

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Order both rates, beside the sidereal one."""
        try:
            await self._offsets.order(rates)
        except AlpacaRefused as refused:
            await self._say_if_it_does_not_track(refused)
            raise

    async def read_offset_rates(self) -> OffsetRates | None:
        """As it says; some go on saying what a stop or a slew has ended."""
        return await self._offsets.read()

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """As it says."""
        return self._axes.spans

    def direction_unsure(self, axis: MountAxis) -> bool:
        """Whether nobody has stated or seen yet which way this axis moves: Alpaca leaves that open."""
        return self._axes.unsure(axis)

    def direction_seen(self, axis: MountAxis, *, rightly: bool) -> None:
        """Keep which way it moves."""
        self._axes.seen(axis, rightly=rightly)

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Order an axis to move on, tracking put in; 0 restores tracking."""
        return await self._axes.order(axis, rate_deg_s, wanted)

    async def _tracks(self) -> bool:
        return await self._device.maybe("tracking", base.truth) is not False

    async def _say_if_it_does_not_track(self, refused: AlpacaRefused) -> None:
        """Alpaca's number for it is that of any wrong state: look."""
        if reason_of(refused.number, refused.words) is Refusal.OTHER and not await self._tracks():
            raise DeviceRefused(
                f"{refused.what}; it doesn't track",
                device=self.device,
                advice="switch tracking on first",
                reason=Refusal.NOT_TRACKING,
            ) from refused

    # -- clock, site, side -----------------------------------------------------------------------

    async def read_clock(self) -> datetime | None:
        """Its clock, taken for the middle between question and answer."""
        if "utcdate" not in self._reader.implemented:
            return None
        before = utc_now()
        try:
            told = await self._device.value("utcdate", base.instant)
        except AlpacaRefused:
            return None
        except DeviceGarbled as garbled:
            # it can be used all the same; whose clock it is isn't known
            self.log.note("event", meaning=f"its clock is not known: {garbled.what}")
            return None
        return told + (utc_now() - before) / 2

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock."""
        await self._client.put("utcdate", {"UTCDate": base.said_instant(utc)})

    async def read_site(self) -> Site | None:
        """Where it believes to stand; None where that was never set."""
        if "sitelatitude" not in self._reader.implemented:
            return None
        device = self._device
        try:
            latitude_deg = await device.value(
                "sitelatitude",
                lambda value: base.number(value, -90.0, 90.0),
            )
            longitude_deg = await device.value(
                "sitelongitude", lambda value: base.number(value, -360.0, 360.0)
            )
        except AlpacaRefused:
            return None
        except DeviceGarbled as garbled:
            self.log.note("event", meaning=f"its site is not known: {garbled.what}")
            return None
        try:
            height_m = await device.value("siteelevation", lambda value: base.number(value, *_HEIGHTS_M))
        except (AlpacaRefused, DeviceGarbled):
            height_m = 0.0
        return Site(latitude_deg, (longitude_deg + 180.0) % 360.0 - 180.0, height_m)

    async def write_site(self, site: Site) -> None:
        """Set its site; one that keeps no height is given none."""
        await self._client.put("sitelatitude", {"SiteLatitude": site.latitude_deg})
        longitude_deg = (site.longitude_deg + 180.0) % 360.0 - 180.0
        await self._client.put("sitelongitude", {"SiteLongitude": longitude_deg})
        try:
            await self._client.put("siteelevation", {"SiteElevation": site.height_m})
        except AlpacaRefused as refused:
            require_known(refused)

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side it would look at a place."""
        if "destinationsideofpier" not in self._reader.implemented:
            return None
        said = state.said_place(place)
        try:
            return await self._device.value("destinationsideofpier", state.pier_side, said)
        except AlpacaRefused:
            # out of its range or in a state where it can't say
            return None


def _guide_rate(value: object) -> float:
    rate_deg_s = base.number(value, 0.0, _FASTEST_PULSE_DEG_S)
    if rate_deg_s == 0.0:
        raise Malformed("a guide rate of 0")
    return rate_deg_s


TIMING = Timing(
    start_grace_s=4.0,
    rest_s=2.5,
    sync_wait_s=6.0,
    late_s=3.5,
    heartbeat_s=1.0,
    silence_s=3.0,
    lost_after_s=9.0,
)
"""Servers answer from what they read up to a second ago, and those far away take up to two seconds for it."""
