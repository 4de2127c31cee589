"""Which jobs are remembered: by their ids, by the keys of their clients; with a store, over restarts.

A client's key is what keeps an order from being carried out twice. That nothing moves before it is written
down is the work of `Jobs`; how it is written down stands here.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import timedelta

from api.http.faults import Problem, Refused, problem
from api.orders.job import Job, JobState, fingerprint_of, interrupted_problem, job_of, problem_record, row_of
from mountnav.errors import JournalFailed, Unknown
from mountnav.journal.job_rows import JobRow
from mountnav.journal.job_store import JobKeeper
from mountnav.sky.coordinates import utc_now
from mountnav.tasks import waited_for

_log = logging.getLogger(__name__)

KEYS_LIVE = timedelta(hours=48)
"""How long, at the least, a client's key is known."""
_KEYS_MOST = 20_000

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
        """Return the job of that id. May wait for the store. Raises `Unknown`."""
        found = self._jobs.get(job_id)
        if found is None and self._store is not None:
            row = self._store.find(job_id)
            found = None if row is None else job_of(row)
        if found is None:
            raise Unknown("there is no job of this id", advice="GET /v1/jobs lists the jobs still remembered")
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
            oldest = next((one for one in self._jobs.values() if one.is_over), None)
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
        """Write its end down, whoever cancels that; what can't be written is for the log."""
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
            _log.exception("the result of job %s can't be written down", job.id)
            row = replace(self._row(job), state=str(state), phase="ended")
        saving = waited_for(self._store.save(row))
        while not saving.done():
            # it is over: a cancellation now changes nothing
            with contextlib.suppress(asyncio.CancelledError):
                await asyncio.wait({saving})
        if isinstance(error := saving.exception(), JournalFailed):
            _log.error("the end of job %s is not written down yet: %s", job.id, error)
        elif error is not None:
            _log.error("the end of job %s is not written down", job.id, exc_info=error)

    def _shown(self, job: Job, result: object | None) -> Mapping[str, object] | None:
        if result is None or isinstance(result, Mapping):
            return result
        return None if self._view is None else self._view(result, job)

    def _row(self, job: Job) -> JobRow:
        return row_of(job, self._shown(job, job.result))


__all__ = ["KEYS_LIVE", "JobMemory", "View"]
