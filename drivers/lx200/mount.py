"""A mount that speaks LX200: the only place that knows in what order its commands make a reading or a slew.

It believes no single odd answer: a place that the mount can't have reached since the last one is asked again,
and counts when the second agrees. A slew has arrived when the mount is at rest *and* where it was sent.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from drivers.command import Command
from drivers.exchange import Exchange
from drivers.line import ByteLine, SerialLine
from drivers.lx200 import codec
from drivers.lx200.habits import Lx200Habits
from mountnav.errors import BadRequest, Busy, DeviceGarbled, DeviceMissing, DeviceRefused, DeviceSilent
from mountnav.navigation.devices import Epoch, MountReading, SlewOutcome
from mountnav.sky.coordinates import Apparent, Icrs, utc_now
from mountnav.sky.sphere import separation_arcsec


class Lx200Mount:
    """A `mountnav.navigation.devices.Mount` over an LX200 line.

    After a lost line the next order opens it again, handshake included.

    Parameters
    ----------
    line : str or callable
        Address for a `SerialLine`, or a function that makes a `ByteLine`.
    name : str, optional
        For messages; the address by default.
    baud : int
        Speed of a serial port.
    habits : Lx200Habits
        Epoch and times.
    """

    def __init__(
        self,
        line: str | Callable[[], ByteLine],
        *,
        name: str | None = None,
        baud: int = 9600,
        habits: Lx200Habits | None = None,
    ) -> None:
        self._line: ByteLine = SerialLine(line, baud=baud) if isinstance(line, str) else line()
        self._name = name or self._line.address
        self._habits = habits or Lx200Habits()
        self._exchange = Exchange(self._line, self._habits.patience)
        self._opening = asyncio.Lock()
        self._target = asyncio.Lock()
        self._wanted_open = False
        self._slewing = False
        self._short = False
        self._knows_bars = True
        self._resolution_arcsec = 15.0
        self._last: MountReading | None = None
        self._spans_s = (0.0, 0.0)
        self._stops = 0

    @property
    def name(self) -> str:
        """Name and address."""
        return self._name

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates this mount speaks, as set."""
        return self._habits.epoch

    @property
    def resolution_arcsec(self) -> float:
        """15 in the long format (1 s of right ascension), 90 in the short one (0.1 min)."""
        return self._resolution_arcsec

    async def open(self) -> None:
        """Connect and identify: ACK, or else the product name, then the format of the right ascension.

        Sends nothing that moves, syncs or sets; only a mount in the short format is asked to toggle it.

        Raises
        ------
        DeviceMissing
            If there is no such port.
        DeviceSilent, DeviceGarbled
            If nothing on it speaks LX200.
        """
        async with self._opening:
            await self._open()

    async def _open(self) -> None:
        await self._line.open()
        self._exchange = Exchange(self._line, self._habits.patience)
        self._last = None
        try:
            await self._identify()
        except BaseException:
            await self._line.close()
            raise
        self._wanted_open = True

    async def _identify(self) -> None:
        one_try_s = self._habits.patience.try_s
        # clones may know one greeting or none; what counts is a readable right ascension
        greetings: tuple[Command[object], ...] = (codec.ALIGNMENT, codec.PRODUCT)
        for greeting in greetings:
            try:
                await self._exchange.ask(greeting, deadline_s=one_try_s)
            except (DeviceSilent, DeviceGarbled):
                continue
            break
        ra = await self._exchange.ask(codec.GET_RA)
        if ra.step_arcsec > 15.0:
            # :U# toggles: it is sent once, and only to a mount seen in the short format [LX200 :U#]
            await self._exchange.ask(codec.TOGGLE_PRECISION)
            ra = await self._exchange.ask(codec.GET_RA)
        self._note_step(ra.step_arcsec)
        try:
            await self._exchange.ask(codec.SLEWING, deadline_s=2.0 * one_try_s)
            self._knows_bars = True
        except (DeviceSilent, DeviceGarbled):
            self._knows_bars = False

    def _note_step(self, step_arcsec: float) -> None:
        self._short = step_arcsec > 15.0
        # orders stay in the classic forms even where readings are finer
        self._resolution_arcsec = max(15.0, step_arcsec)

    async def close(self) -> None:
        """Release the line."""
        self._wanted_open = False
        await self._line.close()

    async def _ready(self) -> None:
        """Open a line again that was lost since `open`."""
        if self._line.usable:
            return
        if not self._wanted_open:
            raise DeviceMissing("not connected", device=self._name, advice="open the mount first")
        async with self._opening:
            # another caller may have done it meanwhile
            if not self._line.usable:
                await self._open()

    # -- readings --------------------------------------------------------------------------------

    async def reading(self) -> MountReading:
        """Where the mount believes it points; asked again until two agree where one alone is doubtful.

        Raises
        ------
        DeviceSilent, DeviceGarbled, DeviceMissing
            If there is no answer, none that makes sense, or no line.
        """
        await self._ready()
        reading, doubtful = await self._one_reading()
        if not doubtful and self._plausible(reading):
            self._last = reading
            return reading
        for _ in range(4):
            again, doubtful = await self._one_reading()
            if not doubtful and self._reachable(reading, again):
                self._last = again
                return again
            reading = again
        raise DeviceGarbled(
            f"readings contradict each other, the last is {reading.place}",
            device=self._name,
            advice="check cable, speed (baud) and that nothing else talks to the mount",
        )

    async def _one_reading(self) -> tuple[MountReading, bool]:
        """One reading, and whether anything went wrong on the way to it."""
        exchange, troubles = self._exchange, self._exchange.troubles
        before = utc_now()
        ra = await exchange.ask(codec.GET_RA)
        dec = await exchange.ask(codec.GET_DEC)
        span = utc_now() - before
        utc = before + span / 2
        self._spans_s = (self._spans_s[1], span.total_seconds())
        slewing: bool | None = None
        if self._knows_bars:
            slewing = await exchange.ask(codec.SLEWING)
        self._note_step(ra.step_arcsec)
        place = Icrs(ra.deg, dec.deg) if self.epoch == "icrs" else Apparent(ra.deg, dec.deg, utc)
        return MountReading(place, utc, slewing), exchange.troubles != troubles

    def _plausible(self, reading: MountReading) -> bool:
        return self._last is not None and self._reachable(self._last, reading)

    def _reachable(self, before: MountReading, after: MountReading) -> bool:
        """Whether a mount read as `before` can be where `after` says."""
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        moving = self._slewing or before.slewing is not False or after.slewing is not False
        free_arcsec = self._habits.resting_arcsec + 2.0 * self._resolution_arcsec
        rate = self._habits.fastest_deg_s * 3600.0 if moving else self._habits.drift_arcsec_s
        # right ascension and declination are asked one after the other: a moving mount goes on between them
        elapsed_s += sum(self._spans_s)
        return _apart_arcsec(before.place, after.place) <= free_arcsec + rate * elapsed_s

    def _still(self, before: MountReading, after: MountReading) -> bool:
        """Whether the mount rested between two readings."""
        elapsed_s = max(0.0, (after.utc - before.utc).total_seconds())
        free_arcsec = 1.1 * self._resolution_arcsec + self._habits.drift_arcsec_s * elapsed_s
        return not after.slewing and _apart_arcsec(before.place, after.place) <= free_arcsec

    # -- orders ----------------------------------------------------------------------------------

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go to a place in the mount's own coordinates; return when at rest.

        Parameters
        ----------
        place : Apparent or Icrs
            Of the kind that `epoch` says.

        Returns
        -------
        SlewOutcome
            ``ARRIVED`` only when at rest within two steps (at least 30″) of the place.

        Raises
        ------
        BadRequest
            If the place is of the other kind.
        Busy
            If another slew runs.
        DeviceRefused
            With the mount's own words; nothing moves.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the mount can't be followed any more; a stop was sent.
        """
        self._check_kind(place)
        if self._slewing:
            raise Busy("a slew is running", device=self._name, advice="stop it first")
        stops, self._slewing = self._stops, True
        try:
            await self._ready()
            return await self._slew(place, stops)
        except (DeviceSilent, DeviceGarbled, DeviceMissing, asyncio.CancelledError):
            # nobody watches it any more: a mount that may be moving is not left so
            with contextlib.suppress(DeviceMissing, DeviceSilent):
                await self._exchange.send_now(codec.STOP)
            raise
        finally:
            self._slewing = False

    async def _slew(self, place: Apparent | Icrs, stops: int) -> SlewOutcome:
        loop = asyncio.get_running_loop()
        started = loop.time()
        before = await self.reading()
        lost_answer: DeviceSilent | DeviceGarbled | None = None
        async with self._target:
            await self._aim(place)
            if self._stops != stops:
                return SlewOutcome.STOPPED
            try:
                answer = await self._exchange.ask(codec.SLEW)
            except (DeviceSilent, DeviceGarbled) as failure:
                # not sent again: whether it was taken up shows in the sky
                lost_answer = failure
            else:
                if answer.refusal is not None:
                    raise self._refused("the slew", answer.refusal)
        if self._stops != stops:
            # the stop may have overtaken the order
            await self._exchange.send_now(codec.STOP)
        ordered = loop.time()
        moved = False
        while True:
            await asyncio.sleep(self._habits.poll_s)
            now = await self.reading()
            resting, before = self._still(before, now), now
            moved = moved or not resting
            if not resting:
                if loop.time() - started > self._habits.slew_timeout_s:
                    await self.stop()
                    return SlewOutcome.STALLED
                continue
            if self._stops != stops:
                return SlewOutcome.STOPPED
            if _apart_arcsec(now.place, place) <= max(30.0, 2.0 * self._resolution_arcsec):
                return SlewOutcome.ARRIVED
            if moved or loop.time() - ordered > self._habits.start_grace_s:
                if lost_answer is not None and not moved:
                    raise lost_answer
                return SlewOutcome.STALLED

    async def sync(self, place: Apparent | Icrs) -> None:
        """Tell the mount that it points at a place in its own coordinates; sent once, not read back.

        Raises
        ------
        BadRequest
            If the place is of the other kind.
        DeviceRefused
            When it says no.
        DeviceSilent, DeviceGarbled
            If its answer was lost; the sync may have been carried out.
        """
        self._check_kind(place)
        await self._ready()
        async with self._target:
            await self._aim(place)
            self._last = None
            refusal = codec.sync_refusal(await self._exchange.ask(codec.SYNC))
        if refusal is not None:
            raise self._refused("the sync", refusal)

    async def stop(self) -> None:
        """Stop all motion: `:Q#` at once, past every other exchange, and again until the mount is at rest.

        Raises
        ------
        DeviceRefused
            If it still moves after `stop_timeout_s`.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the stop can't be sent, or was sent and the mount can't be read.
        """
        self._stops += 1
        await self._ready()
        loop = asyncio.get_running_loop()
        await self._exchange.send_now(codec.STOP)
        until = loop.time() + self._habits.stop_timeout_s
        before = await self.reading()
        while True:
            await asyncio.sleep(self._habits.poll_s)
            now = await self.reading()
            if self._still(before, now):
                return
            if loop.time() > until:
                raise DeviceRefused(
                    "was told to stop and still moves", device=self._name, advice="cut its power"
                )
            before = now
            await self._exchange.send_now(codec.STOP)

    async def _aim(self, place: Apparent | Icrs) -> None:
        if not await self._exchange.ask(codec.set_ra(place.ra_deg, short=self._short)):
            raise self._refused(f"a right ascension of {place.ra_deg:.5f}°", "0")
        if not await self._exchange.ask(codec.set_dec(place.dec_deg, short=self._short)):
            raise self._refused(f"a declination of {place.dec_deg:.5f}°", "0")

    def _refused(self, what: str, words: str) -> DeviceRefused:
        return DeviceRefused(f"refused {what}: {words}", device=self._name)

    def _check_kind(self, place: Apparent | Icrs) -> None:
        if isinstance(place, Icrs) != (self.epoch == "icrs"):
            raise BadRequest(
                f"{type(place).__name__} given to a mount that speaks {self.epoch} coordinates",
                device=self._name,
                advice="convert it first",
            )


def _apart_arcsec(a: Apparent | Icrs, b: Apparent | Icrs) -> float:
    """Return the distance of two places that are of one kind by construction."""
    return separation_arcsec(Icrs(a.ra_deg, a.dec_deg), Icrs(b.ra_deg, b.dec_deg))
