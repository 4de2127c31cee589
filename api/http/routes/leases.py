"""Leases: who holds a telescope; taken, kept by heartbeats, given back."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field

from api.access.security import TheCaller
from api.leases.lease import LONGEST_S, SHORTEST_S, Lease, OnExpiry
from api.orders.targets import Body
from api.problems import responses
from api.service import TheService, TheTelescope

router = APIRouter(prefix="/telescopes", tags=["leases"])


class LeaseBody(Body):
    """How a telescope is to be held."""

    ttl_s: float = Field(
        ge=SHORTEST_S, le=LONGEST_S, description="It lasts so long without a heartbeat (PUT)"
    )
    on_expiry: OnExpiry = Field(
        default=OnExpiry.STOP,
        strict=False,  # JSON has its names alone
        description="What is done when the holder falls silent: stop; park (after a stop); or keep-tracking, "
        "which cancels nothing",
    )
    note: str = Field(default="", max_length=200, description="For people who meet it")
    force: bool = Field(default=False, description="Break another's lease; needs the role configure")


class LeaseView(BaseModel):
    """Who holds a telescope. How the holder shows that it is the holder is never told."""

    telescope: str
    held: bool
    holder: str | None = Field(default=None, description="The name of its key")
    face: str | None = None
    note: str | None = None
    on_expiry: OnExpiry | None = None
    ttl_s: float | None = None
    seconds_left: float | None = Field(default=None, description="Until it runs out, without a heartbeat")
    taken_utc: datetime | None = Field(default=None, description="By the machine's clock")
    until_utc: datetime | None = Field(default=None, description="By the machine's clock, which may be set")
    running_out: bool = Field(
        default=False, description="It has run out, and what `on_expiry` says is being done"
    )


class TakenLeaseView(LeaseView):
    """A lease for its holder."""

    lease: str = Field(
        description="The secret of the holder, told this once: send it with each order and heartbeat in the "
        "header Mountnav-Lease"
    )


@router.get("/{telescope_id}/lease", responses=responses(404))
async def get_lease(service: TheService, telescope: TheTelescope) -> LeaseView:
    """Who holds the telescope, until when, and what is done when the lease runs out."""
    return _view(telescope.id, service.leases.of(telescope.id))


@router.post("/{telescope_id}/lease", status_code=201, responses=responses(404, 409, 503))
async def take_lease(
    service: TheService, telescope: TheTelescope, caller: TheCaller, body: LeaseBody, response: Response
) -> TakenLeaseView:
    """Take the telescope: from now on nobody else may order anything of it, but to stop.

    Keep it by a heartbeat (PUT) at least every `ttl_s`; three in that time are good practice.
    """
    lease, secret = await service.leases.take(
        caller,
        telescope.id,
        ttl_s=body.ttl_s,
        on_expiry=body.on_expiry,
        note=body.note,
        force=body.force,
    )
    service.audit.note(caller, "lease-taken", telescope=telescope.id, request=body, status=201)
    response.headers["Location"] = f"/v1/telescopes/{telescope.id}/lease"
    response.headers["Cache-Control"] = "no-store"
    return TakenLeaseView(**_view(telescope.id, lease).model_dump(), lease=secret)


@router.put("/{telescope_id}/lease", responses=responses(404, 409))
async def keep_lease(service: TheService, telescope: TheTelescope, caller: TheCaller) -> LeaseView:
    """The holder's heartbeat: it lasts for its `ttl_s` from now on. Needs the header Mountnav-Lease."""
    return _view(telescope.id, service.leases.heartbeat(caller, telescope.id))


@router.delete("/{telescope_id}/lease", responses=responses(404, 409))
async def release_lease(
    service: TheService,
    telescope: TheTelescope,
    caller: TheCaller,
    force: Annotated[bool, Query(description="End another's lease; needs the role configure")] = False,
) -> LeaseView:
    """Give the telescope back. A running job goes on, and what `on_expiry` says is not done."""
    service.leases.release(caller, telescope.id, force=force)
    service.audit.note(caller, "lease-released", telescope=telescope.id, request={"force": force}, status=200)
    return _view(telescope.id, None)


def _view(telescope_id: str, lease: Lease | None) -> LeaseView:
    if lease is None:
        return LeaseView(telescope=telescope_id, held=False)
    return LeaseView(
        telescope=telescope_id,
        held=True,
        holder=lease.holder,
        face=lease.face,
        note=lease.note,
        on_expiry=lease.on_expiry,
        ttl_s=lease.ttl_s,
        seconds_left=round(max(0.0, lease.until_s - asyncio.get_running_loop().time()), 3),
        taken_utc=lease.taken_utc,
        until_utc=lease.until_utc,
        running_out=lease.ending,
    )


__all__ = ["LeaseBody", "LeaseView", "TakenLeaseView", "router"]
