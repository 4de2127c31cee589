"""Orders to move, followed to their end; and the stop, which goes past them all.

A slew has arrived when the mount rests *and* is where it was sent, by its readings. Whoever can't follow a
motion any more has sent a stop. A stop is repeated, through silences too, until the mount is seen at rest.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.language import Readout, Sent, Wanted
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
"""Whether a resting mount has done what it was ordered; None when it can't tell."""

_ROOM_S = 0.4
_TELLINGS = 5
"""So often an order is told to a mount that falls silent meanwhile. Doubled, a caller waits a minute."""
_NEARLY_ARCSEC = 7200.0
"""A mount in doubt that rests so near to where it was sent is sent on: it can't have woken up there. Doubled,
one that woke up elsewhere may be."""
_STATES = {
    SlewOutcome.ARRIVED: SlewState.ARRIVED,
    SlewOutcome.STALLED: SlewState.STALLED,
    SlewOutcome.STOPPED: SlewState.STOPPED,
}


class Motions:
    """Moves one mount.

    Parameters
    ----------
    tended : Tended
    """

    def __init__(self, tended: Session) -> None:
        self._tended = tended
        self.refusals = Refusals(tended, self.stop)
        self._went_out = False
        """Whether the order that runs has reached the wire."""

    @asynccontextmanager
    async def job(self, what: str) -> AsyncIterator[int]:
        """Hold the mount for one order to move; gives the count of stops at its start.

        While a stop is carried out the order waits; another stop that comes meanwhile ends it.

        Raises
        ------
        Busy
            If another order to move runs.
        """
        tended = self._tended
        if tended.job is not None:
            raise Busy(f"a {tended.job} is running", device=tended.name, advice="stop it first")
        if tended.pulses:
            raise Busy("a guide pulse is running", device=tended.name, advice="wait for its end")
        tended.job, self._went_out = what, False
        stops, links = tended.stops, tended.links
        try:
            await tended.ready()
            links = tended.links
            # a stop is repeated until the mount is seen at rest: what went out before would be stopped by it
            await tended.no_stop.wait()
            yield stops
        except DeviceRefused:
            # said no in the middle, or won't be stopped: something may still move
            tended.state = SlewState.LOST if self._went_out else SlewState.REFUSED
            tended.stop_owed = tended.stop_owed or self._went_out
            self._settle_doubt(arrived=not self._went_out)
            raise
        except (DeviceSilent, DeviceGarbled, DeviceMissing, asyncio.CancelledError) as trouble:
            tended.state, tended.stop_owed = SlewState.LOST, True
            if self._went_out and isinstance(trouble, DeviceError):
                # where it is when it can be read again nobody has seen it go
                tended.distrust(f"it could not be followed on its way: {trouble.what}")
            self._settle_doubt(arrived=not self._went_out)
            # nobody watches it any more: a mount that may be moving is not left so
            with contextlib.suppress(DeviceError):
                await tended.language.send_stop(0)
            if not asyncio.current_task().cancelling():  # type: ignore[union-attr]
                # a closed line tells less than what closed it
                self._require_link(links)
            raise
        finally:
            tended.job, tended.sent_out = None, False

    async def ordered(
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
            Sends it.
        there : callable
            Whether a resting mount has done it.
        stops : int
            The count of stops from which on no other may have come.
        before : Readout
            The last before the order.
        towards : Apparent or Icrs, optional
            For languages that go in several legs.
        """
        tended = self._tended
        tended.state = SlewState.NONE
        links = tended.links

        def wanted() -> bool:
            return tended.stops == stops and tended.links == links

        sent, before = await self._sent(send, wanted, before, there)
        if not sent.wire:
            self._require_link(links)
            tended.state = SlewState.STOPPED
            return SlewOutcome.STOPPED
        self._went_out = True
        tended.restless()
        if sent.lost is None:
            tended.state = SlewState.ACCEPTED
        if wanted():
            tended.stop_owed = False
        else:
            # the stop may have overtaken the order
            await tended.language.send_stop(0)
        outcome = await self._follow(there, wanted, links, before, sent, towards)
        tended.state = _STATES[outcome]
        proven = towards is not None or not tended.silent_on_its_way
        self._settle_doubt(arrived=outcome is SlewOutcome.ARRIVED and proven)
        return outcome

    async def _sent(
        self,
        send: Callable[[Wanted], Awaitable[Sent]],
        wanted: Wanted,
        before: Readout,
        there: There,
    ) -> tuple[Sent, Readout]:
        """Send an order, unless the mount falls silent while it is told: then it is looked at again first.

        It may have been switched off and on: the order would go out by the place at which it woke up, and be
        seen to arrive there.
        """
        tended = self._tended
        trusted = tended.trusted

        def wanted_and_heard() -> bool:
            # asked right before what moves it goes out
            goes = wanted() and not tended.doubt
            tended.sent_out = tended.sent_out or goes
            return goes

        for _ in range(_TELLINGS):
            tended.doubt, tended.silent_on_its_way = "", False
            async with self.refusals.seen_to(f"the {tended.job}", before, took=there), tended.ordering:
                sent = await send(wanted_and_heard)
            if sent.wire or not wanted():
                tended.sent_out = sent.wire
                return sent, before
            tended.sent_out = False
            now = await tended.look()
            if self._changes(before, now):
                tended.distrust(f"its reading changed while it was told the {tended.job}")
            if trusted:
                tended.require_trust(f"the {tended.job}")
            before = now
        raise DeviceSilent(
            f"fell silent each time it was told the {tended.job}: it was not sent",
            device=tended.name,
            advice="check cable and power",
        )

    def _settle_doubt(self, *, arrived: bool) -> None:
        """What was odd on its way is explained if it came to where it was sent; else its place is not."""
        if self._tended.doubt and not arrived:
            self._tended.distrust(self._tended.doubt)

    def _require_link(self, links: int) -> None:
        """What began on a link doesn't go on on the next: the mount may have been switched off meanwhile."""
        if self._tended.links != links:
            raise DeviceMissing(
                f"its link was lost on the way: {self._tended.lost_why or 'it was opened anew'}",
                device=self._tended.name,
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
        tended = self._tended
        loop, timing = asyncio.get_running_loop(), tended.timing
        started = ordered = changed = rested = loop.time()
        moved = silent = False
        while True:
            await pause(timing.poll_s)
            now = await tended.look()
            self._require_link(links)
            if now.failed and wanted():
                raise await self._failed(before, now)
            took_s = real_s((now.utc - before.utc).total_seconds())
            silent = silent or took_s > real_s(timing.poll_s) + timing.silence_s
            resting, changes = tended.judge.still(before, now), self._changes(before, now)
            before = now
            if not resting:
                moved, rested = True, loop.time()
                changed = loop.time() if changes else changed
                tended.state = SlewState.UNDER_WAY
                if loop.time() - started > timing.slew_timeout_s or loop.time() - changed > timing.stall_s:
                    await self.stop()
                    return SlewOutcome.STALLED
                continue
            changed = loop.time()
            if not wanted():
                return SlewOutcome.STOPPED
            arrived = there(now)
            lost = bool(tended.doubt) and (
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
                    tended.distrust("it was silent on its way, and didn't arrive")
                if not moved:
                    self._nothing_happened(sent, counts=arrived is not None)
                # one that can't tell whether it has parked, and rests, has
                return SlewOutcome.ARRIVED if arrived is None else SlewOutcome.STALLED

    async def _failed(self, before: Readout, now: Readout) -> DeviceRefused:
        """What to raise for a motion that is said to have failed; one that goes on is stopped."""
        tended = self._tended
        said = f"took up the {tended.job}, and failed on the way: {now.failed}"
        if not tended.judge.still(before, now):
            await self.stop()
            said = f"{said}; it was still moving, and was stopped"
        return DeviceRefused(
            said,
            device=tended.name,
            advice="see what its driver says; look at the sky before the next slew",
        )

    def _changes(self, before: Readout, now: Readout) -> bool:
        """Whether the place has changed by more than a step and the turn of the sky."""
        elapsed_s = max(0.0, (now.utc - before.utc).total_seconds())
        steps_arcsec = 1.0 + 1.1 * self._tended.language.resolution_arcsec
        free_arcsec = steps_arcsec + self._tended.timing.drift_arcsec_s * elapsed_s
        return apart_arcsec(before.place, now.place) > free_arcsec

    def _nothing_happened(self, sent: Sent, *, counts: bool) -> None:
        if sent.lost is not None:
            raise sent.lost
        if counts and self._tended.language.silent_refusals:
            raise DeviceRefused(
                "answered the order and didn't move",
                device=self._tended.name,
                advice="below its horizon or beyond one of its limits, or its alignment isn't done",
            )

    async def _next_leg(self, place: Apparent | Icrs, wanted: Wanted) -> bool:
        async with self._tended.ordering:
            return await self._tended.language.next_leg(place, wanted)

    async def stop(self) -> None:
        """Stop all motion: at once, past every other exchange, and again until the mount is seen at rest.

        Raises
        ------
        DeviceRefused
            If it still moves after `Timing.stop_timeout_s`.
        DeviceSilent, DeviceGarbled, DeviceMissing
            If the stop can't be sent, or was sent and the mount can't be read.
        """
        tended = self._tended
        tended.stops += 1
        tended.stop_owed = True
        if not tended.language.usable:
            await tended.ready()
        await tended.language.send_stop(0)
        tended.stopping += 1
        tended.no_stop.clear()
        try:
            repeating = waited_for(self._again_and_again())
            try:
                await self._seen_at_rest()
            finally:
                repeating.cancel()
                with contextlib.suppress(asyncio.CancelledError, DeviceError):
                    await repeating
        finally:
            tended.stopping -= 1
            if not tended.stopping:
                tended.no_stop.set()
        tended.stop_owed = False

    async def _again_and_again(self) -> None:
        again = 0
        while True:
            # the answers that some give to a stop must leave room for those to questions
            await asyncio.sleep(max(self._tended.timing.poll_s, _ROOM_S))
            again += 1
            with contextlib.suppress(DeviceSilent):
                await self._tended.language.send_stop(again)

    async def _seen_at_rest(self) -> None:
        tended, loop = self._tended, asyncio.get_running_loop()
        until = loop.time() + tended.timing.stop_timeout_s
        before: Readout | None = None
        silent = heard_again = False
        while True:
            try:
                now = await tended.look()
            except (DeviceSilent, DeviceGarbled):
                if loop.time() > until:
                    raise
                before, silent = None, True
                continue
            if silent and not heard_again:
                # what was told into the silence it may not have heard: it has its time from now on
                heard_again = True
                until = loop.time() + tended.timing.stop_timeout_s
            if before is not None and tended.judge.still(before, now):
                return
            # one reading tells nothing of motion
            if before is not None and loop.time() > until:
                raise DeviceRefused(
                    "was told to stop and still moves", device=tended.name, advice="cut its power"
                )
            before = now
            await pause(tended.timing.poll_s)
