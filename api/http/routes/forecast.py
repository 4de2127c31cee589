"""What will happen to a target: rises, sets, meridian, the Sun's cone, limits. Orders nothing."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import APIRouter, Body, Depends, Query, Request

from api.http.forecast_views import LONGEST_H, USUAL_H, ForecastBody, ForecastView, forecast_of
from api.orders.targets import NamedTarget
from api.problems import responses
from api.service import TheTelescope
from mountnav.errors import BadRequest

router = APIRouter(prefix="/telescopes", tags=["telescopes"])

Name = Annotated[
    str, Query(min_length=1, max_length=80, description="Name of the target, as `GET /v1/objects` finds it")
]
Hours = Annotated[float, Query(gt=0, le=LONGEST_H, allow_inf_nan=False, description="How far ahead, hours")]
_EXAMPLES = {
    "name": {
        "summary": "The next twelve hours of Jupiter",
        "value": {"target": {"kind": "name", "name": "Jupiter"}},
    },
    "place": {
        "summary": "A place",
        "value": {"target": {"kind": "icrs", "ra_deg": 10.6847, "dec_deg": 41.2688}, "hours": 6.0},
    },
}
_MOST_AT_ONCE = 2
"""Forecasts that are made at a time, each in a thread; others wait. Doubled, a page that is open on four
machines may take four threads from what solves frames."""


async def _room(request: Request) -> asyncio.Semaphore:
    """Shared by all requests of one application."""
    state = request.app.state
    if getattr(state, "forecast_room", None) is None:
        state.forecast_room = asyncio.Semaphore(_MOST_AT_ONCE)
    found: asyncio.Semaphore = state.forecast_room
    return found


Room = Annotated[asyncio.Semaphore, Depends(_room)]


@router.get("/{telescope_id}/forecast", responses=responses(404))
async def get_forecast(
    telescope: TheTelescope, room: Room, name: Name, hours: Hours = USUAL_H
) -> ForecastView:
    """What will happen to a target that has a name. Of any other ask by POST."""
    try:
        target = NamedTarget(name=name)
    except ValueError as unknown:
        raise BadRequest(
            f"no object is called {name!r}", advice="GET /v1/objects?q= finds names"
        ) from unknown
    return await _forecast(telescope, room, ForecastBody(target=target, hours=hours))


@router.post("/{telescope_id}/forecast", responses=responses(404))
async def make_forecast(
    telescope: TheTelescope, room: Room, body: Annotated[ForecastBody, Body(openapi_examples=_EXAMPLES)]
) -> ForecastView:
    """What will happen to a target, whatever kind it is of: rises, sets, meridian, the Sun's cone, limits.

    By the telescope's own limits, along the target's whole way. Nothing is ordered, and no device is asked.
    """
    return await _forecast(telescope, room, body)


async def _forecast(telescope: TheTelescope, room: asyncio.Semaphore, body: ForecastBody) -> ForecastView:
    async with room:
        return await asyncio.to_thread(
            forecast_of, telescope.id, telescope.navigator.mount, body.target, body.hours
        )
