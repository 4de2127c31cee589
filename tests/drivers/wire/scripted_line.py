"""A line that answers by a script, for tests of what stands on a line."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Callable, Coroutine, Iterable

from drivers.wire.command import Command, Read
from mountnav.simulation.virtual_time import VirtualClock, run_virtually


def virtually(test: Callable[[], Coroutine[object, object, None]]) -> Callable[[], None]:
    """A test whose seconds pass at once: no busy machine makes an answer late."""

    @functools.wraps(test)
    def run() -> None:
        run_virtually(test(), VirtualClock())

    return run


class ScriptedLine:
    """Answers each write with the next entry of its script: pairs of a delay in seconds and bytes."""

    address, usable = "a line", True

    def __init__(self, *answers: Iterable[tuple[float, bytes]]) -> None:
        self.script = list(answers)
        self.sent: list[bytes] = []
        self.opened = 0
        self._came = bytearray()
        self._news = asyncio.Event()
        self._gone = asyncio.Event()

    async def open(self) -> None:
        self.opened += 1

    async def close(self) -> None:
        """Nothing to release."""

    async def write(self, data: bytes) -> None:
        self.sent.append(data)
        loop = asyncio.get_running_loop()
        for delay_s, answer in self.script.pop(0) if self.script else ():
            loop.call_later(delay_s, self._arrive, answer)

    write_now = write

    def _arrive(self, data: bytes) -> None:
        self._came += data
        self._news.set()

    async def read(self, timeout_s: float) -> bytes:
        if not self._came:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(timeout_s):
                    await self._news.wait()
        return self.drain()

    def drain(self) -> bytes:
        came = bytes(self._came)
        self._came.clear()
        self._news.clear()
        return came

    async def lost(self) -> str:
        await self._gone.wait()
        return "gone"


def until_hash(heard: bytes, final: bool) -> Read[bytes] | None:
    """A reader of an answer that ends with a hash."""
    end = heard.find(b"#")
    return None if end < 0 else Read(heard[:end], end + 1)


def nothing(heard: bytes, final: bool) -> Read[None]:
    """The reader of a command without an answer."""
    return Read(None, 0)


PLACE = Command(b":GR#", "the place", until_hash)
SLEW = Command(b":MS#", "the slew", until_hash, repeatable=False)
STOP = Command(b":Q#", "the stop", nothing, answered=False)
