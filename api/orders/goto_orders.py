"""How programs without jobs order: a goto replaces their own, a stop comes before all that isn't begun yet.

INDI, LX200 and Stellarium know no jobs, no leases and no "busy": their orders come here and go to the
dispatcher, and what stands against them comes back as words. There is no other way from these faces to a
telescope.
"""

from __future__ import annotations

import asyncio
import contextlib

from api.access.audit import Audit
from api.access.callers import Caller
from api.orders.dispatcher import Dispatcher
from api.orders.job import Job, JobState
from api.orders.targets import Target
from api.orders.vocabulary import Order, SlewOrder, SyncToOrder
from api.problems import Problem, Refused, problem_of
from mountnav.errors import MountnavError

_COMING_TO_REST_S = 3.0
"""How long a sync waits for the end of its client's own goto, s; chosen by hand: the place is reached a
moment before the mount rests. Halved, a sync right after a goto of a slow mount is refused as busy."""
_MOST_STOPS = 3
"""Stops of a telescope that these programs may have under way; further ones wait for the end of those.
Doubled, twice as many stops go to the mount at once."""
LONGEST_SHORT_S = 45.0
"""For what is over soon: a sync, tracking, unparking, a pulse."""


class NotTaken(Exception):
    """An order that was refused, or failed; nothing moves by it any more.

    Parameters
    ----------
    problem : Problem
        As every other face would tell it.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(words_of(problem))
        self.problem = problem

    @property
    def words(self) -> str:
        """What happened, and what to do."""
        return words_of(self.problem)

    @property
    def reasons(self) -> tuple[str, ...]:
        """Which limit, doubt or refusal it was."""
        return tuple(self.problem.reasons or ())


def words_of(problem: Problem) -> str:
    """A problem in a sentence."""
    said = f"{problem.device}: {problem.detail}" if problem.device else problem.detail
    return f"{said} ({problem.advice})" if problem.advice else said


class GotoOrders:
    """Gives one telescope's orders of one face.

    Parameters
    ----------
    audit : Audit
        Where a goto is noted that was refused before it became a job.
    """

    def __init__(self, dispatcher: Dispatcher, audit: Audit, telescope_id: str) -> None:
        self.telescope_id = telescope_id
        self._dispatcher = dispatcher
        self._audit = audit
        self._gotos: dict[str, Job] = {}
        self._stopping = 0
        self._stop_failed: NotTaken | None = None
        self._calm = asyncio.Event()
        self._calm.set()
        self._turn = asyncio.Lock()

    async def goto(self, caller: Caller, target: Target) -> Job:
        """Slew there; a goto of the same caller that is under way is replaced. The job has begun.

        Raises
        ------
        NotTaken
        """
        stops = self._dispatcher.stops_given(self.telescope_id)
        async with self._turn:
            await self._calm.wait()
            await self._dispatcher.turn()
            held = self._dispatcher.watch(self.telescope_id).latest.job
            own = held is not None and held is self._gotos.get(caller.name)
            try:
                if held is None or own:
                    # a wrong click doesn't end the goto that is under way
                    await self._check(caller, target, own)
                    own = own and held is self._dispatcher.watch(self.telescope_id).latest.job
                job = await self._dispatcher.order(
                    caller,
                    self.telescope_id,
                    SlewOrder(target=target),
                    supersede=own,
                    stops_given=stops,
                )
            except (Refused, MountnavError) as refusal:
                raise _not_taken(refusal) from refusal
            self._gotos = {name: one for name, one in self._gotos.items() if not one.is_over}
            self._gotos[caller.name] = job
            return job

    async def sync(self, caller: Caller, target: Target) -> Job:
        """Tell the mount that it points there; returns when it was read back.

        Programs that see a goto's end by its place alone are a moment ahead of the mount at rest: that is
        waited for.

        Raises
        ------
        NotTaken
            Also if it was sent and failed.
        """
        stops = self._dispatcher.stops_given(self.telescope_id)
        held = self._gotos.get(caller.name)
        if held is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_COMING_TO_REST_S):
                    await held.ended.wait()
        return await self._seen(caller, SyncToOrder(target=target), stops)

    async def short(self, caller: Caller, order: Order) -> Job:
        """Give an order that is over soon, and see its end.

        Raises
        ------
        NotTaken
            Also if it failed.
        """
        return await self._seen(caller, order, self._dispatcher.stops_given(self.telescope_id))

    async def _seen(self, caller: Caller, order: Order, stops: int) -> Job:
        async with self._turn:
            job = await self._begun(caller, order, stops)
            try:
                async with asyncio.timeout(LONGEST_SHORT_S):
                    await job.ended.wait()
            except TimeoutError:
                return job
        require_success(job)
        return job

    async def long(self, caller: Caller, order: Order) -> Job:
        """Give an order that takes a while; its job has begun.

        Raises
        ------
        NotTaken
        """
        stops = self._dispatcher.stops_given(self.telescope_id)
        async with self._turn:
            return await self._begun(caller, order, stops)

    async def stop(self, caller: Caller) -> None:
        """Stop all motion now; what waits its turn is dropped, what comes after waits for its end.

        Of very many at once the surplus waits for those that are being sent.

        Raises
        ------
        NotTaken
            The stop could not be sent.
        """
        if self._stopping >= _MOST_STOPS:
            await self._calm.wait()
            if self._stop_failed is not None:
                raise self._stop_failed
            return
        self._stopping += 1
        self._calm.clear()
        try:
            await self._dispatcher.stop(caller, self.telescope_id)
            self._stop_failed = None
        except (Refused, MountnavError) as refusal:
            self._stop_failed = _not_taken(refusal)
            raise self._stop_failed from refusal
        finally:
            self._stopping -= 1
            if not self._stopping:
                self._calm.set()

    async def _check(self, caller: Caller, target: Target, supersede: bool) -> None:
        """Refuse at once what would be refused: these programs wait for an answer, and know no jobs."""
        try:
            await self._dispatcher.check(self.telescope_id, target, supersede=supersede)
        except MountnavError as refusal:
            request = {"target": target.model_dump()}
            self._audit.refused(caller, "slew", refusal, telescope=self.telescope_id, request=request)
            raise

    async def _begun(self, caller: Caller, order: Order, stops: int) -> Job:
        # what is ordered after a stop begins when that is done
        await self._calm.wait()
        await self._dispatcher.turn()
        try:
            return await self._dispatcher.order(caller, self.telescope_id, order, stops_given=stops)
        except (Refused, MountnavError) as refusal:
            raise _not_taken(refusal) from refusal


def require_success(job: Job) -> None:
    """Raise `NotTaken` for a job that ended otherwise."""
    if job.state in (JobState.FAILED, JobState.CANCELLED) and job.problem is not None:
        raise NotTaken(job.problem)


def _not_taken(refusal: Refused | MountnavError) -> NotTaken:
    return NotTaken(refusal.problem if isinstance(refusal, Refused) else problem_of(refusal))


__all__ = ["LONGEST_SHORT_S", "GotoOrders", "NotTaken", "require_success", "words_of"]
