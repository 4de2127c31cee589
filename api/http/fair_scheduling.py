"""Fair scheduling of HTTP: one piece is read, or one request begun, in each turn of the loop, stops first.

The loop has one thread, and a stop needs some fifty turns to its end (the dispatcher, the journal, the
mount's answers). Reading costs much more than sending: 64 kB of tiny chunks or headers take the parser 0.1
s and more. A hundred clients at the same time would each have their part of every turn, and a stop took
more than 2 s. `ReadingTurns` has one piece of one connection read in each turn; `FairRequests` begins one
request in each, and none while a stop that its caller may order is under way.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.rate_limits import is_stop

__all__ = ["PIECE_BYTES", "FairRequests", "Reading", "ReadingTurns", "RequestTurns"]


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


_HELD_S = 2.0
"""Seconds for which a stop holds others back; by then it is answered (`STOP_KNOWN_S`). Doubled, one who sends
stops without end halves what others get."""


class RequestTurns:
    """Whose request begins next, of all ports that share this. Used from the loop's thread alone."""

    def __init__(self) -> None:
        self._turn = asyncio.Lock()
        self._stops = 0
        self._calm = asyncio.Event()
        self._calm.set()

    async def mine(self) -> None:
        """Wait for a turn of the loop in which no other request begins, and for stops that are under way."""
        async with self._turn:
            await self._hold_back()
            # the next one begins in another turn of the loop
            await asyncio.sleep(0)

    @contextmanager
    def stop(self) -> Iterator[None]:
        """A stop is under way."""
        self._stops += 1
        self._calm.clear()
        try:
            yield
        finally:
            self._stops -= 1
            if not self._stops:
                self._calm.set()

    async def _hold_back(self) -> None:
        if self._calm.is_set():
            return
        try:
            async with asyncio.timeout(_HELD_S):
                await self._calm.wait()
        except TimeoutError:
            # its mount takes its time; the answer has gone out by now
            pass


class FairRequests:
    """Let requests begin one after another, and stops before them. Plain ASGI.

    Parameters
    ----------
    may_stop : callable
        Whether who sends a stop may do so: one of a stranger waits with all others.
    turns : RequestTurns, optional
        Shared by the ports of one loop.
    arrived : callable, optional
        Told of each request but stops as it comes, before it waits for its turn.
    """

    def __init__(
        self,
        app: ASGIApp,
        may_stop: Callable[[Scope], bool],
        turns: RequestTurns | None = None,
        arrived: Callable[[Scope], None] = lambda scope: None,
    ) -> None:
        self._app = app
        self._may_stop = may_stop
        self._turns = turns or RequestTurns()
        self._arrived = arrived

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when it is its turn."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif is_stop(scope["method"], scope["path"]) and self._may_stop(scope):
            with self._turns.stop():
                await self._app(scope, receive, send)
        else:
            self._arrived(scope)
            await self._turns.mine()
            await self._app(scope, receive, send)
