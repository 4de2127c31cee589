"""Jobs: their life, one at a time per telescope, keys, cancelling."""

from __future__ import annotations

import asyncio
import logging

import pytest

from api.orders.jobs import Jobs, JobState, TelescopeBusy
from api.problems import Refused
from mountnav.errors import Cancelled, DeviceSilent, NotFound
from tests.api.orders.job_work import ended, forever, nothing


async def test_a_job_runs_and_succeeds(jobs: Jobs) -> None:
    job = jobs.start("slew", "east", {}, nothing)
    assert job.state is JobState.QUEUED
    assert (await ended(job)).state is JobState.SUCCEEDED
    assert jobs.get(job.id) is job
    assert job.created_utc <= (job.started_utc or job.created_utc) <= (job.finished_utc or job.created_utc)


async def test_an_error_of_ours_becomes_the_jobs_problem(jobs: Jobs) -> None:
    async def fail() -> object:
        raise DeviceSilent("no answer to :GR#", device="east", advice="is it on?")

    job = await ended(jobs.start("slew", "east", {}, fail))
    assert job.state is JobState.FAILED
    assert job.problem is not None
    assert (job.problem.type, job.problem.retryable) == ("urn:mountnav:problem:device-silent", True)
    assert (job.problem.device, job.problem.advice) == ("east", "is it on?")


async def test_a_fault_of_ours_ends_the_job_and_goes_to_the_log(
    jobs: Jobs, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail() -> object:
        raise ZeroDivisionError

    with caplog.at_level(logging.ERROR):
        job = await ended(jobs.start("slew", "east", {}, fail))
    assert job.state is JobState.FAILED
    assert job.problem is not None
    assert job.problem.type.endswith(":internal")
    assert "ZeroDivisionError" in caplog.text


async def test_one_at_a_time_per_telescope(jobs: Jobs) -> None:
    first = jobs.start("slew", "east", {}, forever)
    with pytest.raises(TelescopeBusy) as caught:
        jobs.start("look", "east", {}, nothing)
    assert caught.value.job_id == first.id
    west = jobs.start("look", "west", {}, nothing)
    assert (await ended(west)).state is JobState.SUCCEEDED
    jobs.cancel(first)
    await ended(first)
    assert (await ended(jobs.start("look", "east", {}, nothing))).state is JobState.SUCCEEDED


@pytest.mark.parametrize("turns", [0, 1, 3])
async def test_cancelling_early_and_late_and_twice(jobs: Jobs, turns: int) -> None:
    job = jobs.start("slew", "east", {}, forever)
    for _ in range(turns):
        await asyncio.sleep(0)
    jobs.cancel(job)
    jobs.cancel(job)
    assert (await ended(job)).state is JobState.CANCELLED
    assert jobs.running_on("east") is None
    jobs.cancel(job)
    assert job.state is JobState.CANCELLED


async def test_a_stopped_motion_counts_as_cancelled(jobs: Jobs) -> None:
    async def stopped() -> object:
        raise Cancelled("the slew was stopped")

    assert (await ended(jobs.start("slew", "east", {}, stopped))).state is JobState.CANCELLED


async def test_a_key_never_starts_a_second_job(jobs: Jobs) -> None:
    first = jobs.start("slew", "east", {"ra_deg": 1.0}, nothing, key="k")
    assert jobs.start("slew", "east", {"ra_deg": 1.0}, nothing, key="k") is first
    await ended(first)
    assert jobs.start("slew", "east", {"ra_deg": 1.0}, nothing, key="k") is first
    for kind, telescope, request in (
        ("slew", "east", {"ra_deg": 2.0}),
        ("center", "east", {"ra_deg": 1.0}),
        ("slew", "west", {"ra_deg": 1.0}),
    ):
        with pytest.raises(Refused) as caught:
            jobs.start(kind, telescope, dict(request), nothing, key="k")
        assert caught.value.problem.status == 422


async def test_old_jobs_are_forgotten_running_ones_never(jobs: Jobs) -> None:
    running = jobs.start("slew", "east", {}, forever)
    for _ in range(30):
        await ended(jobs.start("look", "west", {}, nothing))
    assert len(jobs.all()) == 10
    assert jobs.get(running.id) is running
    with pytest.raises(NotFound):
        jobs.get("nonsense")
    await jobs.close()


async def test_closing_cancels_and_refuses(jobs: Jobs) -> None:
    job = jobs.start("slew", "east", {}, forever)
    await asyncio.sleep(0)
    await jobs.close()
    assert job.state is JobState.CANCELLED
    with pytest.raises(Refused):
        jobs.start("slew", "east", {}, nothing)


async def test_phase_and_attempts_follow_the_navigator(jobs: Jobs) -> None:
    job = jobs.start("center", "east", {}, forever)
    await asyncio.sleep(0)
    jobs.heard("east", "slewing", {})
    assert job.phase == "slewing"
    jobs.heard("east", "attempt", {"number": 1})
    assert job.attempts == [{"number": 1}]
    jobs.heard("west", "exposing", {})
    assert job.phase == "attempt"
    await jobs.close()
