"""Jobs over restarts: still told, never done twice, and what was running is told as interrupted."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from datetime import timedelta
from pathlib import Path

import pytest

from api.events import Events
from api.orders.jobs import KEYS_LIVE, Job, Jobs, JobState
from api.problems import Refused
from mountnav.clock import utc_now
from mountnav.errors import JournalFailed, NotFound, TargetNotReached
from mountnav.journal.job_rows import JobRow
from mountnav.journal.job_store import JobStore
from mountnav.journal.records import CommandEnd, CommandRecord, Outcome, cause, new_id
from mountnav.journal.sql_journal import SqlJournal, open_journal
from mountnav.sky.coordinates import Apparent

REQUEST: dict[str, object] = {"ra_deg": 10.0, "dec_deg": 20.0, "frame": "icrs"}


class Service:
    """One run of the service: its journal and its jobs, and how often something really moved."""

    def __init__(self, journal: SqlJournal, kept: int) -> None:
        self.journal = journal
        store = JobStore(journal, journal.reader, frozenset({"east", "west"}))
        self.jobs = Jobs(
            Events(100), kept, store=store, view=lambda result, _: {"kind": "slew", "said": str(result)}
        )
        self.moved = 0

    async def move(self) -> object:
        """Give one order to a mount, as navigation does, and come to its end."""
        now = utc_now()
        command = CommandRecord(new_id(), "east", now, "slew", "segment", Apparent(120.0, 40.0, now))
        await self.journal.begin(command)
        self.moved += 1
        await self.journal.end(command.command_id, CommandEnd(utc_now(), Outcome.DONE, "arrived"))
        return "there"

    async def move_and_hang(self) -> object:
        """Killed while the mount is under way."""
        now = utc_now()
        await self.journal.begin(
            CommandRecord(new_id(), "east", now, "slew", "s", Apparent(120.0, 40.0, now))
        )
        self.moved += 1
        return await asyncio.Event().wait()


@asynccontextmanager
async def running(file: Path, kept: int = 100, *, killed: bool = False) -> AsyncIterator[Service]:
    """A run of the service; `killed` ends it without a word to the journal."""
    journal = await asyncio.to_thread(open_journal, file)
    service = Service(journal, kept)
    await service.jobs.take_up()
    tasks_before = asyncio.all_tasks()
    try:
        yield service
    finally:
        if killed:
            # what a killed process wrote was written; nothing more comes from it
            journal._writer._closed = True
        for task in asyncio.all_tasks() - tasks_before:
            task.cancel()
        await asyncio.gather(*(asyncio.all_tasks() - tasks_before), return_exceptions=True)
        if not killed:
            await asyncio.to_thread(journal.close)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


async def _ended(job: Job) -> Job:
    await job.ended.wait()
    return job


async def test_an_ended_job_is_still_told_after_a_restart(file: Path) -> None:
    async with running(file) as service:
        job = await _ended(service.jobs.start("slew", "east", REQUEST, service.move, key="k"))
    async with running(file) as service:
        found = service.jobs.get(job.id)
        assert (found.state, found.kind, found.request) == (JobState.SUCCEEDED, "slew", REQUEST)
        assert found.result == {"kind": "slew", "said": "there"}
        assert (found.created_utc, found.started_utc) == (job.created_utc, job.started_utc)
        assert found.is_over
        assert found.ended.is_set()
        assert service.jobs.start("slew", "east", REQUEST, service.move, key="k") is found
        assert service.moved == 0
        with pytest.raises(Refused):
            service.jobs.start("slew", "east", {**REQUEST, "ra_deg": 11.0}, service.move, key="k")
        assert [one.id for one in service.jobs.all()] == [job.id]


async def test_a_failed_job_keeps_its_problem_and_attempts(file: Path) -> None:
    async def fail() -> object:
        raise TargetNotReached("still 40″ off", device="east", advice="more time")

    async with running(file) as service:
        job = service.jobs.start("center", "east", {}, fail)
        service.jobs.heard("east", "attempt", {"number": 1, "error_arcsec": 40.0})
        await _ended(job)
    async with running(file) as service:
        found = service.jobs.get(job.id)
        assert found.problem == job.problem
        assert found.attempts == [{"number": 1, "error_arcsec": 40.0}]


async def test_a_job_cut_off_is_interrupted_and_never_done_again(file: Path) -> None:
    async with running(file, killed=True) as service:
        job = service.jobs.start("slew", "east", REQUEST, service.move_and_hang, key="k")
        async with asyncio.timeout(60):
            while not service.moved:
                await asyncio.sleep(0.01)
    async with running(file) as service:
        found = service.jobs.get(job.id)
        assert found.state is JobState.FAILED
        assert found.problem is not None
        assert found.problem.type == "urn:mountnav:problem:interrupted"
        assert not found.problem.retryable
        for words in (
            "interrupted by a restart",
            "slew to apparent RA 120.0000° Dec +40.0000°",
            "sent or not",
        ):
            assert words in found.problem.detail
        assert service.jobs.start("slew", "east", REQUEST, service.move, key="k") is found
        assert service.moved == 0
        assert service.jobs.running_on("east") is None
    async with running(file) as service:
        assert service.jobs.get(job.id).problem == found.problem


async def test_an_interrupted_job_tells_its_last_order(file: Path) -> None:
    async with running(file, killed=True) as service:

        async def move_then_hang() -> object:
            await service.move()
            return await asyncio.Event().wait()

        job = service.jobs.start("slew", "east", REQUEST, move_then_hang)
        async with asyncio.timeout(60):
            while not service.journal.reader.commands() or service.journal.reader.in_flight():
                await asyncio.sleep(0.01)
    async with running(file) as service:
        problem = service.jobs.get(job.id).problem
        assert problem is not None
        assert problem.detail.endswith("UTC: done (arrived)")


async def test_a_job_that_cannot_be_written_down_moves_nothing(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running(file) as service:

        async def full(_row: JobRow) -> None:
            raise JournalFailed("the disk is full")

        monkeypatch.setattr(service.journal, "save_job", full)
        job = await _ended(service.jobs.start("slew", "east", REQUEST, service.move))
        assert (job.state, service.moved) == (JobState.FAILED, 0)
        assert job.problem is not None
        assert job.problem.type.endswith(":journal-failed")


async def test_what_a_job_does_carries_its_id(file: Path) -> None:
    async with running(file) as service:
        seen: list[tuple[str | None, str]] = []

        async def look() -> object:
            seen.append((cause().job_id, cause().why))
            return await service.move()

        job = await _ended(service.jobs.start("center", "east", {}, look))
        assert seen == [(job.id, "center")]
        assert service.journal.reader.commands()[0][0].cause.job_id == job.id
        assert cause().job_id is None


async def test_jobs_that_are_forgotten_are_found_in_the_journal_and_keys_live_on(file: Path) -> None:
    async with running(file, kept=3) as service:
        jobs = [
            await _ended(service.jobs.start("slew", "east", REQUEST, service.move, key=f"k{number}"))
            for number in range(8)
        ]
        assert len(service.jobs.all()) == 3
        assert (await asyncio.to_thread(service.jobs.get, jobs[0].id)).state is JobState.SUCCEEDED
        assert service.jobs.start("slew", "east", REQUEST, service.move, key="k0").id == jobs[0].id
        assert service.moved == 8
        with pytest.raises(NotFound):
            service.jobs.get("nonsense")
    async with running(file, kept=3) as service:
        assert len(service.jobs.all()) == 3
        assert service.jobs.start("slew", "east", REQUEST, service.move, key="k0").id == jobs[0].id
        assert service.moved == 0


async def test_old_keys_are_forgotten_in_the_end(file: Path) -> None:
    async with running(file, kept=2) as service:
        for number in range(3):
            job = await _ended(service.jobs.start("slew", "east", REQUEST, service.move, key=f"k{number}"))
            job.created_utc -= KEYS_LIVE + timedelta(hours=1)
        again = await _ended(service.jobs.start("slew", "east", REQUEST, service.move, key="k0"))
        await _ended(service.jobs.start("slew", "east", REQUEST, service.move, key="k9"))
        assert again.id != job.id
        assert len(service.jobs._memory._keys) <= 3


async def test_other_services_jobs_are_left_alone(file: Path) -> None:
    """A journal may be shared: what runs on another service's telescope is not interrupted by our start."""
    journal = await asyncio.to_thread(open_journal, file)
    other = JobRow("theirs", "north", "slew", "running", "slewing", {}, utc_now(), "0" * 64)
    await journal.save_job(other)
    async with running(file) as service:
        assert service.jobs.all() == []
    assert journal.reader.job("theirs") == other
    await asyncio.to_thread(journal.close)


@pytest.mark.long
@pytest.mark.parametrize("turns", [0, 1, 2, 3, 5, 8])
async def test_a_cancelled_job_is_written_down_as_cancelled(file: Path, turns: int) -> None:
    async with running(file) as service:

        async def forever() -> object:
            return await asyncio.Event().wait()

        job = service.jobs.start("slew", "east", REQUEST, forever, key="k")
        for _ in range(turns):
            await asyncio.sleep(0)
        service.jobs.cancel(job)
        service.jobs.cancel(job)
        assert (await _ended(job)).state is JobState.CANCELLED
    async with running(file) as service:
        assert service.jobs.get(job.id).state is JobState.CANCELLED


async def test_superseding_holds_over_a_restart(file: Path) -> None:
    async def stop() -> None:
        return None

    async with running(file, killed=True) as before:
        first = before.jobs.start("slew", "east", dict(REQUEST), before.move_and_hang, key="first")
        while before.moved == 0:
            await asyncio.sleep(0.01)
        request = {**REQUEST, "dec_deg": 30.0}
        second = before.jobs.start(
            "slew", "east", dict(request), before.move_and_hang, key="k", make_room=stop
        )
        await first.ended.wait()
        while before.moved < 2:
            await asyncio.sleep(0.01)
    async with running(file) as after:
        told = after.jobs.get(first.id)
        assert told.state is JobState.CANCELLED
        assert told.problem is not None
        assert told.problem.superseded_by == second.id
        again = after.jobs.start("slew", "east", dict(request), after.move, key="k", make_room=stop)
        assert again.id == second.id
        assert (again.state, after.moved) == (JobState.FAILED, 0)
        with pytest.raises(Refused):
            after.jobs.start("slew", "east", dict(REQUEST), after.move, key="k", make_room=stop)
