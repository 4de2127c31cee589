"""Time that jumps: an event loop that waits for nothing, so that a night of ten hours takes minutes.

Whenever everybody waits, the clock is put on to the next moment at which somebody is to be woken. The same
run takes the same course each time, however fast or loaded the machine is. What would break that is refused:
lines to the outside, and threads that nobody awaits. While an awaited thread works (`asyncio.to_thread`),
time stands.
"""

from __future__ import annotations

import asyncio
import contextvars
import selectors
import sys
import threading
from collections.abc import Callable, Coroutine, Iterator, Mapping
from concurrent.futures import Future as Threaded
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from typing import Any, Final, TypeVar, TypeVarTuple

from mountnav.clock import utc_now as real_utc_now

__all__ = ["NothingWillHappen", "VirtualClock", "VirtualLoop", "for_all_modules", "run_virtually"]

Result = TypeVar("Result")
Args = TypeVarTuple("Args")

START: Final = datetime(2026, 3, 20, 1, 0, tzinfo=UTC)
# Seconds that the clock goes on beyond a timeout, so that rounding leaves nothing just short of being due.
_A_HAIR_S = 1e-9
# Real seconds that a thread may work before a run is called hung. Chosen by hand, for slow machines.
_LONGEST_THREAD_S = 300.0


class NothingWillHappen(RuntimeError):
    """Everybody waits, and there is nothing that could wake anybody: a hang."""


class VirtualClock:
    """Time that stands until a `VirtualLoop` puts it on; fulfils `mountnav.clock.Clock`.

    The instance itself is a ``clock=`` and its `monotonic` a ``monotonic=``, as the mechanics and the fakes
    take them. All faces are one time.

    Parameters
    ----------
    start : datetime, optional
        Aware UTC at which it begins.

    Attributes
    ----------
    now_s : float
        Its seconds; they begin at 1000.
    """

    def __init__(self, start: datetime = START) -> None:
        self._start = start
        self._start_s = 1000.0
        self.now_s = self._start_s

    def __call__(self) -> datetime:
        """Aware UTC now."""
        return self.utc()

    def utc(self) -> datetime:
        """Aware UTC now."""
        return self._start + timedelta(seconds=self.now_s - self._start_s)

    def monotonic(self) -> float:
        """Its seconds."""
        return self.now_s

    def monotonic_s(self) -> float:
        """Its seconds."""
        return self.now_s

    async def sleep(self, seconds: float) -> None:
        """Let so many of its seconds pass; only in a `VirtualLoop` of this clock."""
        await asyncio.sleep(seconds)


class _Jumping(selectors.BaseSelector):
    """Waits for nothing: puts the clock on instead, or waits for threads that work."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._keys: dict[int, selectors.SelectorKey] = {}
        self.working = 0
        self.news = threading.Event()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if timeout is not None and timeout <= 0.0:
            return []
        if self.working:
            if not self.news.wait(_LONGEST_THREAD_S):
                raise NothingWillHappen(f"a thread has been working for {_LONGEST_THREAD_S:.0f} real seconds")
            self.news.clear()
            return []
        if timeout is None:
            raise NothingWillHappen("everybody waits, and nothing will ever happen: a hang")
        # a hair more, so that what was waited for is due
        self._clock.now_s += timeout + _A_HAIR_S
        return []

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        if self._keys:
            # the first is the loop's own, by which threads wake it
            raise RuntimeError("virtual time reads no lines to the outside: use one in memory")
        key = selectors.SelectorKey(fileobj, 0, events, data)
        self._keys[id(fileobj)] = key
        return key

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return self._keys.pop(id(fileobj))

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return {key.fileobj: key for key in self._keys.values()}

    def get_key(self, fileobj: Any) -> selectors.SelectorKey:
        # what the loop asks before it registers
        raise KeyError(fileobj)


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in the time of a `VirtualClock`; nothing outside of it can wake it."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._jumping = _Jumping(clock)
        self._threads: ThreadPoolExecutor | None = None
        super().__init__(self._jumping)

    def time(self) -> float:
        """The clock's seconds."""
        return self._clock.now_s

    def run_in_executor(
        self,
        executor: Any,
        func: Callable[[*Args], Result],
        *args: *Args,
    ) -> asyncio.Future[Result]:
        """Let a thread work, while the clock stands."""
        if executor is None:
            self._threads = self._threads or ThreadPoolExecutor(thread_name_prefix="virtual")
            executor = self._threads
        # counted before it begins: its first word may come at once
        self._jumping.working += 1
        threaded: Threaded[Result] = executor.submit(func, *args)
        future = asyncio.wrap_future(threaded, loop=self)
        # after the result has been handed over: a jump between the two would come too soon
        threaded.add_done_callback(lambda _: self._wake(self._one_less))
        return future

    def call_soon_threadsafe(
        self,
        callback: Callable[[*Args], object],
        *args: *Args,
        context: contextvars.Context | None = None,
    ) -> asyncio.Handle:
        """As every loop; refuses threads that it does not know to work, since time may have jumped.

        Raises
        ------
        RuntimeError
            From a thread that was not started by `asyncio.to_thread` or `run_in_executor` on this loop.
        """
        if not self._jumping.working and threading.get_ident() != self._thread_ident():
            raise RuntimeError("a thread that virtual time doesn't know of: use asyncio.to_thread, or none")
        return self._wake(callback, *args, context=context)

    def close(self) -> None:
        """End, with its threads."""
        super().close()
        if self._threads is not None:
            self._threads.shutdown(wait=True)

    def _wake(
        self,
        callback: Callable[[*Args], object],
        *args: *Args,
        context: contextvars.Context | None = None,
    ) -> asyncio.Handle:
        handle = super().call_soon_threadsafe(callback, *args, context=context)
        self._jumping.news.set()
        return handle

    def _one_less(self) -> None:
        self._jumping.working -= 1

    def _thread_ident(self) -> int | None:
        return getattr(self, "_thread_id", None) or threading.main_thread().ident


def run_virtually(work: Coroutine[Any, Any, Result], clock: VirtualClock) -> Result:
    """Run a coroutine to its end in virtual time.

    Parameters
    ----------
    work : coroutine
        Locks and events must be made inside of it, or belong to no loop yet.
    clock : VirtualClock
        Its seconds go on; it can be used for one run after the other.

    Returns
    -------
    object
        What the coroutine returns.

    Raises
    ------
    NothingWillHappen
        When all wait for what never comes.
    """
    with asyncio.Runner(loop_factory=lambda: VirtualLoop(clock)) as runner:
        return runner.run(work)


@contextmanager
def for_all_modules(clock: VirtualClock) -> Iterator[None]:
    """Let everything imported so far take the clock's UTC for the present: drivers ask `utc_now` themselves.

    Only for simulations of one process of their own, and for tests.
    """
    changed = []
    for name, module in list(sys.modules.items()):
        if not name.startswith(("drivers", "mountnav")):
            continue
        present = getattr(module, "utc_now", None)
        # a module that was first imported during an earlier life has that life's clock
        if present is real_utc_now or isinstance(present, VirtualClock):
            changed.append(module)
            vars(module)["utc_now"] = clock
    try:
        yield
    finally:
        for module in changed:
            vars(module)["utc_now"] = real_utc_now
