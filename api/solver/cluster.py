"""Looks solved on the site's Dask cluster, and by the service's own pool where that is slow or gone."""

from __future__ import annotations

import asyncio
import itertools
import logging
import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from api.solver.limits import Limits
from api.solver.link import ProcessEnded, ProcessLink, Upload, Work, in_memory, task_of
from api.solver.messages import (
    ClusterSeen,
    ClusterSetup,
    ClusterTask,
    Forget,
    Relayed,
    SolvingThere,
    Task,
    packed,
)
from api.solver.pool import Pool
from api.solver.worker import MARGIN_S, Tell
from mountnav.catalog.stars import Catalog
from mountnav.errors import MountnavError
from mountnav.frames import Frame
from mountnav.identification.budget import wall_limit_s
from mountnav.solution import Verdict
from mountnav.tasks import begun, fault_words, waited_for

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration
    from mountnav.settings.solver import SolverSettings

_log = logging.getLogger(__name__)

RELAY = "api.solver.cluster_process"

PAUSE_S = 30.0
"""After a look that came too late the next ones are not sent to the cluster for so long: each of them would
cost its deadline. Doubled, a cluster that was busy for a moment is left alone twice as long."""

RESTART_S = 2.0
"""Until the process that speaks with the cluster is started again."""

_SEND_S = 2.0
"""For the few bytes of a question. A process that doesn't take them is stuck, and is ended."""


class Unanswered(Exception):
    """The cluster gave no answer, and why."""


class Cluster:
    """Solves looks on a Dask cluster; what it doesn't answer in time is solved by the pool.

    Parameters
    ----------
    catalog : Catalog
        Workers of the cluster must have the same.
    tell : callable
        ``tell(kind, data)``: told when the cluster is there or gone, and of each look that it didn't answer.
    settings : SolverSettings
        Scheduler, deadline, resource.
    pool : Pool
        The service's own, which is open as long as this is.
    """

    def __init__(
        self,
        catalog: Catalog,
        tell: Tell,
        *,
        settings: SolverSettings,
        pool: Pool,
        limits: Limits | None = None,
        pause_s: float = PAUSE_S,
    ) -> None:
        assert settings.scheduler is not None
        self._catalog, self._tell, self._settings = catalog, tell, settings
        self._limits = limits or Limits()
        self._pool, self._pause_s = pool, pause_s
        self._link: ProcessLink | None = None
        self._sending = asyncio.Lock()
        self._numbers = itertools.count()
        self._answers: dict[int, asyncio.Future[Relayed]] = {}
        self._masters: list[Calibration] = []
        self._sent: set[int] = set()
        self._seen = ClusterSeen(0, "not connected yet")
        self._not_before_s = 0.0
        self._slow = ""
        self._runner: asyncio.Task[None] | None = None

    @property
    def state(self) -> str:
        """Such as "3 workers"; or "away: " and why, looks are solved by the service's own processes then."""
        if self._seen.workers and self._resting():
            return f"away: {self._slow}"
        if self._seen.workers:
            return f"{self._seen.workers} worker{'s' if self._seen.workers > 1 else ''}"
        return f"away: {self._seen.trouble or 'no worker may be asked'}"

    @property
    def concern(self) -> str | None:
        """What an operator should look into."""
        state = self.state
        return f"the cluster is {state}; looks are solved here" if state.startswith("away") else None

    @property
    def pid(self) -> int | None:
        """Of the process that speaks with the cluster."""
        return None if self._link is None else self._link.pid

    def open(self) -> None:
        """Begin to connect, in the background. Twice is fine."""
        if self._runner is None:
            self._runner = begun(self._run(), "cluster", died=self._died)

    async def close(self) -> None:
        """Let the cluster go; nobody waits for it."""
        if self._runner is not None:
            self._runner.cancel()
            await asyncio.gather(self._runner, return_exceptions=True)

    async def solve(self, work: Work, *, owner: str) -> Verdict:
        """Solve a look: the cluster's answer, or the pool's if that comes first after the deadline.

        Raises
        ------
        Exception
            What `solve` itself raised.
        """
        self.open()
        if self._resting() or not self._seen.workers or isinstance(work.source, Upload):
            return await self._here(work, owner)
        there = waited_for(self._asked(work))
        here: asyncio.Task[Verdict] | None = None
        try:
            await asyncio.wait({there}, timeout=self._settings.deadline_s)
            if there.done():
                try:
                    return there.result()
                except Unanswered as error:
                    self._fell_back(str(error))
                    return await self._here(work, owner)
            self._slow = f"no answer within {self._settings.deadline_s:g} s"
            self._not_before_s = asyncio.get_running_loop().time() + self._pause_s
            self._fell_back(self._slow)
            here = waited_for(self._here(work, owner))
            await asyncio.wait({there, here}, return_when=asyncio.FIRST_COMPLETED)
            if not here.done():
                with suppress(Unanswered):
                    return there.result()
            return await here
        finally:
            for task in (there, here):
                if task is not None:
                    task.cancel()
                    await asyncio.gather(task, return_exceptions=True)

    async def _here(self, work: Work, owner: str) -> Verdict:
        return await self._pool.solve(work, first=True, owner=owner)

    def _resting(self) -> bool:
        return asyncio.get_running_loop().time() < self._not_before_s

    def _fell_back(self, why: str) -> None:
        _log.warning("a look was solved here, not on the cluster: %s", why)
        self._tell("solver", {"process": "cluster", "state": f"a look is solved here: {why}"})

    async def _asked(self, work: Work) -> Verdict:
        """The cluster's verdict. Raises `Unanswered`."""
        link, loop = self._link, asyncio.get_running_loop()
        if link is None:
            raise Unanswered("the process that speaks with the cluster is starting")
        assert isinstance(work.source, Frame)
        number = next(self._numbers)
        answer: asyncio.Future[Relayed] = loop.create_future()
        self._answers[number] = answer
        file = -1
        try:
            file = await asyncio.to_thread(in_memory, work.source.pixels)
            most_s = wall_limit_s(work.settings.budget_s) + MARGIN_S
            async with self._sending:
                await self._send(link, ClusterTask(number, self._task(work), most_s), file)
            relayed = await answer
        except ProcessEnded as error:
            raise Unanswered(f"the process that speaks with the cluster is gone: {error}") from error
        except asyncio.CancelledError:
            if self._link is link:
                begun(self._forget(link, number), "forget", died=lambda _: None)
            raise
        finally:
            del self._answers[number]
            if file >= 0:
                os.close(file)
        if relayed.done is None:
            raise Unanswered(relayed.trouble)
        if relayed.done.fault is not None:
            raise relayed.done.fault.error()
        if relayed.done.verdict is None:
            raise Unanswered("it answered without a verdict")
        return relayed.done.verdict

    async def _send(self, link: ProcessLink, message: object, *files: int) -> None:
        try:
            async with asyncio.timeout(_SEND_S):
                await link.send(message, *files)
        except BaseException as error:
            if not isinstance(error, ProcessEnded):
                link.kill()  # half of a question would be taken for the next one
            if isinstance(error, TimeoutError):
                raise ProcessEnded("it is stuck") from error
            raise

    async def _forget(self, link: ProcessLink, number: int) -> None:
        with suppress(ProcessEnded):
            async with self._sending:
                await self._send(link, Forget(number))

    def _task(self, work: Work) -> Task:
        # workers have their index at a place of theirs; only that there is one is told
        index = None if work.index is None else Path(work.index.name)
        return task_of(work, self._masters, self._sent, index)

    async def _run(self) -> None:
        from api.solver.on_worker import catalogs_told

        try:
            told = await asyncio.to_thread(catalogs_told, self._catalog)
        except MountnavError as error:
            self._seem(ClusterSeen(0, error.what))
            return
        given = SolvingThere(packed(self._catalog), told, self._limits)
        scheduler = self._settings.scheduler
        assert scheduler is not None
        setup = ClusterSetup(scheduler, self._settings.resource, given)
        while True:
            try:
                await self._spoken(setup)
            except ProcessEnded as ended:
                self._seem(ClusterSeen(0, f"the process that speaks with it is gone: {ended}"))
            await asyncio.sleep(RESTART_S)

    async def _spoken(self, setup: ClusterSetup) -> None:
        """Start the process, and hear it until it ends. Raises `ProcessEnded`."""
        link = ProcessLink.start(RELAY)
        try:
            await self._send(link, setup)
            self._sent.clear()
            self._link = link
            while True:
                match await link.receive():
                    case Relayed(number=number) as relayed:
                        answer = self._answers.get(number)
                        if answer is not None and not answer.done():
                            answer.set_result(relayed)
                    case ClusterSeen() as seen:
                        self._seem(seen)
        finally:
            self._link = None
            link.kill()
            for answer in self._answers.values():
                if not answer.done():
                    answer.set_exception(ProcessEnded(f"process {link.pid}"))
            await asyncio.shield(link.close())

    def _seem(self, seen: ClusterSeen) -> None:
        if seen == self._seen:
            return
        before, self._seen = self.state, seen
        if self.state != before:
            (_log.info if seen.workers else _log.warning)("cluster: %s", self.state)
            self._tell("solver", {"process": "cluster", "state": self.state})

    def _died(self, fault: Exception) -> None:
        self._seem(ClusterSeen(0, fault_words(fault)))
        self._runner = None
