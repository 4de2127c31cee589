"""The warm worker: one solving process, asked in turn, looks before uploads; put in place again when it dies.

A caller that is cancelled is free at once. The process may finish the frame within a moment, so that the next
one finds it warm; after that it is ended and started again. So is one that doesn't come to an end by itself,
and one that holds much more memory after a frame than before.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from api.solver.limits import Limits
from api.solver.link import (
    ProcessEnded,
    ProcessLink,
    Reading,
    Upload,
    Work,
    empty_file,
    in_memory,
    pixels_in,
    task_of,
)
from api.solver.messages import Done, Read, Ready, Setup
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, DeviceError, MountnavError
from mountnav.frames import Frame
from mountnav.identification.budget import wall_limit_s
from mountnav.solution import Reason, Times, Verdict
from mountnav.start_up import KEPT_BYTES
from mountnav.tasks import begun, fault_words, waited_for

if TYPE_CHECKING:
    from api.problems import Refused
    from mountnav.measuring.calibration import Calibration

_log = logging.getLogger(__name__)

KEPT_BETWEEN_LOOKS_BYTES = 48 << 20
"""What the service's process may keep of the memory of its last frame until it is idle. With 128 MB it holds
50 MB more and is no faster; with nothing kept a frame of 9 Mpx costs a fifth more."""

START_S = 120.0
"""A process that isn't ready by then never will be; on the slowest computer it takes a tenth of that."""

MARGIN_S = 60.0
"""Reading and measuring on a slow computer: what a solve may take beyond its budget before it is ended."""

GRACE_S = 0.5
"""What the process may still spend on a frame that nobody waits for any more."""

GROWN_MB = 200.0
"""A process that holds so much more than when it was warm is replaced, once its answer is out. Frames leave
up to 30 MB behind; doubled, the service may hold 200 MB more than it needs."""

LOWER_PRIORITY = 5
"""Of the process, as `nice` counts: where cores are scarce, a stop and a state go before a solve."""

Tell = Callable[[str, dict[str, object]], None]
_TIMES = {1: "once", 2: "twice"}


@dataclass(slots=True, eq=False)
class _Request:
    """What is asked; without work the process is only to be there."""

    work: Work | Reading | None
    answer: asyncio.Future[Any]


@dataclass(slots=True, eq=False)
class _Warm:
    """A process that is ready, and which masters it has heard of."""

    link: ProcessLink
    calibrations: set[int] = field(default_factory=set)


class Worker:
    """Solves in a process of its own, one frame at a time.

    Parameters
    ----------
    catalog : Catalog
        Opened there again: it must come through a pickle.
    tell : callable
        ``tell(kind, data)``: told when the process is ready, and when it had to be ended.
    limits : Limits
        What the process may take.
    niceness : int
        See `LOWER_PRIORITY`.
    idle_s : float, optional
        Ended when it had nothing to do for so long, and started by the next frame; never if left out.
    margin_s, grace_s : float
        See `MARGIN_S` and `GRACE_S`.
    many : bool
        Many frames follow each other, and nobody waits for a single one: the process solves no drawn frames
        before it is ready, and keeps its memory from one frame to the next.
    tries : int
        So many processes may die of a frame before it is given up.
    """

    def __init__(
        self,
        catalog: Catalog,
        tell: Tell,
        *,
        limits: Limits | None = None,
        niceness: int = LOWER_PRIORITY,
        idle_s: float | None = None,
        margin_s: float = MARGIN_S,
        grace_s: float = GRACE_S,
        many: bool = False,
        tries: int = 2,
    ) -> None:
        self._many, self._tries = many, tries
        self._catalog = catalog
        self._tell = tell
        self._limits = limits or Limits()
        self._niceness, self._idle_s = niceness, idle_s
        self._grown_mb = 0.0
        self._margin_s, self._grace_s = margin_s, grace_s
        self._queue: asyncio.PriorityQueue[tuple[int, int, _Request]] = asyncio.PriorityQueue()
        self._numbers = itertools.count()
        self._masters: list[Calibration] = []
        self._index: Path | None = None
        self._warm: _Warm | None = None
        self._runner: asyncio.Task[None] | None = None
        self._state = "not started"
        self._at_rest = asyncio.Event()
        self._at_rest.set()

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing is in hand: no frame, and no process that is ended or started."""
        return self._at_rest.is_set()

    async def at_rest(self) -> None:
        """Wait until nothing is in hand."""
        await self._at_rest.wait()

    @property
    def state(self) -> str:
        """For people and programs: "starting", "ready", "solving", or "failed: " and why."""
        return self._state

    @property
    def pid(self) -> int | None:
        """The present process's number."""
        return None if self._warm is None else self._warm.link.pid

    def open(self, index: Path | None) -> None:
        """Start the process in the background, with the index that is known to exist. Twice is fine."""
        self._index = index
        if self._runner is None:
            if self._idle_s is None:
                self._at_rest.clear()
            self._runner = begun(self._run(), "solver", died=self._died)

    async def close(self) -> None:
        """End the process; those who wait are told that the service goes down."""
        if self._runner is not None:
            self._runner.cancel()
            await asyncio.gather(self._runner, return_exceptions=True)
        while not self._queue.empty():
            _, _, request = self._queue.get_nowait()
            _refuse(request)
        await self._drop()
        self._state = "ended"

    async def solve(self, work: Work, *, first: bool) -> Verdict:
        """Solve; with `first` before all that is waiting and isn't.

        Raises
        ------
        DeviceError
            The process died of this frame twice, or can't be started.
        Exception
            What `solve` itself raised there.
        """
        verdict = await self._answer(work, first=first)
        assert isinstance(verdict, Verdict)
        return verdict

    async def read(self, upload: Upload) -> Frame:
        """Read a file there, where it can do no harm; its turn comes as that of an upload.

        Raises
        ------
        BadFrame
            It is no usable image.
        DeviceError
            The process died of this file twice, or can't be started.
        """
        frame = await self._answer(Reading(upload), first=False)
        assert isinstance(frame, Frame)
        return frame

    async def warm_up(self) -> None:
        """Have the process there, started if need be.

        Raises
        ------
        DeviceError
            It can't be started.
        """
        await self._answer(None, first=True)

    async def _answer(self, work: Work | Reading | None, *, first: bool) -> Any:
        if self._state == "ended":
            raise _going_down()
        self.open(self._index)
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        await self._queue.put((0 if first else 1, next(self._numbers), _Request(work, answer)))
        return await answer

    def _died(self, fault: Exception) -> None:
        """Nobody takes what waits any more: those who wait are told, and the next one begins again."""
        self._state, self._runner = f"failed: {fault_words(fault)}", None
        while not self._queue.empty():
            _, _, request = self._queue.get_nowait()
            if not request.answer.done():
                request.answer.set_exception(
                    DeviceError(fault_words(fault), device="solver", advice="send it again")
                )

    async def _run(self) -> None:
        if self._idle_s is None:
            try:
                await self._started_or_told()
            finally:
                self._at_rest.set()
        while True:
            request = await self._next()
            if request.answer.done():
                continue  # its caller left while it waited
            self._at_rest.clear()
            try:
                await self._done_with(request)
            finally:
                self._at_rest.set()

    async def _done_with(self, request: _Request) -> None:
        """Answer a request, and be ready for the next one."""
        try:
            answer = await self._carried_out(request)
        except asyncio.CancelledError:
            _refuse(request)
            raise
        except Exception as error:  # it belongs to the one who asked
            if not request.answer.done():
                request.answer.set_exception(error)
            elif not isinstance(error, MountnavError):
                # nobody else would ever hear of it; what is said of a frame concerns who asked alone
                _log.error("a frame that nobody waits for any more failed unexpectedly", exc_info=error)
        else:
            if not request.answer.done() and answer is not None:
                request.answer.set_result(answer)
        if self._grown_mb > GROWN_MB:
            _log.warning("the solver holds %.0f MB more than it should: replaced", self._grown_mb)
            self._tell("solver", {"state": f"replaced: it holds {self._grown_mb:.0f} MB too much"})
            await self._drop()
        if self._warm is None:
            await self._started_or_told()

    async def _started_or_told(self) -> None:
        """Start the process; what hinders it is reported, and tried again by the next frame."""
        try:
            await self._start()
        except ProcessEnded as ended:
            _log.error("the solver can't be started: %s", ended)
        except Exception as error:  # the runner lives on: anyone who asks next is told
            _log.exception("starting the solver failed unexpectedly")
            self._state = f"failed: {type(error).__name__}; the log has more"

    async def _next(self) -> _Request:
        """The next request; the process is ended if none comes for long."""
        if self._warm is not None and self._idle_s is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._idle_s):
                    return (await self._queue.get())[2]
            await self._drop()
            self._state = "asleep"
        return (await self._queue.get())[2]

    async def _carried_out(self, request: _Request) -> Verdict | Frame | None:
        """The answer; None if the caller left. A process that dies of it is replaced once."""
        fault: ProcessEnded | None = None
        for _ in range(self._tries):
            try:
                warm = self._warm or await self._start()
                if request.answer.done():
                    return None
                if request.work is None:
                    request.answer.set_result(None)
                    return None
                return await self._asked(warm, request, request.work)
            except ProcessEnded as ended:
                fault = ended
                _log.error("the solver died: %s", ended)
                await self._drop()
                if ended.out_of_cpu and request.work is not None:
                    return self._given_up(request.work, "it used up its CPU time")
        times = _TIMES.get(self._tries, f"{self._tries} times")
        raise DeviceError(
            f"the solving process died {times} over this frame: {fault}",
            device="solver",
            advice="is there memory enough? the service goes on, and the next frame finds a new process",
        ) from fault

    async def _start(self) -> _Warm:
        """Start the process and wait until it is warm. Raises `ProcessEnded`."""
        self._state = "starting"
        try:
            link = ProcessLink.start(
                "api.solver.process", kept_bytes=KEPT_BYTES if self._many else KEPT_BETWEEN_LOOKS_BYTES
            )
            try:
                async with asyncio.timeout(START_S):
                    setup = Setup(
                        self._catalog, self._index, self._limits, self._niceness, warm=not self._many
                    )
                    ready = await link.ask(setup)
                if not isinstance(ready, Ready):
                    raise ProcessEnded(f"process {link.pid} didn't say that it is ready")
            except BaseException as error:
                link.kill()
                await asyncio.shield(link.close())
                if isinstance(error, TimeoutError):
                    raise ProcessEnded(f"not ready within {START_S:.0f} s") from error
                raise
        except ProcessEnded as ended:
            self._state = f"failed: {ended}"
            self._tell("solver", {"state": self._state})
            raise
        for trouble in ready.troubles:
            _log.warning("solver: %s", trouble)
        self._warm, self._state = _Warm(link), "ready"
        _log.info("solver ready in %.1f s, process %d", ready.started_s, link.pid)
        self._tell("solver", {"state": "ready", "started_s": ready.started_s})
        return self._warm

    async def _drop(self) -> None:
        if self._warm is not None:
            link, self._warm = self._warm.link, None
            # no process, no solving; the next one is begun at once, but where the caller says otherwise
            self._state, self._grown_mb = "starting", 0.0
            await asyncio.shield(link.close())

    async def _asked(self, warm: _Warm, request: _Request, work: Work | Reading) -> Verdict | Frame | None:
        """Ask the process, for no longer than the work may take and somebody waits for it."""
        answer = request.answer
        files: list[int] = []
        try:
            if isinstance(work.source, Upload):
                files.append(os.dup(work.source.file))  # its own, in case the caller leaves now
            else:
                files.append(await asyncio.to_thread(in_memory, work.source.pixels))
            if isinstance(work, Reading):
                files.append(empty_file())
            if answer.done():
                return None
            task = (
                Read(work.source.name)
                if isinstance(work, Reading)
                else task_of(work, self._masters, warm.calibrations, work.index)
            )
            done = await self._waited_for(warm, request, work, waited_for(warm.link.ask(task, *files)))
            if not isinstance(done, Done):
                return done
            self._state, self._grown_mb = "ready", done.grown_mb
            if done.fault is not None:
                raise done.fault.error()
            if not isinstance(work, Reading):
                if done.verdict is None:
                    raise ProcessEnded(f"process {warm.link.pid} answered without a verdict")
                return done.verdict
            if done.frame is None:
                raise ProcessEnded(f"process {warm.link.pid} answered without a frame")
            return replace(done.frame, pixels=await asyncio.to_thread(pixels_in, files[1], done))
        finally:
            for file in files:
                os.close(file)

    async def _waited_for(
        self, warm: _Warm, request: _Request, work: Work | Reading, reply: asyncio.Task[Any]
    ) -> Done | Verdict | None:
        """The process's answer, or what is said instead when it had to be ended."""
        answer = request.answer
        self._state = "solving"
        try:
            limit_s = self._margin_s
            if not isinstance(work, Reading):
                limit_s += wall_limit_s(work.settings.budget_s)
            both: set[asyncio.Future[Any]] = {reply, answer}
            await asyncio.wait(both, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED)
            if answer.done():
                await asyncio.wait({reply}, timeout=self._grace_s)
            if not reply.done():
                warm.link.kill()
                await asyncio.wait({reply})
                await self._drop()
                return self._ended(work, limit_s, left=answer.done())
        finally:
            reply.cancel()
            await asyncio.gather(reply, return_exceptions=True)
        done = reply.result()
        if not isinstance(done, Done):
            raise ProcessEnded(f"process {warm.link.pid} answered something else")
        return done

    def _ended(self, work: Work | Reading, limit_s: float, *, left: bool) -> Verdict | None:
        """Tell that the process was ended; the verdict for those who wait."""
        why = "nobody waits for its frame any more" if left else f"no end of it within {limit_s:.0f} s"
        _log.warning("the solver was ended: %s", why)
        self._tell("solver", {"state": f"ended: {why}"})
        return None if left else self._given_up(work, f"ended after {limit_s:.0f} s", limit_s)

    def _given_up(self, work: Work | Reading, why: str, spent_s: float = 0.0) -> Verdict:
        """What is said of a frame that took too much time."""
        name = work.source.source if isinstance(work.source, Frame) else work.source.name
        if isinstance(work, Reading):
            raise BadFrame(f"it can't be read in time: {why}", device=name, advice="send a smaller image")
        told = f"{name}: {why}; its budget is {work.settings.budget_s:g} s"
        return Verdict(None, Reason.TIMED_OUT, told, 0, Times(total_s=spent_s))


def _refuse(request: _Request) -> None:
    if not request.answer.done():
        request.answer.set_exception(_going_down())


def _going_down() -> Refused:
    from api.problems import Refused, problem  # brings FastAPI, which commands that solve do without

    return Refused(problem("closing", 503, "the service is shutting down", retryable=True))
