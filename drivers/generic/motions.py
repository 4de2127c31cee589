"""Orders to move, followed to their end; and the stop, which goes past them all.

A slew has arrived when the mount rests *and* is where it was sent, by its readings. When a motion can't be
followed any more a stop is sent. A stop is repeated, through silences too, until the mount is seen at rest.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.language import Readout, Sent, Wanted
from drivers.generic.rates import end_rates
from drivers.generic.refusals import Refusals
from drivers.generic.session import Session
from mountnav.clock import pause, real_s
from mountnav.devices import SlewOutcome, SlewState
from mountnav.errors import (
    Busy,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
)
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.tasks import waited_for

There = Callable[[Readout], bool | None]
"""Whether a resting mount has done what it was ordered; None where a reading doesn't show it."""

_BETWEEN_STOPS_S = 0.4
"""Shortest time (s) between two stops: some mounts answer each, and the answers to readings need room on
the line. Chosen by hand. Doubled, a stop that was lost is sent again so much later; halved, a 9600 baud line
fills."""
_MOST_SENDINGS = 5
"""How often an order is sent to a mount that falls silent meanwhile. Doubled, a caller waits a minute."""
_NEARLY_ARCSEC = 7200.0
"""A mount in doubt that rests so near (arcsec) to where it was sent is sent on: it can't have woken up there.
Doubled, one that woke up elsewhere may be."""
_STATES = {
    SlewOutcome.ARRIVED: SlewState.ARRIVED,
    SlewOutcome.STALLED: SlewState.STALLED,
    SlewOutcome.STOPPED: SlewState.STOPPED,
}


class Motions:
    """Moves one mount.

    Attributes
    ----------
    refusals : Refusals
        Checks the mount's refusals by its readings.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.refusals = Refusals(session, self.stop)
        self._went_out = False
        """Whether the order that runs has reached the wire."""

    @asynccontextmanager
    async def hold(self, what: str) -> AsyncIterator[int]:
        """Hold the mount for one order to move; gives the count of stops at its start.

        While a stop is being carried out the order waits; another stop that comes meanwhile ends it. Orders
        are queued or preempted above; here a second one is refused, since the readings of two motions can't
        be told apart on the wire.

        Raises
        ------
        Busy
            If another order to move runs, or a guide pulse: its end would halt the motion on some mounts.
        """
        session = self._session
        session.require_no_job("stop it first")
        if session.pulses:
            raise Busy("a guide pulse is running", device=session.name, advice="wait for its end")
        session.job, self._went_out = what, False
        stops, links = session.stops, session.links
        try:
            await session.ready()
            links = session.links
            # a stop is repeated until the mount is seen at rest: what went out before would be stopped by it
            await session.no_stop.wait()
            yield stops
        except DeviceRefused:
            # refused after it was sent, or can't be stopped: something may still move
            session.state = SlewState.LOST if self._went_out else SlewState.REFUSED
            session.stop_owed = session.stop_owed or self._went_out
            self._settle_doubt(arrived=not self._went_out)
            raise
        except (DeviceSilent, DeviceGarbled, DeviceMissing, asyncio.CancelledError) as trouble:
            session.state, session.stop_owed = SlewState.LOST, True
            if self._went_out and isinstance(trouble, DeviceError):
                # it was not followed to where it is when it can be read again
                session.distrust(f"it could not be followed on its way: {trouble.what}")
            self._settle_doubt(arrived=not self._went_out)
            # it is not watched any more: a mount that may be moving must not go on
            with contextlib.suppress(DeviceError):
                await session.language.send_stop(0)
            task = asyncio.current_task()
            if task is None or not task.cancelling():
                # raise what closed the line rather than that it is closed
                self._require_link(links)
            raise
        finally:
            session.job, session.sent_out = None, False

    async def carry_out(
        self,
        send: Callable[[Wanted], Awaitable[Sent]],
        there: There,
        *,
        stops: int,
        before: Readout,
        towards: Apparent | Icrs | None = None,
    ) -> SlewOutcome:
        """Send an order to move, once, and follow it until the mount rests.

        Parameters
        ----------
        send : callable
            Sends the order, if it is still wanted when it is asked.
        there : callable
            Whether a resting mount has done it.
        stops : int
            The count of stops when the order began; another stop since then ends it.
        before : Readout
            The last reading before the order.
        towards : Apparent or Icrs, optional
            Where it goes, for languages that slew in several legs.
        """
        session = self._session
        session.state = SlewState.NONE
        links = session.links

        def wanted() -> bool:
            return session.stops == stops and session.links == links

        sent, before = await self._send(send, wanted, before, there)
        if not sent.wire:
            self._require_link(links)
            session.state = SlewState.STOPPED
            return SlewOutcome.STOPPED
        self._went_out = True
        session.forget_rest()
        if sent.lost is None:
            session.state = SlewState.ACCEPTED
        if wanted():
            session.stop_owed = False
        else:
            # the stop may have overtaken the order
            await session.language.send_stop(0)
        outcome = await self._follow(there, wanted, links, before, sent, towards)
        session.state = _STATES[outcome]
        proven = towards is not None or not session.silent_on_its_way
        self._settle_doubt(arrived=outcome is SlewOutcome.ARRIVED and proven)
        return outcome

    async def _send(
        self,
        send: Callable[[Wanted], Awaitable[Sent]],
        wanted: Wanted,
        before: Readout,
        there: There,
    ) -> tuple[Sent, Readout]:
        """Send an order; if the mount falls silent meanwhile, read it again before the order is repeated.

        It may have been switched off and on: the order would go by the place at which it woke up, and would
        seem to arrive there.
        """
        session = self._session
        trusted = session.trusted

        def wanted_and_heard() -> bool:
            # called right before the command that moves the mount goes out
            goes = wanted() and not session.doubt
            session.sent_out = session.sent_out or goes
            return goes

        for _ in range(_MOST_SENDINGS):
            session.doubt, session.silent_on_its_way = "", False
            async with self.refusals.checked(f"the {session.job}", before, took=there), session.ordering:
                sent = await send(wanted_and_heard)
            if sent.wire or not wanted():
                session.sent_out = sent.wire
                return sent, before
            session.sent_out = False
            now = await session.read()
            if session.filter.changed(before, now):
                session.distrust(f"its reading changed while it was told the {session.job}")
            if trusted:
                session.require_trust(f"the {session.job}")
            before = now
        raise DeviceSilent(
            f"fell silent each time it was told the {session.job}: it was not sent",
            device=session.name,
            advice="check cable and power",
        )

    def _settle_doubt(self, *, arrived: bool) -> None:
        """What was odd on the way is harmless if the mount arrived; otherwise its position is not trusted."""
        if self._session.doubt and not arrived:
            self._session.distrust(self._session.doubt)

    def _require_link(self, links: int) -> None:
        """Give up what began on an earlier link: the mount may have been switched off meanwhile."""
        if self._session.links != links:
            raise DeviceMissing(
                f"its link was lost on the way: {self._session.lost_why or 'it was reopened'}",
                device=self._session.name,
                advice="look at the sky before anything moves again",
            )

    async def _follow(
        self,
        there: There,
        wanted: Wanted,
        links: int,
        before: Readout,
        sent: Sent,
        towards: Apparent | Icrs | None,
    ) -> SlewOutcome:
        session = self._session
        loop, timing = asyncio.get_running_loop(), session.timing
        started = ordered = changed = rested = loop.time()
        moved = silent = False
        while True:
            await pause(timing.poll_s)
            now = await session.read()
            self._require_link(links)
            if now.failed and wanted():
                raise await self._failed(before, now)
            took_s = real_s((now.utc - before.utc).total_seconds())
            silent = silent or took_s > real_s(timing.poll_s) + timing.silence_s
            resting, changes = session.filter.still(before, now), session.filter.changed(before, now)
            before = now
            if not resting:
                moved, rested = True, loop.time()
                changed = loop.time() if changes else changed
                session.state = SlewState.UNDER_WAY
                if loop.time() - started > timing.slew_timeout_s or loop.time() - changed > timing.stall_s:
                    await self.stop()
                    return SlewOutcome.STALLED
                continue
            changed = loop.time()
            if not wanted():
                return SlewOutcome.STOPPED
            arrived = there(now)
            lost = bool(session.doubt) and (
                towards is None or apart_arcsec(now.place, towards) > _NEARLY_ARCSEC
            )
            if towards is not None and not lost and await self._next_leg(towards, wanted):
                ordered, moved = loop.time(), False
                continue
            if arrived:
                return SlewOutcome.ARRIVED
            # it may pause between two axes, or take a moment to say that it is parked
            patience_s, since = (timing.rest_s, rested) if moved else (timing.start_grace_s, ordered)
            if loop.time() - since > patience_s:
                if silent and arrived is not None:
                    session.distrust("it was silent on its way, and didn't arrive")
                if not moved:
                    self._raise_why_not(sent, counts=arrived is not None)
                # a mount that doesn't report whether it is parked has parked when it rests
                return SlewOutcome.ARRIVED if arrived is None else SlewOutcome.STALLED

    async def _failed(self, before: Readout, now: Readout) -> DeviceRefused:
        """The error for a motion that the mount reports as failed; if it still moves it is stopped."""
        session = self._session
        said = f"accepted the {session.job}, and failed on the way: {now.failed}"
        if not session.filter.still(before, now):
            await self.stop()
            said = f"{said}; it was still moving, and was stopped"
        return DeviceRefused(
            said,
            device=session.name,
            advice="see what its driver says; look at the sky before the next slew",
        )

    def _raise_why_not(self, sent: Sent, *, counts: bool) -> None:
        """Raise the reason why a mount didn't set out, where there is one."""
        if sent.lost is not None:
            raise sent.lost
        if counts and self._session.language.silent_refusals:
            raise DeviceRefused(
                "answered the order and didn't move",
                device=self._session.name,
                advice="below its horizon or beyond one of its limits, or its alignment isn't done",
            )

    async def _next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        async with self._session.ordering:
            return await self._session.language.next_leg(place, wanted)

    async def stop(self) -> None:
        """Stop all motion: at once, past every other exchange, and again until the mount is seen at rest.

        Raises
        ------
        DeviceRefused
            If it still moves after `Timing.stop_timeout_s`.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the stop can't be sent, or was sent and the mount can't be read.
        """
        session = self._session
        session.stops += 1
        session.stop_owed = True
        if not session.language.usable:
            await session.ready()
        await session.language.send_stop(0)
        session.stopping += 1
        session.no_stop.clear()
        try:
            repeating = waited_for(self._repeat_stop())
            try:
                unended = await self._end_rates()
                await self._wait_for_rest()
            finally:
                repeating.cancel()
                with contextlib.suppress(asyncio.CancelledError, DeviceError):
                    await repeating
        finally:
            session.stopping -= 1
            if not session.stopping:
                session.no_stop.set()
        session.stop_owed = False
        session.axes.clear()
        if unended is not None:
            raise type(unended)(
                f"was stopped, and may track at offset rates: {unended.what}",
                device=session.name,
                advice=unended.advice or "look at the sky",
            )

    async def _end_rates(self) -> DeviceError | None:
        """With a stop the rates of a moving target end too; what hinders that hinders no stop."""
        session = self._session
        if not session.drift.to_end:
            return None
        try:
            # where the stop has switched tracking off, an order to track as for a star might begin it anew
            await end_rates(session, begins_tracking=False)
        except DeviceError as trouble:
            return trouble
        return None

    async def _repeat_stop(self) -> None:
        again = 0
        while True:
            await asyncio.sleep(max(self._session.timing.poll_s, _BETWEEN_STOPS_S))
            again += 1
            with contextlib.suppress(DeviceSilent):
                await self._session.language.send_stop(again)

    async def _wait_for_rest(self) -> None:
        session, loop = self._session, asyncio.get_running_loop()
        until = loop.time() + session.timing.stop_timeout_s
        before: Readout | None = None
        silent = heard_again = False
        while True:
            try:
                now = await session.read()
            except (DeviceSilent, DeviceGarbled):
                if loop.time() > until:
                    raise
                before, silent = None, True
                continue
            if silent and not heard_again:
                # it may not have heard the stops that were sent into the silence: its time begins now
                heard_again = True
                until = loop.time() + session.timing.stop_timeout_s
            if before is not None and session.filter.still(before, now):
                return
            # one reading says nothing about motion
            if before is not None and loop.time() > until:
                raise DeviceRefused(
                    "was told to stop and still moves", device=session.name, advice="cut its power"
                )
            before = now
            await pause(session.timing.poll_s)
