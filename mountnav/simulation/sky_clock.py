"""A clock that runs faster (or stands still): sky and wire seconds from one source, for fakes and tests."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from datetime import datetime, timedelta

from mountnav.clock import utc_now
from mountnav.errors import BadSettings


class FastClock:
    """Time at `speed` times its pace; the instance itself is a ``clock=``, its `monotonic` a ``monotonic=``.

    Parameters
    ----------
    speed : float
        Seconds of this clock in a second, >= 0; at 0 it stands until it is put `on`.
    start : datetime, optional
        Aware UTC at which it begins; now if None.
    ticks : callable
        The seconds that it is made of.

    Raises
    ------
    BadSettings
        When `speed` is no pace or `start` is naive.

    Notes
    -----
    Thread-safe, never runs back. Its two faces never part: a second of `monotonic` is a second of UTC.
    """

    def __init__(
        self,
        speed: float = 1.0,
        start: datetime | None = None,
        *,
        ticks: Callable[[], float] = time.monotonic,
    ) -> None:
        if start is not None and start.utcoffset() is None:
            raise BadSettings(f"the start {start.isoformat()} doesn't say its time zone", advice="give UTC")
        self._ticks = ticks
        self._lock = threading.Lock()
        self._start = utc_now() if start is None else start
        self._speed = _pace(speed)
        self._since_ticks, self._since_s = ticks(), 0.0

    def __call__(self) -> datetime:
        """Aware UTC now."""
        return self._start + timedelta(seconds=self.monotonic())

    def monotonic(self) -> float:
        """Seconds since it began."""
        with self._lock:
            return self._now_s()

    @property
    def speed(self) -> float:
        """Seconds of this clock in a second; may be changed while it runs, without a jump."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        with self._lock:
            self._since_s, self._since_ticks = self._now_s(), self._ticks()
            self._speed = _pace(speed)

    def on(self, seconds: float) -> datetime:
        """Put it on by some seconds (>= 0), and tell its new time."""
        if not (math.isfinite(seconds) and seconds >= 0.0):
            raise BadSettings(f"a clock can't be advanced by {seconds} s", advice=">= 0")
        with self._lock:
            self._since_s += seconds
        return self()

    def wait_s(self, seconds: float) -> float:
        """How many real seconds these seconds of the clock take; infinite when it stands."""
        return seconds / self._speed if self._speed > 0.0 else math.inf

    def _now_s(self) -> float:
        return self._since_s + (self._ticks() - self._since_ticks) * self._speed


def _pace(speed: float) -> float:
    if not (math.isfinite(speed) and speed >= 0.0):
        raise BadSettings(f"speed = {speed} is not a valid speed", advice=">= 0")
    return speed
