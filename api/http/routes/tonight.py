"""The night of a telescope at a glance: what a strip over its hours is drawn from."""

from __future__ import annotations

import asyncio

from fastapi import APIRouter

from api.http.sky_views import headline_target
from api.http.tonight_views import TonightView, tonight_view
from api.problems import responses
from api.service import TheService, TheTelescope
from mountnav.clock import utc_now

router = APIRouter(prefix="/telescopes", tags=["telescopes"])


@router.get("/{telescope_id}/tonight", responses=responses(404))
async def get_tonight(service: TheService, telescope: TheTelescope) -> TonightView:
    """Sun, Moon and target over the hours of the night, what its looks saw, what was done when."""
    utc = utc_now()
    snapshot = service.dispatcher.watch(telescope.id).latest
    mount = telescope.navigator.mount
    target = headline_target(mount, snapshot.state, snapshot.job, utc)
    where = service.settings.journal.where
    return await asyncio.to_thread(
        tonight_view, telescope.id, mount, target, telescope.last_frame, where, utc
    )


__all__ = ["router"]
