"""What jobs of tests do: nothing, or nothing for ever."""

from __future__ import annotations

import asyncio

from api.orders.jobs import Job


async def forever() -> object:
    return await asyncio.Event().wait()


async def nothing() -> object:
    return None


async def ended(job: Job) -> Job:
    await job.ended.wait()
    return job
