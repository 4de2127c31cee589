"""What has come over a line and nobody has read yet, and why the line was lost: for every kind of line."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing

_CLOSED = "closed"
_MOST_UNREAD_BYTES = 1 << 16
"""What may wait for its reader: six seconds of the fastest serial line. Doubled, as much more memory."""


class Incoming:
    """The reading half of a line. Used from the event loop's thread alone.

    Parameters
    ----------
    address : str
        Of the line, for messages.
    advice : callable
        What a user can do when it is lost.
    log : WireLog
        Where the line's opening and loss are noted.
    """

    def __init__(self, address: str, advice: Callable[[], str], log: WireLog) -> None:
        self._address = address
        self._advice = advice
        self._log = log
        self._came = bytearray()
        self._news = asyncio.Event()
        self._gone = asyncio.Event()
        self._open = False
        self._lost: str | None = None

    @property
    def usable(self) -> bool:
        """Whether the line is open and not lost."""
        return self._open and self._lost is None

    def opened(self) -> None:
        """Begin anew: what came over an earlier opening is forgotten."""
        self._open, self._lost = True, None
        self._came.clear()
        self._news.clear()
        self._gone.clear()
        self._log.note("event", meaning=f"opened {self._address}")

    def closed(self) -> None:
        """End it: whoever still waits for an answer must not read that of the next opening."""
        if self._open:
            self._open = False
            self._lost = self._lost or _CLOSED
            self._news.set()

    def arrived(self, data: bytes) -> None:
        """Keep what has come."""
        self._came += data
        # nobody may be reading: of a line that is never quiet the latest is kept
        del self._came[:-_MOST_UNREAD_BYTES]
        self._news.set()

    def lose(self, why: str) -> None:
        """Count the line as lost; only the first reason counts."""
        if self._open and self._lost is None:
            self._lost = why
            self._log.note("event", meaning=f"lost {self._address}: {why}")
        self._news.set()
        self._gone.set()

    async def lost(self) -> str:
        """Wait until the open line is lost, and tell why."""
        await self._gone.wait()
        return self._lost or _CLOSED

    async def read(self, timeout_s: float) -> bytes:
        """Return what has come, waiting up to `timeout_s` for the first byte; empty when none came.

        Raises
        ------
        DeviceMissing
            If the line is not open or was lost, and nothing is left to read.
        """
        if not self._came:
            self.require()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(timeout_s, 0.0)):
                    await self._news.wait()
        came = self.drain()
        if not came and self._lost is not None:
            raise self.missing()
        return came

    def drain(self) -> bytes:
        """Throw away what has come so far, and return it."""
        came = bytes(self._came)
        self._came.clear()
        if self._lost is None:
            self._news.clear()
        return came

    def require(self) -> None:
        """Raise `DeviceMissing` unless the line is open and not lost."""
        if not self.usable:
            raise self.missing()

    def missing(self) -> DeviceMissing:
        """The error that tells of a line that is not open, or was lost."""
        if self._lost in (None, _CLOSED):
            return DeviceMissing("the line is not open", device=self._address, advice="connect first")
        return DeviceMissing(f"the line was lost: {self._lost}", device=self._address, advice=self._advice())
