"""Superseding: the job that holds a telescope makes room, the mount is stopped first, each end is told."""

from __future__ import annotations

import asyncio

import pytest

from api.events import Events
from api.orders.jobs import Job, Jobs, JobState, TelescopeBusy
from api.problems import Refused
from mountnav.errors import DeviceMissing


class Mount:
    """Writes down, in order, what is done with it; its work ends slowly when it is cancelled."""

    def __init__(self) -> None:
        self.story: list[str] = []
        self.going = asyncio.Event()
        self.may_end = asyncio.Event()
        self.may_end.set()

    async def slew(self) -> object:
        """Slew until it is cancelled."""
        self.story.append("slewing")
        self.going.set()
        try:
            return await asyncio.Event().wait()
        finally:
            await self.may_end.wait()
            self.story.append("slew ended")

    async def stop(self) -> None:
        """Stop."""
        self.story.append("stopped")

    async def other(self) -> object:
        """Do the other order."""
        self.story.append("other")
        return None


@pytest.fixture
def jobs() -> Jobs:
    return Jobs(Events(100), kept=50)


async def _ended(job: Job) -> Job:
    await asyncio.wait_for(job.ended.wait(), 60)
    return job


async def test_the_holder_is_cancelled_and_the_mount_stopped_before_the_other_begins(jobs: Jobs) -> None:
    mount = Mount()
    first = jobs.start("slew", "east", {"n": 1}, mount.slew)
    await mount.going.wait()
    second = jobs.start("center", "east", {"n": 2}, mount.other, make_room=mount.stop)
    assert jobs.running_on("east") is second
    assert not second.is_over
    await _ended(second)
    assert second.state is JobState.SUCCEEDED
    assert mount.story.index("stopped") < mount.story.index("other")
    assert mount.story.index("slew ended") < mount.story.index("other")
    assert first.state is JobState.CANCELLED
    assert first.problem is not None
    assert first.problem.type.endswith(":cancelled")
    assert first.problem.superseded_by == second.id
    assert second.id in first.problem.detail


async def test_the_stop_does_not_wait_for_the_holders_end(jobs: Jobs) -> None:
    mount = Mount()
    mount.may_end.clear()
    jobs.start("slew", "east", {}, mount.slew)
    await mount.going.wait()
    second = jobs.start("slew", "east", {"n": 2}, mount.other, make_room=mount.stop)
    for _ in range(20):
        await asyncio.sleep(0)
    assert mount.story == ["slewing", "stopped"]
    assert second.phase == "superseding"
    mount.may_end.set()
    await _ended(second)
    assert mount.story[-2:] == ["slew ended", "other"]


async def test_what_the_superseded_one_still_tells_is_its_own(jobs: Jobs) -> None:
    mount = Mount()
    mount.may_end.clear()
    first = jobs.start("center", "east", {}, mount.slew)
    await mount.going.wait()
    second = jobs.start("slew", "east", {"n": 2}, mount.other, make_room=mount.stop)
    jobs.heard("east", "attempt", {"number": 1})
    assert [len(first.attempts), len(second.attempts)] == [1, 0]
    mount.may_end.set()
    await _ended(second)


async def test_a_chain_of_three_ends_with_the_last_alone(jobs: Jobs) -> None:
    mount = Mount()
    mount.may_end.clear()
    first = jobs.start("slew", "east", {}, mount.slew)
    await mount.going.wait()
    second = jobs.start("slew", "east", {"n": 2}, mount.slew, make_room=mount.stop)
    await asyncio.sleep(0)
    third = jobs.start("slew", "east", {"n": 3}, mount.other, make_room=mount.stop)
    await _ended(second)
    # the first one still works on the mount: nobody else may
    assert not third.is_over
    assert "other" not in mount.story
    with pytest.raises(TelescopeBusy) as busy:
        jobs.start("look", "east", {}, mount.other)
    assert busy.value.job_id == third.id
    mount.may_end.set()
    await _ended(third)
    assert [one.state for one in (first, second, third)] == [
        JobState.CANCELLED,
        JobState.CANCELLED,
        JobState.SUCCEEDED,
    ]
    assert mount.story.count("slewing") == 1
    assert second.problem is not None
    assert second.problem.superseded_by == third.id
    assert jobs.running_on("east") is None


async def test_if_the_mount_cannot_be_told_to_stop_the_new_job_fails_and_moves_nothing(jobs: Jobs) -> None:
    mount = Mount()

    async def gone() -> None:
        raise DeviceMissing("the port is gone", device="east", advice="plug it in")

    first = jobs.start("slew", "east", {}, mount.slew)
    await mount.going.wait()
    second = await _ended(jobs.start("slew", "east", {"n": 2}, mount.other, make_room=gone))
    assert second.state is JobState.FAILED
    assert second.problem is not None
    assert second.problem.type.endswith(":device-missing")
    assert second.problem.retry_after_s is not None
    assert "other" not in mount.story
    assert (await _ended(first)).state is JobState.CANCELLED


async def test_a_job_that_waits_for_room_can_be_cancelled_itself(jobs: Jobs) -> None:
    mount = Mount()
    mount.may_end.clear()
    first = jobs.start("slew", "east", {}, mount.slew)
    await mount.going.wait()
    second = jobs.start("slew", "east", {"n": 2}, mount.other, make_room=mount.stop)
    await asyncio.sleep(0)
    jobs.cancel(second)
    assert (await _ended(second)).state is JobState.CANCELLED
    assert jobs.running_on("east") is first
    mount.may_end.set()
    await _ended(first)
    assert "other" not in mount.story


async def test_superseding_nobody_is_an_ordinary_order(jobs: Jobs) -> None:
    mount = Mount()
    job = await _ended(jobs.start("slew", "east", {}, mount.other, make_room=mount.stop))
    assert job.state is JobState.SUCCEEDED
    assert mount.story == ["other"]


async def test_a_key_holds_for_superseding_too(jobs: Jobs) -> None:
    mount = Mount()
    jobs.start("slew", "east", {}, mount.slew)
    await mount.going.wait()
    second = jobs.start("slew", "east", {"n": 2}, mount.slew, key="k", make_room=mount.stop)
    assert jobs.start("slew", "east", {"n": 2}, mount.other, key="k", make_room=mount.stop) is second
    assert second.superseded_by is None
    with pytest.raises(Refused) as caught:
        jobs.start("slew", "east", {"n": 3}, mount.other, key="k", make_room=mount.stop)
    assert caught.value.problem.status == 422
    # the refused one has cost nobody his job
    assert not second.is_over
    await jobs.close()
    assert second.state is JobState.CANCELLED
