"""The event stream: everything that happens, as server-sent events with ids to resume from."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.sse import EventSourceResponse, ServerSentEvent

from api.faults import responses
from api.service import TheService

router = APIRouter(tags=["events"])

LastEventId = Annotated[
    str | None,
    Header(alias="Last-Event-ID", max_length=100, description="Go on after this event, as far as it is kept"),
]


@router.get("/events", response_class=EventSourceResponse, responses=responses())
async def follow_events(
    service: TheService, last_event_id: LastEventId = None
) -> AsyncIterator[ServerSentEvent]:
    """Events from now on, or from `Last-Event-ID` on; a comment each 15 s keeps the connection alive."""
    yield ServerSentEvent(comment="mountnav")
    async for event in service.events.follow(last_event_id):
        data = {"utc": event.utc.isoformat(), **event.data}
        yield ServerSentEvent(data=data, event=event.kind, id=event.id)
