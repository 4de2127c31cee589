"""What a mount goes on doing by itself once it was ordered: rates beside the stars', an axis moved by hand.

Each has an end, somebody who counts down to it, a guard that ends it when the service is dead (`dead_man`),
and an `Ending` that tries on. Here stands what both kinds do alike; `offset_rates` and `moved_axes` know how
theirs is ordered, judged and seen to have ended.
"""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import timedelta

from mountnav.errors import DeviceError, MountnavError
from mountnav.journal.records import Outcome
from mountnav.mount.dead_man import LEFT_S, SelfActing
from mountnav.mount.ending import Ending
from mountnav.mount.kill_points import kill_point
from mountnav.mount.order_book import outcome_of
from mountnav.mount.order_rooms import OrderRooms, Orders
from mountnav.tasks import fault_words


class SelfActingOrders(Orders, ABC):
    """Orders after which one mount goes on by itself, and how that is ended.

    Parameters
    ----------
    name : {"offset-rates", "move-axis"}
        In the journal, and to the guard.
    words : str
        What goes on, for messages.
    stop : callable
        ``stop(why)``: stops the mount.
    """

    def __init__(
        self, rooms: OrderRooms, name: SelfActing, words: str, *, stop: Callable[[str], Awaitable[None]]
    ) -> None:
        super().__init__(rooms)
        self._name: SelfActing = name
        self._stop = stop
        self._wire = asyncio.Lock()
        self._timer: asyncio.Task[None] | None = None
        self.ending = Ending(
            name,
            words,
            once=self._end_once,
            stop=stop,
            owed=lambda: self.owed,
            book=self._book,
            clock=self._clock,
            tell=self._state.tell,
        )
        self._state.listen(self._said)

    @property
    @abstractmethod
    def owed(self) -> bool:
        """Whether something goes on that has to be ended, or may."""

    @abstractmethod
    async def end(self, why: str) -> None:
        """End it, and return when it is seen to have ended; nothing to end is fine.

        Raises
        ------
        DeviceError
            It is tried on, and the mount stopped if that doesn't help.
        """

    @abstractmethod
    async def _end_once(self, why: str) -> None:
        """End it and see that it has. Raises a `MountnavError` if not."""

    async def before(self, order: str) -> None:
        """End it before an order that it must not outlive. Raises as `end`, but never before a park."""
        try:
            await self.end(f"an order to {order}")
        except DeviceError:
            if order != "park":
                raise

    async def _end_left(self, why: str) -> None:
        """End what an earlier run of the service has left going. Raises as `end`."""
        with suppress(DeviceError):  # it goes on already, guard or none
            self._armed.need(self._name, self._clock.utc() + timedelta(seconds=LEFT_S))
        await self.ending.now(why)

    @contextmanager
    def _written_end(self, facts: Mapping[str, object]) -> Iterator[None]:
        """Write an order to end. No `Sender.send`: that waits for the disk, and for an order under way."""
        row = self._book.begin_now(self._name, self._state.segments.segment_id, facts)
        try:
            yield
        except BaseException as error:
            self._book.end_soon(row, outcome_of(error, on_wire=True), str(error) or "cancelled")
            raise
        finally:
            self._state.moved()
            kill_point(f"{self._name} sent")
        self._book.end_soon(row, Outcome.DONE)

    async def _let_go(self, within_s: float) -> None:
        """The mount is let go: end it; what can't be ended is left to the guard."""
        self.ending.begin("the mount is let go")
        await self.ending.over(within_s)
        await self.ending.close()
        self._no_countdown()

    def _no_countdown(self) -> None:
        task, self._timer = self._timer, None
        if task is not None and task is not asyncio.current_task():
            task.cancel()

    def _timer_died(self, fault: Exception) -> None:
        self.ending.begin(f"nobody counts down to its end: {fault_words(fault)}")

    def _said(self, what: str, facts: Mapping[str, object]) -> None:
        """A link that is lost, a mount that was switched off: it ends as soon as that can be ordered."""
        if what in ("link-lost", "untrusted"):
            self.ending.begin(f"{what}: {facts.get('why', '')}")
        elif what in ("link-back", "connected"):
            self.ending.wake()

    async def _ended_quietly(self, why: str) -> None:
        """End it; what fails is tried on."""
        with suppress(MountnavError):
            await self.ending.now(why)
