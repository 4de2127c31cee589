"""Strangers' bytes are read in short parts, one in each turn of the loop, and each client has its allowance.

A loop has one thread: while it reads what one client sends, nobody's stop is heard. So what is read at once
is short, and many clients take turns: the loop's longest turn doesn't grow with their number.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from typing import TypeVar

Part = TypeVar("Part")

_BURST_BYTES = 1 << 20
"""What a client may send at once; 5,000 messages that may wait are half of it."""
STOPS_AT_ONCE = 8
"""Stops of one client that may be under way; the next one is read when one of them is over. A program in
panic sends two or three; without a bound a client could begin 40,000 in a second."""
_STEADY_BYTES_S = 131_072
"""What it may send for ever; a planetarium sends some hundreds. Doubled, 64 clients take twice the time."""


class Turns:
    """Who reads next, among the clients of a port."""

    def __init__(self) -> None:
        self._mine = asyncio.Lock()

    async def mine(self) -> None:
        """Wait for a turn of the loop that no other client of the port has."""
        async with self._mine:
            await asyncio.sleep(0)

    async def each(self, parts: Iterator[Part]) -> AsyncIterator[Part]:
        """Give out parts, each in a turn of the loop in which no other client's part is made."""
        while True:
            async with self._mine:
                part = next(parts, None)
                await asyncio.sleep(0)
            if part is None:
                return
            yield part


class Allowance:
    """What one client may send: beyond it nothing more is read for a while, and only its own line waits."""

    def __init__(self) -> None:
        self._left = float(_BURST_BYTES)
        self._then_s = asyncio.get_running_loop().time()

    async def spend(self, count: int) -> None:
        """Take so many bytes off, and wait as long as it is overdrawn; others have a turn in any case."""
        now_s = asyncio.get_running_loop().time()
        self._left = min(_BURST_BYTES, self._left + (now_s - self._then_s) * _STEADY_BYTES_S) - count
        self._then_s = now_s
        await asyncio.sleep(max(0.0, -self._left / _STEADY_BYTES_S))


__all__ = ["STOPS_AT_ONCE", "Allowance", "Turns"]
