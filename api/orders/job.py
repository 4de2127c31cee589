"""One job: its life, and how it is written down and taken up again."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from api.problems import Problem, problem, problem_of
from mountnav.devices import Epoch
from mountnav.errors import Busy, Cancelled, JournalFailed
from mountnav.journal.job_rows import JobRow


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
    """One piece of long work on a telescope; only `Jobs` changes it.

    `progress` is what was told last of following a target; it isn't written down. `result` is what the work
    returned; of a job from before a restart, the mapping that the API showed.
    `superseded_by` is the id of the job that took its place; `why_stopped`, in words, why it was told to
    end; `epoch` the mount's own frame; `announced`: an event has told that it began.
    """

    id: str
    kind: str
    telescope: str
    request: dict[str, object]
    created_utc: datetime
    state: JobState = JobState.QUEUED
    phase: str = "queued"
    attempts: list[dict[str, object]] = field(default_factory=list)
    progress: dict[str, object] = field(default_factory=dict)
    result: object | None = None
    problem: Problem | None = None
    started_utc: datetime | None = None
    finished_utc: datetime | None = None
    ended: asyncio.Event = field(default_factory=asyncio.Event)
    key: str | None = None
    fingerprint: str = ""
    superseded_by: str | None = None
    superseded_by_kind: str = ""
    why_stopped: str = ""
    epoch: Epoch | None = None
    announced: bool = False
    written: asyncio.Event = field(default_factory=asyncio.Event)
    """Set when it is on the disk, or won't be: `unwritten` tells why."""
    unwritten: JournalFailed | None = None

    @property
    def is_over(self) -> bool:
        """Whether it has come to its end."""
        return self.state in ENDS


def row_of(job: Job, result: Mapping[str, object] | None) -> JobRow:
    """A job as it is written down, with its result as the API shows it."""
    return JobRow(
        job_id=job.id,
        telescope=job.telescope,
        kind=job.kind,
        state=str(job.state),
        phase=job.phase,
        request=job.request,
        created_utc=job.created_utc,
        request_sha256=job.fingerprint,
        attempts=tuple(job.attempts),
        result=result,
        problem=problem_record(job.problem),
        started_utc=job.started_utc,
        finished_utc=job.finished_utc,
        key=job.key,
    )


def job_of(row: JobRow) -> Job:
    """A job as it was written down."""
    return Job(
        id=row.job_id,
        kind=row.kind,
        telescope=row.telescope,
        request=dict(row.request),
        created_utc=row.created_utc,
        state=JobState(row.state),
        phase=row.phase,
        attempts=[dict(attempt) for attempt in row.attempts],
        result=row.result,
        problem=None if row.problem is None else Problem.model_validate(dict(row.problem)),
        started_utc=row.started_utc,
        finished_utc=row.finished_utc,
        key=row.key,
        fingerprint=row.request_sha256,
    )


def interrupted_problem(job: Job, known: str) -> Problem:
    """What a job is told to have ended with that a restart of the service cut off."""
    return problem(
        "interrupted",
        503,
        f"interrupted by a restart of the service: {known}",
        device=job.telescope,
        advice="see where the telescope stands, then ask again with a new Idempotency-Key",
        retryable=False,
        job_id=job.id,
    )


def problem_record(found: Problem | None) -> Mapping[str, object] | None:
    """A problem as it is written down."""
    return None if found is None else found.model_dump(mode="json", exclude_none=True)


class TelescopeBusy(Busy):
    """Another job holds the telescope; `job_id` tells which."""

    def __init__(self, job: Job) -> None:
        super().__init__(
            f"job {job.id} ({job.kind}) is running",
            device=job.telescope,
            advice="wait for it, or cancel it with DELETE /v1/jobs/{id}",
        )
        self.job_id = job.id


def stopped(job: Job) -> Cancelled:
    """What a job ends with that was cancelled."""
    if job.superseded_by is not None:
        return Cancelled(
            f"superseded by job {job.superseded_by} ({job.superseded_by_kind})",
            device=job.telescope,
            advice=f"GET /v1/jobs/{job.superseded_by} says what became of that one",
        )
    return Cancelled(
        job.why_stopped or "stopped on request",
        device=job.telescope,
        advice="start it again when it is safe",
    )


def told_stopped(job: Job, error: Cancelled) -> Problem:
    """A cancelled job's problem: who wanted its end; one that was superseded names its successor."""
    wanted = job.superseded_by is not None or job.why_stopped
    found = problem_of(stopped(job) if wanted else error)
    return found.model_copy(update={"superseded_by": job.superseded_by})


def fingerprint_of(kind: str, telescope: str, request: dict[str, object]) -> str:
    """What an idempotency key stands for."""
    text = json.dumps([kind, telescope, request], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
