"""POST /v1/solve: a FITS file in, its place in the sky out. Moves nothing."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from starlette.datastructures import UploadFile
from starlette.exceptions import HTTPException
from starlette.formparsers import MultiPartException
from starlette.types import Message, Receive

from api.faults import Refused, problem, responses
from api.hints import make_hint
from api.service import TheService
from api.solve_record import SolveRecord, solve_record
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadFrame, BadRequest
from mountnav.frames import Hint
from mountnav.reading import read_frame
from mountnav.solution import Reason, Verdict
from mountnav.solve import SolveSettings, solve

router = APIRouter(tags=["solve"])

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
            "application/fits": _BINARY,
            "application/octet-stream": _BINARY,
        },
    }
}

Ra = Annotated[float | None, Query(ge=0, lt=360, allow_inf_nan=False, description="Believed ICRS center")]
Dec = Annotated[float | None, Query(ge=-90, le=90, allow_inf_nan=False)]
Radius = Annotated[
    float | None, Query(gt=0, le=180, allow_inf_nan=False, description="How wrong that may be")
]
Scale = Annotated[float | None, Query(gt=0, le=3600, allow_inf_nan=False, description="Arcseconds per pixel")]


@router.post("/solve", responses=responses(413), openapi_extra=_BODY)
async def solve_upload(
    request: Request,
    service: TheService,
    ra_deg: Ra = None,
    dec_deg: Dec = None,
    radius_deg: Radius = None,
    scale_low_arcsec_px: Scale = None,
    scale_high_arcsec_px: Scale = None,
    telescope: Annotated[str | None, Query(description="Whose calibration masters to apply")] = None,
) -> SolveRecord:
    """Solve an uploaded frame. Hints not given are taken from its header. Not solved is an answer: 200."""
    hint = make_hint(ra_deg, dec_deg, radius_deg, scale_low_arcsec_px, scale_high_arcsec_px)
    name, content = await _upload(request, int(service.settings.service.max_upload_mb * 1e6))
    if not content:
        raise BadFrame("the upload is empty", advice="send the file as the body, or as the form part `file`")
    settings = service.solve_settings(telescope)
    async with service.solving:
        verdict = await asyncio.to_thread(_solve, content, name, service.catalog, hint, settings)
    if verdict.reason is Reason.BAD_FRAME:
        raise BadFrame(verdict.detail or str(verdict.reason), device=name)
    return solve_record(name, verdict)


def _solve(
    content: bytes, name: str, catalog: Catalog, hint: Hint | None, settings: SolveSettings
) -> Verdict:
    began = time.perf_counter()
    frame = read_frame(content, name=name, raw=True)
    read_s = time.perf_counter() - began
    verdict = solve(frame, catalog, hint=hint, settings=settings)
    times = replace(verdict.times, read_s=read_s, total_s=verdict.times.total_s + read_s)
    return replace(verdict, times=times)


async def _upload(request: Request, limit_bytes: int) -> tuple[str, bytes]:
    """Name and content of the upload; refused as soon as it is longer than the limit."""
    announced = request.headers.get("content-length", "0")
    if announced.isascii() and announced.isdigit() and int(announced[:20]) > limit_bytes:
        raise _too_large(limit_bytes)
    limited = Request(request.scope, _limited(request.receive, limit_bytes))
    if not request.headers.get("content-type", "").startswith("multipart/form-data"):
        return "upload", await limited.body()
    try:
        async with limited.form(max_files=1, max_fields=20) as form:
            file = form.get("file")
            if not isinstance(file, UploadFile):
                raise BadRequest("the form has no part `file`", advice="curl -F file=@frame.fits URL")
            return file.filename or "upload", await file.read()
    except (MultiPartException, HTTPException) as error:
        told = error.message if isinstance(error, MultiPartException) else error.detail
        raise BadRequest(f"the form can't be read: {told}", advice="curl -F file=@frame.fits URL") from error


def _limited(receive: Receive, limit_bytes: int) -> Receive:
    taken = 0

    async def receive_limited() -> Message:
        nonlocal taken
        message = await receive()
        taken += len(message.get("body", b""))
        if taken > limit_bytes:
            raise _too_large(limit_bytes)
        return message

    return receive_limited


def _too_large(limit_bytes: int) -> Refused:
    limit_mb = limit_bytes / 1e6
    found = problem(
        "too-large",
        413,
        f"the upload is larger than {limit_mb:g} MB",
        advice="send a smaller file, or raise service.max_upload_mb",
    )
    return Refused(found)
