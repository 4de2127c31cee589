"""Science frames sent to a night: uploaded, by their path, or by their header alone."""

from __future__ import annotations

import asyncio
import hashlib
import json
import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from fastapi import APIRouter, Query, Request, Response
from pydantic import ValidationError

from api.http.bodies import received
from api.http.night_views import FramePathBody, FrameView, frame_view
from api.http.routes.night import TheNight
from api.nights.nights import NightRunner, digest_of
from api.orders.execute_order import goal
from api.problems import responses
from api.service import TheService
from api.solver.link import Upload, in_memory
from mountnav.ephemeris import Ephemeris
from mountnav.errors import BadFrame, BadRequest, Busy
from mountnav.frames import Frame
from mountnav.night.frames_in import Receipt
from mountnav.reading import frame_from_array
from mountnav.sky.coordinates import Icrs

router = APIRouter(prefix="/telescopes", tags=["night"])

LONGEST_JSON_BYTES = 2_000_000
"""Longest JSON body, bytes: a FITS header with 10,000 cards takes 1 MB. Doubled, the loop may parse for
twice as long."""
UPLOADS_WAITING = 8
"""Uploads lie in memory until they are looked at; files of this machine lie where they are."""
_HEADER_SIDE_PX = 16
"""Side of the empty image that stands for a frame of which only the header was sent, pixels; it is never
measured."""

_BINARY = {"schema": {"type": "string", "format": "binary"}}
_FORM = {
    "type": "object",
    "required": ["file"],
    "properties": {"file": {"type": "string", "format": "binary"}},
}
PATH_EXAMPLE = {
    "path": "/data/2026-12-01/m31-017.fits",
    "target": {"kind": "icrs", "ra_deg": 10.6847, "dec_deg": 41.2687},
}
"""Of a body: a frame that lies on the service's machine, and where it should look."""
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "description": "The image as the part `file` of a form or as the body itself; or JSON: its path, or "
        "its header alone",
        "content": {
            "multipart/form-data": {"schema": _FORM},
            "application/octet-stream": _BINARY,
            "application/json": {
                # the schema itself is added to the description by the application
                "schema": {"$ref": "#/components/schemas/FramePathBody"},
                "examples": {"path": {"value": PATH_EXAMPLE}},
            },
        },
    }
}
Wait = Annotated[
    float,
    Query(ge=0, le=600, allow_inf_nan=False, description="Seconds to wait for what comes of it"),
]
Held = Annotated[
    bool,
    Query(description="Nothing is exposed before the answer: a correction may be made meanwhile"),
]
Ra = Annotated[
    float | None,
    Query(
        ge=0,
        lt=360,
        allow_inf_nan=False,
        description="Right ascension of the place where the frame's center was meant to be, ICRS, degrees",
    ),
]
Dec = Annotated[float | None, Query(ge=-90, le=90, allow_inf_nan=False)]


@router.post(
    "/{telescope_id}/frames",
    status_code=202,
    responses={
        **responses(404, 409, 413),
        200: {"model": FrameView, "description": "What came of it; or the frame was here before"},
    },
    openapi_extra=_BODY,
)
async def send_frame(
    request: Request,
    service: TheService,
    night: TheNight,
    response: Response,
    wait: Wait = 0.0,
    hold: Held = False,
    target_ra_deg: Ra = None,
    target_dec_deg: Dec = None,
) -> FrameView:
    """Send a science frame: it is identified, measured, and by the night's rules the mount is corrected.

    Answers 202 with its id at once; with `wait` 200 as soon as all is known. The same content is looked at
    once, however often it is sent.
    """
    if request.headers.get("content-type", "").partition(";")[0].strip().lower() == "application/json":
        body = await _json_body(request)
        if body.target is not None and body.target_ra_deg is not None:
            raise BadRequest("either target, or target_ra_deg and target_dec_deg")
        target: Icrs | Ephemeris | None = _target(body.target_ra_deg, body.target_dec_deg)
        if body.target is not None:
            navigator = service.observatory.telescope(night.parts.telescope_id).navigator
            target = await asyncio.to_thread(goal, navigator, body.target)
        receipt = await _by_json(night, body, target)
    else:
        target = _target(target_ra_deg, target_dec_deg)
        receipt = await _uploaded(request, service, night, hold, target)
    response.headers["Location"] = f"/v1/telescopes/{night.parts.telescope_id}/frames/{receipt.frame_id}"
    answer = await night.result(receipt.frame_id, wait)
    if answer.done or receipt.duplicate:
        response.status_code = 200
    return frame_view(answer, night.parts.telescope_id, duplicate=receipt.duplicate)


@router.get("/{telescope_id}/frames", responses=responses(404, 409))
async def list_frames(
    night: TheNight, count: Annotated[int, Query(ge=1, le=1000, description="At most so many frames")] = 50
) -> list[FrameView]:
    """The newest frames, newest first."""
    return [frame_view(frame, night.parts.telescope_id) for frame in night.newest(count)]


@router.get("/{telescope_id}/frames/{frame_id}", responses=responses(404, 409))
async def get_frame(night: TheNight, frame_id: str, wait: Wait = 0.0) -> FrameView:
    """One frame; with `wait`, as soon as all is known of it, or when that time has passed."""
    return frame_view(await night.result(frame_id, wait), night.parts.telescope_id)


async def _json_body(request: Request) -> FramePathBody:
    text = b""
    async for piece in request.stream():
        text += piece
        if len(text) > LONGEST_JSON_BYTES:
            raise BadRequest("the JSON is too long", advice="send the frame's path, or upload it")
    try:
        return FramePathBody.model_validate_json(text)
    except ValidationError as error:
        told = "; ".join(
            f"{'.'.join(str(part) for part in wrong['loc'])}: {wrong['msg']}" for wrong in error.errors()[:5]
        )
        raise BadRequest(told, advice='send {"path": "/data/frame.fits"} or {"header": {...}}') from error


async def _by_json(night: NightRunner, body: FramePathBody, target: Icrs | Ephemeris | None) -> Receipt:
    if (body.path is None) == (body.header is None):
        raise BadRequest("either a path or a header is needed", advice='send {"path": "..."}')
    if body.header is not None:
        frame = _header_frame(body.header, body.source or "a header")
        digest = hashlib.sha256(json.dumps(body.header, sort_keys=True).encode()).hexdigest()
        return night.offer_frame(frame.source, digest, lambda: frame, pixels=False)
    path = await asyncio.to_thread(night.allowed, Path(body.path or ""))
    try:
        digest = await asyncio.to_thread(digest_of, path)
    except OSError as trouble:
        raise BadFrame(f"the file can't be read: {trouble.strerror}", device=str(path)) from trouble
    return night.offer_file(path, digest, held=body.hold, target=target)


def _header_frame(header: dict[str, Any], source: str) -> Frame:
    """A frame without pixels of its own, for its time and place."""
    plain = {key: one for key, one in header.items() if isinstance(one, str | int | float | bool)}
    nothing = np.zeros((_HEADER_SIDE_PX, _HEADER_SIDE_PX), np.uint8)
    return frame_from_array(nothing, plain, name=source)


async def _uploaded(
    request: Request, service: TheService, night: NightRunner, hold: bool, target: Icrs | None
) -> Receipt:
    """Take an upload in; its content is kept until it has been looked at."""
    if night.session.frames.waiting >= UPLOADS_WAITING:
        raise Busy("frames wait to be identified", advice="send it again in a while, or send its path")
    async with received(request, int(service.settings.service.max_upload_mb * 1e6)) as upload:
        content = await asyncio.to_thread(_content, upload.file)
        name = upload.name
    digest = await asyncio.to_thread(lambda: hashlib.sha256(content).hexdigest())

    loop = asyncio.get_running_loop()

    def read() -> Frame:
        # called in a thread: what a stranger sent is unpacked where the solver's limits hold
        file = in_memory(np.frombuffer(content, np.uint8))
        try:
            reading = service.solver.read_upload(Upload(name, file))
            return asyncio.run_coroutine_threadsafe(reading, loop).result()
        finally:
            os.close(file)

    return night.offer_frame(name, digest, read, held=hold, target=target)


def _content(file: int) -> bytes:
    size = os.fstat(file).st_size
    pieces, at = [], 0
    while at < size:
        piece = os.pread(file, min(1 << 24, size - at), at)
        if not piece:
            break
        pieces.append(piece)
        at += len(piece)
    return b"".join(pieces)


def _target(ra_deg: float | None, dec_deg: float | None) -> Icrs | None:
    if (ra_deg is None) != (dec_deg is None):
        raise BadRequest("a target needs target_ra_deg and target_dec_deg", advice="give both or none")
    if ra_deg is None or dec_deg is None:
        return None
    return Icrs(ra_deg, dec_deg)
