"""The clock: aware UTC, seconds that never run back, and waiting; the machine's, or a virtual time.

Everything that needs an instant calls `utc_now`; what lasts (exposures, pauses between frames, guide pulses,
settling) lasts `real_s` of the machine's seconds. Time limits for wires, solvers and clients are no part of
this: a faster sky makes no cable and no computer faster, so they stay the machine's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Protocol

from mountnav.errors import BadSettings

__all__ = [
    "Clock",
    "SystemClock",
    "VirtualTime",
    "in_virtual_time",
    "pause",
    "real_s",
    "seconds",
    "sky_s",
    "utc_now",
    "virtual_time",
]


class VirtualTime(Protocol):
    """Another time than the machine's, whose UTC and seconds are one."""

    def __call__(self) -> datetime:
        """Aware UTC now."""
        ...

    def monotonic(self) -> float:
        """Its seconds; they never run back."""
        ...

    @property
    def speed(self) -> float:
        """Its seconds in one of the machine's, > 0."""
        ...


class _Present:
    virtual: VirtualTime | None = None


def utc_now() -> datetime:
    """Now, as an aware UTC datetime."""
    virtual = _Present.virtual
    return datetime.now(UTC) if virtual is None else virtual()


def real_s(duration_s: float) -> float:
    """How many of the machine's seconds so many seconds last."""
    virtual = _Present.virtual
    return duration_s if virtual is None else duration_s / virtual.speed


def sky_s(machine_s: float) -> float:
    """How many seconds pass in so many of the machine's; the inverse of `real_s`."""
    virtual = _Present.virtual
    return machine_s if virtual is None else machine_s * virtual.speed


def virtual_time() -> VirtualTime | None:
    """The virtual time of this process; None, as everywhere under a real sky: it has none."""
    return _Present.virtual


@contextmanager
def in_virtual_time(virtual: VirtualTime) -> Iterator[None]:
    """Let the whole process live in another time; before anything else begins, and until all of it has ended.

    Raises
    ------
    BadSettings
        When it lives in one already, or the time would stand still.
    """
    if _Present.virtual is not None:
        raise BadSettings("this process has a virtual time already", advice="set it once, before all else")
    if not virtual.speed > 0.0:
        raise BadSettings(f"at a speed of {virtual.speed} nothing would ever end", advice="> 0")
    _Present.virtual = virtual
    try:
        yield
    finally:
        _Present.virtual = None


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
    import asyncio  # not at the top: solving a file on the command line does without it

    await asyncio.sleep(real_s(duration_s))


class SystemClock:
    """The clock of this process: the machine's, whose seconds are the event loop's, or its virtual time."""

    def utc(self) -> datetime:
        """Aware UTC now."""
        return utc_now()

    def monotonic_s(self) -> float:
        """Seconds of the event loop, or of the virtual time."""
        import asyncio

        virtual = virtual_time()
        return asyncio.get_running_loop().time() if virtual is None else virtual.monotonic()

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await pause(seconds)
