"""What happened, in order, for whoever listens: a ring of events, each with an id to resume from."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass
from datetime import datetime
from uuid import uuid4

from mountnav.sky.coordinates import utc_now


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    Attributes
    ----------
    id : str
        ``run-number``: the number counts up within one run of the service.
    kind : str
        Such as ``slewing``, ``attempt``, ``job``.
    data : dict
        JSON values; NaN and infinities are None.
    """

    id: str
    number: int
    kind: str
    utc: datetime
    data: dict[str, object]


class Events:
    """The last events, and a way to follow them. Used from the event loop's thread alone.

    Each reader keeps its own place in the ring, so a slow reader costs no memory: when the ring has
    passed it by, it is told so by an event of kind ``gap`` and goes on with the oldest kept.

    Parameters
    ----------
    kept : int
        How many events stay readable.
    """

    def __init__(self, kept: int) -> None:
        self._run = uuid4().hex[:8]
        self._ring: deque[Event] = deque(maxlen=kept)
        self._last = 0
        self._news = asyncio.Event()
        self._closed = False

    def publish(self, kind: str, data: dict[str, object]) -> Event:
        """Add an event and wake all readers."""
        self._last += 1
        event = Event(f"{self._run}-{self._last}", self._last, kind, utc_now(), _finite(data))
        self._ring.append(event)
        self._wake()
        return event

    def close(self) -> None:
        """End all readers, so that the server can go down."""
        self._closed = True
        self._wake()

    async def follow(self, last_event_id: str | None = None) -> AsyncIterator[Event]:
        """Yield events as they come, those after `last_event_id` first.

        An id of an earlier run of the service, or one that is no id, is answered with a ``gap`` and all
        that is kept. Without an id only what comes from now on is told.
        """
        place = self._last
        if last_event_id:
            run, _, number = last_event_id.rpartition("-")
            known = run == self._run and number.isascii() and number.isdigit() and len(number) < 19
            place = min(int(number), self._last) if known else 0
            if not known:
                yield self._gap("the id is not of this run of the service; all kept events follow")
        while not self._closed:
            news = self._news
            oldest = self._ring[0].number if self._ring else self._last + 1
            if place < oldest - 1:
                yield self._gap(f"{oldest - 1 - place} events are no longer kept")
                place = oldest - 1
            for event in [event for event in self._ring if event.number > place]:
                yield event
                place = event.number
            if place == self._last and not self._closed:
                await news.wait()

    def _gap(self, why: str) -> Event:
        number = self._ring[0].number - 1 if self._ring else self._last
        return Event(f"{self._run}-{number}", number, "gap", utc_now(), {"why": why})

    def _wake(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()


def _finite(data: dict[str, object]) -> dict[str, object]:
    """`data` without NaN and infinities, which JSON doesn't know."""
    return {
        key: None if isinstance(value, float) and not math.isfinite(value) else value
        for key, value in data.items()
    }
