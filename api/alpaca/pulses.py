"""Guide pulses over Alpaca: taken at once, carried out one after the other, one for each axis at most."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Literal

from api.access.callers import Caller
from api.alpaca.refusals import AlpacaError, error_of, failure_of, invalid_operation
from api.http.faults import Refused, problem_of
from api.orders.desk import Desk
from api.orders.job import Job
from api.orders.orders import GuideOrder
from mountnav.errors import MountnavError
from mountnav.tasks import begun, fault_words, waited_for

_AXIS = {"n": "declination", "s": "declination", "e": "hour angle", "w": "hour angle"}
DIRECTIONS: tuple[Literal["n", "s", "e", "w"], ...] = ("n", "s", "e", "w")
"""As Alpaca counts them: 0 north, 1 south, 2 east, 3 west."""


class Pulses:
    """The guide pulses of one telescope.

    Parameters
    ----------
    desk : Desk
    telescope_id : str
    """

    def __init__(self, desk: Desk, telescope_id: str) -> None:
        self._desk = desk
        self._telescope_id = telescope_id
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._failure: AlpacaError | None = None
        self._stops = 0

    @property
    def running(self) -> bool:
        """Whether one runs or waits."""
        return any(not task.done() for task in self._tasks.values())

    async def guide(self, caller: Caller, order: GuideOrder) -> None:
        """Take a pulse; it runs, or waits for the one of the other axis, when this returns.

        Raises
        ------
        AlpacaError
            A pulse of the same axis still runs.
        MountnavError, Refused
            As the desk's `order`.
        """
        axis = _AXIS[order.direction]
        if (same := self._tasks.get(axis)) is not None and not same.done():
            raise invalid_operation(
                f"a guide pulse of the {axis} axis still runs: wait for IsPulseGuiding False"
            )
        self._failure = None
        before = next((task for task in self._tasks.values() if not task.done()), None)
        if before is not None:
            self._tasks[axis] = begun(
                self._later(caller, order, before, self._stops), "alpaca guide", died=self._died
            )
            return
        # a task that waits for the order: a pulse that comes meanwhile finds it
        ordered = waited_for(self._desk.order(caller, self._telescope_id, order), "alpaca guide")
        self._tasks[axis] = begun(self._follow(ordered, self._stops), "alpaca guide", died=self._died)
        await ordered

    def failed_before(self) -> AlpacaError | None:
        """How a pulse failed after it was taken; told once."""
        failure, self._failure = self._failure, None
        return failure

    def aborting(self) -> None:
        """What waits isn't carried out any more."""
        self._stops += 1

    async def close(self) -> None:
        """Follow no more."""
        for task in self._tasks.values():
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await task

    def _died(self, fault: Exception) -> None:
        self._failure = AlpacaError(0x5FF, fault_words(fault))

    async def _follow(self, ordered: asyncio.Task[Job], stops: int) -> None:
        try:
            job = await ordered
        except (MountnavError, Refused):
            return  # whoever ordered it hears of it
        await self._end_of(job, stops)

    async def _later(self, caller: Caller, order: GuideOrder, before: asyncio.Task[None], stops: int) -> None:
        await asyncio.wait({before})
        if self._stops != stops:
            return
        try:
            job = await self._desk.order(caller, self._telescope_id, order)
        except (MountnavError, Refused) as refusal:
            found = refusal.problem if isinstance(refusal, Refused) else problem_of(refusal)
            self._failure = error_of(found)
            return
        await self._end_of(job, stops)

    async def _end_of(self, job: Job, stops: int) -> None:
        """Wait for its end; `stops` as when the pulse was taken: an abort since is no failure of it."""
        await job.ended.wait()
        if job.problem is not None and self._stops == stops:
            self._failure = failure_of(job.problem)


__all__ = ["DIRECTIONS", "Pulses"]
