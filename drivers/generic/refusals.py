"""After a refusal: whether the mount does it all the same; then it is stopped and no longer trusted.

One bit of an answer may flip, and a driver may answer an order that it carries out with an alarm: so each
refusal is checked by readings. This is the one place for that, for all families and all orders.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress

from drivers.generic.language import Readout
from drivers.generic.session import Session
from mountnav.clock import pause, utc_now
from mountnav.devices import OffsetRates, SlewState, moved_arcsec
from mountnav.errors import DeviceError, DeviceRefused, RefusedButDone

_LATELY_S = 2.0
"""s. A reading no older than this still says how the mount stood before an order. Chosen: four heartbeats.
Doubled, its drift since then hides more motion; halved, each order costs a reading more."""
_IN_DEGREES_ARCSEC = 36.0
"""From here on messages give a motion in degrees: 0.01°, their last digit."""

Stop = Callable[[], Awaitable[None]]
"""Stops the mount until it is seen at rest; raises `DeviceError`."""
Took = Callable[[Readout], bool | None]
"""Whether a reading shows that the order was carried out; None where it can't show that."""
Ask = Callable[[], Awaitable[bool]]
"""Whether the mount says, asked for it, that the order was carried out; raises `DeviceError`."""


class Refusals:
    """Checks the refusals of one mount."""

    def __init__(self, session: Session, stop: Stop) -> None:
        self._session = session
        self._stop = stop

    async def before(self) -> Readout:
        """The mount before an order: its last reading if that is fresh, or a new one."""
        last, changed_utc = self._session.filter.last, self._session.drift.changed_utc
        # one from before its rates changed would not say where it drifts from
        of_now = last is not None and (changed_utc is None or last.utc > changed_utc)
        if last is not None and of_now and (utc_now() - last.utc).total_seconds() < _LATELY_S:
            return last
        return await self._session.read()

    async def before_at_rest(self) -> Readout:
        """As `before`; one that still moves, say up to a rate that it was given just now, is waited for.

        Not for longer than `Timing.rest_s`: a reading that says "slewing" after that is one that slews.
        """
        session, loop = self._session, asyncio.get_running_loop()
        until = loop.time() + session.timing.rest_s
        before = await self.before()
        while before.slewing and not (session.axes or session.drift.may) and loop.time() < until:
            await pause(session.timing.soon_s)
            before = await session.read()
        return before

    @asynccontextmanager
    async def checked(
        self,
        order: str,
        before: Readout,
        *,
        took: Took | None = None,
        undo: Callable[[], Awaitable[object]] | None = None,
        stops: bool = True,
        ask: Ask | None = None,
    ) -> AsyncIterator[None]:
        """Send an order within this context: a refusal that the readings contradict becomes `RefusedButDone`.

        Parameters
        ----------
        order : str
            In words: "the slew".
        before : Readout
            The reading before it.
        took : callable, optional
            What besides motion shows that the order was carried out.
        undo : callable, optional
            Takes back what was done without motion.
        stops : bool
            Whether the mount is stopped as soon as its place has changed, and not only if it reports a slew:
            after all orders but a sync.
        ask : callable, optional
            Asks the mount, once, for what no reading shows.

        Raises
        ------
        DeviceRefused
            The order's own refusal: the mount stays where it was.
        RefusedButDone
            It carried the order out, and was stopped if that was possible.
        DeviceSilent, DeviceGarbled, DeviceMissing
            It refused, and can't be read since.
        """
        log, began = self._session.language.log, self._session.language.log.count
        # a motion that began before is not ours to stop, and says nothing about the refusal
        moved_already = bool(before.slewing) or self._session.in_motion
        # those that the order itself may bring are what is looked for
        rates = self._session.drift.may
        try:
            yield
        except DeviceRefused as refusal:
            asked = any(entry.way == "driver->mount" for entry in log.entries(began))
            if moved_already or not asked:  # nothing went out: the driver's own refusal
                raise
            done = await self._belied(refusal, before, took, ask, rates)
            if done is None:
                raise
            raise await self._ended(order, refusal, done, undo, stops=stops) from refusal

    async def _belied(
        self,
        refusal: DeviceRefused,
        before: Readout,
        took: Took | None,
        ask: Ask | None,
        rates: tuple[OffsetRates, ...],
    ) -> str | None:
        """What the mount does although it refused, in words; None if it does nothing."""
        session, loop = self._session, asyncio.get_running_loop()
        orders = self._orders()
        if ask is not None:
            try:
                asked = await ask()
            except DeviceError as trouble:
                raise await self._unread(refusal, trouble) from refusal
            if asked:
                return None if orders != self._orders() else "did it"
        until = loop.time() + session.timing.start_grace_s
        while True:
            # unfiltered readings: the filter believes a motion late, and the mount must be stopped at once
            done = self._did(before, await self._read(refusal), took, rates)
            if done is not None:
                # one reading may be wrong as well: two in a row are enough to stop the mount
                done = self._did(before, await self._read(refusal), took, rates)
            if orders != self._orders():
                return None  # its motion may now be due to another order
            if done is not None or loop.time() > until:
                return done
            await pause(session.timing.soon_s)

    def _orders(self) -> tuple[object, ...]:
        session = self._session
        return session.job, session.stops, session.pulses, session.links, tuple(session.axes.items())

    async def _read(self, refusal: DeviceRefused) -> Readout:
        try:
            return await self._session.read_once()
        except DeviceError as trouble:
            raise await self._unread(refusal, trouble) from refusal

    def _did(
        self, before: Readout, now: Readout, took: Took | None, rates: tuple[OffsetRates, ...]
    ) -> str | None:
        free_arcsec = self._session.timing.resting_free_arcsec(self._session.language.resolution_arcsec)
        moved = moved_arcsec(before.reading, now.reading, rates)
        if moved > free_arcsec:
            in_degrees = moved >= _IN_DEGREES_ARCSEC
            return f"moved by {moved / 3600.0:.2f}°" if in_degrees else f"moved by {moved:.0f}″"
        if now.slewing:
            return "moved"
        if took is not None and took(now) and took(before) is False:
            return "did it"
        return None

    async def _unread(self, refusal: DeviceRefused, trouble: DeviceError) -> DeviceError:
        """The error for a mount that refused and can't be read: it may move, and a stop is owed."""
        session = self._session
        session.state, session.stop_owed = SlewState.LOST, True
        if session.job is None:
            # an order to move sends its own stop
            with suppress(DeviceError):
                await session.language.send_stop(0)
        return type(trouble)(
            f"said no ({refusal.what}), and whether it does it anyway can't be seen: {trouble.what}",
            device=session.name,
            advice="look at the mount before anything moves",
        )

    async def _ended(
        self,
        order: str,
        refusal: DeviceRefused,
        done: str,
        undo: Callable[[], Awaitable[object]] | None,
        *,
        stops: bool,
    ) -> RefusedButDone:
        """Stop or undo what it does, distrust its position and report it; return the error to raise."""
        session = self._session
        said = f"{order}: said refused ({refusal.what}), but {done}"
        session.language.log.note("event", meaning=said)
        # before the stop: nothing may be sent by this position while the stop is carried out
        session.distrust(f"it said no to {order}, and {done}")
        advice = "its position is not trusted: solve a frame and sync (recover), and see to its line"
        try:
            if done == "did it":
                if undo is not None:
                    await undo()
                    said = f"{said}; undone"
            elif stops or done == "moved":
                await self._stop()
                session.state = SlewState.STOPPED
                said = f"{said}; stopped"
        except DeviceError as trouble:
            session.state, session.stop_owed = SlewState.LOST, True
            said = f"{said}, and could not be stopped: {trouble.what}"
            advice = "it may be moving: stop it, or cut its power"
        session.emit("refused-but-done", {"order": order, "why": said})
        return RefusedButDone(said, device=session.name, advice=advice)
