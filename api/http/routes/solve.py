"""POST /v1/solve: a FITS file in, its place in the sky out. Moves nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from dataclasses import replace
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request

from api.access.callers import Role
from api.access.security import TheCaller, require_role, require_telescope
from api.http.bodies import received
from api.problems import responses
from api.service import TheService
from api.solver.hints import make_hint
from api.solver.solve_record import SolveRecord, solve_record
from mountnav.errors import BadFrame, Cancelled
from mountnav.solution import Reason, Verdict
from mountnav.tasks import waited_for

router = APIRouter(tags=["solve"])

LONGEST_BUDGET_S = 120.0
"""A single frame must not keep the solver from all others for long."""

_BINARY = {"schema": {"type": "string", "format": "binary"}}
_FORM = {
    "type": "object",
    "required": ["file"],
    "properties": {"file": {"type": "string", "format": "binary"}},
}
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "The image: as the part `file` of a form, or the body itself",
        "content": {
            "multipart/form-data": {"schema": _FORM},
            "application/octet-stream": _BINARY,
        },
    }
}

Ra = Annotated[
    float | None,
    Query(
        ge=0, lt=360, allow_inf_nan=False, description="Right ascension of the believed center, ICRS, degrees"
    ),
]
Dec = Annotated[float | None, Query(ge=-90, le=90, allow_inf_nan=False)]
Radius = Annotated[
    float | None,
    Query(gt=0, le=180, allow_inf_nan=False, description="How far from there the center may be, degrees"),
]
Scale = Annotated[
    float | None,
    Query(gt=0, le=3600, allow_inf_nan=False, description="Bound of the scale, arcseconds per pixel"),
]

Blind = Annotated[
    Literal["after", "only", "never"] | None,
    Query(
        description="Search the whole sky: after the hint failed; only so, without asking any hint; never. "
        "Else as the settings have it"
    ),
]
Budget = Annotated[
    float | None,
    Query(
        gt=0,
        le=LONGEST_BUDGET_S,
        allow_inf_nan=False,
        description="Seconds for identifying it, waiting for the blind index included; reading and measuring "
        "come on top. Else as the settings have it",
    ),
]


@router.post("/solve", responses=responses(404), openapi_extra=_BODY)
async def solve_upload(
    request: Request,
    service: TheService,
    caller: TheCaller,
    ra_deg: Ra = None,
    dec_deg: Dec = None,
    radius_deg: Radius = None,
    scale_low_arcsec_px: Scale = None,
    scale_high_arcsec_px: Scale = None,
    telescope: Annotated[
        str | None, Query(description="Id of the telescope whose calibration masters are applied")
    ] = None,
    blind: Blind = None,
    budget_s: Budget = None,
) -> SolveRecord:
    """Solve an uploaded frame. Hints not given are taken from its header. Not solved is an answer: 200.

    One that was found by searching the whole sky has a `mode` that begins with `blind/`.
    """
    if telescope is not None:
        # a key that may only solve sees no telescopes
        require_role(caller, Role.VIEW)
        require_telescope(caller, telescope)
    hint = make_hint(ra_deg, dec_deg, radius_deg, scale_low_arcsec_px, scale_high_arcsec_px)
    settings = service.solve_settings(telescope)
    settings = replace(settings, blind=blind or settings.blind, budget_s=budget_s or settings.budget_s)
    async with received(request, int(service.settings.service.max_upload_mb * 1e6)) as upload:
        solving = service.solver.solve_upload(upload, hint, settings, owner=caller.name)
        verdict = await _unless_gone(request, solving)
    if verdict.reason is Reason.BAD_FRAME:
        raise BadFrame(verdict.detail or str(verdict.reason), device=upload.name)
    return solve_record(upload.name, verdict)


async def _unless_gone(request: Request, solving: Coroutine[None, None, Verdict]) -> Verdict:
    """Wait for the verdict, as long as the client does."""
    solved = waited_for(solving)
    gone = waited_for(_gone(request))
    both: set[asyncio.Task[Any]] = {solved, gone}
    try:
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        if solved.done():
            return solved.result()
        raise Cancelled("the client is gone", advice="send it again")
    finally:
        for task in both:
            task.cancel()
        await asyncio.gather(*both, return_exceptions=True)


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass
