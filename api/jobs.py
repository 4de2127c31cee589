"""Jobs: long work with an id, one motion at a time per telescope, cancelled at any time, never done twice."""

from __future__ import annotations

import asyncio
import hashlib
import json
import logging
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum
from uuid import uuid4

from api.events import Events
from api.faults import Problem, Refused, internal_problem, problem, problem_of
from mountnav.errors import Busy, Cancelled, MountnavError, Unknown
from mountnav.sky.coordinates import utc_now

_log = logging.getLogger(__name__)


class JobState(StrEnum):
    """Where a job stands; the last three are ends."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


ENDS = frozenset({JobState.SUCCEEDED, JobState.FAILED, JobState.CANCELLED})


@dataclass(slots=True, eq=False)
class Job:
    """One piece of long work on a telescope; only `Jobs` changes it."""

    id: str
    kind: str
    telescope: str
    request: dict[str, object]
    created_utc: datetime
    state: JobState = JobState.QUEUED
    phase: str = "queued"
    attempts: list[dict[str, object]] = field(default_factory=list)
    result: object | None = None
    problem: Problem | None = None
    started_utc: datetime | None = None
    finished_utc: datetime | None = None
    ended: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def is_over(self) -> bool:
        """Whether it has come to its end."""
        return self.state in ENDS


class TelescopeBusy(Busy):
    """Another job holds the telescope; `job_id` tells which."""

    def __init__(self, job: Job) -> None:
        super().__init__(
            f"job {job.id} ({job.kind}) is running",
            device=job.telescope,
            advice="wait for it, or cancel it with DELETE /v1/jobs/{id}",
        )
        self.job_id = job.id


class Jobs:
    """All jobs of the service. Used from the event loop's thread alone.

    Parameters
    ----------
    events : Events
        Told of each change.
    kept : int
        How many jobs, and idempotency keys, are remembered.
    """

    def __init__(self, events: Events, kept: int) -> None:
        self._events = events
        self._kept = kept
        self._jobs: OrderedDict[str, Job] = OrderedDict()
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._held: dict[str, Job] = {}
        self._keys: OrderedDict[str, tuple[str, Job]] = OrderedDict()
        self._closing = False

    def start(
        self,
        kind: str,
        telescope: str,
        request: dict[str, object],
        work: Callable[[], Awaitable[object]],
        *,
        key: str | None = None,
    ) -> Job:
        """Start `work` as a job, or return the one that was started with the same key.

        Raises
        ------
        TelescopeBusy
            Another job holds the telescope.
        Refused
            422: the key was used for another request. 503: the service is going down.
        """
        print_of_request = _fingerprint(kind, telescope, request)
        if key is not None and key in self._keys:
            known_print, job = self._keys[key]
            if known_print != print_of_request:
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
        if self._closing:
            raise Refused(problem("closing", 503, "the service is going down", retryable=True))
        if telescope in self._held:
            raise TelescopeBusy(self._held[telescope])
        job = Job(uuid4().hex, kind, telescope, request, utc_now())
        self._remember(job, key, print_of_request)
        self._held[telescope] = job
        self._tasks[job.id] = asyncio.create_task(self._run(job, work), name=f"{kind} {telescope}")
        return job

    def get(self, job_id: str) -> Job:
        """Return the job of that id. Raises `Unknown`."""
        if job_id not in self._jobs:
            raise Unknown("there is no job of this id", advice="GET /v1/jobs lists the jobs still remembered")
        return self._jobs[job_id]

    def all(self) -> list[Job]:
        """All remembered jobs, newest first."""
        return list(reversed(self._jobs.values()))

    def running_on(self, telescope: str) -> Job | None:
        """The job that holds a telescope."""
        return self._held.get(telescope)

    def heard(self, telescope: str, kind: str, data: dict[str, object]) -> None:
        """Take in what a navigator tells: it becomes an event, and the running job's phase."""
        job = self._held.get(telescope)
        if job is not None and not job.is_over:
            job.phase = kind
            if kind == "attempt":
                job.attempts.append(data)
        self._events.publish(kind, {"telescope": telescope, "job_id": job.id if job else None, **data})

    def cancel(self, job: Job) -> None:
        """Cancel; its end comes with `job.ended`. Once more, or after its end, does nothing."""
        task = self._tasks.get(job.id)
        if task is not None and not job.is_over and job.phase != "cancelling":
            job.phase = "cancelling"
            task.cancel()
            if job.state is JobState.QUEUED:
                # A task that never ran is thrown away without a step, so nobody else would end the job.
                self._end(job, JobState.CANCELLED, found=problem_of(_stopped(job)))

    async def close(self) -> None:
        """Cancel all jobs and wait for their ends; refuse new ones."""
        self._closing = True
        tasks = list(self._tasks.values())
        for job in list(self._held.values()):
            self.cancel(job)
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _run(self, job: Job, work: Callable[[], Awaitable[object]]) -> None:
        job.state, job.phase, job.started_utc = JobState.RUNNING, "starting", utc_now()
        self._tell(job)
        try:
            result = await work()
        except asyncio.CancelledError:
            self._end(job, JobState.CANCELLED, found=problem_of(_stopped(job)))
        except Cancelled as error:
            self._end(job, JobState.CANCELLED, found=problem_of(error))
        except MountnavError as error:
            self._end(job, JobState.FAILED, found=problem_of(error))
        except Exception:
            # The job's owner must learn that it ended; what happened is for the log.
            _log.exception("job %s (%s %s) hit a fault", job.id, job.kind, job.telescope)
            self._end(job, JobState.FAILED, found=internal_problem())
        else:
            self._end(job, JobState.SUCCEEDED, result=result)

    def _end(
        self, job: Job, state: JobState, *, result: object | None = None, found: Problem | None = None
    ) -> None:
        job.state, job.phase, job.finished_utc = state, "ended", utc_now()
        job.result, job.problem = result, found
        self._held.pop(job.telescope, None)
        self._tasks.pop(job.id, None)
        job.ended.set()
        self._tell(job)

    def _tell(self, job: Job) -> None:
        data: dict[str, object] = {
            "telescope": job.telescope,
            "job_id": job.id,
            "kind": job.kind,
            "state": str(job.state),
        }
        if job.problem is not None:
            data["problem"] = job.problem.model_dump(exclude_none=True)
        self._events.publish("job", data)

    def _remember(self, job: Job, key: str | None, print_of_request: str) -> None:
        self._jobs[job.id] = job
        if key is not None:
            self._keys[key] = (print_of_request, job)
        while len(self._jobs) > self._kept:
            oldest = next((one for one in self._jobs.values() if one.is_over), None)
            if oldest is None:
                break
            del self._jobs[oldest.id]
        while len(self._keys) > self._kept:
            self._keys.popitem(last=False)


def _stopped(job: Job) -> Cancelled:
    return Cancelled("stopped on request", device=job.telescope, advice="start it again when it is safe")


def _fingerprint(kind: str, telescope: str, request: dict[str, object]) -> str:
    text = json.dumps([kind, telescope, request], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
