"""Axes moved on by hand: at a speed, on top of tracking, until they are told to end, or stopped.

Nothing on the wire ends such a motion by itself; how long it may last is decided above. While an axis is
moved no other order to move begins. Whatever is not certain ends it: an answer that was lost, an end that was
refused, a broken link, a driver that is closed. Some protocols leave open which way an axis goes: there the
first motion is watched, and stopped if it goes the other way.
"""

from __future__ import annotations

import asyncio
import contextlib
import math

from drivers.generic.language import Readout
from drivers.generic.motions import Motions
from drivers.generic.refusal_words import parked
from drivers.generic.session import Session
from mountnav.clock import pause
from mountnav.devices import MountAxis, RateSpan, SlewState
from mountnav.errors import (
    BadRequest,
    Busy,
    DeviceError,
    DeviceRefused,
    DeviceSilent,
    Refusal,
    RefusedButDone,
)
from mountnav.sky.sphere import half_turn_deg
from mountnav.tasks import begun

_SPEED_FREE = 1e-9
"""Share by which a speed may lie outside of a span: what adding up decimal numbers leaves. Doubled or halved,
nothing shows."""

_MOST_DEC_DEG = 85.0
"""Nearer to a pole a direction in right ascension isn't judged: a step of the readings becomes a degree."""
_SHOWS = 3.0
"""A motion shows when it is so many times what readings may wander and the sky may turn. Doubled, an axis
that goes the wrong way is stopped later; halved, noise stops one that goes right."""


class Axes:
    """Moves the axes of one mount."""

    def __init__(self, session: Session, motions: Motions) -> None:
        self._session = session
        self._motions = motions
        self._watches: dict[MountAxis, asyncio.Task[None]] = {}
        self._orders: dict[MountAxis, int] = {}
        """How many orders came for each axis: an older one doesn't go out after a newer one."""

    async def move(self, axis: MountAxis, rate_deg_s: float) -> None:
        """Move an axis on, or end that; see `GenericMount.move_axis`."""
        session = self._session
        self._check(axis, rate_deg_s)
        session.require_no_job("stop it first", by_hand=True)
        if session.pulses:
            raise Busy("a guide pulse is running", device=session.name, advice="wait for its end")
        number = self._orders[axis] = self._orders.get(axis, 0) + 1
        if rate_deg_s == 0.0:
            await self._end(axis, number)
        else:
            await self._begin(axis, rate_deg_s, number)

    def _check(self, axis: MountAxis, rate_deg_s: float) -> None:
        session = self._session
        spans = session.language.axis_rates_deg_s.get(axis, ())
        if axis not in ("primary", "secondary"):
            raise BadRequest(f"{axis!r} is not an axis", device=session.name, advice="primary or secondary")
        if not math.isfinite(rate_deg_s):
            raise BadRequest(
                f"a speed of {rate_deg_s}°/s",
                device=session.name,
                advice="a finite number; 0 ends the motion",
            )
        if not spans:
            raise DeviceRefused(
                f"can't move its {axis} axis by hand", device=session.name, reason=Refusal.UNSUPPORTED
            )
        if rate_deg_s and not any(_within(abs(rate_deg_s), span) for span in spans):
            raise BadRequest(
                f"can't move its {axis} axis at {rate_deg_s:+.6g}°/s",
                device=session.name,
                advice=f"it can at {', '.join(map(_text, spans))}",
            )

    async def _begin(self, axis: MountAxis, rate_deg_s: float, number: int) -> None:
        session = self._session
        stops = session.stops
        await session.ready()
        links = session.links
        await session.no_stop.wait()
        before = await self._motions.refusals.before_at_rest()
        if before.parked:
            raise parked("moving an axis", device=session.name)
        if before.slewing and not (session.axes or session.drift.may):
            raise DeviceRefused("can't move an axis: it slews", device=session.name, reason=Refusal.BUSY)

        def wanted() -> bool:
            return (
                session.stops == stops
                and session.links == links
                and session.job is None
                and self._orders[axis] == number
            )

        if not wanted():
            raise self._overtaken()
        was = session.axes.get(axis)
        session.axes[axis] = rate_deg_s
        session.forget_rest()
        try:
            async with self._motions.refusals.checked("moving the axis", before), session.ordering:
                sent = await session.language.send_move_axis(axis, rate_deg_s, wanted)
            if sent.lost is not None:
                raise sent.lost
        except DeviceRefused:
            self._as_it_was(axis, was, number)
            raise
        except RefusedButDone:
            raise  # it was stopped
        except (DeviceError, asyncio.CancelledError):
            # it may move, and nobody would watch it
            session.state, session.stop_owed = SlewState.LOST, True
            with contextlib.suppress(DeviceError):
                await session.language.send_stop(0)
            session.axes.clear()
            raise
        if not sent.wire:
            self._as_it_was(axis, was, number)
            raise self._overtaken()
        if session.stops == stops and session.links == links:
            session.stop_owed = False
            if session.language.direction_unsure(axis) and abs(before.place.dec_deg) < _MOST_DEC_DEG:
                self._watch(axis, rate_deg_s, number, before)
        else:
            # the stop may have overtaken the order
            await session.language.send_stop(0)

    def _as_it_was(self, axis: MountAxis, rate_deg_s: float | None, number: int) -> None:
        if self._orders[axis] != number:
            return  # a newer order says how it is
        if rate_deg_s is None:
            self._session.axes.pop(axis, None)
        else:
            self._session.axes[axis] = rate_deg_s

    def _overtaken(self) -> DeviceRefused:
        return DeviceRefused(
            "the order to move the axis was not sent: a stop or a newer order "
            "came before it, or its link was lost",
            device=self._session.name,
        )

    async def _end(self, axis: MountAxis, number: int) -> None:
        session = self._session
        self._unwatch(axis)
        await session.ready()
        stops = session.stops
        try:
            async with session.ordering:
                sent = await session.language.send_move_axis(axis, 0.0, lambda: True)
            if sent.lost is not None:
                raise sent.lost
            if {one for one in session.axes if one != axis}:
                # the other axis moves on: whether this one rests no reading shows
                session.axes.pop(axis, None)
                return
            await self._rest(axis, number)
        except DeviceError as trouble:
            session.language.log.note("event", meaning=f"the {axis} axis is stopped: {trouble.what}")
            if session.stops == stops:
                await self._motions.stop()
            return
        if self._orders[axis] == number:
            session.axes.pop(axis, None)

    async def _rest(self, axis: MountAxis, number: int) -> None:
        """Wait until it was seen at rest; raises `DeviceSilent` if it goes on."""
        session, loop = self._session, asyncio.get_running_loop()
        until = loop.time() + session.timing.stop_timeout_s
        before = await session.read()
        while self._orders[axis] == number:
            await pause(session.timing.soon_s)
            now = await session.read()
            if session.filter.still(before, now):
                return
            if loop.time() > until:
                raise DeviceSilent("still moves after it was told to end", device=session.name)
            before = now

    def _watch(self, axis: MountAxis, rate_deg_s: float, number: int, before: Readout) -> None:
        self._unwatch(axis)
        watch = self._watched(axis, rate_deg_s, number, before)
        self._watches[axis] = begun(watch, f"axis-{axis}", died=self._watch_died)

    def _unwatch(self, axis: MountAxis) -> None:
        watch = self._watches.pop(axis, None)
        if watch is not None and watch is not asyncio.current_task():
            watch.cancel()

    def _watch_died(self, fault: Exception) -> None:
        # a motion that nobody watches must not go on: the next reading that shows it sends a stop
        self._session.stop_owed = True
        self._session.language.log.note("event", meaning=f"watching an axis failed: {fault}")

    async def _watched(self, axis: MountAxis, rate_deg_s: float, number: int, before: Readout) -> None:
        """See which way an axis goes; stop it if that is the wrong one."""
        session = self._session
        while True:
            await pause(session.timing.soon_s)
            went_arcsec = self._went_arcsec(axis, before, await session.read())
            if self._orders[axis] != number or session.axes.get(axis) != rate_deg_s:
                return  # what it does since is due to another order
            if went_arcsec == 0.0:
                continue
            rightly = went_arcsec * rate_deg_s > 0.0
            session.language.direction_seen(axis, rightly=rightly)
            if rightly:
                return
            words = f"its {axis} axis moved in the opposite direction ({went_arcsec / 3600.0:+.2f}°)"
            session.language.log.note("event", meaning=words)
            session.emit("axis-went-wrong", {"axis": axis, "why": f"{words}: stopped, and known from now on"})
            await self._motions.stop()
            return

    def _went_arcsec(self, axis: MountAxis, before: Readout, now: Readout) -> float:
        """How far an axis went; 0 as long as that may be noise, or the turn of the sky."""
        session = self._session
        free_arcsec = session.timing.resting_free_arcsec(session.language.resolution_arcsec)
        turned_arcsec = session.timing.drift_arcsec_s * (now.utc - before.utc).total_seconds()
        noise_arcsec = _SHOWS * (free_arcsec + turned_arcsec)
        if axis == "secondary":
            went_arcsec = 3600.0 * (now.place.dec_deg - before.place.dec_deg)
        else:
            went_arcsec = 3600.0 * half_turn_deg(now.place.ra_deg - before.place.ra_deg)
            dec_deg = min(abs(now.place.dec_deg), _MOST_DEC_DEG)
            noise_arcsec /= math.cos(math.radians(dec_deg))
        return went_arcsec if abs(went_arcsec) > noise_arcsec else 0.0

    async def close(self) -> None:
        """End all that is moved by hand: nobody is left who would."""
        session = self._session
        for axis in tuple(self._watches):
            self._unwatch(axis)
        if session.axes and session.language.usable:
            with contextlib.suppress(DeviceError):
                await self._motions.stop()


def _within(speed_deg_s: float, span: RateSpan) -> bool:
    return span.least_deg_s * (1.0 - _SPEED_FREE) <= speed_deg_s <= span.most_deg_s * (1.0 + _SPEED_FREE)


def _text(span: RateSpan) -> str:
    if span.least_deg_s == span.most_deg_s:
        return f"{span.most_deg_s:.6g}°/s"
    return f"{span.least_deg_s:.6g} to {span.most_deg_s:.6g}°/s"
