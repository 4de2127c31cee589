"""Stops: of one telescope, of all. No body, no lease, never refused as busy: they come before all else."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from api.faults import Refused, problem, problem_of, responses
from api.security import TheCaller
from api.service import TheService, TheTelescope
from api.service_views import StopAllView, StoppedView, StopView
from mountnav.errors import DeviceError

router = APIRouter(tags=["stop"])

_FAILURES = {
    502: "The mount could not be told to stop",
    503: "The mount can't be reached: the stop could NOT be sent",
    504: "The mount gives no answer: the stop may not have arrived",
}
_NOT_SENT: dict[int | str, dict[str, Any]] = {
    status: {**responses()[422], "description": description} for status, description in _FAILURES.items()
}


@router.post("/telescopes/{telescope_id}/stop", responses={**responses(404), **_NOT_SENT})
async def stop_telescope(service: TheService, telescope: TheTelescope, caller: TheCaller) -> StopView:
    """Stop all motion now: no body, never refused as busy. Answers once the stop was sent."""
    job = await service.desk.stop(caller, telescope.id)
    return StopView(telescope=telescope.id, cancelled_job_id=None if job is None else job.id)


@router.post("/stop", responses={**responses(), 502: {**_NOT_SENT[502], "description": "Not all were told"}})
async def stop_all(service: TheService, caller: TheCaller) -> StopAllView:
    """Stop all telescopes now. Needs no body.

    A telescope that is not connected, and can't be reached now either, is told as such in the answer; one
    that is connected and could not be told to stop makes it a 502 `stop-failed`.
    """
    connected = {one.id for one in service.observatory.telescopes if one.is_open}
    ended = await service.desk.stop_all(caller)
    views = []
    for telescope_id, end in ended.items():
        if isinstance(end, DeviceError):
            views.append(StoppedView(telescope=telescope_id, stopped=False, problem=str(end)))
        else:
            job_id = None if end is None else end.id
            views.append(StoppedView(telescope=telescope_id, stopped=True, cancelled_job_id=job_id))
    failed = {name: end for name, end in ended.items() if isinstance(end, DeviceError) and name in connected}
    if failed:
        raise Refused(
            problem(
                "stop-failed",
                502,
                "; ".join(f"{name}: {problem_of(end).detail}" for name, end in failed.items()),
                advice="look at the mount; cut its power if it moves",
                retryable=True,
                errors=[{"at": one.telescope, "what": one.problem or "stopped"} for one in views],
            )
        )
    return StopAllView(stopped=all(one.stopped for one in views), telescopes=views)
