"""The two motors of a board: what takes several commands, said in their order, and ended in every case.

Only ``:J`` starts a motor, and before each one it is asked whether it is still wanted. A board spoils its
answers when two commands reach it in one write (an owner saw it on an HEQ5), so a stop goes out as two.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from drivers.generic.serial_language import OptionalQuestions
from drivers.skywatcher import codec
from drivers.skywatcher.axes import Gearing, true_timer_hz
from drivers.skywatcher.codec import Axis, Board, Features, MotorStatus, Nack
from drivers.wire.command import Command
from drivers.wire.link import Link
from mountnav.clock import pause, real_s, utc_now
from mountnav.errors import DeviceError, DeviceRefused, Refusal
from mountnav.tasks import waited_for

_BETWEEN_STOPS_S = 0.03
"""Pause between the stops of both motors: a board spoils its answers when two commands reach it in one
write. Chosen by hand, above the 17 ms in which real boards answer."""
_USUAL_RATIO = 16
"""Steps at once in the high speed range, of a board that doesn't say them [SKYWATCHER :g]."""
_GLANCE_S = 0.05
"""Pause between questions whether a motor still runs. Chosen by hand."""
_HALT_S = 8.0
"""A motor that runs on for so long after it was ordered to stop is reported as one that does not obey.
Chosen by hand: more than the longest ramp (`_HARD_AFTER_S`) and what a hard stop takes."""
_HARD_AFTER_S = 5.0
"""A motor that still runs so long after the order to slow down is stopped hard. Chosen by hand: by the
numbers of an HEQ5 Pro its ramp from full speed takes 1.6 s."""
_HARD_AFTER_STOPS = 8
"""From this repetition of a stop on it is a hard one. Chosen by hand; halved, a mount with a slow ramp is
stopped with a jolt."""
_FAST_FROM_DEG = 0.8
"""Gotos farther than this run in the high speed range. Chosen by hand; shorter ones are over before the
ramp is."""
_FAST_BRAKE, _SLOW_BRAKE = 3200, 200
"""Counts before its target at which a goto slows down, in the high and in the low speed range; a tenth of
the way at most. The numbers are those of INDI's driver [INDI eqmod]."""


@dataclass(frozen=True, slots=True)
class Count:
    """Where an axis was, and when.

    Attributes
    ----------
    utc : datetime
        In the middle between question and answer.
    span_s : float
        Between question and answer.
    """

    value: int
    utc: datetime
    span_s: float


class Motors:
    """Both motors behind a link.

    Parameters
    ----------
    fastest_deg_s : float
        A count that an axis can't have come to at this rate is doubted.

    Attributes
    ----------
    gears : dict of Axis to Gearing
        Known after `meet`.
    stops : int
        Stops that were sent.
    starts : int
        How often one was ordered to start.
    """

    def __init__(self, link: Link, fastest_deg_s: float) -> None:
        self.link = link
        self._fastest_deg_s = fastest_deg_s
        self.gears: dict[Axis, Gearing] = {}
        self.stops = self.starts = 0
        self.refining = OptionalQuestions(link, self._alive)
        self._last: dict[Axis, tuple[Count, bool]] = {}
        self._slowing: set[Axis] = set()
        """Those told to stop, and not seen at rest since: "running" they say down their whole ramp."""

    # -- questions -------------------------------------------------------------------------------

    async def meet(self) -> tuple[Board, Features | None]:
        """Ask who is there and what the gears are; changes nothing."""
        ask = self.link.ask
        self.refining.begin()
        board = await ask(codec.board())
        gears: dict[Axis, Gearing] = {}
        for axis in Axis:
            counts = await ask(codec.counts_per_turn(axis))
            timer_hz = true_timer_hz(board, await ask(codec.timer_hz(axis)))
            # only what runs fast when it is found is counted with it: gotos are the board's own
            ratio = await self.refining.known(codec.fast_ratio(axis))
            gears[axis] = Gearing(counts, timer_hz, ratio or _USUAL_RATIO)
        self.gears = gears
        self._last.clear()
        features = await self.refining.known(codec.features(Axis.HOUR_ANGLE))
        return board, None if isinstance(features, Nack) else features

    async def _alive(self) -> None:
        await self.link.ask(codec.board())

    async def status(self, axis: Axis) -> MotorStatus:
        """What a motor does."""
        told = await self.link.ask(codec.status(axis))
        if not told.running:
            self._slowing.discard(axis)
        return told

    async def at_rest(self) -> None:
        """Wait until both motors rest."""
        for axis in Axis:
            while (await self.status(axis)).running:  # the board doesn't say by itself
                await pause(_GLANCE_S)

    async def count(self, axis: Axis) -> Count:
        """Where an axis is."""
        before = utc_now()
        value = await self.link.ask(codec.position(axis))
        took = utc_now() - before
        return Count(value, before + took / 2, max(took.total_seconds(), 0.0))

    async def sharp_count(self, axis: Axis, looks: int = 3) -> Count:
        """Where an axis is: of some looks the shortest, whose instant is the surest."""
        return min([await self.count(axis) for _ in range(looks)], key=lambda count: count.span_s)

    def odd(self, axis: Axis, now: Count, *, running: bool) -> bool:
        """Whether an axis can't have come there since the last look: perhaps the other axis's answer."""
        last, self._last[axis] = self._last.get(axis), (now, running)
        if last is None:
            return False
        before, ran = last
        elapsed_s = (now.utc - before.utc).total_seconds() + now.span_s
        free_deg = 0.02 + (self._fastest_deg_s * elapsed_s if ran or running else 0.0)
        return abs(self.gears[axis].turn_deg(now.value - before.value)) > free_deg

    def forget(self) -> None:
        """An axis may be counted elsewhere now."""
        self._last.clear()

    # -- orders ----------------------------------------------------------------------------------

    async def order(self, command: Command[Nack | None]) -> None:
        """Send an order.

        Raises
        ------
        DeviceRefused
            If the board says no.
        """
        nack = await self.link.ask(command)
        if nack is not None:
            raise DeviceRefused(
                f"{command.meaning}: {nack.words}", device=self.link.device, reason=nack.reason
            )

    async def send_stop(self, again: int = 0) -> None:
        """Stop both past everything else; hard when the ramp doesn't end it."""
        self.stops += 1
        self._slowing.update(Axis)
        stop = codec.stop_hard if again >= _HARD_AFTER_STOPS else codec.slow_down
        await self.link.send_now(codec.urgent(stop(Axis.HOUR_ANGLE)))
        await asyncio.sleep(_BETWEEN_STOPS_S)
        await self.link.send_now(codec.urgent(stop(Axis.DECLINATION)))

    async def halt(self, axis: Axis, wanted: Callable[[], bool]) -> bool:
        """Stop one motor and wait until it rests; False when the order behind it is no longer wanted.

        Raises
        ------
        DeviceRefused
            If it goes on.
        """
        loop = asyncio.get_running_loop()
        if not (await self.status(axis)).running:
            return wanted()
        self._slowing.add(axis)
        await self.order(codec.slow_down(axis))
        began_s = loop.time()
        hard = False
        while (await self.status(axis)).running:
            past_s = loop.time() - began_s
            if past_s > _HALT_S:
                raise DeviceRefused(
                    f"motor {int(axis)} was told to stop and still runs",
                    device=self.link.device,
                    advice="cut its power",
                    reason=Refusal.BUSY,
                )
            if past_s > _HARD_AFTER_S and not hard:
                hard = True
                await self.order(codec.stop_hard(axis))
            await pause(_GLANCE_S)
        return wanted()

    async def goto(self, axis: Axis, count: int, wanted: Callable[[], bool]) -> bool:
        """Send a resting motor to a count; False when there is no way to go, or it is no longer wanted.

        Raises
        ------
        DeviceRefused
            If the board says no.
        """
        way = count - (await self.count(axis)).value
        far = abs(way)
        if far == 0:
            return False
        fast = self.gears[axis].turn_deg(far) > _FAST_FROM_DEG
        # a goto runs by ramps of the board's own, whatever the step period
        await self.order(codec.motion(axis, goto=True, fast=fast, backward=way < 0))
        await self.order(codec.goto_by(axis, far))
        await self.order(codec.brake_by(axis, min(_FAST_BRAKE if fast else _SLOW_BRAKE, far // 10)))
        return await self._start(axis, wanted)

    async def run(self, axis: Axis, rate_deg_s: float, wanted: Callable[[], bool]) -> bool:
        """Let a motor run on at a low rate (signed: forward counts); False when no longer wanted.

        One that runs so already, that way round, only changes its rate; not on its ramp down, at whose end it
        would rest.
        """
        status = await self.status(axis)
        slow = not status.goto and not status.fast and axis not in self._slowing
        if status.running and not (slow and status.backward is (rate_deg_s < 0)):
            if not await self.halt(axis, wanted):
                return False
            status = await self.status(axis)
        if status.running:
            await self.set_rate(axis, abs(rate_deg_s))
            return wanted()
        await self.order(codec.motion(axis, goto=False, fast=False, backward=rate_deg_s < 0))
        await self.set_rate(axis, abs(rate_deg_s))
        return await self._start(axis, wanted)

    async def set_rate(self, axis: Axis, rate_deg_s: float) -> None:
        """Set the rate (> 0) of a motor that runs slowly, or will."""
        await self.order(codec.period(axis, self.gears[axis].period(rate_deg_s)))

    async def _start(self, axis: Axis, wanted: Callable[[], bool]) -> bool:
        if not wanted():
            return False
        self.starts += 1
        self._slowing.discard(axis)
        await self.order(codec.start(axis))
        return True

    async def for_a_time(
        self,
        axis: Axis,
        begin: Callable[[], Awaitable[bool]],
        duration_s: float,
        end: Command[Nack | None] | None = None,
    ) -> bool:
        """Begin something, wait, and end it: in every case, also when the caller is cancelled or it fails.

        `duration_s` counts from the middle of the exchange that begins it; without `end` the motor is halted.
        False when it was not begun.

        When the end is not answered the motor is stopped past everything: better at rest than running on at a
        rate that nobody knows of.
        """
        loop = asyncio.get_running_loop()
        asked_s = loop.time()
        try:
            if not await begin():
                return False
            # the end takes an exchange as well: what is left is counted from one middle to the other
            await asyncio.sleep(max(real_s(duration_s) - (loop.time() - asked_s), 0.0))
        finally:
            await _to_its_end(self._end(end, axis))
        return True

    async def _end(self, end: Command[Nack | None] | None, axis: Axis) -> None:
        if end is None:
            self._slowing.add(axis)
        try:
            await self.order(end or codec.slow_down(axis))
        except DeviceError:
            self._slowing.add(axis)
            with contextlib.suppress(DeviceError):
                await self.link.send_now(codec.urgent(codec.slow_down(axis)))
            raise

    async def energize(self) -> None:
        """Switch both motors' current on; nothing moves."""
        for axis in Axis:
            await self.order(codec.energize(axis))
            if not (await self.status(axis)).initialized:
                raise DeviceRefused(
                    f"motor {int(axis)} was energized and says it is not", device=self.link.device
                )


async def _to_its_end(work: Coroutine[Any, Any, None]) -> None:
    """Wait for some work that a cancelled caller must not leave half done."""
    task = waited_for(work)
    try:
        await asyncio.shield(task)
    except asyncio.CancelledError:
        await task
        raise
