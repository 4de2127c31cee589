"""Every dialect of LX200 as a `drivers.generic.language.Language`: in what order its words make an order.

The words themselves, and what a dialect lacks, stand in its `drivers.lx200.codec.dialect.Dialect`.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Mapping
from datetime import datetime

from drivers.generic.language import Identity, Readout, Sent, Wanted
from drivers.generic.serial_language import SerialLanguage
from drivers.lx200.codec.dialect import Dialect, Nudge, Order
from drivers.lx200.rates import move_axis, order_rates
from drivers.lx200.readings import Lx200Reader
from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.clock import pause, real_s
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
from mountnav.errors import DeviceError, DeviceRefused
from mountnav.sky.coordinates import Apparent, Icrs, Site

Once = Callable[[tuple[Order, ...], str, Wanted], Awaitable[Sent]]
"""Sends orders once each, unless they are not wanted any more."""


async def timed_pulses(
    dialect: Dialect, once: Once, direction: Direction, duration_s: float, wanted: Wanted
) -> Sent:
    """Have the mount time a pulse, in pieces where it can't count so far; returns when it is over."""
    assert dialect.pulse is not None
    left_ms, sent = max(1, round(duration_s * 1000.0)), Sent(wire=False)
    while left_ms > 0:
        piece_ms = min(left_ms, dialect.longest_pulse_ms)
        sent = await once((dialect.pulse(direction, piece_ms),), "the guide pulse", wanted)
        if not sent.wire or sent.lost is not None:
            return sent
        await pause(piece_ms / 1000.0)
        left_ms -= piece_ms
    return sent


async def nudged(
    nudge: Nudge,
    once: Once,
    halt: Callable[[Command[None]], Awaitable[None]],
    direction: Direction,
    duration_s: float,
    wanted: Wanted,
) -> Sent:
    """Start a motion at the guide rate, wait, and stop it, also when given up or stopped meanwhile."""
    sent = await once(nudge.rate, "the guide rate", wanted)
    if not sent.wire or not wanted():
        return Sent(wire=False)
    loop = asyncio.get_running_loop()
    try:
        sent = await once((nudge.start[direction],), "the guide motion", wanted)
        until = loop.time() + real_s(duration_s)
        # a stop that comes meanwhile is seen within a twentieth of a second
        while sent.wire and wanted() and (left_s := until - loop.time()) > 0.0:  # noqa: ASYNC110
            await asyncio.sleep(min(left_s, 0.05))
    finally:
        with contextlib.suppress(DeviceError):
            await halt(nudge.stop[direction])
    return sent


class Lx200Language(SerialLanguage):
    """LX200 over a link.

    Parameters
    ----------
    dialect : Dialect, optional
        Instead of the one that the handshake shows.
    epoch : {"apparent", "icrs"}, optional
        Kind of coordinates; the dialect's by default. The protocol says none [LX200 Epoch].
    """

    def __init__(self, link: Link, dialect: Dialect | None = None, *, epoch: Epoch | None = None) -> None:
        super().__init__(link)
        self._reader = Lx200Reader(link, dialect)
        self._exchange = self._reader.exchange
        self._wanted_epoch = epoch
        self._target = asyncio.Lock()

    # -- what it is --------------------------------------------------------------------------------

    @property
    def dialect(self) -> Dialect:
        """The one that is spoken; known after `open`.

        Raises
        ------
        RuntimeError
            Before.
        """
        if self._reader.dialect is None:
            raise RuntimeError("no dialect before the handshake")
        return self._reader.dialect

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it is set to speak."""
        return self._wanted_epoch or self.usual_epoch

    @property
    def usual_epoch(self) -> Epoch:
        """The dialect's; Meade's, and that of all clones we know, is the equinox of date."""
        return "apparent" if self._reader.dialect is None else self._reader.dialect.epoch

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step of a place as read or written: 15 in the long format, 90 in the short one."""
        written = 15.0 if self._reader.dialect is None else self._reader.dialect.step_arcsec
        return max(self._reader.step_arcsec, written)

    @property
    def skills(self) -> frozenset[Skill]:
        """What the dialect's words allow."""
        return frozenset() if self._reader.dialect is None else self._reader.dialect.skills

    @property
    def guide_rates_deg_s(self) -> tuple[float, float] | None:
        """The same on both axes, where the dialect asks for it."""
        rate_deg_s = self._reader.guide_rate_deg_s
        return None if rate_deg_s is None else (rate_deg_s, rate_deg_s)

    @property
    def silent_refusals(self) -> bool:
        """The dialect's."""
        return self._reader.dialect is not None and self._reader.dialect.silent_refusals

    # -- the link ----------------------------------------------------------------------------------

    async def open(self) -> Identity:
        """Open the link, find the dialect and the format; moves, syncs and sets nothing.

        Only a mount in the short format is asked to toggle it [LX200 :U#].

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks LX200.
        """
        return await self._greeted(self._reader.identify)

    async def readout(self) -> Readout:
        """Place, state, and evidence of a power-up; see `Lx200Reader.readout`."""
        return await self._reader.readout(self.epoch)

    # -- orders ------------------------------------------------------------------------------------

    async def send_slew(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Set the target, then slew there, once."""
        self._reader.parking_over()
        async with self._target:
            await self._aim(place)
            if not (self.dialect.tracks_before_slew and self._reader.rests):
                return await self._exchange.once((self.dialect.slew,), "the slew", wanted)
            return await self._tracking_then_slew(wanted)

    async def _tracking_then_slew(self, wanted: Wanted) -> Sent:
        dialect = self.dialect
        sent = await self._exchange.once(dialect.tracking_on, "tracking", wanted)
        if not sent.wire or sent.lost is not None:
            return sent
        try:
            return await self._exchange.once((dialect.slew,), "the slew", wanted)
        except DeviceRefused:
            # as it was: nothing has changed when an order was refused
            for order in dialect.tracking_off:
                await self._exchange.order(order, "tracking")
            raise

    async def send_sync(self, place: Apparent | Icrs, wanted: Wanted) -> Sent:
        """Set the target, then sync on it, once."""
        async with self._target:
            await self._aim(place)
            return await self._exchange.once((self.dialect.sync,), "the sync", wanted)

    async def _aim(self, place: Apparent | Icrs) -> None:
        dialect = self.dialect
        await self._exchange.order(
            dialect.set_ra(place.ra_deg, self._reader.short), f"a right ascension of {place.ra_deg:.5f}°"
        )
        await self._exchange.order(
            dialect.set_dec(place.dec_deg, self._reader.short), f"a declination of {place.dec_deg:.5f}°"
        )

    async def send_stop(self, again: int) -> None:
        """Stop all motion, past every other exchange."""
        dialect = self.dialect
        self._reader.parking_over()
        await self._link.send_now(*dialect.stop)
        if again == 0:
            for order in dialect.after_stop:
                await self._exchange.order(order, "what follows a stop")

    async def send_park(self, wanted: Wanted) -> Sent:
        """Order parking."""
        sent = await self._exchange.once(self._words(self.dialect.park, "park"), "parking", wanted)
        if sent.wire:
            self._reader.parking_ordered()
        return sent

    async def send_unpark(self) -> None:
        """Order unparking."""
        try:
            for order in self._words(self.dialect.unpark, "unpark"):
                await self._exchange.order(order, "unparking")
        except DeviceRefused:
            # some say no where there is nothing to unpark
            if (await self.readout()).parked is not False:
                raise
        self._reader.parking_over()

    async def send_home(self, wanted: Wanted) -> Sent:
        """Order homing."""
        self._reader.parking_over()
        return await self._exchange.once(self._words(self.dialect.home, "go home"), "homing", wanted)

    async def send_set_park(self) -> None:
        """Take the present place for the park position."""
        for order in self._words(self.dialect.set_park, "set a park position"):
            await self._exchange.order(order, "the park position")

    @property
    def tracking_rates(self) -> frozenset[TrackingRate]:
        """At which rates it can be ordered to track."""
        sidereal = {TrackingRate.SIDEREAL} if self.dialect.tracking_on else set()
        return frozenset(self.dialect.rates) | sidereal

    async def send_tracking(self, on: bool, rate: TrackingRate) -> None:
        """Order tracking, then its rate; a rate alone where tracking can't be switched."""
        dialect = self.dialect
        if not on:
            orders = self._words(dialect.tracking_off, "stop tracking")
        elif rate in dialect.rates:
            # on first: some begin with the stars' rate
            orders = (*dialect.tracking_on, dialect.rates[rate])
        elif rate is TrackingRate.SIDEREAL:
            orders = self._words(dialect.tracking_on, "start tracking")
        else:
            raise self._unsupported(f"track at the {rate} rate")
        for order in orders:
            await self._exchange.order(order, "tracking")

    def _words(self, words: tuple[Order, ...], what: str) -> tuple[Order, ...]:
        if not words:
            raise self._unsupported(what)
        return words

    # -- guiding -----------------------------------------------------------------------------------

    async def send_guide(self, direction: Direction, duration_s: float, wanted: Wanted) -> Sent:
        """Guide; returns when the pulse is over."""
        dialect = self.dialect
        if dialect.pulse is not None:
            return await timed_pulses(dialect, self._exchange.once, direction, duration_s, wanted)
        if dialect.nudge is not None:
            halt = self._link.send_now
            return await nudged(dialect.nudge, self._exchange.once, halt, direction, duration_s, wanted)
        raise self._unsupported("guide")

    async def guiding(self) -> bool | None:
        """Whether a pulse still runs, where the dialect has a word for it."""
        dialect = self.dialect
        return None if dialect.guiding is None else await dialect.guiding(self._exchange)

    # -- what moves --------------------------------------------------------------------------------

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        """The dialect's bound; 0 where an axis takes none."""
        dialect = self._reader.dialect
        return None if dialect is None or dialect.offsets is None else dialect.offsets.most_arcsec_s

    @property
    def offset_step_arcsec_s(self) -> float:
        """The dialect's step."""
        dialect = self._reader.dialect
        return 0.0 if dialect is None or dialect.offsets is None else dialect.offsets.step_arcsec_s

    async def send_offset_rates(self, rates: OffsetRates) -> None:
        """Order rates beside the sidereal one; see `order_rates`."""
        words = self.dialect.offsets
        if words is None:
            raise self._unsupported("track at offset rates")
        await order_rates(self._exchange, words, rates)

    async def read_offset_rates(self) -> OffsetRates | None:
        """What it says to have, where it says it."""
        words = self.dialect.offsets
        return None if words is None or words.read is None else await words.read(self._exchange)

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        """The dialect's."""
        dialect = self._reader.dialect
        return {} if dialect is None or dialect.keys is None else dialect.keys.spans

    async def send_move_axis(self, axis: MountAxis, rate_deg_s: float, wanted: Wanted) -> Sent:
        """Choose the speed and press a key, or let go of it.

        Raises
        ------
        DeviceRefused
            If this mount can't be moved so.
        """
        keys = self.dialect.keys
        if keys is None or axis not in keys.spans:
            raise self._unsupported(f"move its {axis} axis by hand")
        return await move_axis(self._exchange, keys, axis, rate_deg_s, wanted)

    # -- clock, site, sides ------------------------------------------------------------------------

    async def read_clock(self) -> datetime | None:
        """Its clock now, aware UTC."""
        dialect = self.dialect
        if dialect.read_clock is None or not self._reader.ready:
            return None
        return await dialect.read_clock(self._exchange)

    async def write_clock(self, utc: datetime) -> None:
        """Set its clock, in the zone of UTC."""
        dialect = self.dialect
        if dialect.write_clock is None:
            raise self._unsupported("take a time")
        for order in dialect.write_clock(utc):
            await self._exchange.order(order, f"the {order.meaning}")
        self._reader.clock_was_set()

    async def read_site(self) -> Site | None:
        """Where it believes to stand."""
        dialect = self.dialect
        if dialect.read_site is None or not self._reader.ready:
            return None
        return await dialect.read_site(self._exchange)

    async def write_site(self, site: Site) -> None:
        """Tell it where it stands."""
        dialect = self.dialect
        if dialect.write_site is None:
            raise self._unsupported("take a site")
        for order in dialect.write_site(site):
            await self._exchange.order(order, f"the {order.meaning}")

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side it would look at a place; sets the target, moves nothing."""
        dialect = self.dialect
        if dialect.destination_side is None:
            return None
        async with self._target:
            await self._aim(place)
            return await dialect.destination_side(self._exchange)
