"""Motion over Alpaca: the last slew, guide pulses, and where parking and homing ended [Alpaca §5].

Slewing is the standard's only way to tell that a slew failed after it began: reading it raises then, once
for each client that has an id, and for those without one until the next order or an abort. Pulses are taken
at once and carried out one after the other, one for each axis at most. Where parking and homing ended is
kept for mounts that don't say by themselves that they are there.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from typing import Literal

from api.access.callers import Caller
from api.alpaca.connection import Client
from api.alpaca.errors import AlpacaError, Number, error_of, failure_of, invalid_operation
from api.orders.dispatcher import Dispatcher
from api.orders.job import Job
from api.orders.vocabulary import GuideOrder, Order
from api.orders.watching import Snapshot
from api.problems import Refused, problem_of
from mountnav.clock import real_s
from mountnav.errors import MountnavError
from mountnav.navigation.navigator import Navigator
from mountnav.sky.sphere import half_turn_deg
from mountnav.tasks import begun, fault_words, waited_for

__all__ = ["DIRECTIONS", "Motion", "Pulses", "Stations", "Work"]


_NEAR_DEG = 0.1
"""How near to where parking or homing ended counts as still there, deg: above the noise of encoders and
refraction. Doubled, a small nudge away goes unseen."""
_ZENITH_DEG = 89.0
"""Above this altitude azimuth says nothing of the place: at 89° a whole turn of it is 2° of the sky at
most."""


class Stations:
    """Altitude and azimuth of each station, as last reached; a telescope that is there stands still."""

    def __init__(self) -> None:
        self._places: dict[str, tuple[float, float]] = {}

    def remember(self, station: str, snapshot: Snapshot) -> None:
        """It stands at its station now."""
        state = snapshot.state
        if state.altitude_deg is not None and state.azimuth_deg is not None:
            self._places[station] = state.altitude_deg, state.azimuth_deg

    def forget(self, station: str) -> None:
        """It does no more."""
        self._places.pop(station, None)

    def is_at(self, station: str, snapshot: Snapshot) -> bool:
        """Whether it stands there still."""
        at, state = self._places.get(station), snapshot.state
        if at is None or state.altitude_deg is None or state.azimuth_deg is None:
            return False
        if snapshot.slewing or (state.reading is not None and state.reading.tracking):
            return False
        turn_deg = abs(half_turn_deg(state.azimuth_deg - at[1])) if abs(at[0]) < _ZENITH_DEG else 0.0
        return abs(state.altitude_deg - at[0]) < _NEAR_DEG and turn_deg < _NEAR_DEG


_AXIS = {"n": "declination", "s": "declination", "e": "hour angle", "w": "hour angle"}
DIRECTIONS: tuple[Literal["n", "s", "e", "w"], ...] = ("n", "s", "e", "w")
"""As Alpaca counts them: 0 north, 1 south, 2 east, 3 west."""


class Pulses:
    """The guide pulses of one telescope."""

    def __init__(self, dispatcher: Dispatcher, telescope_id: str) -> None:
        self._dispatcher = dispatcher
        self._telescope_id = telescope_id
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._failure: AlpacaError | None = None
        self._stops = 0

    @property
    def running(self) -> bool:
        """Whether one runs or waits."""
        return any(not task.done() for task in self._tasks.values())

    async def guide(self, caller: Caller, order: GuideOrder, *, stops_given: int) -> None:
        """Take a pulse; it runs, or waits for the one of the other axis, when this returns.

        Parameters
        ----------
        stops_given : int
            How many stops, of whatever face, had been given when it came: after a further one it isn't begun.

        Raises
        ------
        AlpacaError
            A pulse of the same axis still runs.
        MountnavError, Refused
            As the dispatcher's `order`.
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
                self._later(caller, order, before, self._stops, stops_given), "alpaca guide", died=self._died
            )
            return
        # a task that waits for the order: a pulse that comes meanwhile finds it
        ordered = waited_for(
            self._dispatcher.order(caller, self._telescope_id, order, stops_given=stops_given), "alpaca guide"
        )
        self._tasks[axis] = begun(self._follow(ordered, self._stops), "alpaca guide", died=self._died)
        await ordered

    def failed_before(self) -> AlpacaError | None:
        """How a pulse failed after it was taken; reported once."""
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
            return  # the one who ordered it learns of it
        await self._end_of(job, stops)

    async def _later(
        self, caller: Caller, order: GuideOrder, before: asyncio.Task[None], stops: int, stops_given: int
    ) -> None:
        await asyncio.wait({before})
        if self._stops != stops:
            return
        try:
            job = await self._dispatcher.order(caller, self._telescope_id, order, stops_given=stops_given)
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


_log = logging.getLogger(__name__)

_STOP_S = 0.5
"""How long AbortSlew waits for the end of the stop, s: clients expect its answer at once, and failures
within it are reported. Doubled, a slow mount's failures are seen more often, and clients wait longer."""
Work = Callable[[Navigator], Awaitable[object]]


class Motion:
    """Orders one telescope's motions for Alpaca's clients.

    Attributes
    ----------
    settle_s : int
        How long after its end a motion still counts as one.
    """

    def __init__(self, dispatcher: Dispatcher, telescope_id: str) -> None:
        self.settle_s = 0
        self._dispatcher = dispatcher
        self._telescope_id = telescope_id
        self._ordering = 0
        self._job: Job | None = None
        self._client: Client | None = None
        self._following: asyncio.Task[AlpacaError | None] | None = None
        self._aborted: Job | None = None
        self._stopping: set[asyncio.Task[None]] = set()
        self._failure: AlpacaError | None = None
        self._told: set[Client] = set()
        self._hurry = asyncio.Event()

    @property
    def under_way(self) -> bool:
        """From the moment an order is taken until its end is settled and read; a stop is one, too."""
        return (
            self._ordering > 0
            or bool(self._stopping)
            or (self._following is not None and not self._following.done())
        )

    def is_of(self, client: Client) -> bool:
        """Whether what is under way was ordered by this client."""
        return self.under_way and self._client == client

    def slews_for(self, client: Client) -> bool:
        """Whether a slew that this client ordered runs."""
        job = self._job
        return job is not None and not job.is_over and job.kind == "slew" and self._client == client

    def begin_anew(self, client: Client) -> None:
        """A client that has just connected is not told how a motion before that failed."""
        if self._failure is not None and client.client_id != 0:
            self._told.add(client)

    async def begin(
        self,
        caller: Caller,
        client: Client,
        order: Order,
        *,
        stops_given: int,
        work: Work | None = None,
        supersede: bool = False,
        arrived: Callable[[], None] | None = None,
    ) -> None:
        """Order a motion; it has begun when this returns.

        Parameters
        ----------
        stops_given : int
            How many stops had been given when the order came: after a further one it is not begun.
        work : callable, optional
            What is done for it, if more than the order says; one job all the same.
        supersede : bool
            Whether what this same client has under way makes room. Nobody else's work ever does.
        arrived : callable, optional
            Called when it has succeeded and the mount was read again.

        Raises
        ------
        MountnavError, Refused
            As the dispatcher's `order`.
        """
        self._ordering += 1
        held = self._job
        try:
            await self.stopped()
            held = self._job
            mine = supersede and self.is_of(client) and held is not None and not held.is_over
            if mine:
                self._aborted = held
            if work is None:
                job = await self._dispatcher.order(
                    caller, self._telescope_id, order, supersede=mine, stops_given=stops_given
                )
            else:
                request = order.model_dump(exclude_none=True)
                job = await self._dispatcher.give(
                    caller,
                    self._telescope_id,
                    order.kind,
                    request,
                    work,
                    supersede=mine,
                    stops_given=stops_given,
                )
            self._job, self._client = job, client
            self._failure = None
            self._told.clear()
            self._hurry.clear()
            self._following = begun(self._follow(job, arrived), f"alpaca {order.kind}", died=self._died)
        except BaseException:
            if self._aborted is held and held is not None and not held.is_over:
                self._aborted = None  # it goes on
            raise
        finally:
            self._ordering -= 1

    def begin_by_hand(self) -> None:
        """An axis is moved on: how a motion before that failed is told no more."""
        self._failure = None
        self._told.clear()

    def fail(self, failure: AlpacaError) -> None:
        """A motion by hand has ended by itself: told as the failure of a slew is."""
        self._failure = failure
        self._told.clear()

    async def ended(self) -> None:
        """Wait for the end of what is under way; a failure, or anybody's stop, raises `AlpacaError`."""
        if (following := self._following) is None:
            return
        await asyncio.wait({following})
        if following.cancelled():
            raise AlpacaError(0x508, "the service is shutting down: how this ended is not known")
        if (fault := following.exception()) is not None:
            raise AlpacaError(0x5FF, f"how it ended is not known: {fault_words(fault)}")
        if (failure := following.result()) is None:
            return
        if self._failure is failure:
            self._failure = None
        raise failure

    async def wait(self, wait_s: float) -> None:
        """Wait for the end, but no longer than so many of the machine's seconds; raises nothing."""
        if (following := self._following) is not None:
            await asyncio.wait({following}, timeout=wait_s)

    def failed_before(self, client: Client) -> AlpacaError | None:
        """The failure of the last motion, if this client has not been reported; it is from now on."""
        if self._failure is None or client in self._told:
            return None
        if client.client_id != 0:
            self._told.add(client)
        return self._failure

    async def stopped(self) -> None:
        """Wait for stops that are under way: an order that came between would be ended by them."""
        if self._stopping:
            await asyncio.wait(set(self._stopping))

    async def abort(self, caller: Caller) -> None:
        """Stop the telescope, whatever it does. The end of what is aborted is no failure.

        The stop is sent at once; if the mount takes long to come to rest, that isn't waited for: Slewing is
        True until then, and what goes wrong after this has returned is the failure of the motion.

        Raises
        ------
        MountnavError, Refused
            As the dispatcher's `stop`.
        """
        self._failure = None
        self._told.clear()
        self._hurry.set()
        if self._job is not None and not self._job.is_over:
            self._aborted = self._job
        stopping = waited_for(self._stop(caller), "alpaca abort")
        self._stopping.add(stopping)
        stopping.add_done_callback(self._stopping.discard)
        await asyncio.wait({stopping}, timeout=_STOP_S)
        if stopping.done():
            await stopping
        else:
            stopping.add_done_callback(self._stopped_late)

    async def _stop(self, caller: Caller) -> None:
        await self._dispatcher.stop(caller, self._telescope_id)
        await self._dispatcher.watch(self._telescope_id).refresh()

    def _stopped_late(self, stopping: asyncio.Task[None]) -> None:
        error = None if stopping.cancelled() else stopping.exception()
        if isinstance(error, MountnavError):
            found = failure_of(problem_of(error))
            self._failure = AlpacaError(found.number, f"the stop failed: {found.words}")
        elif error is not None:
            self._failure = AlpacaError(0x5FF, f"the stop failed: {error}")
            _log.error("a stop of %s failed", self._telescope_id, exc_info=error)

    async def close(self) -> None:
        """Follow no more."""
        if self._following is not None:
            self._following.cancel()
            with contextlib.suppress(asyncio.CancelledError, Exception):
                await self._following

    def _died(self, fault: Exception) -> None:
        """How it ended is not known: that must not look like an arrival."""
        self._failure = AlpacaError(0x5FF, f"how it ended is not known: {fault_words(fault)}")

    async def _follow(self, job: Job, arrived: Callable[[], None] | None) -> AlpacaError | None:
        """Until a motion is settled and read; how it failed, aborted ones included."""
        await job.ended.wait()
        failure = _failure_of(job)
        if failure is None and self.settle_s > 0:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(real_s(self.settle_s)):
                    await self._hurry.wait()
        await self._dispatcher.watch(self._telescope_id).refresh()
        if failure is None and arrived is not None:
            arrived()
        if self._job is job and self._aborted is not job:
            self._failure = failure
        return failure


def _failure_of(job: Job) -> AlpacaError | None:
    if job.problem is None:
        return None
    found = failure_of(job.problem)
    how = "was stopped" if found.number == Number.CANCELLED else "failed"
    return AlpacaError(found.number, f"the {job.kind} {how}: {found.words}")
