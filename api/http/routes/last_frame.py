"""The last frame that a telescope looked at: its picture, and the stars measured and identified on it."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Response

from api.http.frame_views import LastFrameView, last_frame_view
from api.observatory.last_frame import MEDIA_TYPE
from api.problems import responses
from api.service import TheService, TheTelescope
from mountnav.errors import NotFound

router = APIRouter(prefix="/telescopes", tags=["frames"])

IfNoneMatch = Annotated[str | None, Header(alias="If-None-Match", max_length=200)]


@router.get(
    "/{telescope_id}/last-frame",
    response_model=LastFrameView,
    responses={204: {"description": "No look since the service was started"}, **responses(404)},
)
async def get_last_frame(service: TheService, telescope: TheTelescope) -> LastFrameView | Response:
    """What the last look saw: measured and identified stars, center, target, where north is."""
    keeper = telescope.last_frame
    if keeper is None or keeper.kept is None:
        return Response(status_code=204)
    site, air = service.settings.site.site, service.settings.air.air
    jobs = [job for job in service.jobs.all() if job.telescope == telescope.id]
    return last_frame_view(telescope.id, keeper.kept, jobs, site, air)


@router.get(
    "/{telescope_id}/last-frame.webp",
    response_class=Response,
    responses={
        200: {
            "content": {MEDIA_TYPE: {}},
            "description": "The frame, binned and stretched",
        },
        304: {"description": "The same as before"},
        **responses(404),
    },
)
async def get_last_frame_picture(telescope: TheTelescope, if_none_match: IfNoneMatch = None) -> Response:
    """The picture of the last frame; its rows run from the frame's last one down to its first."""
    found = None if telescope.last_frame is None else await telescope.last_frame.preview()
    if found is None:
        raise NotFound("this telescope has not looked since the service was started", advice="order a look")
    kept, preview = found
    headers = {"ETag": f'"{kept.id}"', "Cache-Control": "private, no-cache"}
    if if_none_match == headers["ETag"]:
        return Response(status_code=304, headers=headers)
    return Response(preview.content, media_type=MEDIA_TYPE, headers=headers)


__all__ = ["router"]
