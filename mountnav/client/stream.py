"""Server-sent events out of lines; no I/O [HTML Living Standard §9.2]."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any


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
