"""A fake whose time runs faster: the bench sleeps by the world's clock, the fake reckons by its own."""

from __future__ import annotations

from collections.abc import Callable

from drivers.fakes.bench.thread import Fake, Troubled
from drivers.fakes.faults import LineOrder
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.present import real_s


class InFastTime:
    """Tells a bench in real seconds what a fake says in those of its clock.

    Parameters
    ----------
    fake : Fake
        Made with this clock's `monotonic`.
    clock : FastClock, optional
        The present of the whole process if None.
    """

    def __init__(self, fake: Fake, clock: FastClock | None = None) -> None:
        self._fake = fake
        self._wait_s = real_s if clock is None else clock.wait_s

    def feed(self, data: bytes) -> bytes:
        """As of the fake."""
        return self._fake.feed(data)

    def due_in_s(self) -> float | None:
        """Real seconds."""
        due_in_s = self._fake.due_in_s()
        return None if due_in_s is None else self._wait_s(due_in_s)

    def line_orders(self) -> list[LineOrder]:
        """As of the fake; what happens to the line takes real seconds."""
        return self._fake.line_orders() if isinstance(self._fake, Troubled) else []

    def wake_by(self, wake: Callable[[], None] | None) -> None:
        """As of the fake."""
        if isinstance(self._fake, Troubled):
            self._fake.wake_by(wake)
