"""What comes over HTTP is read in turns: a piece of one connection in each turn of the loop, stops first.

Reading costs much more than sending: 64 kB of tiny chunks or headers take the parser 0.1 s and more. A
hundred clients who send that at once would each have their part of every turn of the loop, and a stop needs
some fifty turns to its end.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Protocol

PIECE_BYTES = 2048
"""Read in one turn: some 5 ms of the smallest chunks. Doubled, a stop among a hundred hostile clients takes
longer by a quarter of a second; halved, large uploads in chunks are slower."""


class Reading(Protocol):
    """A connection of which something waits to be read."""

    loop: asyncio.AbstractEventLoop

    @property
    def is_urgent(self) -> bool:
        """Whether what waits is a stop."""
        ...

    def read_piece(self) -> bool:
        """Read up to `PIECE_BYTES` of what waits; whether more waits."""
        ...


class ReadingTurns:
    """Whose turn it is. Used from the loop's thread alone."""

    def __init__(self) -> None:
        self._stops: deque[Reading] = deque()
        self._others: deque[Reading] = deque()
        self._turning = False

    def ask(self, one: Reading) -> None:
        """Something came for a connection of which nothing waited: it is read now, or when it is its turn."""
        if self._turning:
            (self._stops if one.is_urgent else self._others).append(one)
            return
        self._turning = True
        self._read(one)
        one.loop.call_soon(self._next)

    def _next(self) -> None:
        ones = self._stops or self._others
        if not ones:
            self._turning = False
            return
        one = ones.popleft()
        one.loop.call_soon(self._next)
        self._read(one)

    def _read(self, one: Reading) -> None:
        if one.read_piece():
            (self._stops if one.is_urgent else self._others).append(one)


__all__ = ["PIECE_BYTES", "Reading", "ReadingTurns"]
