"""Frames solved side by side in processes of their own, answered in the order in which they were named.

Each process is a `Worker` of the service: it maps the catalog and the index, which so exist once in memory,
is ended when a frame hangs it or takes too much, and is replaced.
"""

from __future__ import annotations

import asyncio
import os
from collections import deque
from collections.abc import AsyncGenerator, Iterator
from dataclasses import replace
from pathlib import Path

from api.batch.inputs import FrameFile, frames_of
from api.batch.outcomes import Outcome, sha256_of
from api.batch.result_files import Held
from api.http.file_names import shown
from api.solver.link import Upload, Work
from api.solver.worker import Worker
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, DeviceError
from mountnav.files import open_plain
from mountnav.frames import Hint
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.settings import SolveSettings
from mountnav.tasks import waited_for

AHEAD = 100
"""Frames for each process that may be done before an earlier one is. A hopeless one takes as long as a
hundred others. Doubled, twice as many answers wait in memory, some 0.1 MB each."""


class Pool:
    """Processes that solve.

    Parameters
    ----------
    jobs : int
        How many processes.
    settings : SolveSettings
        Without an index.
    index : Path or None
        Of the whole sky.
    note : str
        For each frame that isn't solved; empty for none.
    held : Held or None
        What needn't be solved again; None: nothing is hashed.
    """

    def __init__(
        self,
        catalog: Catalog,
        *,
        jobs: int,
        hint: Hint | None,
        settings: SolveSettings,
        index: Path | None,
        note: str = "",
        held: Held | None = None,
    ) -> None:
        self._workers = [Worker(catalog, _to_nobody, niceness=0, many=True) for _ in range(jobs)]
        self._free: asyncio.Queue[Worker] = asyncio.Queue()
        self._hashing = asyncio.Semaphore(jobs + 1)
        self._hint, self._settings, self._index, self._note = hint, settings, index, note
        self._held = held

    async def outcomes(self, files: list[Path], hdu: int | str | None) -> AsyncGenerator[Outcome]:
        """Solve the files; in order."""
        for worker in self._workers:
            worker.open(self._index)
            self._free.put_nowait(worker)
        frames = _frames(files, hdu)
        pending: deque[asyncio.Task[Outcome]] = deque()
        try:
            while True:
                while len(pending) < AHEAD * len(self._workers):
                    frame = await asyncio.to_thread(next, frames, None)
                    if frame is None:
                        break
                    pending.append(waited_for(self._outcome(frame)))
                if not pending:
                    return
                yield await pending.popleft()
        finally:
            for task in pending:
                task.cancel()
            await asyncio.gather(*pending, return_exceptions=True)
            await asyncio.gather(*(worker.close() for worker in self._workers))

    async def _outcome(self, frame: FrameFile) -> Outcome:
        sha256 = ""
        try:
            if self._held is not None:
                async with self._hashing:
                    sha256 = await asyncio.to_thread(sha256_of, frame.path)
                if (known := self._held.solved(sha256, frame)) is not None:
                    return Outcome(frame, sha256=sha256, held=known)
            verdict = await self._verdict(frame)
        except OSError as error:
            return Outcome(frame, unread=f"the file can't be read: {error.strerror or error}", sha256=sha256)
        except DeviceError as error:
            return Outcome(frame, unread=str(error), sha256=sha256)
        if self._note and verdict.solution is None:
            verdict = replace(verdict, notes=(*verdict.notes, self._note))
        return Outcome(frame, verdict, sha256=sha256)

    async def _verdict(self, frame: FrameFile) -> Verdict:
        worker = await self._free.get()
        try:
            with open_plain(frame.path) as file:
                name = shown(Path(frame.path.name))
                upload = Upload(name, os.dup(file.fileno()), hdu=frame.hdu)
            try:
                work = Work(upload, self._hint, self._settings, self._index)
                return await worker.solve(work, first=False)
            except BadFrame as fault:
                return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times())
            finally:
                os.close(upload.file)
        finally:
            self._free.put_nowait(worker)


def _frames(files: list[Path], hdu: int | str | None) -> Iterator[FrameFile]:
    for path in files:
        yield from frames_of(path, hdu)


def _to_nobody(kind: str, data: dict[str, object]) -> None:
    """The log has what becomes of the processes."""
