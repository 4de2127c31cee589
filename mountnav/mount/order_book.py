"""An order and its row in the journal: written before it is sent, closed when its outcome is known.

Whatever happens in between (errors, cancellation, a disk that is full) the outcome is written: shielded, and
kept to be written again if the journal doesn't take it.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from mountnav.clock import Clock
from mountnav.devices import MountReading
from mountnav.errors import (
    BadRequest,
    Busy,
    DeviceError,
    DeviceRefused,
    JournalFailed,
    MountnavError,
    RefusedButDone,
    SyncIgnored,
)
from mountnav.journal.records import (
    CommandEnd,
    CommandRecord,
    Entry,
    EntryKind,
    Journal,
    Order,
    Outcome,
    new_id,
)
from mountnav.mount.kill_points import kill_point
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.tasks import begun, waited_for

EVEN_UNWRITTEN: frozenset[Order] = frozenset({"park"})
"""What brings a telescope into safety doesn't wait for a disk that is full; a stop never waits for any."""


@dataclass(slots=True)
class OrderRow:
    """An order that stands in the journal.

    Attributes
    ----------
    sent : bool
        Whether it may have gone over the wire.
    facts : dict
        For its end.
    """

    record: CommandRecord
    sent: bool = False
    facts: dict[str, object] = field(default_factory=dict)


class OrderBook:
    """Writes the orders of one mount."""

    def __init__(self, journal: Journal, clock: Clock, telescope: str) -> None:
        self._journal = journal
        self._clock = clock
        self._telescope = telescope
        self._late: dict[str, CommandEnd] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    async def begin(
        self,
        order: Order,
        segment_id: str,
        *,
        place: Apparent | Icrs | None = None,
        facts: Mapping[str, object] | None = None,
        before: MountReading | None = None,
    ) -> OrderRow:
        """Write an order down; durable on return.

        Raises
        ------
        JournalFailed
            Then it must not be sent. Never for a park: that is written as soon as it can be.
        """
        kill_point(f"{order} begin")
        if order in EVEN_UNWRITTEN and getattr(self._journal, "problem", None) is not None:
            return self.begin_now(order, segment_id, facts)
        with contextlib.suppress(JournalFailed):
            await self._write_late()
        record = self._record(order, segment_id, place, facts, before)
        writing = waited_for(self._journal.begin(record))
        if await _finished(writing):
            # it is written and won't be sent: it must not look as if it were under way
            if writing.exception() is None:
                await self.end(OrderRow(record), Outcome.NOT_SENT, "cancelled before it was sent")
            raise asyncio.CancelledError
        try:
            writing.result()
        except JournalFailed:
            if order not in EVEN_UNWRITTEN:
                raise
            return self.begin_now(order, segment_id, facts)
        kill_point(f"{order} begun")
        return OrderRow(record)

    def begin_now(self, order: Order, segment_id: str, facts: Mapping[str, object] | None = None) -> OrderRow:
        """Write a stop down without waiting."""
        record = self._record(order, segment_id, None, facts, None)
        self._journal.begin_now(record)
        kill_point(f"{order} begun")
        return OrderRow(record, sent=True)

    def _record(
        self,
        order: Order,
        segment_id: str,
        place: Apparent | Icrs | None,
        facts: Mapping[str, object] | None,
        before: MountReading | None,
    ) -> CommandRecord:
        return CommandRecord(
            command_id=new_id(),
            telescope=self._telescope,
            utc=self._clock.utc(),
            order=order,
            segment_id=segment_id,
            place=place,
            facts=dict(facts or {}),
            before=before,
        )

    async def end(
        self,
        written: OrderRow,
        outcome: Outcome,
        detail: str = "",
        *,
        after: MountReading | None = None,
        miss_arcsec: float | None = None,
    ) -> None:
        """Close an order. Never raises but `CancelledError`, and that after it has been written."""
        task = self.end_soon(written, outcome, detail, after=after, miss_arcsec=miss_arcsec)
        if await _finished(task):
            raise asyncio.CancelledError

    def end_soon(
        self,
        written: OrderRow,
        outcome: Outcome,
        detail: str = "",
        *,
        after: MountReading | None = None,
        miss_arcsec: float | None = None,
    ) -> asyncio.Task[None]:
        """Close an order without waiting: the outcome of a stop is reported before the disk has it."""
        order, command_id = written.record.order, written.record.command_id
        end = CommandEnd(self._clock.utc(), outcome, detail, after, miss_arcsec, dict(written.facts))
        # until it is written it is owed
        self._late[command_id] = end

        async def write() -> None:
            kill_point(f"{order} end")
            with contextlib.suppress(JournalFailed):
                await self._journal.end(command_id, end)
                self._late.pop(command_id, None)
                kill_point(f"{order} ended")

        # if it dies it stays owed, and is written with the next one
        task = begun(write(), f"close-{order}", died=lambda _: None)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def settle(self) -> None:
        """Wait until everything is written that can be."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))
        with contextlib.suppress(JournalFailed):
            await self._write_late()

    async def _write_late(self) -> None:
        """Write the ends that the journal didn't take; those being written are left alone."""
        while self._tasks:
            await asyncio.wait(set(self._tasks))
        for command_id, end in list(self._late.items()):
            await self._journal.end(command_id, end)
            self._late.pop(command_id, None)

    async def note(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> None:
        """Write down anything else; a journal that fails doesn't hide what is reported."""
        with contextlib.suppress(JournalFailed):
            await self._journal.note(self._entry(kind, what, facts))

    def note_now(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> None:
        """As `note`, without waiting."""
        self._journal.note_now(self._entry(kind, what, facts))

    def _entry(self, kind: EntryKind, what: str, facts: Mapping[str, object]) -> Entry:
        return Entry(self._clock.utc(), self._telescope, kind, what, dict(facts))


async def _finished(task: asyncio.Future[None]) -> bool:
    """Wait for a piece of writing to end, also through a cancellation; whether there was one."""
    cancelled = False
    while not task.done():
        try:
            await asyncio.wait({task})
        except asyncio.CancelledError:
            cancelled = True
    return cancelled


def outcome_of(error: BaseException, *, on_wire: bool) -> Outcome:
    """The outcome of an order that raised an error.

    Parameters
    ----------
    on_wire : bool
        Whether anything went over the wire since the order was given to the driver, as far as is known.
    """
    if isinstance(error, DeviceRefused):
        return Outcome.REFUSED
    if isinstance(error, RefusedButDone):
        return Outcome.REFUSED_BUT_DONE
    if isinstance(error, SyncIgnored):
        return Outcome.IGNORED
    if isinstance(error, Busy | BadRequest):
        return Outcome.NOT_SENT
    if isinstance(error, DeviceError | MountnavError):
        return Outcome.UNKNOWN if on_wire else Outcome.NOT_SENT
    return Outcome.UNKNOWN


def wire_count(wire: object) -> int | None:
    """How many messages have gone over a mount's wire; None if that isn't counted."""
    count = getattr(wire, "count", None)
    return count if isinstance(count, int) else None
