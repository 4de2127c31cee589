"""Chunks solved in lanes: each lane has one warm process, one chunk, and the next frame read ahead.

A frame has a deadline. One that doesn't answer by then, or that ends its process, has the process replaced
and is tried once more; then it is set aside, and the lane goes on. One frame a lane is read ahead, so that a
slow process makes its lane wait, and nothing piles up.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import signal
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from api.archive.chosen import Prepared
from api.archive.fetching import Fetched, fetched, is_remote
from api.http.file_names import shown
from api.solver.limits import Limits
from api.solver.link import ProcessEnded, Upload, Work
from api.solver.worker import Worker
from mountnav.archive.folder import RunFolder
from mountnav.archive.store import DIED, FAULT, HUNG, UNREAD, Counts, Result, chunk_written, claimed
from mountnav.archive.work_list import Chunk, Entry
from mountnav.errors import BadFrame, BadSettings, DeviceError, DeviceMissing, MountnavError
from mountnav.frames import Hint
from mountnav.solution import Reason, Times, Verdict
from mountnav.solving.solve import merged_hint
from mountnav.tasks import Crew, waited_for

_log = logging.getLogger(__name__)

TRIES = 2
"""Of a frame that hangs or ends its process; the second one is in a process that was started anew."""

MOST_KILLS = 5
"""Times that the process may be killed (SIGKILL) over a frame before the frame is to blame: an operator or a
scheduler kills whatever is under way, and the kernel, when memory is out, may hit it for another's sake. With
fewer a busy killer makes an innocent frame look like poison; doubled, poison that fills the memory does so
twice as often."""

PAUSE_S = 2.0
"""Before a file that couldn't be read is tried again, s: a network's hiccup is over by then, a missing file
costs no more. Doubled, a list of names that are all wrong takes twice as long."""

MOST_UNREAD_RUNNING = 20
"""Frames in a row that the storage fails on before the chunk is given up: it is the storage's fault then, and
nobody wants a chunk of such. Doubled, that shows after twice as many."""

_CHANGING = "the file is being written: it changed while it was read, in each of 2 tries"

_KILLED = "KILLED"
"""For now: from outside, it seems."""

_OWN_FAULTS = (
    errno.ENOENT,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.EACCES,
    errno.EPERM,
    errno.EINVAL,
    errno.ENAMETOOLONG,
    errno.ELOOP,
    errno.EFBIG,
)
"""Errors that are the file's own: no second try makes it better. All else is the storage's."""


@dataclass(slots=True)
class Progress:
    """What has been done since this command began.

    Attributes
    ----------
    counts : Counts
        Of all frames, those of unfinished chunks too.
    chunks : int
        Finished.
    left : int
        Chunks that somebody else works on.
    """

    chunks_wanted: int = 0
    frames_wanted: int = 0
    chunks: int = 0
    left: int = 0
    counts: Counts = field(default_factory=Counts)
    began_s: float = field(default_factory=time.monotonic)


Tell = Callable[[Progress], object]


class ChunkSolver:
    """Solves chunks with one process. Opened in the event loop that it works in.

    Parameters
    ----------
    index : Path or None
        Of the whole sky.
    limits : Limits, optional
        What the process may take.
    """

    def __init__(self, prepared: Prepared, index: Path | None, limits: Limits | None = None) -> None:
        self._prepared, self._index, self._limits = prepared, index, limits
        self._worker: Worker | None = None
        self._ready = asyncio.Event()
        self._state = ""
        self._running_unread = 0

    async def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            await self._worker.close()
            self._worker = None

    async def chunk(self, run: RunFolder, chunk: Chunk, told: Callable[[Result], object]) -> bool:
        """Solve a chunk, and put it into the store; False if somebody else has it.

        Raises
        ------
        OSError
            The store can't be written.
        DeviceMissing
            The storage of the frames doesn't answer.
        BadSettings
            A catalog is damaged.
        """
        with claimed(run, chunk) as ours:
            if not ours:
                return False
            entries = await asyncio.to_thread(chunk.entries)
            with chunk_written(run, chunk, self._prepared.recipe) as writer:
                ahead: asyncio.Task[Fetched | OSError] | None = None
                try:
                    for at, entry in enumerate(entries):
                        asked_s = time.monotonic()
                        opened = await (ahead or waited_for(self._fetched(entry)))
                        waited_s = time.monotonic() - asked_s
                        following = entries[at + 1] if at + 1 < len(entries) else None
                        ahead = None if following is None else waited_for(self._fetched(following))
                        fetch_s = opened.fetch_s if isinstance(opened, Fetched) else waited_s
                        answer = await self._result(entry, opened)
                        if answer is None:
                            await asyncio.sleep(PAUSE_S)
                            answer = await self._result(entry, await self._fetched(entry))
                            answer = answer or Result(entry, code=UNREAD, why=_CHANGING)
                        result = replace(answer, fetch_s=fetch_s, waited_s=waited_s)
                        writer.add(result)
                        told(result)
                finally:
                    if ahead is not None:
                        left = await _ended(ahead)
                        if isinstance(left, Fetched):
                            left.file.close()
        return True

    async def _fetched(self, entry: Entry) -> Fetched | OSError:
        """The frame, or why it can't be read."""
        for last in (False, True):
            try:
                return await self._fetched_in_time(entry)
            except OSError as fault:
                if last or fault.errno in _OWN_FAULTS:
                    return fault
            await asyncio.sleep(PAUSE_S)
        raise AssertionError  # the last try returns

    async def _fetched_in_time(self, entry: Entry) -> Fetched:
        reading = waited_for(asyncio.to_thread(fetched, entry.file, self._prepared.deadline_s))
        # the thread goes on for as long as the server lets it; what it brings too late is thrown away
        try:
            done, _ = await asyncio.wait({reading}, timeout=self._prepared.deadline_s)
        except BaseException:
            reading.add_done_callback(_thrown_away)
            raise
        if not done:
            reading.add_done_callback(_thrown_away)
            raise OSError(errno.ETIMEDOUT, f"no answer came within {self._prepared.deadline_s:g} s")
        return reading.result()

    async def _result(self, entry: Entry, opened: Fetched | OSError) -> Result | None:
        """What became of the frame; None if it was written to meanwhile."""
        began_s = time.monotonic()
        if isinstance(opened, OSError):
            if opened.errno in _OWN_FAULTS:
                self._running_unread = 0
            else:
                self._running_unread += 1
                if self._running_unread >= MOST_UNREAD_RUNNING:
                    raise DeviceMissing(
                        f"{self._running_unread} frames in a row can't be read; the last one: "
                        f"{opened.strerror or opened}",
                        device=shown(Path(entry.file)),
                        advice="repair the storage, and give the same command again: nothing is lost",
                    )
            why = f"the file can't be read: {opened.strerror or opened}"
            return Result(entry, code=UNREAD, why=why)
        self._running_unread = 0
        try:
            tried = kills = 0
            while True:
                verdict, code, why = await self._tried(entry, opened)
                if code == _KILLED and kills < MOST_KILLS:
                    kills += 1
                    continue
                tried += 1
                if verdict is not None or tried == TRIES:
                    break
                _log.warning("%s: %s; tried again", entry.file, why)
            if not opened.unchanged():
                return None  # the hash is that of another content than the answer
            return Result(
                entry,
                opened.sha256,
                opened.size_bytes,
                verdict,
                DIED if code == _KILLED else code,
                "" if verdict is not None else f"{why}, in each of {TRIES} tries",
                tried,
                time.monotonic() - began_s,
            )
        finally:
            opened.file.close()

    async def _tried(self, entry: Entry, opened: Fetched) -> tuple[Verdict | None, str, str]:
        """A verdict, or code and words for why there is none."""
        prepared = self._prepared
        worker = await self._started()
        name = shown(Path(entry.file.rpartition("/")[2] if is_remote(entry.file) else Path(entry.file).name))
        upload = Upload(name, opened.file.fileno(), hdu=entry.hdu)
        work = Work(upload, _hint(entry, prepared.hint), prepared.settings, self._index)
        try:
            async with asyncio.timeout(prepared.deadline_s):
                return await worker.solve(work, first=False), "", ""
        except TimeoutError:
            code, why = HUNG, f"no answer within {prepared.deadline_s:g} s"
        except BadFrame as fault:
            return Verdict(None, Reason.BAD_FRAME, str(fault), 0, Times()), "", ""
        except BadSettings:
            raise  # a catalog is damaged: that is no frame's fault
        except DeviceError as fault:
            ended = fault.__cause__
            killed = isinstance(ended, ProcessEnded) and ended.signal_number == signal.SIGKILL
            code, why = _KILLED if killed else DIED, "the process that solved it died of it"
        except MountnavError as fault:
            code, why = FAULT, f"{type(fault).__name__}: {fault}"[:300]
        except Exception as fault:  # a fault of ours ends one frame, not a million
            _log.error("%s: a fault in mountnav", entry.file, exc_info=fault)
            code, why = FAULT, f"a fault in mountnav: {type(fault).__name__}: {fault}"[:300]
        await self.close()
        return None, code, why

    async def _started(self) -> Worker:
        """The process, ready for a frame: starting it is no frame's time."""
        if self._worker is None:
            self._ready.clear()
            self._worker = Worker(
                self._prepared.catalog,
                self._told,
                limits=self._limits,
                niceness=0,
                margin_s=2.0 * self._prepared.deadline_s,  # the deadline here comes first
                many=True,
                tries=1,  # they are counted here
            )
            self._worker.open(self._index)
        if not self._ready.is_set():
            await self._ready.wait()
            if self._state.startswith("failed"):
                await self.close()
                raise DeviceError(
                    f"the solving process can't be started: {self._state}",
                    device="solver",
                    advice="is there memory enough, and may this user start processes?",
                )
        return self._worker

    def _told(self, kind: str, data: dict[str, object]) -> None:
        self._state = str(data.get("state", ""))
        if self._state == "ready" or self._state.startswith("failed"):
            self._ready.set()


def _hint(entry: Entry, general: Hint | None) -> Hint | None:
    """What the list says of a frame, and where it is silent what was said of all."""
    if entry.hint is None or general is None:
        return entry.hint or general
    return replace(merged_hint(general, entry.hint), alternatives=())


async def _ended(task: asyncio.Task[Fetched | OSError]) -> Fetched | OSError | None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        return await task
    return None


def _thrown_away(task: asyncio.Task[Fetched]) -> None:
    if not task.cancelled() and task.exception() is None:
        task.result().file.close()


async def solve_chunks(
    run: RunFolder,
    chunks: Iterable[Chunk],
    prepared: Prepared,
    *,
    lanes: int,
    index: Path | None,
    tell: Tell = lambda progress: None,
    limits: Limits | None = None,
) -> Progress:
    """Solve all chunks that are not done yet, in order, so many at a time.

    Returns
    -------
    Progress
        At the end.

    Raises
    ------
    OSError, MountnavError
        As `ChunkSolver.chunk`. Chunks that are finished stay; all else is left as it was.
    """
    done = run.done()
    wanted = [chunk for chunk in chunks if chunk.number not in done]
    progress = Progress(len(wanted), sum(chunk.frames for chunk in wanted))
    waiting = iter(wanted)
    run.make()

    def told(result: Result) -> None:
        progress.counts.add(result.outcome)
        tell(progress)

    async def lane(waiting: Iterator[Chunk]) -> None:
        solver = ChunkSolver(prepared, index, limits)
        try:
            for chunk in waiting:
                if await solver.chunk(run, chunk, told):
                    progress.chunks += 1
                else:
                    progress.left += 1
                tell(progress)
        finally:
            await solver.close()

    crew = Crew()
    try:
        tasks = [crew.begin(lane(waiting), f"lane {at}") for at in range(min(lanes, len(wanted)))]
        await crew.until(*tasks)
    finally:
        await crew.end()
    return progress


def lanes_here(jobs: int) -> int:
    """How many lanes are meant: 0 is one a core that this process may use."""
    return jobs or len(os.sched_getaffinity(0))
