"""The present, seconds that never run back, and waiting: one source, so that a night runs at any speed."""

from __future__ import annotations

import asyncio
import time
from datetime import datetime
from typing import Protocol

from mountnav.sky.present import real_s, utc_now, virtual_time


class Clock(Protocol):
    """What everything that decides or waits takes its time from."""

    def utc(self) -> datetime:
        """Aware UTC now."""
        ...

    def monotonic_s(self) -> float:
        """Seconds that never run back and never jump."""
        ...

    async def sleep(self, seconds: float) -> None:
        """Let so many of this clock's seconds pass."""
        ...


def seconds() -> float:
    """Seconds that never run back, of the same time as `utc_now`."""
    virtual = virtual_time()
    return time.monotonic() if virtual is None else virtual.monotonic()


async def pause(duration_s: float) -> None:
    """Let so many seconds pass: the machine's, or those of the process's virtual time."""
    await asyncio.sleep(real_s(duration_s))


class SystemClock:
    """The clock of this process: the machine's, whose seconds are the event loop's, or its virtual time."""

    def utc(self) -> datetime:
        """Aware UTC now."""
        return utc_now()

    def monotonic_s(self) -> float:
        """Seconds of the event loop, or of the virtual time."""
        virtual = virtual_time()
        return asyncio.get_running_loop().time() if virtual is None else virtual.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await pause(seconds)
