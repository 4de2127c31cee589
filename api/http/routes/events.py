"""The event streams: of the whole service, of one telescope, of one job; with ids to resume from.

They are server-sent events, with a comment when nothing else keeps the line alive.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Header
from fastapi.responses import StreamingResponse

from api.access.security import TheCaller
from api.events import Event, Reader, pieces
from api.orders.jobs import ENDS, Job
from api.problems import responses
from api.service import Service, TheJob, TheService, TheTelescope

__all__ = ["EVENT_STREAM", "KEEP_ALIVE_S", "STREAM", "EventStream"]


KEEP_ALIVE_S = 15.0
"""Proxies take a line that is silent for longer for dead."""
_KEEP_ALIVE = b": keep-alive\n\n"

EVENT_STREAM = "text/event-stream"
STREAM: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "Server-sent events, for as long as the client listens",
        "content": {
            EVENT_STREAM: {
                "itemSchema": {
                    "type": "object",
                    "properties": {
                        "data": {"type": "string"},
                        "event": {"type": "string"},
                        "id": {"type": "string"},
                    },
                }
            }
        },
    }
}
"""OpenAPI's entry for a stream."""


class EventStream(StreamingResponse):
    """An answer that goes on: what a reader hears, as it comes.

    Parameters
    ----------
    first : sequence of Event
        Sent before anything else.
    ends_with : callable, optional
        The event after which the stream ends; else it ends with the service.
    keep_alive_s : float
        After so long without an event a comment is sent.
    """

    media_type = EVENT_STREAM

    def __init__(
        self,
        reader: Reader,
        *,
        first: Sequence[Event] = (),
        ends_with: Callable[[Event], bool] | None = None,
        keep_alive_s: float = KEEP_ALIVE_S,
    ) -> None:
        super().__init__(
            _stream(reader, first, ends_with, keep_alive_s),
            # nginx would keep events back until its buffer is full
            headers={"Cache-Control": "no-cache", "X-Accel-Buffering": "no"},
        )


async def _stream(
    reader: Reader,
    first: Sequence[Event],
    ends_with: Callable[[Event], bool] | None,
    keep_alive_s: float,
) -> AsyncIterator[bytes]:
    # at once: anyone who connects sees that the stream lives
    yield b": mountnav\n\n"
    events: Sequence[Event] | None = first
    while events is not None:
        last = (
            None if ends_with is None else next((at for at, one in enumerate(events) if ends_with(one)), None)
        )
        if last is not None:
            events = events[: last + 1]
        if events:
            for piece in pieces(events):
                yield b"".join(event.wire for event in piece)
        elif events is not first:
            yield _KEEP_ALIVE
        if last is not None:
            return
        events = await reader.next(keep_alive_s)


router = APIRouter(tags=["events"])

LastEventId = Annotated[
    str | None,
    Header(alias="Last-Event-ID", max_length=100, description="Go on after this event, as far as it is kept"),
]


@router.get("/events", response_class=StreamingResponse, responses={**responses(), **STREAM})
async def follow_events(
    service: TheService, caller: TheCaller, last_event_id: LastEventId = None
) -> EventStream:
    """Events from now on, or from `Last-Event-ID` on; a comment each 15 s keeps the connection alive.

    A key for some telescopes is told of those, and of the service.
    """

    def about(event: Event) -> bool:
        return caller.reaches(event.data.get("telescope")) or not event.data.get("telescope")

    return EventStream(service.events.reader(last_event_id, None if caller.telescopes is None else about))


@router.get(
    "/telescopes/{telescope_id}/events",
    response_class=StreamingResponse,
    responses={**responses(404), **STREAM},
)
async def follow_telescope_events(
    service: TheService, telescope: TheTelescope, last_event_id: LastEventId = None
) -> EventStream:
    """As `/v1/events`, but only what is about this telescope."""

    def about(event: Event) -> bool:
        return event.data.get("telescope") == telescope.id

    return EventStream(service.events.reader(last_event_id, about))


@router.get("/jobs/{job_id}/events", response_class=StreamingResponse, responses={**responses(404), **STREAM})
async def follow_job_events(
    service: TheService, job: TheJob, last_event_id: LastEventId = None
) -> EventStream:
    """As `/v1/events`, but only about one job, from its beginning (as far as that is kept) to its end.

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
