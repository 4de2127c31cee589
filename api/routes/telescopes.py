"""Telescopes: their state, and the orders center, slew, sync, look, recover and stop."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Annotated, Any

from fastapi import APIRouter, Body, Header, Response

from api.faults import responses
from api.jobs import Job
from api.models import (
    CenterBody,
    JobView,
    LookBody,
    SlewBody,
    StopView,
    TelescopeView,
    job_view,
    telescope_view,
)
from api.observatory import Telescope
from api.service import Service, TheService, TheTelescope
from mountnav.navigation.navigator import Navigator
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent, Icrs, utc_now

router = APIRouter(prefix="/telescopes", tags=["telescopes"])

Key = Annotated[
    str | None,
    Header(
        alias="Idempotency-Key",
        min_length=1,
        max_length=255,
        description="Made by the client: the same key with the same request never starts a second job",
    ),
]
_LOCATION: dict[int | str, dict[str, Any]] = {
    202: {"headers": {"Location": {"description": "The job", "schema": {"type": "string"}}}}
}
_STARTING: dict[int | str, dict[str, Any]] = {**responses(404, 409), **_LOCATION}
_STOP_FAILURES = {
    503: "The mount can't be reached: the stop could NOT be sent",
    504: "The mount gives no answer: the stop may not have arrived",
}


@router.get("", responses=responses())
async def list_telescopes(service: TheService) -> list[TelescopeView]:
    """All telescopes and their state."""
    return list(await asyncio.gather(*(_view(service, one) for one in service.observatory.telescopes)))


@router.get("/{telescope_id}", responses=responses(404))
async def get_telescope(service: TheService, telescope: TheTelescope) -> TelescopeView:
    """State of one telescope: where it believes it points, and what it does."""
    return await _view(service, telescope)


@router.post("/{telescope_id}/center", status_code=202, responses=_STARTING)
async def center_telescope(
    service: TheService, telescope: TheTelescope, body: CenterBody, response: Response, key: Key = None
) -> JobView:
    """Slew, look, sync, and slew again until the target is at the frame's center."""

    async def order(navigator: Navigator) -> object:
        return await navigator.center(
            _target(body),
            tolerance_arcsec=body.tolerance_arcsec,
            max_tries=body.max_tries,
            timeout_s=body.timeout_s,
        )

    return _start(service, telescope, "center", body, order, response, key)


@router.post("/{telescope_id}/slew", status_code=202, responses=_STARTING)
async def slew_telescope(
    service: TheService, telescope: TheTelescope, body: SlewBody, response: Response, key: Key = None
) -> JobView:
    """Go to a place as the mount believes it; nothing is looked at."""

    async def order(navigator: Navigator) -> object:
        return await navigator.slew(_target(body))

    return _start(service, telescope, "slew", body, order, response, key)


@router.post("/{telescope_id}/sync", status_code=202, responses=_STARTING)
async def sync_telescope(
    service: TheService, telescope: TheTelescope, response: Response, key: Key = None
) -> JobView:
    """Look, and tell the mount where it truly points. Needs no body."""

    async def order(navigator: Navigator) -> object:
        return await navigator.sync()

    return _start(service, telescope, "sync", None, order, response, key)


@router.post("/{telescope_id}/look", status_code=202, responses=_STARTING)
async def look_telescope(
    service: TheService,
    telescope: TheTelescope,
    response: Response,
    key: Key = None,
    body: Annotated[LookBody | None, Body()] = None,
) -> JobView:
    """Expose and solve: where it truly points. Moves and syncs nothing. The body may be left out."""

    async def order(navigator: Navigator) -> object:
        return await navigator.look(body.exposure_s if body else None)

    return _start(service, telescope, "look", body, order, response, key)


@router.post("/{telescope_id}/recover", status_code=202, responses=_STARTING)
async def recover_telescope(
    service: TheService,
    telescope: TheTelescope,
    response: Response,
    key: Key = None,
    body: Annotated[LookBody | None, Body()] = None,
) -> JobView:
    """Tell a lost mount where it points: two looks anywhere in the sky that agree, then a sync. Never moves.

    However far the place is from what the mount believes; it must stand within the telescope's limits now.
    The body may be left out.
    """

    async def order(navigator: Navigator) -> object:
        return await navigator.recover(body.exposure_s if body else None)

    return _start(service, telescope, "recover", body, order, response, key)


@router.post(
    "/{telescope_id}/stop",
    responses={
        **responses(404),
        **{status: {**responses()[422], "description": text} for status, text in _STOP_FAILURES.items()},
    },
)
async def stop_telescope(service: TheService, telescope: TheTelescope) -> StopView:
    """Stop all motion now: no body, never refused as busy. Answers once the stop was sent."""
    job = await service.stop(telescope)
    return StopView(telescope=telescope.id, cancelled_job_id=job.id if job else None)


def _start(
    service: Service,
    telescope: Telescope,
    kind: str,
    body: SlewBody | LookBody | None,
    order: Callable[[Navigator], Awaitable[object]],
    response: Response,
    key: str | None,
) -> JobView:
    request = {} if body is None else body.model_dump(exclude_none=True)
    job: Job = service.start(kind, telescope, request, order, key=key)
    response.headers["Location"] = f"/v1/jobs/{job.id}"
    return job_view(job)


def _target(body: SlewBody) -> Icrs:
    """Where to go, as ICRS; an apparent place is one of the moment the job begins."""
    if body.frame == "icrs":
        return Icrs(body.ra_deg, body.dec_deg)
    return apparent_to_icrs(Apparent(body.ra_deg, body.dec_deg, utc_now()))


async def _view(service: Service, telescope: Telescope) -> TelescopeView:
    state = await telescope.state()
    return telescope_view(state, telescope.mount_address, service.jobs.running_on(telescope.id))
