"""A run of `mountnav solve` over many frames: progress, interrupts, and what is said at the end."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Coroutine, Iterator
from contextlib import AbstractContextManager, aclosing, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mountnav.errors import BadSettings

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from api.batch.outcomes import Outcome
    from api.batch.pool import Pool
    from api.batch.result_files import Held
    from api.batch.writing import Writing
    from api.cli.solve import FileSolver
    from mountnav.catalog.catalog_set import CatalogSet
    from mountnav.frames import Hint
    from mountnav.solving.settings import SolveSettings

INTERRUPTED = 130
"""Exit code of a command that was interrupted from the terminal, as shells count: 128 + SIGINT."""
FAULTS_SHOWN = 20
"""Of what couldn't be written, so many are told in full; a full disk has one for each frame."""


class Run:
    """One run over files.

    Parameters
    ----------
    writing : Writing
        Where each outcome goes.
    hdu : int or str or None
        Which extension; "all".
    """

    def __init__(self, writing: Writing, files: list[Path], hdu: int | str | None) -> None:
        self._writing, self._files, self._hdu = writing, files, hdu
        self._began_s = time.monotonic()
        self._meter: _Meter | None = None

    def one_by_one(self, solver: FileSolver, held: Held | None) -> int:
        """Solve in this process, one frame after the other; the exit code."""
        with self._measured(), _Interrupts() as interrupts:
            try:
                for outcome in self._solved_here(solver, held):
                    with interrupts.later():
                        self._add(outcome)
            except KeyboardInterrupt:
                return self._ended(interrupted=True)
            except BaseException:
                self._writing.close()
                raise
        return self._ended()

    def _solved_here(self, solver: FileSolver, held: Held | None) -> Iterator[Outcome]:
        from api.batch.inputs import frames_of
        from api.batch.outcomes import Outcome, sha256_of
        from api.cli.output import unreadable

        for path in self._files:
            for frame in frames_of(path, self._hdu):
                try:
                    sha256 = "" if held is None else sha256_of(path)
                except OSError as error:
                    yield Outcome(frame, unread=unreadable(error))
                    continue
                known = None if held is None else held.solved(sha256, frame)
                if known is not None:
                    yield Outcome(frame, sha256=sha256, held=known)
                else:
                    yield solver.outcome(frame, sha256)

    def side_by_side(
        self, catalog: CatalogSet, hint: Hint | None, settings: SolveSettings, jobs: int, held: Held | None
    ) -> int:
        """Solve in processes of their own; the exit code.

        Raises
        ------
        BadSettings
            Only the whole sky is to be searched, and the index for it can't be built.
        """
        import asyncio  # expensive, and a run of one process does without

        from api.batch.pool import Pool
        from api.cli.solve import open_or_build_index

        index, note = None, ""
        if settings.blind != "never":
            try:
                index = open_or_build_index(catalog.indexed).path
            except BadSettings as refused:
                if settings.blind == "only":
                    raise
                note = f"the whole sky was not searched: {refused}"
        settings = replace(settings, index=None)
        pool = Pool(catalog, jobs=jobs, hint=hint, settings=settings, index=index, note=note, held=held)
        with self._measured():
            try:
                asyncio.run(self._taken(pool))
            except KeyboardInterrupt:
                return self._ended(interrupted=True)
            except BaseException:
                self._writing.close()
                raise
        return self._ended()

    async def _taken(self, pool: Pool) -> None:
        import asyncio

        async with aclosing(pool.outcomes(self._files, self._hdu)) as outcomes:
            async for outcome in outcomes:
                # in a thread: the processes are served meanwhile; to its end, no matter who interrupts
                await _to_the_end(asyncio.to_thread(self._add, outcome))

    def _add(self, outcome: Outcome) -> None:
        self._writing.add(outcome)
        if self._meter is not None:
            self._meter.count(outcome)

    def _ended(self, *, interrupted: bool = False) -> int:
        """Write the rest, say what came of it; the exit code."""
        self._writing.close()
        summary = self._writing.summary
        for fault in summary.faults[:FAULTS_SHOWN]:
            sys.stderr.write(f"mountnav: {fault}\n")
        if summary.frames > 1 or summary.held or interrupted:
            words = summary.words(time.monotonic() - self._began_s, interrupted=interrupted)
            sys.stderr.write(f"{words}\n")
        return INTERRUPTED if interrupted else 0 if summary.all_well else 1

    def _measured(self) -> AbstractContextManager[object]:
        """A bar for people; nothing for a pipe, nor for one frame."""
        if len(self._files) < 2 or not sys.stderr.isatty():
            return nullcontext()
        self._meter = _Meter(self._files)
        return self._meter.shown()


class _Meter:
    """The bar: files done, files left, how many of them unsolved."""

    def __init__(self, files: list[Path]) -> None:
        self._total = len(files)
        self._last: Path | None = None
        self._failed = 0
        self._progress: Progress | None = None
        self._task: TaskID | None = None

    @contextmanager
    def shown(self) -> Iterator[None]:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        self._progress = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=sys.stdout.isatty(),  # else it is a file, and none of the bar's business
        )
        self._task = self._progress.add_task("", total=self._total)
        with self._progress:
            yield

    def count(self, outcome: Outcome) -> None:
        assert self._progress is not None
        assert self._task is not None
        self._failed += not outcome.solved
        step = outcome.frame.path != self._last
        self._last = outcome.frame.path
        words = f"[red]{self._failed} not solved[/red]" if self._failed else ""
        self._progress.update(self._task, advance=int(step), description=words)


class _Interrupts:
    """Ctrl-C ends a solve at once, but lets what is being written come to its end."""

    def __init__(self) -> None:
        self._writing = self._came = False
        self._before: Any = None

    def __enter__(self) -> _Interrupts:
        self._before = signal.signal(signal.SIGINT, self._interrupt)
        return self

    def __exit__(self, *fault: object) -> None:
        signal.signal(signal.SIGINT, self._before)

    @contextmanager
    def later(self) -> Iterator[None]:
        self._writing = True
        try:
            yield
        finally:
            self._writing = False
        if self._came:
            raise KeyboardInterrupt

    def _interrupt(self, number: int, frame: object) -> None:
        self._came = True
        if not self._writing:
            raise KeyboardInterrupt


async def _to_the_end(work: Coroutine[Any, Any, None]) -> None:
    """Wait for a thread's work even when this task is cancelled meanwhile; then be cancelled."""
    import asyncio

    from mountnav.tasks import waited_for

    task = waited_for(work)
    try:
        await asyncio.shield(task)
    except asyncio.CancelledError:
        await asyncio.wait({task})
        raise
