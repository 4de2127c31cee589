"""A pool of solving processes that all telescopes and uploads share."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from api.solver.limits import Limits
from api.solver.link import Upload, Work
from api.solver.turns import Turns
from api.solver.worker import Tell, Worker
from mountnav.catalog.stars import Catalog
from mountnav.errors import MountnavError
from mountnav.frames import Frame
from mountnav.solution import Verdict
from mountnav.tasks import begun

IDLE_S = 600.0
"""A process besides the first is ended after so long without a frame: 130 MB. The next one waits 2 to 5 s."""


class Pool:
    """Solves in several processes, each of them one frame at a time.

    The first process stays; the others are started when all before them are busy. Each is a `Worker`:
    bounded, put in place again when it dies, replaced when it holds too much.

    Parameters
    ----------
    catalog : Catalog
        Opened in each process again: it must come through a pickle.
    tell : callable
        ``tell(kind, data)``: told what becomes of the processes.
    size : int
        Most processes; 2 at least.
    limits : Limits, optional
        What each of them may take.
    idle_s : float
        See `IDLE_S`.
    """

    def __init__(
        self,
        catalog: Catalog,
        tell: Tell,
        *,
        size: int,
        limits: Limits | None = None,
        idle_s: float = IDLE_S,
    ) -> None:
        self._workers = tuple(
            Worker(catalog, _of_one(tell, number), limits=limits, idle_s=idle_s if number else None)
            for number in range(size)
        )
        self._free = list(self._workers)
        self._turns = Turns(size)
        self._seeking = 0
        self._starting: set[Worker] = set()
        self._failed: set[Worker] = set()
        self._news = asyncio.Event()

    @property
    def state(self) -> str:
        """Of the best of the processes: "starting", "ready", "solving", or "failed: " and why."""
        states = [one.state for one in self._workers if one.state not in ("not started", "asleep")]
        for good in ("solving", "ready"):
            if good in states:
                return good
        return states[0] if states else self._workers[0].state

    @property
    def told(self) -> str:
        """For people: how many processes there are, and how many frames wait."""
        alive = sum(one.pid is not None for one in self._workers)
        return f"{alive} of {len(self._workers)} processes, {self._turns.waiting} frames wait"

    @property
    def pids(self) -> tuple[int, ...]:
        """Of the processes that are there."""
        return tuple(one.pid for one in self._workers if one.pid is not None)

    def open(self, index: Path | None) -> None:
        """Start the first process in the background, with the index that is known to exist. Twice is fine."""
        for one in self._workers:
            one.open(index)

    async def close(self) -> None:
        """End the processes; those who wait are told that the service goes down."""
        await asyncio.gather(*(one.close() for one in self._workers))
        self._failed.update(self._free)  # who still waits for one is told by it that the service goes down
        self._tell_news()

    async def solve(self, work: Work, *, first: bool, owner: str = "") -> Verdict:
        """Solve, once it is its turn.

        Parameters
        ----------
        first : bool
            Whether it is a look, which goes before uploads.
        owner : str
            Whose it is: owners share the pool evenly.

        Raises
        ------
        DeviceError
            Processes died of this frame twice, or can't be started.
        Exception
            What `solve` itself raised there.
        """
        async with self._process(owner, first=first) as worker:
            return await worker.solve(work, first=first)

    async def read(self, upload: Upload, *, owner: str = "") -> Frame:
        """Read a file there, where it can do no harm; its turn comes as that of an upload.

        Raises
        ------
        BadFrame
            It is no usable image.
        DeviceError
            Processes died of this file twice, or can't be started.
        """
        async with self._process(owner, first=False) as worker:
            return await worker.read(upload)

    @asynccontextmanager
    async def _process(self, owner: str, *, first: bool) -> AsyncIterator[Worker]:
        """One of the processes, for one frame."""
        await self._turns.take(owner, first=first)
        try:
            worker = await self._taken()
        except BaseException:
            self._turns.give_back(owner, first=first, used_s=0.0)
            raise
        began_s = time.monotonic()

        def given_back() -> None:
            self._free.append(worker)
            self._free.sort(key=self._workers.index)
            self._tell_news()
            self._turns.give_back(owner, first=first, used_s=time.monotonic() - began_s)

        async def later() -> None:
            try:
                await worker.at_rest()
            finally:
                given_back()

        try:
            yield worker
        finally:
            # one that is being ended or replaced would keep the next frame waiting; others may be free
            if worker.is_at_rest:
                given_back()
            else:
                begun(later(), "pool", died=lambda _: None)

    async def _taken(self) -> Worker:
        """A process that is free and warm.

        Where none is, one more is started, and the first that is free serves: a process needs seconds to get
        warm, and most frames a tenth of one.
        """
        self._seeking += 1
        try:
            while True:
                warm = next((one for one in self._free if one.pid is not None and one.is_at_rest), None)
                failed = next((one for one in self._free if one in self._failed), None)
                if warm is None and failed is not None:
                    self._failed.discard(failed)
                    warm = failed  # who asks it is told why it can't be started
                if warm is not None:
                    self._free.remove(warm)
                    return warm
                cold = next((one for one in self._free if one not in self._starting), None)
                if cold is not None and len(self._starting) < self._seeking:
                    self._starting.add(cold)
                    begun(self._warmed_up(cold), "pool", died=lambda _: None)
                await self._news.wait()
        finally:
            self._seeking -= 1

    async def _warmed_up(self, worker: Worker) -> None:
        try:
            await worker.warm_up()
            await worker.at_rest()
        except Exception as fault:
            from api.problems import Refused  # brings FastAPI, which commands that solve do without

            if not isinstance(fault, MountnavError | Refused):
                raise
            self._failed.add(worker)
        finally:
            self._starting.discard(worker)
            self._tell_news()

    def _tell_news(self) -> None:
        """A process is free, or can't be had: who waits looks again."""
        self._news.set()
        self._news = asyncio.Event()


def _of_one(tell: Tell, number: int) -> Tell:
    """What is told of a process says which of the pool it is."""
    return lambda kind, data: tell(kind, data | {"process": f"pool {number + 1}"})
