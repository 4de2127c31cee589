"""Requests begin one in each turn of the loop, and none while a stop is under way.

The loop has one thread. A hundred clients that ask at the same time would each get a part of the same turn; a
stop needs some fifty turns to its end (the desk, the journal, the mount's answers), and took more than 2 s.
Here a turn begins one request only, and a stop that its caller may order lets none begin until it is over.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from starlette.types import ASGIApp, Receive, Scope, Send

from api.access.limits_of_rate import is_stop

_HELD_S = 2.0
"""Seconds for which a stop holds others back; by then it is answered (`STOP_KNOWN_S`). Doubled, one who sends
stops without end halves what others get."""


class FairRequests:
    """Let requests begin one after another, and stops before them. Plain ASGI.

    Parameters
    ----------
    app : ASGIApp
    may_stop : callable
        Whether who sends a stop may do so: one of a stranger waits with all others.
    """

    def __init__(self, app: ASGIApp, may_stop: Callable[[Scope], bool]) -> None:
        self._app = app
        self._may_stop = may_stop
        self._turn = asyncio.Lock()
        self._stops = 0
        self._calm = asyncio.Event()
        self._calm.set()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request on when it is its turn."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif is_stop(scope["method"], scope["path"]) and self._may_stop(scope):
            await self._stop(scope, receive, send)
        else:
            async with self._turn:
                await self._hold_back()
                # the next one begins in another turn of the loop
                await asyncio.sleep(0)
            await self._app(scope, receive, send)

    async def _stop(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._stops += 1
        self._calm.clear()
        try:
            await self._app(scope, receive, send)
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


__all__ = ["FairRequests"]
