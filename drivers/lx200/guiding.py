"""Guide pulses: those that the mount times, and those that we time ourselves and end in every case."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable

from drivers.generic.language import Sent, Wanted
from drivers.lx200.dialect import Dialect, Nudge, Order
from drivers.wire.command import Command
from mountnav.clock import pause
from mountnav.devices import Direction
from mountnav.errors import DeviceError
from mountnav.sky.present import real_s

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
