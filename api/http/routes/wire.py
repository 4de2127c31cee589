"""The wire log of a telescope's mount: what went over its line lately, as JSON lines."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response

from api.problems import responses
from api.service import TheTelescope
from drivers.wire.wire_log import WireLog
from mountnav.errors import NotFound

router = APIRouter(prefix="/telescopes", tags=["telescopes"])

NDJSON = "application/x-ndjson"


@router.get(
    "/{telescope_id}/wire",
    response_class=Response,
    responses={**responses(404), 200: {"content": {NDJSON: {"schema": {"type": "string"}}}}},
)
async def get_wire(
    telescope: TheTelescope,
    after: Annotated[int, Query(ge=0, description="Only messages with numbers (`n`) above this")] = 0,
) -> Response:
    """Messages between driver and mount, oldest first, as far as the ring keeps them.

    A header line stands in front of a dump from the beginning (`after` = 0). Each line: `t` seconds since the
    service began to log, `dir`, `bytes`, `hex`, `meaning`, `n`.
    """
    log = telescope.navigator.mount.wire_log
    if not isinstance(log, WireLog):
        raise NotFound("its driver keeps no wire log", device=telescope.id)
    header = {"telescope": telescope.id, "mount": telescope.mount_address} if after == 0 else None
    return Response("".join(f"{line}\n" for line in log.lines(header, after)), media_type=NDJSON)
