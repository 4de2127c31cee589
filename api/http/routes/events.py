"""The event streams: of the whole service, of one telescope, of one job; with ids to resume from."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse

from api.events import Event
from api.http.event_stream import STREAM, EventStream
from api.http.faults import responses
from api.orders.jobs import ENDS, Job
from api.service import Service, TheJob, TheService, TheTelescope

router = APIRouter(tags=["events"])

LastEventId = Annotated[
    str | None,
    Header(alias="Last-Event-ID", max_length=100, description="Go on after this event, as far as it is kept"),
]


@router.get("/events", response_class=StreamingResponse, responses={**responses(), **STREAM})
async def follow_events(service: TheService, last_event_id: LastEventId = None) -> EventStream:
    """Events from now on, or from `Last-Event-ID` on; a comment each 15 s keeps the connection alive."""
    return EventStream(service.events.reader(last_event_id))


@router.get(
    "/telescopes/{telescope_id}/events",
    response_class=StreamingResponse,
    responses={**responses(404), **STREAM},
)
async def follow_telescope_events(
    service: TheService, telescope: TheTelescope, last_event_id: LastEventId = None
) -> EventStream:
    """As `/v1/events`, what is about one telescope alone."""

    def about(event: Event) -> bool:
        return event.data.get("telescope") == telescope.id

    return EventStream(service.events.reader(last_event_id, about))


@router.get("/jobs/{job_id}/events", response_class=StreamingResponse, responses={**responses(404), **STREAM})
async def follow_job_events(
    service: TheService, job: TheJob, last_event_id: LastEventId = None
) -> EventStream:
    """As `/v1/events`, what is about one job alone: from its beginning, as far as that is kept, to its end.

    The stream ends with the job; that of one that has ended tells its end in any case.
    """

    def about(event: Event) -> bool:
        return event.data.get("job_id") == job.id

    def is_end(event: Event) -> bool:
        return event.kind == "job" and event.data.get("job_id") == job.id and event.data["state"] in ENDS

    events = service.events
    reader = events.reader(last_event_id, about)
    first = reader.all_at_hand() if last_event_id else events.kept(about)
    forgotten = job.announced and not first and not last_event_id
    if forgotten or (job.is_over and not any(is_end(event) for event in first)):
        first = [*first, _now(service, job)]
    return EventStream(reader, first=first, ends_with=is_end)


def _now(service: Service, job: Job) -> Event:
    """Where a job stands, as an event; it is not kept."""
    return service.events.told_now("job", service.jobs.told(job))
