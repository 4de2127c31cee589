"""The service's solver: a warm process or threads, with the index of the blind search once it is there."""

from __future__ import annotations

import asyncio
import os
import time
from dataclasses import replace
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING

from api.solver.blind_index import BlindIndexKeeper
from api.solver.cluster import Cluster
from api.solver.limits import Limits
from api.solver.link import Upload, Work
from api.solver.pool import Pool
from api.solver.worker import Tell, Worker
from mountnav.catalog.stars import Catalog
from mountnav.frames import Frame, Hint
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings
from mountnav.tasks import begun

if TYPE_CHECKING:
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.navigation.equipment import Solve
    from mountnav.settings.solver import SolverSettings

UPLOADS_AT_ONCE = 2
"""Without a worker, in threads; looks never wait for uploads."""

UPLOADS_PRIORITY = 10
"""Of the process for uploads, as `nice` counts: on one core a look gets three times its share."""

UPLOADS_IDLE_S = 600.0
"""The process for uploads is ended after so long without one: 130 MB. The next one waits 2 to 5 s."""


class Solver:
    """Solves for the navigators and for uploads. Fulfills `mountnav.navigation.equipment.Solve`.

    Parameters
    ----------
    worker : bool
        In processes of their own: one for looks, and one for uploads while there are any, so that no look
        waits for what a stranger sent; else in threads of this one.
    tell : callable
        ``tell(kind, data)``: told of what becomes of the process and of the index.
    build_early : bool
        Have the index built when the solver opens, not when the first frame needs it, which may be at night.
    limits : Limits, optional
        What each of the processes may take.
    looks : bool
        Without it there are only uploads: their process is warm from the start, stays, and has the priority
        of looks.
    uploads_wait : bool
        Keep the process for uploads warm from the beginning: programs wait for it each time.
    engine : SolverSettings, optional
        Where frames are solved; by one process for looks and one for uploads if left out.
    """

    def __init__(
        self,
        catalog: Catalog,
        *,
        worker: bool,
        tell: Tell,
        build_early: bool = False,
        limits: Limits | None = None,
        looks: bool = True,
        uploads_wait: bool = False,
        engine: SolverSettings | None = None,
    ) -> None:
        self._uploads_wait = uploads_wait
        self._build_early = build_early
        self.blind_index = BlindIndexKeeper(catalog, tell)
        self.pool: Pool | None = None
        self.cluster: Cluster | None = None
        if engine is not None and engine.engine != "process":
            self.pool = Pool(catalog, tell, size=engine.workers, limits=limits)
            worker = False
            if engine.engine == "dask":
                self.cluster = Cluster(catalog, tell, settings=engine, pool=self.pool, limits=limits)
        self.worker = Worker(catalog, tell, limits=limits) if worker and looks else None
        self.uploads: Worker | None = None
        if worker and not looks:
            self.uploads = Worker(catalog, tell, limits=limits, niceness=0)
        elif worker:
            self.uploads = Worker(
                catalog,
                _of_uploads(tell),
                limits=limits,
                niceness=UPLOADS_PRIORITY,
                idle_s=None if uploads_wait else UPLOADS_IDLE_S,
            )
        self._threads = Threads(catalog)
        self._opening: asyncio.Task[None] | None = None

    @property
    def state(self) -> str:
        """Of the worker: "starting", "ready", "solving", "failed: ..."; "in this process" without one."""
        if self.pool is not None:
            return self.pool.state
        first = self.worker or self.uploads
        return "in this process" if first is None else first.state

    @property
    def engine(self) -> str:
        """For people and programs: "process", "pool: 1 of 4 processes, ...", "dask: 3 workers"."""
        if self.cluster is not None:
            return f"dask: {self.cluster.state}"
        return "process" if self.pool is None else f"pool: {self.pool.told}"

    @property
    def concern(self) -> str | None:
        """What an operator should look into, though frames are solved."""
        return None if self.cluster is None else self.cluster.concern

    def of(self, owner: str) -> Solve:
        """The solver for the looks of one telescope, which shares it evenly with the others."""

        async def solve(frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
            return await self._solved(Work(frame, hint, settings), first=True, owner=owner)

        return solve

    def open(self) -> None:
        """Begin to get ready, in the background."""
        if self._opening is None:
            # without an index or a warm process it solves all the same, later
            self._opening = begun(self._open(), "solver opening", died=lambda _: None)

    async def close(self) -> None:
        """End the worker, and the building of the index if it is going on."""
        if self._opening is not None:
            await asyncio.gather(self._opening, return_exceptions=True)
        await self.blind_index.close()
        if self.cluster is not None:
            await self.cluster.close()
        if self.pool is not None:
            await self.pool.close()
        for worker in (self.worker, self.uploads):
            if worker is not None:
                await worker.close()

    async def __call__(self, frame: Frame, hint: Hint, settings: SolveSettings) -> Verdict:
        """Solve a look's frame, before any upload that waits."""
        return await self._solved(Work(frame, hint, settings), first=True)

    async def solve_upload(
        self, upload: Upload, hint: Hint | None, settings: SolveSettings, *, owner: str = ""
    ) -> Verdict:
        """Solve an upload, once it is its turn.

        Parameters
        ----------
        owner : str
            Who sent it: a pool is shared evenly.

        Raises
        ------
        BadFrame
            It is no usable image.
        """
        return await self._solved(Work(upload, hint, settings), first=False, owner=owner)

    async def read_upload(self, upload: Upload) -> Frame:
        """Read an upload, raw, where it can do no harm.

        Raises
        ------
        BadFrame
            It is no usable image.
        """
        if self.pool is not None:
            return await self.pool.read(upload)
        if self.uploads is not None:
            return await self.uploads.read(upload)
        return await asyncio.to_thread(_read, os.dup(upload.file), upload.name)

    async def _solved(self, work: Work, *, first: bool, owner: str = "") -> Verdict:
        """Solve; wait for the index only if the frame needs it, and no longer than the budget."""
        self.open()
        assert self._opening is not None
        await asyncio.wait({self._opening})
        settings = work.settings
        if settings.blind == "never":
            return await self._carried_out(work, first=first, owner=owner)
        began = time.monotonic()
        index = self.blind_index.path
        if index is None and settings.blind == "only":
            index = await self.blind_index.wait(settings.budget_s)
        if index is None and self.blind_index.may_come:
            # once in an installation's life: half of the time stays for the index and what it finds
            work = replace(work, settings=replace(settings, budget_s=0.5 * settings.budget_s))
        verdict = await self._carried_out(replace(work, index=index), first=first, owner=owner)
        if index is not None or verdict.reason is None or not verdict.reason.whole_sky_may_help:
            return verdict
        index = await self.blind_index.wait(settings.budget_s - (time.monotonic() - began))
        if index is None:
            told = f"the whole sky was not searched: the blind index is {self.blind_index.state}"
            return replace(verdict, notes=(*verdict.notes, told))
        return await self._carried_out(replace(work, index=index), first=first, owner=owner)

    async def _carried_out(self, work: Work, *, first: bool, owner: str) -> Verdict:
        if self.cluster is not None and first:
            return await self.cluster.solve(work, owner=owner)
        if self.pool is not None:
            return await self.pool.solve(work, first=first, owner=owner)
        worker = self.worker if first else self.uploads
        if worker is None:
            return await self._threads.solve(work, first=first)
        return await worker.solve(work, first=first)

    async def _open(self) -> None:
        await self.blind_index.find()
        first = self.worker or self.uploads
        if first is not None:
            first.open(self.blind_index.path)
        if self.pool is not None:
            self.pool.open(self.blind_index.path)
        if self.cluster is not None:
            self.cluster.open()
        if self.uploads is not None and self._uploads_wait:
            self.uploads.open(self.blind_index.path)
        if self._build_early:
            await self.blind_index.wait(0.0)


def _of_uploads(tell: Tell) -> Tell:
    """What is told of the process for uploads says that it is that one."""
    return lambda kind, data: tell(kind, data | {"process": "uploads"})


def _read(file: int, name: str) -> Frame:
    """Read a frame from a descriptor, which is closed then."""
    from mountnav.reading import read_frame  # with a worker the service itself never reads uploads

    try:
        return read_frame(Path(f"/proc/self/fd/{file}"), name=name, raw=True)
    finally:
        os.close(file)


class Threads:
    """Solves in threads of this process: no process to start, but the service shares its core with it."""

    def __init__(self, catalog: Catalog) -> None:
        self._catalog = catalog
        self._uploads = asyncio.Semaphore(UPLOADS_AT_ONCE)
        self._index: BlindIndex | None = None

    async def solve(self, work: Work, *, first: bool) -> Verdict:
        """Solve. A caller that is cancelled is free at once; the thread goes on to its end."""
        if first:
            return await asyncio.to_thread(self._solve, work, None)
        assert isinstance(work.source, Upload)
        async with self._uploads:
            # the thread's own, since it may outlive the caller, who closes his
            file = os.fdopen(os.dup(work.source.file), "rb", buffering=0)
            return await asyncio.to_thread(self._solve, work, file)

    def _solve(self, work: Work, file: FileIO | None) -> Verdict:
        # imported late: with a worker the service itself never solves
        from api.solver.process import solved_upload
        from mountnav.solving.solve import solve

        settings = replace(work.settings, index=self._opened(work.index))
        if not isinstance(work.source, Upload):
            return solve(work.source, self._catalog, hint=work.hint, settings=settings)
        assert file is not None
        with file:
            source = work.source
            return solved_upload(
                file.fileno(),
                source.name,
                self._catalog,
                work.hint,
                settings,
                stars=source.stars,
                hdu=source.hdu,
            )

    def _opened(self, path: Path | None) -> BlindIndex | None:
        from mountnav.identification.blind.index import BlindIndex

        if path is None:
            return None
        if self._index is None or self._index.path != path:
            self._index = BlindIndex.open(path)
        return self._index
