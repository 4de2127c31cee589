"""Events as they go over HTTP: server-sent events, with a comment when nothing else keeps the line alive."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

from fastapi.responses import StreamingResponse

from api.events import Event, Reader, pieces

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
    reader : Reader
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
    # at once: whoever connects sees that the stream lives
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


__all__ = ["EVENT_STREAM", "KEEP_ALIVE_S", "STREAM", "EventStream"]
