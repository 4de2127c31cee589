"""Frames that come in: each once, by its content; a bounded queue; an answer for everybody who asks."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime

from mountnav.ephemeris import Ephemeris
from mountnav.errors import Busy, NotFound
from mountnav.frames import Frame
from mountnav.night.events import Decision
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset

ANSWERS_KEPT = 2000
"""So many answers are kept for those who ask for a frame's result; of ten times as many frames it is known
that they came. Chosen by hand: some nights of a frame a minute. Halved, a scheduler that asks late gets
none."""
ID_LENGTH = 32
"""So many hex digits of the pixels' digest name a frame: 128 bits, by chance alike never."""


@dataclass(frozen=True, slots=True)
class Arrived:
    """A frame as it came.

    Attributes
    ----------
    source : str
        Path, or what the sender called it.
    digest : str
        SHA-256 of its content, hexadecimal.
    read : callable
        Gives the frame; blocks, and is called in a thread. Raises `BadFrame`.
    held : bool
        The sender waits for the answer and exposes nothing meanwhile.
    target : Icrs, Ephemeris or None
        Where the frame's center was meant to be; of a target that moves, where it is in the middle of the
        exposure.
    pixels : bool
        False: a header alone; its time and place are noted, and nothing is corrected by it.
    """

    frame_id: str
    source: str
    digest: str
    arrived_utc: datetime
    read: Callable[[], Frame]
    held: bool = False
    target: Icrs | Ephemeris | None = None
    pixels: bool = True


@dataclass(frozen=True, slots=True)
class FrameAnswer:
    """What became of a frame.

    Attributes
    ----------
    done : bool
        Whether all that follows is known.
    seen : Icrs or None
        Place of its center.
    offset : Offset or None
        Seen minus believed.
    decision : Decision or None
        What was decided by it.
    outcome : str
        What came of the correction; empty without one.
    """

    frame_id: str
    source: str
    digest: str
    arrived_utc: datetime
    done: bool = False
    mid_utc: datetime | None = None
    placed: bool = False
    fully: bool = False
    seen: Icrs | None = None
    sigma_arcsec: float | None = None
    offset: Offset | None = None
    field: str = ""
    look_id: str = ""
    decision: Decision | None = None
    outcome: str = ""
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Receipt:
    """That a frame was taken in.

    Attributes
    ----------
    duplicate : bool
        The same content was here before; it isn't looked at again.
    """

    frame_id: str
    duplicate: bool


@dataclass(slots=True)
class _Kept:
    answer: FrameAnswer
    done: asyncio.Event = field(default_factory=asyncio.Event)


class FramesIn:
    """The frames of one telescope, in the order they came. Used from the event loop's thread alone.

    Parameters
    ----------
    most_waiting : int
        More are refused.
    """

    def __init__(self, most_waiting: int = 50) -> None:
        self._most_waiting = most_waiting
        self._waiting: OrderedDict[str, Arrived] = OrderedDict()
        self._answers: OrderedDict[str, _Kept] = OrderedDict()
        self._known: OrderedDict[str, None] = OrderedDict()
        self._came = asyncio.Event()

    @property
    def waiting(self) -> int:
        """How many wait."""
        return len(self._waiting)

    @property
    def is_full(self) -> bool:
        """Whether the next one would be refused."""
        return len(self._waiting) >= self._most_waiting

    def knows(self, digest: str) -> bool:
        """Whether a frame of this content was here before."""
        return digest[:ID_LENGTH] in self._known

    def remember(self, frame_id: str) -> None:
        """Know a frame of an earlier life of the service."""
        self._known[frame_id] = None
        while len(self._known) > 10 * ANSWERS_KEPT:
            self._known.popitem(last=False)

    def offer(
        self,
        source: str,
        digest: str,
        read: Callable[[], Frame],
        arrived_utc: datetime,
        *,
        held: bool = False,
        target: Icrs | Ephemeris | None = None,
        pixels: bool = True,
    ) -> Receipt:
        """Take a frame in, unless its content was here before.

        Raises
        ------
        Busy
            Too many wait.
        """
        frame_id = digest[:ID_LENGTH]
        if frame_id in self._known:
            if frame_id not in self._answers:
                told = "it was processed before: the journal has it"
                self.answer(FrameAnswer(frame_id, source, digest, arrived_utc, done=True, detail=told))
                self._forget()
            return Receipt(frame_id, duplicate=True)
        if self.is_full:
            raise Busy(
                f"{len(self._waiting)} frames wait to be identified", advice="send it again in a while"
            )
        self.remember(frame_id)
        arrived = Arrived(frame_id, source, digest, arrived_utc, read, held, target, pixels)
        self._waiting[frame_id] = arrived
        self._answers[frame_id] = _Kept(FrameAnswer(frame_id, source, digest, arrived_utc))
        self._forget()
        self._came.set()
        return Receipt(frame_id, duplicate=False)

    async def next(self) -> Arrived:
        """Wait for the next frame, and take it out of the queue."""
        while not self._waiting:
            self._came.clear()
            await self._came.wait()
        return self._waiting.popitem(last=False)[1]

    def answer(self, answer: FrameAnswer) -> None:
        """Give the answer to all who wait for it."""
        kept = self._answers.setdefault(answer.frame_id, _Kept(answer))
        kept.answer = answer
        kept.done.set()

    async def result(self, frame_id: str, wait_s: float = 0.0) -> FrameAnswer:
        """Tell what became of a frame, waiting for its end no longer than `wait_s`.

        Raises
        ------
        NotFound
            There is no frame of this id any more.
        """
        kept = self._answers.get(frame_id)
        if kept is None:
            raise NotFound(
                "there is no frame of this id",
                advice="it was never sent, or is of an earlier run of the service: the journal has it",
            )
        if wait_s > 0 and not kept.done.is_set():
            try:
                async with asyncio.timeout(wait_s):
                    await kept.done.wait()
            except TimeoutError:
                pass
        return kept.answer

    def newest(self, count: int) -> list[FrameAnswer]:
        """The newest frames, newest first."""
        kept = list(self._answers.values())[-count:] if count > 0 else []
        return [entry.answer for entry in reversed(kept)]

    def _forget(self) -> None:
        while len(self._answers) > ANSWERS_KEPT:
            oldest = next((key for key, one in self._answers.items() if one.done.is_set()), None)
            if oldest is None:
                return
            del self._answers[oldest]


def facts_of(answer: FrameAnswer) -> Mapping[str, object]:
    """JSON values of an answer, for events and recordings."""
    decision = answer.decision
    return {
        "frame_id": answer.frame_id,
        "source": answer.source,
        "mid_utc": None if answer.mid_utc is None else answer.mid_utc.isoformat(),
        "placed": answer.placed,
        "fully": answer.fully,
        "ra_deg": None if answer.seen is None else answer.seen.ra_deg,
        "dec_deg": None if answer.seen is None else answer.seen.dec_deg,
        "sigma_arcsec": answer.sigma_arcsec,
        "offset_east_arcsec": None if answer.offset is None else answer.offset.east_arcsec,
        "offset_north_arcsec": None if answer.offset is None else answer.offset.north_arcsec,
        "field": answer.field,
        "look_id": answer.look_id,
        "act": None if decision is None else str(decision.act),
        "why": None if decision is None else str(decision.why),
        "text": "" if decision is None else decision.text,
        "outcome": answer.outcome,
        "detail": answer.detail,
    }
