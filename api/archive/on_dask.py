"""The same chunks on Dask's workers, each with a warm solving process, into the same store.

What crosses the network is the number of a chunk and its counts. So workers need the archive's folder and
the frames under the same names, as a shared file system gives them, and the same mountnav. When a worker dies
Dask gives its chunk to another one; when the scheduler or this client dies, what is finished is in the store.
"""

from __future__ import annotations

import asyncio
import atexit
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from api.archive.chosen import Prepared, prepared_for
from api.archive.solving import ChunkSolver, Progress, Tell
from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.store import Result
from mountnav.archive.work_list import Chunk, WorkList
from mountnav.errors import DeviceMissing, MountnavError, StoreFailed
from mountnav.extras import extra

if TYPE_CHECKING:
    from distributed import Client

AHEAD = 2
"""Chunks for each thread of a worker that Dask knows of: one in work, one that follows. Doubled, a chunk of
higher priority that comes later waits longer."""

RETRIES = 3
"""Of a chunk that failed, on whatever worker; one whose worker died is tried as often as Dask's own setting
``distributed.scheduler.allowed-failures`` says. Doubled, a full disk is noticed twice as late."""

CONNECT_S = 30.0
"""Until a scheduler has to answer. Doubled, a wrong address is noticed twice as late."""


_LOGGERS = ("distributed", "distributed.client")
"""Dask's own, whose levels its configuration sets one by one."""


def solve_on_dask(
    folder: Folder,
    run: RunFolder,
    chunks: list[Chunk],
    *,
    jobs: int,
    scheduler: str | None,
    tell: Tell = lambda progress: None,
    say: Any = lambda text: None,
) -> Progress:
    """Solve all chunks that are not done yet.

    Parameters
    ----------
    jobs : int
        Workers of a local cluster, where no scheduler is named.
    scheduler : str or None
        Address of one that is there.
    say : callable
        Told where the dashboard is.

    Raises
    ------
    DeviceMissing
        The scheduler doesn't answer, or went away.
    MountnavError
        A chunk failed on each worker that tried it.
    """
    with extra("dask", "Dask's workers"):
        from distributed import Client, as_completed

    prepared = prepared_for(run)  # what can't be solved here is told before any worker is asked
    prepared.index()
    done = run.done()
    wanted = [chunk for chunk in chunks if chunk.number not in done]
    progress = Progress(len(wanted), sum(chunk.frames for chunk in wanted))
    if not wanted:
        return progress
    run.make()
    where, name = str(folder.path.absolute()), run.name
    with _client(Client, jobs, scheduler) as client:
        if scheduler is not None or _dashboard():
            say(f"dashboard: {client.dashboard_link}")
        waiting = iter(wanted)

        def submitted(chunk: Chunk) -> Any:
            return client.submit(
                solved_there,
                where,
                name,
                chunk.number,
                key=f"mountnav-{name}-{chunk.number}",
                pure=False,
                retries=RETRIES,
                priority=chunk.priority,
            )

        threads = max(1, sum(client.nthreads().values()) or jobs)
        first = [submitted(chunk) for _, chunk in zip(range(AHEAD * threads), waiting, strict=False)]
        running = as_completed(first, loop=client.loop)
        fault: BaseException | None = None
        for future in running:
            try:
                told = future.result()
            except Exception as error:
                fault = fault or error
                break
            if told is None:
                progress.left += 1
            else:
                progress.chunks += 1
                progress.counts.plus(told)
            tell(progress)
            if (following := next(waiting, None)) is not None:
                running.add(submitted(following))
        if fault is not None:
            raise _told(fault, scheduler) from fault
        if progress.chunks + progress.left < len(wanted):
            raise _gone(scheduler)  # what was asked for was forgotten
    return progress


@contextmanager
def _client(kind: type[Client], jobs: int, scheduler: str | None) -> Iterator[Client]:
    """A client, and where no scheduler is named a cluster of its own."""
    # what concerns the user is told by us, in a line; Dask tells a lost line in a hundred
    before = [(logger, logger.level) for logger in map(logging.getLogger, _LOGGERS)]
    for logger, _ in before:
        logger.setLevel(logging.CRITICAL)
    try:
        if scheduler is not None:
            with kind(scheduler, timeout=CONNECT_S, set_as_default=False) as client:
                if not client.nthreads():
                    client.wait_for_workers(1, timeout=CONNECT_S)
                yield client
            return
        from distributed import LocalCluster

        shown = ":8787" if _dashboard() else None
        with (
            LocalCluster(
                n_workers=jobs, threads_per_worker=1, dashboard_address=shown, silence_logs=logging.ERROR
            ) as cluster,
            kind(cluster, set_as_default=False) as client,
        ):
            yield client
    except (OSError, TimeoutError) as fault:
        raise DeviceMissing(
            f"the scheduler doesn't answer: {fault}",
            device=scheduler or "Dask",
            advice="is it running, with workers? then give the same command again: nothing is lost",
        ) from fault
    finally:
        for logger, level in before:
            logger.setLevel(level)


def _dashboard() -> bool:
    """Whether there is what draws it."""
    return find_spec("bokeh") is not None


def _gone(scheduler: str | None) -> DeviceMissing:
    return DeviceMissing(
        "the scheduler went away",
        device=scheduler or "Dask",
        advice="start it and its workers, and give the same command again: finished chunks are in the store",
    )


def _told(fault: BaseException, scheduler: str | None) -> MountnavError:
    from distributed.client import FutureCancelledError
    from distributed.comm import CommClosedError

    if isinstance(fault, MountnavError):
        return fault
    # a lost line is an OSError, too; that of a worker's disk has a number
    if isinstance(fault, CommClosedError | FutureCancelledError):
        return _gone(scheduler)
    kind = type(fault).__name__
    if isinstance(fault, OSError):
        return StoreFailed(
            f"a worker can't write or read: {fault.strerror or fault}", advice="free some space"
        )
    return DeviceMissing(
        f"Dask gave up a chunk: {kind}: {str(fault)[:300]}",
        device="Dask",
        advice="give the same command again: what is finished is in the store",
    )


# -- on a worker ---------------------------------------------------------------------------------------------


_GOODBYE_S = 3.0
"""How long a worker that ends waits for its solving process; that one ends by itself, too."""


class _Warm:
    """What a worker keeps between two chunks: an event loop, and a solver for each of its threads."""

    def __init__(self) -> None:
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, name="mountnav-solvers", daemon=True).start()
        self._lock = threading.Lock()
        self._prepared: dict[str, tuple[Prepared, Path | None]] = {}
        self._free: dict[str, list[ChunkSolver]] = {}
        atexit.register(self._close)

    def _close(self) -> None:
        """End the processes as this one ends."""

        async def closed() -> None:
            for solvers in self._free.values():
                while solvers:
                    await solvers.pop().close()

        with suppress(TimeoutError):
            asyncio.run_coroutine_threadsafe(closed(), self._loop).result(_GOODBYE_S)

    def solved(self, run: RunFolder, chunk: Chunk) -> dict[str, int] | None:
        """Solve a chunk; its counts, or None if another worker has it."""
        from mountnav.archive.store import Counts

        counts = Counts()

        def told(result: Result) -> None:
            counts.add(result.outcome)

        async def carried_out() -> bool:
            solver = self._taken(run)
            try:
                done = await solver.chunk(run, chunk, told)
            except BaseException:
                await solver.close()
                raise
            self._free[str(run.path)].append(solver)
            return done

        if not asyncio.run_coroutine_threadsafe(carried_out(), self._loop).result():
            return None
        return {name: getattr(counts, name) for name in Counts.__slots__}

    def prepare(self, run: RunFolder) -> None:
        """Open catalogs and index, once for each run; and check that the results will be the same."""
        with self._lock:
            if str(run.path) not in self._prepared:
                prepared = prepared_for(run)
                self._prepared[str(run.path)] = prepared, prepared.index()
                self._free[str(run.path)] = []

    def _taken(self, run: RunFolder) -> ChunkSolver:
        free = self._free[str(run.path)]
        return free.pop() if free else ChunkSolver(*self._prepared[str(run.path)])


_WARM: list[_Warm] = []
_MAKING = threading.Lock()


def solved_there(archive: str, run_name: str, number: int) -> dict[str, int] | None:
    """Solve a chunk on the worker that this runs on; its counts, or None if another one has it."""
    folder = Folder.open(Path(archive))
    run = folder.run(run_name)
    if run.chunk(number).exists():
        # a worker that died had finished it, or the client that asked was another one
        from mountnav.archive.store import Counts, read_counts

        told = read_counts(run, number)
        return {name: int(told[name]) for name in Counts.__slots__}
    chunk = WorkList.open(folder).chunks[number]
    with _MAKING:
        if not _WARM:
            _WARM.append(_Warm())
    _WARM[0].prepare(run)
    return _WARM[0].solved(run, chunk)
