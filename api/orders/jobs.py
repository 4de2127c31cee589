"""Jobs: long work with an id, one motion at a time per telescope, cancelled at any time, never done twice.

Every change of a job is made by `Jobs`, and nothing moves before it is written down. `JobMemory` keeps
which jobs are remembered: by their ids and by the keys of their clients, with a store over restarts. A
client's key is what keeps an order from being carried out twice.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import replace
from datetime import timedelta
from uuid import uuid4

from api.events import Events
from api.orders.job import (
    ENDS,
    Job,
    JobState,
    TelescopeBusy,
    fingerprint_of,
    interrupted_problem,
    job_of,
    problem_record,
    row_of,
    stopped,
    told_stopped,
)
from api.orders.lean_results import without_stars
from api.problems import Problem, Refused, internal_problem, problem, problem_of
from mountnav.clock import utc_now
from mountnav.devices import Epoch
from mountnav.errors import Cancelled, JournalFailed, MountnavError, NotFound
from mountnav.journal.job_rows import JobRow
from mountnav.journal.job_store import JobKeeper
from mountnav.journal.records import because
from mountnav.tasks import begun, waited_for

__all__ = ["ENDS", "KEYS_LIVE", "Job", "JobMemory", "JobState", "Jobs", "TelescopeBusy", "View"]


_log = logging.getLogger(__name__)

KEYS_LIVE = timedelta(hours=48)
"""How long, at the least, a client's key is known."""
_KEYS_MOST = 20_000
"""Idempotency keys that are remembered at the most; chosen by hand: an order each second for five hours.
Halved, a client that repeats an older order has it done twice."""

View = Callable[[object, Job], Mapping[str, object] | None]


class JobMemory:
    """The jobs that are remembered. Used from the event loop's thread alone.

    Parameters
    ----------
    kept : int
        How many; those that are not are asked of the store.
    store : JobKeeper, optional
        Where jobs and keys outlive the process.
    view : callable, optional
        ``view(result, job)``: a result as the API shows it, for the store.
    """

    def __init__(self, kept: int, *, store: JobKeeper | None = None, view: View | None = None) -> None:
        self._kept = kept
        self._store = store
        self._view = view
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._keys: OrderedDict[str, Job] = OrderedDict()

    async def take_up(self) -> list[Job]:
        """Remember those of earlier runs; what was running then is written down as interrupted.

        Returns
        -------
        list of Job
            Those that were interrupted, oldest first.

        Raises
        ------
        JournalFailed
        """
        store = self._store
        if store is None:
            return []
        since = utc_now() - KEYS_LIVE
        keyed = await asyncio.to_thread(store.latest, _KEYS_MOST, since)
        older = [] if len(keyed) >= self._kept else await asyncio.to_thread(store.latest, self._kept)
        rows = {row.job_id: row for row in (*keyed, *older)}
        interrupted = []
        for row in sorted(rows.values(), key=lambda one: one.created_utc):
            job = job_of(row)
            if not job.is_over:
                known = await asyncio.to_thread(store.last_order, job.id)
                job.state, job.phase, job.finished_utc = JobState.FAILED, "ended", utc_now()
                job.problem = interrupted_problem(job, known)
                await store.save(self._row(job))
                interrupted.append(job)
            job.written.set()
            job.ended.set()
            self.remember(job)
        return interrupted

    # -- what is asked of it ------------------------------------------------------------------------

    def of_key(self, key: str | None, kind: str, telescope: str, request: dict[str, object]) -> Job | None:
        """Return the job that was started with this key; None if there is none.

        Raises
        ------
        Refused
            422: the key was used for another request.
        """
        if key is None or key not in self._keys:
            return None
        job = self._keys[key]
        if job.fingerprint != fingerprint_of(kind, telescope, request):
            raise Refused(
                problem(
                    "idempotency-key-reused",
                    422,
                    "this Idempotency-Key was used for another request",
                    advice="use a new key for each new request",
                    job_id=job.id,
                )
            )
        return job

    def at_hand(self, job_id: str) -> Job | None:
        """Return the job of that id if it is remembered. Waits for nothing."""
        return self._jobs.get(job_id)

    def get(self, job_id: str) -> Job:
        """Return the job of that id. May wait for the store. Raises `NotFound`."""
        found = self._jobs.get(job_id)
        if found is None and self._store is not None:
            row = self._store.find(job_id)
            found = None if row is None else job_of(row)
        if found is None:
            raise NotFound(
                "there is no job of this id", advice="GET /v1/jobs lists the jobs still remembered"
            )
        return found

    def all(self) -> list[Job]:
        """All that are remembered, newest first."""
        return list(reversed(self._jobs.values()))

    # -- what is told to it -------------------------------------------------------------------------

    def remember(self, job: Job) -> None:
        """Keep a job in mind, and its key; the oldest that have ended are let go."""
        self._jobs[job.id] = job
        if job.key is not None:
            self._keys[job.key] = job
        while len(self._jobs) > self._kept:
            oldest = next((job for job in self._jobs.values() if job.is_over), None)
            if oldest is None:
                break
            del self._jobs[oldest.id]
        # without a store keys live as long as jobs; with one, as long as clients may repeat a request
        most = self._kept if self._store is None else _KEYS_MOST
        while len(self._keys) > self._kept:
            key, oldest = next(iter(self._keys.items()))
            if len(self._keys) <= most and (
                not oldest.is_over or job.created_utc - oldest.created_utc < KEYS_LIVE
            ):
                break
            del self._keys[key]

    def forget_key(self, job: Job) -> None:
        """A job that never began stands for no request: its key may be used again."""
        if job.key is not None and self._keys.get(job.key) is job:
            del self._keys[job.key]

    async def write(self, job: Job) -> None:
        """Write it down as it stands; on the disk on return. Raises `JournalFailed`."""
        if self._store is not None:
            await self._store.save(self._row(job))

    def write_now(self, job: Job) -> None:
        """Write it down as it stands, without waiting."""
        if self._store is not None:
            self._store.save_now(self._row(job))

    async def write_end(
        self, job: Job, state: JobState, result: object | None, found: Problem | None
    ) -> None:
        """Write its end down, no matter who cancels that; what can't be written is for the log."""
        if self._store is None:
            return
        try:
            row = replace(
                self._row(job),
                state=str(state),
                phase="ended",
                problem=problem_record(found),
                result=self._shown(job, result),
            )
        except Exception:
            # a result that can't be shown is a fault of ours, and no reason to forget how the job ended
            _log.exception("the result of job %s can't be written to the journal", job.id)
            row = replace(self._row(job), state=str(state), phase="ended")
        saving = waited_for(self._store.save(row))
        while not saving.done():
            # it is over: a cancellation now changes nothing
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.wait({saving})
        if isinstance(error := saving.exception(), JournalFailed):
            _log.error("the end of job %s is not in the journal yet: %s", job.id, error)
        elif error is not None:
            _log.error("the end of job %s is not in the journal", job.id, exc_info=error)

    def _shown(self, job: Job, result: object | None) -> Mapping[str, object] | None:
        if result is None or isinstance(result, Mapping):
            return result
        return None if self._view is None else self._view(result, job)

    def _row(self, job: Job) -> JobRow:
        return row_of(job, self._shown(job, job.result))


_SAFE_WAITS_S = 2.0
"""So long a park waits for its row to be on the disk."""


class Jobs:
    """All jobs of the service. Used from the event loop's thread alone.

    Parameters
    ----------
    events : Events
        Told of each change.
    kept : int
        How many jobs are remembered; those that are not are asked of the store.
    store : JobKeeper, optional
        Where jobs and keys outlive the process; `take_up` reads it.
    view : callable, optional
        ``view(result, job)``: a result as the API shows it, for the store.
    """

    def __init__(
        self, events: Events, kept: int, *, store: JobKeeper | None = None, view: View | None = None
    ) -> None:
        self._events = events
        self._memory = JobMemory(kept, store=store, view=view)
        self._tasks: dict[str, asyncio.Task[None]] = {}
        # of each telescope its jobs that are not over: the last one holds it, those before make room
        self._line: dict[str, list[Job]] = {}
        # by the id of the job that they are done within
        self._within: dict[str, list[Job]] = {}
        self._closing = False

    async def take_up(self) -> list[Job]:
        """Remember the jobs and keys of earlier runs; what was running then is reported as interrupted.

        To be called once, before anything is started. Nothing is done again.

        Returns
        -------
        list of Job
            Those that were interrupted, newest first.

        Raises
        ------
        JournalFailed
        """
        interrupted = await self._memory.take_up()
        for job in interrupted:
            self._tell(job)
        return interrupted[::-1]

    def known(self, key: str | None, kind: str, telescope: str, request: dict[str, object]) -> Job | None:
        """Return the job that was started with this key; None if there is none.

        Raises
        ------
        Refused
            422: the key was used for another request.
        """
        return self._memory.of_key(key, kind, telescope, request)

    def start(
        self,
        kind: str,
        telescope: str,
        request: dict[str, object],
        work: Callable[[], Awaitable[object]],
        *,
        key: str | None = None,
        make_room: Callable[[], Awaitable[object]] | None = None,
        epoch: Epoch | None = None,
        even_unwritten: bool = False,
        within: str | None = None,
    ) -> Job:
        """Start `work` as a job, or return the one that was started with the same key.

        Parameters
        ----------
        key : str, optional
            Made by the client.
        make_room : callable, optional
            Supersede a job that holds the telescope: that one is cancelled, `make_room` is called to stop the
            mount, and `work` begins when both have ended. If `make_room` fails, so does the new job.
        epoch : {"apparent", "icrs"}, optional
            The mount's own frame, for answers that give places in both.
        even_unwritten : bool
            Whether it is done though the journal can't be written; its row follows then.
        within : str, optional
            Where a job of this kind holds the telescope, `work` is done within that one, which goes on; it is
            cancelled with it.

        Raises
        ------
        TelescopeBusy
            Another job holds the telescope, and is not to be superseded.
        Refused
            422: the key was used for another request. 503: the service is going down.
        """
        known = self.known(key, kind, telescope, request)
        if known is not None:
            return known
        if self._closing:
            raise Refused(problem("closing", 503, "the service is shutting down", retryable=True))
        line = self._line.setdefault(telescope, [])
        inside = within is not None and bool(line) and line[-1].kind == within
        if line and make_room is None and not inside:
            raise TelescopeBusy(line[-1])
        job = Job(
            uuid4().hex,
            kind,
            telescope,
            request,
            utc_now(),
            key=key,
            fingerprint=fingerprint_of(kind, telescope, request),
            epoch=epoch,
        )
        before = () if inside else tuple(line)
        self._memory.remember(job)
        if inside:
            self._within.setdefault(line[-1].id, []).append(job)
        else:
            line.append(job)
        for earlier in before:
            if earlier.superseded_by is None:
                earlier.superseded_by, earlier.superseded_by_kind = job.id, kind
            self.cancel(earlier)
        doing = work if make_room is None or not before else self._after(job, before, make_room, work)
        self._tasks[job.id] = begun(
            self._run(job, doing, even_unwritten), f"{kind} {telescope}", died=lambda _: self._died(job)
        )
        return job

    def _after(
        self,
        job: Job,
        before: Sequence[Job],
        make_room: Callable[[], Awaitable[object]],
        work: Callable[[], Awaitable[object]],
    ) -> Callable[[], Awaitable[object]]:
        """Work that begins when the jobs before it have ended and the mount was sent a stop."""
        # the stop waits neither for the journal nor for the end of those jobs
        stopping = waited_for(make_room())
        stopping.add_done_callback(_heard_of)

        async def done() -> object:
            job.phase = "superseding"
            await asyncio.shield(stopping)
            for earlier in before:
                await earlier.ended.wait()
            job.phase = "starting"
            return await work()

        return done

    def remembered(self, job_id: str) -> Job | None:
        """Return the job of that id if it is remembered. Waits for nothing."""
        return self._memory.at_hand(job_id)

    def get(self, job_id: str) -> Job:
        """Return the job of that id. Raises `NotFound`.

        May wait for the store, if the job isn't remembered any more: then call it in a thread.
        """
        return self._memory.get(job_id)

    def all(self) -> list[Job]:
        """All remembered jobs, newest first."""
        return self._memory.all()

    def running_on(self, telescope: str) -> Job | None:
        """The job that holds a telescope."""
        line = self._line.get(telescope)
        return line[-1] if line else None

    def heard(self, telescope: str, kind: str, data: dict[str, object]) -> None:
        """Take in what a navigator tells: it becomes an event, and the running job's phase."""
        line = self._line.get(telescope)
        # what a superseded job still does on its way out is its own
        job = line[0] if line else None
        if job is not None and not job.is_over:
            job.phase = kind
            if kind == "following":
                job.progress = data
            if kind == "attempt":
                job.attempts.append(data)
                self._memory.write_now(job)
        self._events.publish(kind, {"telescope": telescope, "job_id": job.id if job else None, **data})

    def cancel(self, job: Job, why: str = "") -> None:
        """Cancel; its end comes with `job.ended`. Once more, or after its end, does nothing.

        Parameters
        ----------
        why : str
            What its owner is told.
        """
        for inner in tuple(self._within.get(job.id, ())):
            self.cancel(inner, why)
        task = self._tasks.get(job.id)
        if task is not None and not job.is_over and job.phase not in ("cancelling", "ending"):
            job.phase, job.why_stopped = "cancelling", why
            task.cancel()
            if job.state is JobState.QUEUED:
                # A task that never ran is thrown away without a step, so nobody else would end the job.
                self._end(job, JobState.CANCELLED, found=told_stopped(job, stopped(job)))
                self._memory.write_now(job)

    async def close(self) -> None:
        """Cancel all jobs and wait for their ends; refuse new ones."""
        self._closing = True
        tasks = list(self._tasks.values())
        for job in [job for line in self._line.values() for job in line]:
            self.cancel(job, "the service was shut down")
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(
        self, job: Job, work: Callable[[], Awaitable[object]], even_unwritten: bool = False
    ) -> None:
        job.state, job.phase, job.started_utc = JobState.RUNNING, "starting", utc_now()
        result: object | None = None
        found: Problem | None = None
        state = JobState.SUCCEEDED
        try:
            # before it does anything: a request repeated after a restart must find it
            await self._write(job, even_unwritten)
            self._tell(job)
            with because(job_id=job.id, why=job.kind):
                result = await work()
        except asyncio.CancelledError:
            state, found = JobState.CANCELLED, told_stopped(job, stopped(job))
        except Cancelled as error:
            state, found = JobState.CANCELLED, told_stopped(job, error)
        except MountnavError as error:
            state, found = JobState.FAILED, problem_of(error)
        except Exception:
            # The job's owner must learn that it ended; what happened is for the log.
            _log.exception("job %s (%s %s) hit a fault", job.id, job.kind, job.telescope)
            state, found = JobState.FAILED, internal_problem()
        job.finished_utc = utc_now()
        # before anybody is told, so that a restart doesn't tell otherwise
        job.phase = "ending"
        await self._memory.write_end(job, state, result, found)
        self._end(job, state, result=result, found=found)

    def _died(self, job: Job) -> None:
        """Its end could not be recorded as it should: it has ended all the same, and holds nothing."""
        if not job.is_over:
            self._end(job, JobState.FAILED, found=internal_problem())

    async def _write(self, job: Job, even_unwritten: bool) -> None:
        """Write it down before it does anything; its caller is answered after that."""
        try:
            async with asyncio.timeout(_SAFE_WAITS_S if even_unwritten else None):
                await self._memory.write(job)
        except TimeoutError:
            _log.error(
                "job %s (%s %s) began before it was written to the journal", job.id, job.kind, job.telescope
            )
        except JournalFailed as failure:
            if not even_unwritten:
                job.unwritten = failure
                # the same request may come again, and is to be tried again then
                self._memory.forget_key(job)
                job.written.set()
                raise
            _log.error(
                "job %s (%s %s) began without a journal entry: %s", job.id, job.kind, job.telescope, failure
            )
        job.written.set()

    def _end(
        self, job: Job, state: JobState, *, result: object | None = None, found: Problem | None = None
    ) -> None:
        job.state, job.phase, job.finished_utc = state, "ended", job.finished_utc or utc_now()
        # views, journal and clients need no stars; of a thousand jobs they would be hundreds of megabytes
        job.result, job.problem = without_stars(result), found
        if job in (line := self._line.get(job.telescope, [])):
            line.remove(job)
        for inner in self._within.pop(job.id, ()):
            self.cancel(inner, "the job that it was part of has ended")
        for others in self._within.values():
            if job in others:
                others.remove(job)
        self._tasks.pop(job.id, None)
        job.written.set()
        job.ended.set()
        self._tell(job)

    @staticmethod
    def told(job: Job) -> dict[str, object]:
        """Where a job stands, as its events tell it."""
        data: dict[str, object] = {
            "telescope": job.telescope,
            "job_id": job.id,
            "kind": job.kind,
            "state": str(job.state),
            "phase": job.phase,
        }
        if job.problem is not None:
            data["problem"] = job.problem.model_dump(exclude_none=True)
        return data

    def _tell(self, job: Job) -> None:
        job.announced = True
        self._events.publish("job", self.told(job))


def _heard_of(stopping: asyncio.Future[object]) -> None:
    """Its failure is the new job's; where that ended before it could hear of it, nobody misses it."""
    if not stopping.cancelled():
        stopping.exception()
