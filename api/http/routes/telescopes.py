"""Telescopes: what is known of them now; and a notice that an operator has seen."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Request, Response

from api.access.security import TheCaller
from api.http.service_views import AcknowledgedView
from api.http.telescope_views import StateAnswers, answered, state_answers
from api.orders.job_views import TelescopeView
from api.problems import responses
from api.service import TheTelescope

router = APIRouter(prefix="/telescopes", tags=["telescopes"])

_TAG = {"ETag": {"description": "Names this reading", "schema": {"type": "string"}}}
_STATE: dict[int | str, dict[str, Any]] = {
    200: {"headers": _TAG},
    304: {"description": "As the client has it: If-None-Match names this reading", "headers": _TAG},
}
Answers = Annotated[StateAnswers, Depends(state_answers)]
IfNoneMatch = Annotated[
    str | None, Header(max_length=2000, description="The ETag of an answer that the client has")
]


@router.get("", response_model=list[TelescopeView], responses={**responses(), **_STATE})
async def list_telescopes(
    request: Request, answers: Answers, caller: TheCaller, if_none_match: IfNoneMatch = None
) -> Response:
    """All telescopes that the key is for and their state, as they were read last. Asks no device."""
    return answered(request, answers.all(caller.telescopes))


@router.get("/{telescope_id}", response_model=TelescopeView, responses={**responses(404), **_STATE})
async def get_telescope(
    request: Request, telescope: TheTelescope, answers: Answers, if_none_match: IfNoneMatch = None
) -> Response:
    """State of one telescope: where it believes it points, and what it does. Asks no device."""
    return answered(request, answers.of(telescope))


@router.post("/{telescope_id}/acknowledge", responses=responses(404))
async def acknowledge_notice(telescope: TheTelescope, caller: TheCaller) -> AcknowledgedView:
    """Say that the notice of what was in flight when the service was killed has been seen. Moves nothing."""
    notice = telescope.restart.notice
    await telescope.restart.acknowledge(caller.name)
    return AcknowledgedView(telescope=telescope.id, notice=notice)
