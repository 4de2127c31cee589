"""Stops: of one telescope, of all. No body, no lease, never refused as busy: they come before all else."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from api.access.security import TheCaller
from api.http.service_views import StopAllView, StoppedView, StopView
from api.orders.dispatcher import STOP_KNOWN_S, StopGiven
from api.problems import Refused, problem, problem_of, responses
from api.service import TheService, TheTelescope

router = APIRouter(tags=["stop"])

_LATE = f"not known yet: it was not confirmed within {STOP_KNOWN_S:g} s; the event stop-settled tells"
_FAILURES = {
    502: "The mount could not be told to stop",
    503: "The mount can't be reached: the stop could NOT be sent",
    504: "The mount gives no answer: the stop may not have arrived",
}
_NOT_SENT: dict[int | str, dict[str, Any]] = {
    status: {**responses()[422], "description": description} for status, description in _FAILURES.items()
}


_NOT_YET: dict[int | str, dict[str, Any]] = {
    202: {"description": "Not known yet whether it was sent; the event `stop-settled` tells"}
}


@router.post(
    "/telescopes/{telescope_id}/stop",
    responses={**responses(404), **_NOT_SENT, 202: {**_NOT_YET[202], "model": StopView}},
)
async def stop_telescope(
    service: TheService, telescope: TheTelescope, caller: TheCaller, response: Response
) -> StopView:
    """Stop all motion now: no body, never refused as busy. Answers once it was sent, and within 2 s."""
    given = await service.dispatcher.give_stop(caller, telescope.id)
    if given.error is not None:
        raise given.error
    job_id = None if given.job is None else given.job.id
    if given.sent is None:
        response.status_code = 202
        return StopView(telescope=telescope.id, stopped=None, cancelled_job_id=job_id)
    return StopView(telescope=telescope.id, cancelled_job_id=job_id)


@router.post(
    "/stop",
    responses={
        **responses(),
        502: {**_NOT_SENT[502], "description": "Not all were told"},
        202: {**_NOT_YET[202], "model": StopAllView},
    },
)
async def stop_all(service: TheService, caller: TheCaller, response: Response) -> StopAllView:
    """Stop all telescopes now, and answer within 2 s. Needs no body. A key for some stops those.

    A telescope that is not connected, and can't be reached now either, is told as such in the answer; one
    that is connected and could not be told to stop makes it a 502 `stop-failed`. Of one that takes longer it
    is said that it is not known yet (202), and the event `stop-settled` says what came of it.
    """
    connected = {telescope.id for telescope in service.observatory.telescopes if telescope.is_open}
    given = await service.dispatcher.stop_all(caller)
    views = [_view(telescope_id, one) for telescope_id, one in given.items()]
    failed = {name: one.error for name, one in given.items() if one.error is not None and name in connected}
    if failed:
        raise Refused(
            problem(
                "stop-failed",
                502,
                "; ".join(f"{name}: {problem_of(error).detail}" for name, error in failed.items()),
                advice="look at the mount; cut its power if it moves",
                retryable=True,
                errors=[{"at": view.telescope, "what": _words(view)} for view in views],
            )
        )
    if any(view.stopped is None for view in views):
        response.status_code = 202
    known = [view.stopped for view in views]
    return StopAllView(stopped=False if False in known else None if None in known else True, telescopes=views)


def _view(telescope_id: str, given: StopGiven) -> StoppedView:
    return StoppedView(
        telescope=telescope_id,
        stopped=given.sent,
        cancelled_job_id=None if given.job is None else given.job.id,
        problem=_LATE if given.sent is None else None if given.error is None else str(given.error),
    )


def _words(one: StoppedView) -> str:
    return "stopped" if one.stopped else one.problem or "not stopped"
