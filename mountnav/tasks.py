"""Work beside its caller, begun in one place, so that no task dies unheard.

asyncio keeps the fault of a task to itself until somebody asks: a reader that died leaves a link that looks
alive, and positions that stand still. So there are three ways to begin work here, and no others (a test reads
all sources for `create_task` and `ensure_future`):

- `waited_for`: its beginner waits for it, and its fault is the beginner's own;
- `begun`: nobody waits; who is told of its fault, and ends what hung on it, has to be said;
- a `Crew`: tasks that stand and fall together, as those of one connection.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

T = TypeVar("T")
U = TypeVar("U")
Died = Callable[[Exception], object]

_log = logging.getLogger(__name__)


def waited_for(work: Awaitable[T], name: str | None = None) -> asyncio.Task[T]:
    """Begin work that the beginner waits for."""
    if not asyncio.iscoroutine(work):
        work = _as_coroutine(work)
    return asyncio.get_running_loop().create_task(work, name=name)


async def _as_coroutine(work: Awaitable[T]) -> T:
    return await work


async def together(*work: Awaitable[T]) -> list[T]:
    """Do several things at once, and return what came of each; the first fault ends the others."""
    tasks = [waited_for(one) for one in work]
    try:
        if tasks:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_EXCEPTION)
            for task in tasks:
                if task in done:
                    task.result()
        return [task.result() for task in tasks]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def both(one: Awaitable[T], other: Awaitable[U]) -> tuple[T, U]:
    """`together`, for two of different kinds."""
    first, second = waited_for(one), waited_for(other)
    await together(first, second)
    return first.result(), second.result()


async def first_of(*work: Awaitable[object]) -> None:
    """Do several things at once until the first has ended; end the others: a pause and what cuts it short."""
    tasks = [waited_for(one) for one in work]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def begun(work: Coroutine[Any, Any, T], name: str, *, died: Died) -> asyncio.Task[T]:
    """Begin work that nobody waits for.

    Parameters
    ----------
    name : str
        For the log.
    died : callable
        Told of its fault, at once, to end or mend what hung on it: a link, a connection, an order. A
        cancellation is no fault.
    """
    task = waited_for(work, name)

    def ended(task: asyncio.Task[T]) -> None:
        fault = None if task.cancelled() else task.exception()
        if isinstance(fault, Exception):
            _log.error("the task %s failed unexpectedly", name, exc_info=fault)
            died(fault)

    task.add_done_callback(ended)
    return task


async def cancelled(task: asyncio.Task[Any] | None) -> None:
    """End a task, if there is one, and wait until it has ended; a fault that it had is raised."""
    if task is not None:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


def fault_words(fault: BaseException) -> str:
    """How a fault of ours is told to users; the log has more."""
    return f"a fault in mountnav: {type(fault).__name__}: {fault}"[:200]


class Crew:
    """Tasks that stand and fall together: the first fault among them is raised to who waits for them."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()
        self._fault: Exception | None = None
        self._faulted = asyncio.Event()

    def begin(self, work: Coroutine[Any, Any, T], name: str) -> asyncio.Task[T]:
        """Begin work that ends with the others."""
        task = waited_for(work, name)
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        fault = None if task.cancelled() else task.exception()
        if isinstance(fault, Exception):
            self.fail(fault)

    def fail(self, fault: Exception) -> None:
        """Have it raised to who waits, though it happened elsewhere; the first one counts."""
        self._fault = self._fault or fault
        self._faulted.set()

    async def until(self, *last: asyncio.Task[Any]) -> None:
        """Wait until all of these have ended; a fault in any task of the crew is raised at once."""
        faulted = waited_for(self._faulted.wait())
        try:
            waiting = {task for task in last if not task.done()}
            while waiting and self._fault is None:
                done, _ = await asyncio.wait({*waiting, faulted}, return_when=asyncio.FIRST_COMPLETED)
                waiting -= done
        finally:
            faulted.cancel()
        if self._fault is not None:
            raise self._fault

    async def until_any(self) -> None:
        """Wait until one of them has ended; its fault is raised."""
        if self._tasks:
            await asyncio.wait(set(self._tasks), return_when=asyncio.FIRST_COMPLETED)
        if self._fault is not None:
            raise self._fault

    async def end(self) -> None:
        """End those that are left, and wait for that."""
        tasks = list(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


__all__ = ["Crew", "Died", "begun", "both", "fault_words", "first_of", "together", "waited_for"]
