"""What happened, in order, for anyone who listens: a ring of events, each with an id to resume from."""

from __future__ import annotations

import asyncio
import json
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from dataclasses import dataclass
from datetime import date, datetime
from uuid import uuid4

from mountnav.clock import utc_now

_PIECE_BYTES = 65_536
"""So much is given to a reader at once: as much as waits for a connection that takes nothing. Without a bound
500 slow ones hold the whole ring each, 100 MB and more."""

About = Callable[["Event"], bool]
"""Which events somebody listens for."""


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
    wire : bytes
        As a server-sent event, made once for all who listen.
    """

    id: str
    number: int
    kind: str
    utc: datetime
    data: dict[str, object]
    wire: bytes


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
        self.run = uuid4().hex[:8]
        self._ring: deque[Event] = deque(maxlen=kept)
        self._last = 0
        self._news = asyncio.Event()
        self._closed = False

    @property
    def closed(self) -> bool:
        """Whether nothing comes any more."""
        return self._closed

    def publish(self, kind: str, data: dict[str, object]) -> Event:
        """Add an event and wake all readers."""
        self._last += 1
        event = self._event(self._last, kind, data)
        self._ring.append(event)
        self._wake()
        return event

    def close(self) -> None:
        """End all readers, so that the server can go down."""
        self._closed = True
        self._wake()

    def reader(self, last_event_id: str | None = None, about: About | None = None) -> Reader:
        """Somebody who listens from this moment on, or from after `last_event_id`.

        An id of an earlier run of the service, or one that is no id, is answered with a ``gap`` and all
        that is kept. Without an id only what comes from now on is told.

        Parameters
        ----------
        about : callable, optional
            Only these events; gaps are told in any case.
        """
        if not last_event_id:
            return Reader(self, self._last, about)
        run, _, number = last_event_id.rpartition("-")
        if run == self.run and number.isascii() and number.isdigit() and len(number) < 19:
            return Reader(self, min(int(number), self._last), about)
        return Reader(self, 0, about, strange=True)

    async def follow(
        self, last_event_id: str | None = None, about: About | None = None
    ) -> AsyncIterator[Event]:
        """Yield events as they come, those after `last_event_id` first; see `reader`."""
        reader = self.reader(last_event_id, about)
        while (events := await reader.next()) is not None:
            for event in events:
                yield event

    def told_now(self, kind: str, data: dict[str, object], id_of: int | None = None) -> Event:
        """An event for one reader alone: it is not kept, and its id is that of the last one of all."""
        return self._event(self._last if id_of is None else id_of, kind, data)

    # -- for readers ---------------------------------------------------------------------------------

    def after(self, place: int) -> tuple[list[Event], int]:
        """What is kept of the events after a place, a piece of it, and how many are not kept any more."""
        oldest = self._ring[0].number if self._ring else self._last + 1
        lost = max(0, oldest - 1 - place)
        # both ends of the ring are near, and so is its middle: it is made of blocks
        first = max(place + 1, oldest) - oldest
        newer = (self._ring[at] for at in range(first, len(self._ring)))
        return next(pieces(newer), []), lost

    def kept(self, about: About) -> list[Event]:
        """All that is kept of what somebody listens for."""
        return [event for event in self._ring if about(event)]

    async def news(self, after: int) -> None:
        """Wait until there is something after a place, or the end."""
        while self._last <= after and not self._closed:
            await self._news.wait()

    @property
    def last(self) -> int:
        """Number of the last event."""
        return self._last

    def gap(self, why: str) -> Event:
        """An event that tells of a gap; anyone who resumes from its id gets all that is kept."""
        number = self._ring[0].number - 1 if self._ring else self._last
        return self._event(number, "gap", {"why": why})

    def _event(self, number: int, kind: str, data: dict[str, object]) -> Event:
        utc = utc_now()
        clean = {key: _finite(value) for key, value in data.items()}
        event_id = f"{self.run}-{number}"
        text = json.dumps({"utc": utc.isoformat(), **clean}, default=_plain, ensure_ascii=False)
        wire = f"event: {kind}\ndata: {text}\nid: {event_id}\n\n".encode("utf-8", "replace")
        return Event(event_id, number, kind, utc, clean, wire)

    def _wake(self) -> None:
        news, self._news = self._news, asyncio.Event()
        news.set()


def pieces(events: Iterable[Event]) -> Iterator[list[Event]]:
    """Part events into pieces that may be sent at once."""
    piece: list[Event] = []
    size = 0
    for event in events:
        piece.append(event)
        size += len(event.wire)
        if size >= _PIECE_BYTES:
            yield piece
            piece, size = [], 0
    if piece:
        yield piece


class Reader:
    """One who listens: his place in the ring.

    Parameters
    ----------
    place : int
        Number of the last event that he knows.
    strange : bool
        He came with an id that means nothing here.
    """

    def __init__(self, events: Events, place: int, about: About | None, *, strange: bool = False) -> None:
        self._events = events
        self._place = place
        self._about = about
        self._strange = strange

    async def next(self, patience_s: float | None = None) -> list[Event] | None:
        """A piece of what came since, in order; none if `patience_s` has passed; None at the end."""
        try:
            async with asyncio.timeout(patience_s):
                while True:
                    found = self.at_hand()
                    if found:
                        return found
                    if self._events.closed:
                        return None
                    await self._events.news(self._place)
        except TimeoutError:
            return []

    def at_hand(self) -> list[Event]:
        """What came since, without waiting, a piece of it: nobody who reads slowly holds more in memory."""
        found: list[Event] = []
        if self._strange:
            self._strange = False
            found.append(self._events.gap("the id is not of this run of the service; all kept events follow"))
            self._place = found[0].number
        while not found:
            newer, lost = self._events.after(self._place)
            if lost:
                found.append(self._events.gap(f"{lost} events are no longer kept"))
            if not newer:
                break
            self._place = newer[-1].number
            found += [event for event in newer if self._about is None or self._about(event)]
        return found

    def all_at_hand(self) -> list[Event]:
        """What came since, without waiting, all of it."""
        found: list[Event] = []
        while newer := self.at_hand():
            found += newer
        return found


def _finite(value: object) -> object:
    """`value` without NaN and infinities, which JSON doesn't know."""
    match value:
        case float():
            return value if math.isfinite(value) else None
        case dict():
            return {str(key): _finite(one) for key, one in value.items()}
        case list() | tuple():
            return [_finite(one) for one in value]
        case _:
            return value


def _plain(value: object) -> str:
    return value.isoformat() if isinstance(value, date) else str(value)
