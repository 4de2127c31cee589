"""The thread that keeps a fake on its wire, at a line speed, in real or in fast time."""

from __future__ import annotations

import os
import select
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from drivers.fakes.faults import LineOrder
from mountnav.clock import real_s
from mountnav.errors import DeviceError
from mountnav.simulation.sky_clock import FastClock

_BITS_PER_BYTE = 10.0
"""Start bit, eight data bits, stop bit (8N1, as all mounts here have it)."""


class SlowLine:
    """A fake behind a serial line of some speed: each byte takes its time, both ways.

    Parameters
    ----------
    baud : int
        Bits per second.
    monotonic : callable
        Gives seconds.
    """

    def __init__(self, fake: Fake, baud: int, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._fake = fake
        self._byte_s = _BITS_PER_BYTE / baud
        self._monotonic = monotonic
        self._to_fake: deque[tuple[float, int]] = deque()
        self._from_fake: deque[tuple[float, int]] = deque()

    def feed(self, data: bytes) -> bytes:
        """Take bytes at the driver's end and return those that have arrived there."""
        now_s = self._monotonic()
        self._send(self._to_fake, data, now_s)
        self._send(self._from_fake, self._fake.feed(_arrived(self._to_fake, now_s)), now_s)
        return _arrived(self._from_fake, now_s)

    def due_in_s(self) -> float | None:
        """Seconds until the next byte arrives at one of the ends, or the fake has something to send."""
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


_TRY_AGAIN_S = 0.2
"""s between two attempts to put a port back whose place another program has taken. Chosen by hand. Doubled, a
fake comes back up to 0.2 s later."""


class Fake(Protocol):
    """What a bench needs of a fake: bytes in, bytes out, and when it has something to send unasked."""

    def feed(self, data: bytes) -> bytes:
        """Take bytes (perhaps none) and return what is sent now."""
        ...

    def due_in_s(self) -> float | None:
        """Seconds until there is something to send without new bytes."""
        ...


@runtime_checkable
class Troubled(Protocol):
    """A fake whose faults also strike its line."""

    def line_orders(self) -> list[LineOrder]:
        """Take out what is to be done to the line."""
        ...

    def wake_by(self, wake: Callable[[], None] | None) -> None:
        """Set the function that wakes the thread that sleeps until `due_in_s`."""
        ...


@runtime_checkable
class Opened(Protocol):
    """A fake that has to know when its port is opened."""

    def port_opened(self) -> None:
        """Called each time a client opens the port."""
        ...


@dataclass(slots=True)
class _Errand:
    """A call that another thread wants to be made in the bench's thread."""

    do: Callable[[], None]
    done: threading.Event = field(default_factory=threading.Event)
    failure: BaseException | None = None

    def run(self) -> None:
        try:
            self.do()
        except BaseException as failure:
            self.failure = failure
        finally:
            self.done.set()


class Bench(ABC):
    """A fake on a wire, in a thread of its own; a context manager.

    Parameters
    ----------
    baud : int, optional
        Bytes take their time, as on a serial line of this speed; without it they come at once.

    Notes
    -----
    `vanish`, `come_back`, `hang_up`, `reset` and `black_hole` may be called from any thread and are done when
    they return. The fake's own line faults do the same.
    """

    def __init__(self, fake: Fake, *, baud: int | None = None) -> None:
        self.fake = fake
        self._spoken: Fake = fake if baud is None else SlowLine(fake, baud)
        self._thread: threading.Thread | None = None
        self._wake_read = self._wake_write = -1
        self._errands: list[_Errand] = []
        self._ending = False
        self._gone = True
        self._back_s: float | None = None
        self._swallow_until_s = 0.0

    @property
    @abstractmethod
    def address(self) -> str:
        """The address for a driver."""

    # -- start and end ---------------------------------------------------------------------------

    def start(self) -> Self:
        """Open the wire and start answering; starting twice is fine.

        Raises
        ------
        DeviceMissing, OSError
            If the wire can't be opened.
        """
        if self._thread is not None:
            return self
        self._open()
        self._gone, self._ending = False, False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_read, False)
        if isinstance(self.fake, Troubled):
            self.fake.wake_by(self._wake)
        self._thread = threading.Thread(target=self._run, name="bench", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Stop answering and take the wire away; stopping twice is fine."""
        if self._thread is None:
            return
        if isinstance(self.fake, Troubled):
            self.fake.wake_by(None)
        self._ending = True
        self._wake()
        self._thread.join()
        self._thread = None
        os.close(self._wake_read)
        os.close(self._wake_write)
        if not self._gone:
            self._close()
            self._gone = True

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    # -- what can happen to a wire ---------------------------------------------------------------

    def vanish(self, for_s: float | None = None) -> None:
        """Take the port away, as when a plug is pulled.

        Parameters
        ----------
        for_s : float, optional
            It comes back by itself after this time; otherwise with `come_back`.
        """
        self._in_thread(lambda: self._vanish(for_s))

    def come_back(self) -> None:
        """Put the port back: a serial one under another name, a network one under the same."""
        self._in_thread(self._return)

    def hang_up(self) -> None:
        """Close the connection to the present client; a new one may connect."""
        self._in_thread(self._hang_up)

    def reset(self) -> None:
        """Break the connection off hard."""
        self._in_thread(self._reset)

    def black_hole(self, for_s: float) -> None:
        """For some time accept all bytes and answer nothing; the fake doesn't hear them either."""
        self._in_thread(lambda: self._swallow(for_s))

    def _vanish(self, for_s: float | None) -> None:
        self._back_s = None if for_s is None else time.monotonic() + for_s
        if not self._gone:
            self._gone = True
            self._close()

    def _return(self) -> None:
        self._back_s = None
        if self._gone:
            self._open()
            self._gone = False

    def _return_or_wait(self) -> None:
        try:
            self._return()
        except (DeviceError, OSError):
            # another program has taken its place meanwhile
            self._back_s = time.monotonic() + _TRY_AGAIN_S

    def _swallow(self, for_s: float | None) -> None:
        self._swallow_until_s = float("inf") if for_s is None else time.monotonic() + for_s

    def _happen(self, order: LineOrder) -> None:
        match order.kind:
            case "vanish":
                self._vanish(order.for_s)
            case "hang-up":
                self._hang_up()
            case "reset":
                self._reset()
            case "black-hole":
                self._swallow(order.for_s)

    # -- the thread ------------------------------------------------------------------------------

    def _in_thread(self, do: Callable[[], None]) -> None:
        if self._thread is None:
            return
        errand = _Errand(do)
        self._errands.append(errand)
        self._wake()
        errand.done.wait()
        if errand.failure is not None:
            raise errand.failure

    def _wake(self) -> None:
        os.write(self._wake_write, b".")

    def _run(self) -> None:
        try:
            while not self._ending:
                self._turn()
        finally:
            while self._errands:
                self._errands.pop(0).done.set()

    def _turn(self) -> None:
        watched = select.poll()
        watched.register(self._wake_read, select.POLLIN)
        for end in [] if self._gone else self._ends():
            watched.register(end, select.POLLIN | (select.POLLOUT if self._waits_to_write(end) else 0))
        ready = dict(watched.poll(self._patience_ms()))
        if ready.pop(self._wake_read, 0):
            os.read(self._wake_read, 4096)
            while self._errands:
                self._errands.pop(0).run()
        if self._back_s is not None and time.monotonic() >= self._back_s:
            self._return_or_wait()
        if not ready:
            self._tell(b"")
        for end, events in ready.items():
            if not self._gone and end in self._ends():
                if events & select.POLLOUT:
                    self._write_on(end)
                if events & ~select.POLLOUT:
                    self._hear(end)

    def _patience_ms(self) -> int | None:
        waits_s = [] if self._back_s is None else [self._back_s - time.monotonic()]
        due_in_s = self._spoken.due_in_s()
        if due_in_s is not None:
            waits_s.append(due_in_s)
        # rounded up, so that what it waits for is due when it wakes
        return int(max(0.0, min(waits_s)) * 1000.0) + 1 if waits_s else None

    def _tell(self, data: bytes) -> None:
        """Feed the fake, send its answer, and carry out its line faults."""
        swallowed = time.monotonic() < self._swallow_until_s
        said = self._spoken.feed(b"" if swallowed or self._gone else data)
        if said and not swallowed and not self._gone:
            self._say(said)
        if isinstance(self.fake, Troubled):
            for order in self.fake.line_orders():
                self._happen(order)

    def _opened_by_client(self) -> None:
        """Tell the fake that a client has opened its port."""
        if isinstance(self.fake, Opened):
            self.fake.port_opened()

    # -- what a wire is --------------------------------------------------------------------------

    @abstractmethod
    def _open(self) -> None:
        """Open the wire."""

    @abstractmethod
    def _close(self) -> None:
        """Take the wire away."""

    @abstractmethod
    def _ends(self) -> list[int]:
        """File descriptors to poll."""

    @abstractmethod
    def _hear(self, end: int) -> None:
        """Read from one of them and `_tell`."""

    @abstractmethod
    def _say(self, data: bytes) -> None:
        """Send to the client, without waiting."""

    def _waits_to_write(self, end: int) -> bool:
        """Whether bytes wait until this end accepts more."""
        return False

    def _write_on(self, end: int) -> None:
        """Send what waits."""
        raise NotImplementedError

    @abstractmethod
    def _hang_up(self) -> None:
        """Close the connection to the present client."""

    def _reset(self) -> None:
        self._hang_up()


class InFastTime:
    """A fake whose time runs faster: the bench waits in real seconds, the fake counts in its own.

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
        """As of the fake; durations of line faults are in real seconds."""
        return self._fake.line_orders() if isinstance(self._fake, Troubled) else []

    def wake_by(self, wake: Callable[[], None] | None) -> None:
        """As of the fake."""
        if isinstance(self._fake, Troubled):
            self._fake.wake_by(wake)
