"""Guide pulses: timed by the motors where they can, by us at the slowest key where they can't."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from drivers.generic.language import Sent, Wanted
from drivers.nexstar import codec
from drivers.nexstar.greeting import Ask
from drivers.nexstar.passthrough import LONGEST_PULSE_S, Axis
from drivers.wire.command import Command
from mountnav.clock import pause

_SLOWEST_KEY = 1
_LOOK_S = 0.05
_LONGER_S = 1.0


class Guiding:
    """One pulse.

    Parameters
    ----------
    ask : callable
        Asks a question, in step.
    once : callable
        Sends an order a single time.
    send_now : callable
        Sends past everything else.
    percent : int
        Of the sidereal rate, for pulses of the motors.
    """

    def __init__(
        self,
        ask: Ask,
        once: Callable[[Command[None], Wanted], Awaitable[Sent]],
        send_now: Callable[..., Awaitable[Any]],
        percent: int,
    ) -> None:
        self._ask, self._once, self._send_now = ask, once, send_now
        self._percent = percent

    async def by_motor(self, axis: Axis, sign: int, duration_s: float, wanted: Wanted) -> Sent:
        """Order pulses of at most 2.55 s one after the other, and wait for each [NexStar P 0x26, 0x27]."""
        left_s, sent = duration_s, Sent(wire=False)
        while left_s >= 0.005:
            part_s = min(left_s, LONGEST_PULSE_S)
            now = await self._once(codec.guide(axis, sign * self._percent, part_s), wanted)
            if not now.wire:
                return sent
            sent = now
            await pause(part_s)
            await self._over(axis)
            if sent.lost is not None:
                # not known whether it was taken up: the rest of a long pulse would make it worse
                return sent
            left_s -= part_s
        return sent

    async def _over(self, axis: Axis) -> None:
        loop = asyncio.get_running_loop()
        until = loop.time() + _LONGER_S
        while await self._ask(codec.guiding(axis)):
            if loop.time() > until:
                await self._send_now(codec.press(axis, 0))
                return
            await asyncio.sleep(_LOOK_S)

    async def by_key(self, axis: Axis, sign: int, duration_s: float, wanted: Wanted) -> Sent:
        """Press the slowest key for so long, and let go of it in every case [NexStar P 0x24, 0x25].

        Both go past everything else, or the moment would last as long as somebody else's question.
        """
        if not wanted():
            return Sent(wire=False)
        try:
            await self._send_now(codec.press(axis, sign * _SLOWEST_KEY))
            await pause(duration_s)
        finally:
            await self._send_now(codec.press(axis, 0))
        # and again, with an answer: it has let go
        await self._ask(codec.move(axis, 0))
        return Sent()
