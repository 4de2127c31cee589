"""A whole rotator made of any protocol's language: turned to an angle and seen there, or told why not.

It knows the mechanism alone. Which way round it may turn, and where the sky's north is, others decide.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Protocol

from drivers.wire.wire_log import WireLog
from mountnav.clock import Clock, SystemClock
from mountnav.devices import RotatorReading
from mountnav.errors import (
    BadRequest,
    Busy,
    Cancelled,
    DeviceError,
    DeviceGarbled,
    DeviceMissing,
    DeviceRefused,
    DeviceSilent,
    NotReached,
    RefusedButDone,
    TargetNotReached,
)
from mountnav.sky.sphere import half_turn_deg, turn_deg

__all__ = ["GenericRotator", "RotatorLanguage", "RotatorTiming", "Told"]

_NEAR_DEG = 0.05
"""A rotator that rests so near to the ordered angle is there, °, or within one and a half of its steps.
Chosen by hand: a tenth of what frames at 1° tolerance need. Doubled, an ignored turn of 0.1° passes."""
_STEPS = 1.5
"""So many of its steps beside the angle count as there: rounding by the rotator and by its driver. Doubled,
coarse rotators rest three steps beside it."""
MOVED_DEG = 0.02
"""Readings that differ by less show no motion, °: drivers give two decimals. Doubled, slow ones seem to
stand."""
_TELLING = 2
"""So many readings in a row show that it turns although it has refused to. At 1 a damaged one stops it."""
_AGAIN_S = 1.0
"""Between two tries to stop it over a connection that was lost, s. Doubled, it turns by 3° more."""
MOST_DEG = 3600.0
"""A reading further from 0 is no angle: ten turns. Doubled, damaged numbers pass for angles more often."""
USUAL_STEP_DEG = 0.01
"""Of a rotator whose driver tells none: drivers give angles with two decimals. Doubled, turns end up to 0.03°
beside their angle."""


@dataclass(frozen=True, slots=True)
class Told:
    """What a rotator's driver says: its mechanism's angle, and whether it moves."""

    mechanical_deg: float
    moving: bool | None


@dataclass(frozen=True, slots=True)
class RotatorTiming:
    """How long a rotator is waited for.

    Attributes
    ----------
    poll_s : float
        Between two readings while it turns.
    start_s : float
        One that hasn't moved so long after its order doesn't.
    rest_s : float
        One that rests beside its angle for so long has ended: some pause to take up their backlash.
    stall_s : float
        One that says it turns and doesn't for so long is stopped.
    turn_timeout_s : float
        A turn that takes longer is stopped: a full one at 0.6°/s.
    stop_timeout_s : float
        So long it may take to rest after a stop.
    refused_s : float
        After a refusal it is watched for so long: one that turns all the same is stopped.
    lost_s : float
        So long its connection is tried again that was lost in a turn, to stop it: one turns by 60° meanwhile.
    """

    poll_s: float = 0.25
    start_s: float = 5.0
    rest_s: float = 2.0
    stall_s: float = 20.0
    turn_timeout_s: float = 600.0
    stop_timeout_s: float = 10.0
    refused_s: float = 2.0
    lost_s: float = 20.0


class RotatorLanguage(Protocol):
    """What a protocol must offer for one rotator; `GenericRotator` makes a whole rotator of it.

    No two methods are called at once, except `send_stop`.
    """

    @property
    def name(self) -> str:
        """Name and address, for messages."""
        ...

    @property
    def log(self) -> WireLog:
        """The latest messages."""
        ...

    @property
    def usable(self) -> bool:
        """Whether it is open and not lost."""
        ...

    @property
    def step_deg(self) -> float:
        """Its coarsest step; known after `open`."""
        ...

    @property
    def reversed(self) -> bool | None:
        """Whether its driver counts the other way round, by the last reading; None where it doesn't say."""
        ...

    async def open(self) -> None:
        """Connect, again if the connection was lost; a failure leaves no connection behind."""
        ...

    async def close(self) -> None:
        """Release the connection; the device stays connected, for others."""
        ...

    async def read(self) -> Told:
        """Ask for the angle, and whether it moves."""
        ...

    async def order(self, mechanical_deg: float) -> None:
        """Order a turn to an angle in [0, 360); return when it was taken. `DeviceRefused` when it says no."""
        ...

    async def send_stop(self) -> None:
        """Order it to stop, past all other orders."""
        ...


class GenericRotator:
    """A `mountnav.devices.Rotator`."""

    def __init__(
        self,
        language: RotatorLanguage,
        *,
        timing: RotatorTiming | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._language = language
        self._timing = timing or RotatorTiming()
        self._clock = clock or SystemClock()
        self._wanted_open = False
        self._opening = asyncio.Lock()
        self._turning = self._sent = False
        self._stops = 0
        self.links = 0
        """How often its connection was opened: a count from before one may be another."""

    @property
    def name(self) -> str:
        """Name and address, for messages."""
        return self._language.name

    @property
    def wire_log(self) -> WireLog:
        """The latest messages."""
        return self._language.log

    @property
    def step_deg(self) -> float:
        """Its coarsest step."""
        return self._language.step_deg

    @property
    def reversed(self) -> bool | None:
        """Whether its driver counts the other way round, by the last reading; None where it doesn't say."""
        return self._language.reversed

    async def open(self) -> None:
        """Connect. Never turns it, never syncs it.

        Raises
        ------
        DeviceMissing, DeviceSilent, DeviceGarbled
            There is no server, no such rotator, or it can't be connected.
        DeviceRefused
            It is not connected and must not be connected, or it is no rotator.
        """
        async with self._opening:
            await self._language.open()
            self.links += 1
        self._wanted_open = True

    async def close(self) -> None:
        """Stop a turn, and release the connection; the rotator stays connected."""
        self._wanted_open = False
        if self._turning:
            with suppress(DeviceError):
                await self.stop()
        await self._language.close()

    async def reading(self) -> RotatorReading:
        """At which angle it stands. Raises `DeviceError`."""
        await self._ready()
        asked = self._clock.utc()
        told = await self._language.read()
        if not (math.isfinite(told.mechanical_deg) and abs(told.mechanical_deg) <= MOST_DEG):
            raise DeviceSilent(
                f"reports an angle of {told.mechanical_deg}°", device=self.name, advice="is its driver sound?"
            )
        return RotatorReading(told.mechanical_deg, asked + (self._clock.utc() - asked) / 2, told.moving)

    async def turn(
        self, mechanical_deg: float, *, seen: Callable[[RotatorReading], None] | None = None
    ) -> RotatorReading:
        """Turn to an angle of its mechanism; return when it is seen to rest there.

        Parameters
        ----------
        seen : callable, optional
            Told of each reading on the way; what it raises stops the rotator, and is passed on.

        Raises
        ------
        BadRequest
            It is no angle.
        Busy
            It turns already, by our order.
        Cancelled
            A stop came.
        TargetNotReached
            It said that it would, and did not move (`NotReached.STUCK`); came to rest elsewhere
            (`NotReached.REST`); or took too long and was stopped (`NotReached.TIME`).
        RefusedButDone
            It said no, and turned all the same; it was stopped.
        DeviceRefused
        DeviceError
            What it does isn't known; it was stopped, over a new connection if need be, or couldn't be.
        """
        if not math.isfinite(mechanical_deg):
            raise BadRequest(f"{mechanical_deg}° is not an angle", device=self.name)
        if self._turning:
            raise Busy("it is turning", device=self.name, advice="wait for it, or stop it")
        self._turning, self._sent = True, False
        stops = self._stops
        try:
            return await self._turned(mechanical_deg, seen)
        except asyncio.CancelledError:
            # nobody waits any more
            with suppress(DeviceError):
                await asyncio.shield(self._language.send_stop())
            raise
        except (DeviceMissing, DeviceSilent, DeviceGarbled) as trouble:
            # nobody knows what it does: it must not turn on
            if not self._sent:
                raise
            raise await self._ended(trouble, stops) from trouble
        finally:
            self._turning = False

    async def stop(self) -> None:
        """Stop it now; return when it is seen to rest.

        Raises
        ------
        DeviceSilent
            It turns on, or doesn't answer.
        DeviceRefused, DeviceError
        """
        self._stops += 1
        await self._stopped()

    async def _stopped(self) -> Told:
        """Stop it; how it rests."""
        await self._ready()
        await self._language.send_stop()
        timing, clock = self._timing, self._clock
        until_s = clock.monotonic_s() + timing.stop_timeout_s
        before = await self._language.read()
        while True:
            await clock.sleep(timing.poll_s)
            now = await self._language.read()
            still = self._apart_deg(now.mechanical_deg, before.mechanical_deg) < MOVED_DEG
            if still and not now.moving:
                return now
            if clock.monotonic_s() > until_s:
                raise DeviceSilent(
                    f"it still turns {timing.stop_timeout_s:.0f} s after its stop, "
                    f"at {now.mechanical_deg:.1f}°",
                    device=self.name,
                    advice="switch it off: cables may be wound up",
                )
            before = now
            await self._language.send_stop()

    # -- inside ------------------------------------------------------------------------------------

    @staticmethod
    def _apart_deg(one_deg: float, other_deg: float) -> float:
        return abs(half_turn_deg(one_deg - other_deg))

    async def _turned(
        self, mechanical_deg: float, seen: Callable[[RotatorReading], None] | None
    ) -> RotatorReading:
        timing, clock, stops = self._timing, self._clock, self._stops
        near_deg = max(_NEAR_DEG, _STEPS * self.step_deg)
        before = await self.reading()
        if self._apart_deg(before.mechanical_deg, mechanical_deg) <= near_deg / 2.0 and not before.moving:
            return before
        self._require_unstopped(stops)
        links, self._sent = self.links, True
        try:
            await self._language.order(turn_deg(mechanical_deg))
        except DeviceRefused as refusal:
            await self._hold_to(refusal, before, stops)
            raise
        began_s = moved_s = clock.monotonic_s()
        rests_s: float | None = None
        latest, ever = before, False
        while True:
            await clock.sleep(timing.poll_s)
            now = await self.reading()
            self._require_unstopped(stops)
            if links != self.links:
                raise DeviceMissing(
                    "its connection was lost while it turned, and opened again: its count may be another",
                    device=self.name,
                    advice="look through the telescope before the next turn: a solve shows how it stands",
                )
            if seen is not None:
                await self._told(seen, now)
            at_s = clock.monotonic_s()
            if self._apart_deg(now.mechanical_deg, latest.mechanical_deg) >= MOVED_DEG:
                moved_s, ever, latest, rests_s = at_s, True, now, None
            off_deg = self._apart_deg(now.mechanical_deg, mechanical_deg)
            still = at_s - moved_s >= 2.0 * timing.poll_s
            rests = now.moving is False or (now.moving is None and still)
            if rests and still and off_deg <= near_deg:
                return now
            if rests:
                rests_s = at_s if rests_s is None else rests_s
                over = at_s - rests_s >= (timing.rest_s if ever else timing.start_s)
                if over:
                    # one that sets out late must not turn when nobody expects it any more
                    with suppress(DeviceError):
                        await self._language.send_stop()
                    raise self._elsewhere(before, now, mechanical_deg, ever)
            elif at_s - moved_s >= timing.stall_s:
                await self._stopped_late(f"says that it turns, and has stood at {now.mechanical_deg:.2f}°")
            if at_s - began_s >= timing.turn_timeout_s:
                await self._stopped_late(
                    f"hasn't reached {mechanical_deg:.2f}°, at {now.mechanical_deg:.2f}°,"
                )

    async def _hold_to(self, refusal: DeviceRefused, before: RotatorReading, stops: int) -> None:
        """Watch one that has refused: if it turns all the same it is stopped, and that is raised."""
        clock = self._clock
        until_s = clock.monotonic_s() + self._timing.refused_s
        seen = 0
        while not before.moving and clock.monotonic_s() < until_s:
            now = await self.reading()
            self._require_unstopped(stops)
            turned_deg = self._apart_deg(now.mechanical_deg, before.mechanical_deg)
            # one reading may be wrong
            seen = seen + 1 if now.moving or turned_deg >= MOVED_DEG else 0
            if seen >= _TELLING:
                rests = await self._stopped()
                raise RefusedButDone(
                    f"the turn: said refused ({refusal.what}), but it turned from "
                    f"{before.mechanical_deg:.1f}°; stopped at {rests.mechanical_deg:.1f}°",
                    device=self.name,
                    advice="see to its line and its driver before the next turn",
                ) from refusal
            await clock.sleep(self._timing.poll_s)

    async def _ended(self, trouble: DeviceError, stops: int) -> DeviceError:
        """Stop one that may be turning, over a new connection if need be; the error to raise."""
        clock = self._clock
        until_s = clock.monotonic_s() + self._timing.lost_s
        why = ""
        while stops == self._stops and self._wanted_open:
            try:
                rests = await self._stopped()
            except DeviceRefused as refusal:
                why = refusal.what
                break
            except DeviceError as again:
                why = again.what
                if clock.monotonic_s() >= until_s:
                    break
                await clock.sleep(_AGAIN_S)
            else:
                words = f"{trouble.what}; it was stopped at {rests.mechanical_deg:.1f}°"
                return type(trouble)(words, device=self.name, advice=trouble.advice)
        if not why:
            return trouble  # who stops or closes it sees to that
        return type(trouble)(
            f"{trouble.what}; it could not be stopped ({why}): it may be turning on",
            device=self.name,
            advice="look at it: cables may be wound up",
        )

    async def _told(self, seen: Callable[[RotatorReading], None], now: RotatorReading) -> None:
        try:
            seen(now)
        except BaseException:
            with suppress(DeviceError):
                await self._language.send_stop()
            raise

    def _elsewhere(
        self, before: RotatorReading, now: RotatorReading, wanted_deg: float, ever: bool
    ) -> TargetNotReached:
        if not ever:
            return TargetNotReached(
                f"it took the order to turn to {wanted_deg:.2f}° and says that it is done, and did not move: "
                f"it stands at {now.mechanical_deg:.2f}°",
                device=self.name,
                advice="look at it: power, clutch, a limit in its own driver",
                reason=NotReached.STUCK,
            )
        return TargetNotReached(
            f"it stopped at {now.mechanical_deg:.2f}°, and should have turned from "
            f"{before.mechanical_deg:.2f}° to {wanted_deg:.2f}°",
            device=self.name,
            advice="look at it before the next turn: is it blocked, has it a limit of its own, did somebody "
            "stop it?",
            reason=NotReached.REST,
        )

    async def _stopped_late(self, words: str) -> None:
        with suppress(DeviceError):
            await self._language.send_stop()
        raise TargetNotReached(
            f"it {words} for too long, and was stopped",
            device=self.name,
            advice="look at it before the next turn; allow more time if it is slow (turn_timeout_s)",
            reason=NotReached.TIME,
        )

    def _require_unstopped(self, stops: int) -> None:
        if stops != self._stops:
            raise Cancelled("the turn was stopped", device=self.name, advice="order it again when it is safe")

    async def _ready(self) -> None:
        """Open a connection again that was lost since `open`."""
        if self._language.usable:
            return
        if not self._wanted_open:
            raise DeviceMissing("not connected", device=self.name, advice="open the rotator first")
        async with self._opening:
            if not self._language.usable:
                await self._language.open()
                self.links += 1
