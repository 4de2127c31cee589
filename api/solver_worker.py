"""The warm worker: one solving process, asked in turn, looks before uploads; put in place again when it dies.

A caller that is cancelled is free at once. The process may finish the frame within a moment, so that the next
one finds it warm; after that it is ended and started anew. So is one that doesn't come to an end by itself.
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

from api.faults import Refused, problem
from api.solver_link import ProcessEnded, ProcessLink
from api.solver_messages import Done, Ready, Setup, Task
from api.solver_work import Upload, Work, described, in_memory
from mountnav.catalog.stars import Catalog
from mountnav.errors import DeviceError
from mountnav.frames import Frame
from mountnav.solution import Reason, Times, Verdict

if TYPE_CHECKING:
    from mountnav.measuring.calibration import Calibration

_log = logging.getLogger(__name__)

START_S = 120.0
"""A process that isn't ready by then never will be; on the slowest computer it takes a tenth of that."""

MARGIN_S = 60.0
"""Reading and measuring on a slow computer: what a solve may take beyond its budget before it is ended."""

GRACE_S = 0.5
"""What the process may still spend on a frame that nobody waits for any more."""

Tell = Callable[[str, dict[str, object]], None]


@dataclass(slots=True, eq=False)
class _Request:
    work: Work
    answer: asyncio.Future[Verdict]


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
        Opened there anew: it must come through a pickle.
    tell : callable
        ``tell(kind, data)``: told when the process is ready, and when it had to be ended.
    margin_s, grace_s : float
        See `MARGIN_S` and `GRACE_S`.
    """

    def __init__(
        self, catalog: Catalog, tell: Tell, *, margin_s: float = MARGIN_S, grace_s: float = GRACE_S
    ) -> None:
        self._catalog = catalog
        self._tell = tell
        self._margin_s, self._grace_s = margin_s, grace_s
        self._queue: asyncio.PriorityQueue[tuple[int, int, _Request]] = asyncio.PriorityQueue()
        self._numbers = itertools.count()
        self._masters: list[Calibration] = []
        self._index: Path | None = None
        self._warm: _Warm | None = None
        self._runner: asyncio.Task[None] | None = None
        self._state = "not started"

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
            self._runner = asyncio.create_task(self._run(), name="solver")

    async def close(self) -> None:
        """End the process; whoever still waits is told that the service goes down."""
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
        self.open(self._index)
        answer: asyncio.Future[Verdict] = asyncio.get_running_loop().create_future()
        await self._queue.put((0 if first else 1, next(self._numbers), _Request(work, answer)))
        return await answer

    async def _run(self) -> None:
        with contextlib.suppress(ProcessEnded):
            await self._start()
        while True:
            _, _, request = await self._queue.get()
            if request.answer.done():
                continue  # its caller left while it waited
            try:
                verdict = await self._carried_out(request)
            except asyncio.CancelledError:
                _refuse(request)
                raise
            except Exception as error:  # it belongs to whoever asked
                if not request.answer.done():
                    request.answer.set_exception(error)
            else:
                if not request.answer.done() and verdict is not None:
                    request.answer.set_result(verdict)
            if self._warm is None:
                with contextlib.suppress(ProcessEnded):
                    await self._start()

    async def _carried_out(self, request: _Request) -> Verdict | None:
        """The verdict; None if the caller left. A process that dies of it is replaced once."""
        fault: ProcessEnded | None = None
        for _ in range(2):
            try:
                warm = self._warm or await self._start()
                if request.answer.done():
                    return None
                return await self._asked(warm, request)
            except ProcessEnded as ended:
                fault = ended
                _log.error("the solver died: %s", ended)
                await self._drop()
        raise DeviceError(
            f"the solving process died twice over this frame: {fault}",
            device="solver",
            advice="is there memory enough? the service goes on, and the next frame finds a new process",
        )

    async def _start(self) -> _Warm:
        """Start the process and wait until it is warm. Raises `ProcessEnded`."""
        self._state = "starting"
        try:
            link = ProcessLink.start("api.solver_process")
            try:
                async with asyncio.timeout(START_S):
                    ready = await link.ask(Setup(self._catalog, self._index))
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
        assert isinstance(ready, Ready)
        for trouble in ready.troubles:
            _log.warning("solver: %s", trouble)
        self._warm, self._state = _Warm(link), "ready"
        _log.info("solver ready in %.1f s, process %d", ready.started_s, link.pid)
        self._tell("solver", {"state": "ready", "started_s": ready.started_s})
        return self._warm

    async def _drop(self) -> None:
        if self._warm is not None:
            link, self._warm = self._warm.link, None
            await asyncio.shield(link.close())

    async def _asked(self, warm: _Warm, request: _Request) -> Verdict | None:
        """Ask the process, for no longer than the work may take and somebody waits for it."""
        work, answer = request.work, request.answer
        pixels = work.source.pixels if isinstance(work.source, Frame) else None
        file = None if pixels is None else await asyncio.to_thread(in_memory, pixels)
        if answer.done():
            if file is not None:
                os.close(file)
            return None
        if isinstance(work.source, Upload):
            file = os.dup(work.source.file)  # its own, in case the caller leaves now
        reply = asyncio.create_task(warm.link.ask(self._task(warm, work), file))
        self._state = "solving"
        try:
            limit_s = work.settings.budget_s + self._margin_s
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
            if file is not None:
                os.close(file)
        done = reply.result()
        assert isinstance(done, Done)
        self._state = "ready"
        if done.error is not None:
            raise done.error
        return done.verdict

    def _task(self, warm: _Warm, work: Work) -> Task:
        masters = work.settings.calibration
        number: int | None = None
        if masters is not None:
            known = [one for one, kept in enumerate(self._masters) if kept is masters]
            number = known[0] if known else len(self._masters)
            if not known:
                self._masters.append(masters)
        news = masters if number is not None and number not in warm.calibrations else None
        if number is not None:
            warm.calibrations.add(number)
        return Task(
            source=described(work.source),
            hint=work.hint,
            settings=replace(work.settings, calibration=None, index=None),
            calibration_number=number,
            calibration=news,
            index=work.index,
        )

    def _ended(self, work: Work, limit_s: float, *, left: bool) -> Verdict | None:
        """Tell that the process was ended; the verdict for whoever still waits."""
        why = "nobody waits for its frame any more" if left else f"no end of it within {limit_s:.0f} s"
        _log.warning("the solver was ended: %s", why)
        self._tell("solver", {"state": f"ended: {why}"})
        if left:
            return None
        name = work.source.source if isinstance(work.source, Frame) else work.source.name
        return Verdict(
            None,
            Reason.TIMED_OUT,
            f"{name}: ended after {limit_s:.0f} s; its budget is {work.settings.budget_s:g} s",
            0,
            Times(total_s=limit_s),
        )


def _refuse(request: _Request) -> None:
    if not request.answer.done():
        found = problem("closing", 503, "the service is going down", retryable=True)
        request.answer.set_exception(Refused(found))
