"""Events of the service as a stream of server-sent events, followed over lost connections. No I/O.

Events are parsed from lines [HTML Living Standard §9.2]; `Following` says what to request, what a line means,
and when to give up.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from typing import Any

import httpx

from mountnav.client import requests
from mountnav.client.results import Job


@dataclass(frozen=True, slots=True)
class ServerEvent:
    """One server-sent event.

    Attributes
    ----------
    event_id : str
        To resume from.
    kind : str
        ``job``, ``attempt``, ``slewing``, ...; ``gap`` where events were lost.
    data : dict
        The event's JSON object.
    """

    event_id: str
    kind: str
    data: dict[str, Any]


class EventReader:
    """Makes events of lines; remembers the last id."""

    def __init__(self, last_id: str | None = None) -> None:
        self.last_id = last_id
        self._fields: dict[str, str] = {}

    def line(self, text: str) -> ServerEvent | None:
        """Take in a line; the event that it ends, or None."""
        if text:
            name, _, value = text.partition(":")
            value = value.removeprefix(" ")
            if name == "data" and "data" in self._fields:
                value = f"{self._fields['data']}\n{value}"
            if name:
                # a line that begins with a colon keeps the connection alive, and says nothing
                self._fields[name] = value
            return None
        fields, self._fields = self._fields, {}
        if "data" not in fields:
            return None
        self.last_id = fields.get("id", self.last_id)
        return ServerEvent(fields.get("id", ""), fields.get("event", ""), json.loads(fields["data"]))

    def cut(self) -> None:
        """Forget a half of an event: the connection was lost."""
        self._fields = {}


def is_end(event: ServerEvent, job_id: str) -> bool:
    """Whether an event tells the end of a job."""
    return (
        event.kind == "job"
        and event.data.get("job_id") == job_id
        and event.data.get("state") in ("succeeded", "failed", "cancelled")
    )


TIMEOUT = httpx.Timeout(10.0, read=45.0)
"""An event stream is kept alive by a comment each 15 s."""
# Seconds between attempts to connect again. Chosen by hand; doubled, events come up to a second later after
# a loss.
_PAUSE_S = 1.0


class Following:
    """Follows the events of all telescopes, of one, or of a job; the client opens and reads the stream.

    Parameters
    ----------
    after : str or None
        Id of the event to go on after.
    telescope : str or None
        Id of the telescope whose events are wanted; None: of all.
    job : Job, str or None
        Job, or its id, whose events are wanted; None: of all.
    patience_s : float
        So long a lost connection is tried again.

    Attributes
    ----------
    path : str
        Path of the stream, from the service's address.
    over : bool
        Whether the event that ends it was heard.
    """

    def __init__(
        self, *, after: str | None, telescope: str | None, job: Job | str | None, patience_s: float
    ) -> None:
        self._job_id = None if job is None else job if isinstance(job, str) else job["id"]
        self._reader = EventReader(after)
        self._patience_s = patience_s
        self._lost_s: float | None = None
        self.path = requests.events_path(telescope, self._job_id)
        self.over = False

    @property
    def headers(self) -> dict[str, str]:
        """What to ask with: it goes on after the last event that was heard."""
        headers = {"Accept": "text/event-stream"}
        if self._reader.last_id is not None:
            headers["Last-Event-ID"] = self._reader.last_id
        return headers

    def heard(self, line: str) -> ServerEvent | None:
        """Take in a line; the event that it ends, or None."""
        self._lost_s = None
        event = self._reader.line(line)
        if event is not None and self._job_id is not None:
            self.over = is_end(event, self._job_id)
        return event

    def broken(self, failure: httpx.TransportError | None) -> float:
        """The connection ended; for how many seconds to wait before the next one.

        Raises
        ------
        httpx.TransportError
            It has been lost for as long as there is patience.
        """
        self._reader.cut()
        now_s = time.monotonic()
        self._lost_s = now_s if self._lost_s is None else self._lost_s
        if now_s - self._lost_s >= self._patience_s:
            raise failure or httpx.RemoteProtocolError("the service ended the events")
        return min(_PAUSE_S, self._patience_s)
