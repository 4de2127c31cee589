"""A line in memory to a fake mount in the same process: real drivers in virtual time, without a wire.

Only tests and benchmarks use it. It is here because both do, and because it is one more wire for a fake.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable

from drivers.fakes.wire_fake import WireFake
from drivers.wire.wire_log import WireLog
from mountnav.errors import DeviceMissing
from mountnav.simulation.virtual_time import VirtualClock

_OPENING_S = 0.01
"""How long opening takes, virtual s: a port takes its time, and a driver that retries without a pause would
otherwise stop the virtual clock. Doubled or halved, nothing shows."""
_JUST_AFTER_S = 1e-6
"""Delay (virtual s) after which a fake is asked for what is due: rounding must not make it too early.
Chosen by hand; at 0 the loop may spin at one instant."""


class MemoryLine:
    """A `drivers.wire.line.ByteLine` to a fake in the same process.

    Parameters
    ----------
    latency_s : float
        Transfer time each way.

    Attributes
    ----------
    now_writes : list of (float, bytes)
        What was sent past the queue, and when: stops.
    opened : int
        How often it was opened.
    """

    def __init__(self, fake: WireFake, clock: VirtualClock, log: WireLog, latency_s: float = 0.002) -> None:
        self.fake = fake
        self.now_writes: list[tuple[float, bytes]] = []
        self.opened = 0
        self._clock = clock
        self._log = log
        self._latency_s = latency_s
        self._generation = 0
        self._under_way: deque[tuple[int, Callable[[bytes], None], bytes]] = deque()
        self._came = bytearray()
        self._news = asyncio.Event()
        self._gone = asyncio.Event()
        self._open = False
        self._lost: str | None = None
        self._away_until_s = self._swallow_until_s = 0.0
        self._alarm: asyncio.TimerHandle | None = None

    @property
    def address(self) -> str:
        """For messages."""
        return "memory"

    @property
    def usable(self) -> bool:
        """Whether it is open and was not lost."""
        return self._open and self._lost is None

    async def open(self) -> None:
        """Open it. Raises `DeviceMissing` while the port is away."""
        await self.close()
        await asyncio.sleep(_OPENING_S)
        if self._clock.now_s < self._away_until_s:
            raise DeviceMissing("there is no such port", device=self.address)
        self._generation += 1
        self.opened += 1
        self._open, self._lost = True, None
        self._came.clear()
        self._news.clear()
        self._gone.clear()
        self.fake.port_opened()
        self._arm()

    async def close(self) -> None:
        """Close it."""
        self._open = False
        self._generation += 1
        if self._alarm is not None:
            self._alarm.cancel()

    async def write(self, data: bytes) -> None:
        """Send. Raises `DeviceMissing` when it was lost."""
        self._send(data)
        await asyncio.sleep(0)

    async def write_now(self, data: bytes) -> None:
        """Send past everything else. Raises `DeviceMissing` when it was lost."""
        self._send(data)
        self.now_writes.append((self._clock.now_s, data))
        await asyncio.sleep(0)

    def _send(self, data: bytes) -> None:
        self._usable_or_raise()
        self._log.note("driver->mount", data)
        self._carry(self._at_fake, data)

    def _usable_or_raise(self) -> None:
        if not self.usable:
            raise DeviceMissing(f"the line was lost: {self._lost}", device=self.address)

    async def read(self, timeout_s: float) -> bytes:
        """Return what came, or comes within the time. Raises `DeviceMissing` when it was lost."""
        if not self._came:
            self._usable_or_raise()
            if timeout_s <= 0.0:
                await asyncio.sleep(0)
            else:
                try:
                    async with asyncio.timeout(timeout_s):
                        await self._news.wait()
                except TimeoutError:
                    pass
        came = self.drain()
        if not came and self._lost is not None:
            self._usable_or_raise()
        return came

    def drain(self) -> bytes:
        """Drop what has come so far, and return it."""
        came = bytes(self._came)
        self._came.clear()
        if self._lost is None:
            self._news.clear()
        return came

    async def lost(self) -> str:
        """Wait until it is lost, and return why."""
        await self._gone.wait()
        return self._lost or "closed"

    def unplug(self, for_s: float, why: str = "unplugged") -> None:
        """Lose the line now; it can't be opened again for `for_s`."""
        self._away_until_s = self._clock.now_s + for_s
        self._lose(why)

    def silence(self, for_s: float) -> None:
        """Let nothing arrive at the mount for `for_s`; the line stays open."""
        self._swallow_until_s = self._clock.now_s + for_s

    # -- the cable -----------------------------------------------------------------------------------

    def _carry(self, to: Callable[[bytes], None], data: bytes) -> None:
        if data:
            self._under_way.append((self._generation, to, data))
            asyncio.get_running_loop().call_later(self._latency_s, self._arrive)

    def _arrive(self) -> None:
        # one at a time from the front: bytes never overtake each other
        generation, to, data = self._under_way.popleft()
        if generation == self._generation and self.usable:
            to(data)

    def _at_fake(self, data: bytes) -> None:
        swallowed = self._clock.now_s < self._swallow_until_s
        said = self.fake.feed(b"" if swallowed else data)
        if not swallowed:
            self._carry(self._at_driver, said)
        for order in self.fake.line_orders():
            until_s = self._clock.now_s + (order.for_s or 0.0)
            if order.kind == "black-hole":
                self._swallow_until_s = until_s
                continue
            if order.kind == "vanish":
                self._away_until_s = until_s
            self._lose(order.kind)
        self._arm()

    def _at_driver(self, data: bytes) -> None:
        self._log.note("mount->driver", data)
        self._came += data
        self._news.set()

    def _lose(self, why: str) -> None:
        self._lost = self._lost or why
        self._news.set()
        self._gone.set()

    def _arm(self) -> None:
        if self._alarm is not None:
            self._alarm.cancel()
        due_in_s = self.fake.due_in_s()
        if due_in_s is not None and self._open:
            loop = asyncio.get_running_loop()
            self._alarm = loop.call_later(due_in_s + _JUST_AFTER_S, self._at_fake, b"")
