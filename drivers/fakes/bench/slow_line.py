"""A fake behind a serial line of some speed: each byte takes its time, both ways."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.fakes.bench.thread import Fake

_BITS_PER_BYTE = 10.0
"""Start bit, eight data bits, stop bit."""


class SlowLine:
    """Hands bytes on when they would have come over.

    Parameters
    ----------
    fake : Fake
    baud : int
        Bits per second.
    monotonic : callable
        Seconds.
    """

    def __init__(self, fake: Fake, baud: int, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._fake = fake
        self._byte_s = _BITS_PER_BYTE / baud
        self._monotonic = monotonic
        self._to_fake: deque[tuple[float, int]] = deque()
        self._from_fake: deque[tuple[float, int]] = deque()

    def feed(self, data: bytes) -> bytes:
        """Take bytes at one end and return those that have arrived there."""
        now_s = self._monotonic()
        self._send(self._to_fake, data, now_s)
        self._send(self._from_fake, self._fake.feed(_arrived(self._to_fake, now_s)), now_s)
        return _arrived(self._from_fake, now_s)

    def due_in_s(self) -> float | None:
        """Seconds until the next byte arrives somewhere, or the fake has something to say."""
        waits_s = [way[0][0] - self._monotonic() for way in (self._to_fake, self._from_fake) if way]
        due_in_s = self._fake.due_in_s()
        if due_in_s is not None:
            waits_s.append(due_in_s)
        return max(0.0, min(waits_s)) if waits_s else None

    def _send(self, way: deque[tuple[float, int]], data: bytes, now_s: float) -> None:
        free_s = max(now_s, way[-1][0]) if way else now_s
        way.extend((free_s + number * self._byte_s, byte) for number, byte in enumerate(data, 1))


def _arrived(way: deque[tuple[float, int]], now_s: float) -> bytes:
    came = bytearray()
    while way and way[0][0] <= now_s:
        came.append(way.popleft()[1])
    return bytes(came)
