"""Jobs: what long work does, how it ended, and its cancelling."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from api.access.security import TheCaller
from api.http.job_requests import PREFERENCE_APPLIED, ThePatience
from api.orders.job_views import JobView, job_view
from api.problems import responses
from api.service import TheJob, TheService, TheTelescope

router = APIRouter(tags=["jobs"])

Count = Annotated[int, Query(ge=1, le=10_000, description="At most so many jobs")]


@router.get("/jobs", responses=responses())
async def list_jobs(service: TheService, caller: TheCaller, count: Count = 1000) -> list[JobView]:
    """All jobs still remembered, newest first: those of the telescopes that the key is for."""
    found = [job for job in service.jobs.all() if caller.reaches(job.telescope)]
    return [job_view(job) for job in found[:count]]


@router.get("/telescopes/{telescope_id}/jobs", responses=responses(404))
async def list_telescope_jobs(
    service: TheService, telescope: TheTelescope, count: Count = 1000
) -> list[JobView]:
    """The jobs of one telescope that are still remembered, newest first."""
    found = [job for job in service.jobs.all() if job.telescope == telescope.id]
    return [job_view(job) for job in found[:count]]


@router.get("/jobs/{job_id}", responses={**responses(404), 200: {"headers": PREFERENCE_APPLIED}})
async def get_job(job: TheJob, patience: ThePatience) -> JobView:
    """One job; with `wait`, as soon as it has ended, or when that time has passed."""
    await patience.wait(job)
    return job_view(job)


class NextView(BaseModel):
    """How a mosaic goes on."""

    left: int = Field(description="So many are wanted yet of the present panel; 0: the next one begins")


@router.post("/jobs/{job_id}/next", responses=responses(400, 403, 404, 409))
async def next_panel(service: TheService, job: TheJob, caller: TheCaller) -> NextView:
    """Say that the camera is through with a frame of a mosaic's panel. No body.

    After as many as the order's `frames` the next panel begins.
    """
    return NextView(left=service.dispatcher.next_panel(caller, job))


@router.delete("/jobs/{job_id}", responses=responses(404))
async def cancel_job(service: TheService, job: TheJob, caller: TheCaller) -> JobView:
    """Cancel a job and stop its mount. One that has ended is left as it is; twice is fine."""
    await service.dispatcher.cancel(caller, job)
    return job_view(job)


@router.post("/jobs/{job_id}/cancel", responses=responses(404))
async def cancel_job_by_post(service: TheService, job: TheJob, caller: TheCaller) -> JobView:
    """Cancel a job and stop its mount: the same as DELETE, for clients that can't send that. No body."""
    await service.dispatcher.cancel(caller, job)
    return job_view(job)
