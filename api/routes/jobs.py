"""Jobs: what long work does, how it ended, and its cancelling."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from api.faults import responses
from api.models import JobView, job_view
from api.service import TheJob, TheService

router = APIRouter(prefix="/jobs", tags=["jobs"])

Wait = Annotated[
    float,
    Query(
        ge=0, le=3600, allow_inf_nan=False, description="Seconds to wait for the job's end before answering"
    ),
]


@router.get("", responses=responses())
async def list_jobs(service: TheService) -> list[JobView]:
    """All jobs still remembered, newest first."""
    return [job_view(job) for job in service.jobs.all()]


@router.get("/{job_id}", responses=responses(404))
async def get_job(service: TheService, job: TheJob, wait: Wait = 0.0) -> JobView:
    """One job; with `wait`, as soon as it has ended, or when that time has passed."""
    await service.wait(job, wait)
    return job_view(job)


@router.delete("/{job_id}", responses=responses(404))
async def cancel_job(service: TheService, job: TheJob) -> JobView:
    """Cancel a job and stop its mount. One that has ended is left as it is; twice is fine."""
    await service.cancel(job)
    return job_view(job)
