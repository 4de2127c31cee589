"""Sending one order: written down, sent unless a stop has overtaken it, closed whatever becomes of it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from mountnav.devices import Mount, MountReading, PierSide
from mountnav.errors import DeviceError, DeviceRefused, JournalFailed, MountnavError, OutsideLimits
from mountnav.journal.records import EntryKind, Order, Outcome
from mountnav.mount.standing import Standing
from mountnav.mount.written_orders import OrderBook, Written, outcome_of, wire_count
from mountnav.navigation.kinds import from_mount
from mountnav.navigation.steps import step
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

T = TypeVar("T")


class OvertakenError(Exception):
    """A stop came before the order was sent."""


@dataclass(frozen=True, slots=True)
class Came:
    """What an order that didn't raise has come to.

    Attributes
    ----------
    outcome : Outcome
    detail : str
    after : MountReading or None
        The mount's, if its answer held one.
    miss_arcsec : float or None
    facts : mapping
    new_segment : str
        Why a new segment begins; empty if none does.
    synced_on : PierSide or None
        On which side, if it was a sync.
    """

    outcome: Outcome
    detail: str = ""
    after: MountReading | None = None
    miss_arcsec: float | None = None
    facts: Mapping[str, object] | None = None
    new_segment: str = ""
    synced_on: PierSide | None = None


class Sender:
    """Sends the orders of one mount, each with its row in the journal.

    Parameters
    ----------
    mount : Mount
        Only asked for its wire log and its slew's state.
    book : OrderBook
    standing : Standing

    Attributes
    ----------
    stops : int
        How many stops were ordered.
    """

    def __init__(self, mount: Mount, book: OrderBook, standing: Standing) -> None:
        self._mount = mount
        self._book = book
        self._standing = standing
        self.stops = 0
        self._stopping = 0
        self._settled = asyncio.Event()

    @contextmanager
    def stopping(self) -> Iterator[None]:
        """Count a stop, and hold back what is ordered until it has ended: seen at rest, or failed."""
        self.stops += 1
        self._stopping += 1
        try:
            yield
        finally:
            self._stopping -= 1
            self._settled.set()

    async def settled(self) -> None:
        """Wait until no stop is under way.

        A driver repeats its stop until the mount rests: an order that is sent meanwhile would be ended by the
        stop of the one before it.
        """
        while self._stopping:
            self._settled.clear()
            await self._settled.wait()

    async def send(
        self,
        order: Order,
        send: Callable[[], Awaitable[T]],
        came: Callable[[T], Came],
        *,
        stops: int,
        moves: bool,
        reads: bool = False,
        place: Apparent | Icrs | None = None,
        facts: Mapping[str, object] | None = None,
        before: MountReading | None = None,
    ) -> T:
        """Write an order down, send it, and close it.

        Parameters
        ----------
        order : str
        send : callable
            Gives it to the driver.
        came : callable
            What its answer means.
        stops : int
            The count of stops from which on no other may have come.
        moves : bool
            Whether it may move the mount, or change its zero points.
        reads : bool
            Whether the mount is read afterwards, for the row.
        place, facts, before : optional
            For the row.

        Raises
        ------
        OvertakenError
            A stop came first; nothing was sent.
        JournalFailed
            Nothing was sent.
        DeviceError, CancelledError
            As the driver raised it; the row is closed.
        """
        try:
            written = await self._book.begin(
                order, self._standing.segments.segment_id, place=place, facts=facts, before=before
            )
        except JournalFailed as failure:
            self._standing.tell("journal-failed", {"order": order, "why": failure.what})
            raise
        if self.stops != stops:
            await self._book.end(written, Outcome.NOT_SENT, "a stop came before it was sent")
            raise OvertakenError
        noted = wire_count(getattr(self._mount, "wire_log", None))
        try:
            result = await send()
        except BaseException as error:
            await self._failed(written, error, noted, moves=moves)
            raise
        step(f"{order} sent")
        if moves:
            self._standing.moved()
        await self._close(written, came(result), place if reads else None, reads=reads)
        return result

    async def _close(
        self, written: Written, came: Came, place: Apparent | Icrs | None, *, reads: bool
    ) -> None:
        after, miss, cancelled = came.after, came.miss_arcsec, False
        if came.new_segment:
            self._standing.new_segment(came.new_segment, came.synced_on)
        if reads and after is None:
            try:
                after = await self._standing.reading()
            except DeviceError:
                pass  # the order is done all the same; whoever needs the place asks again
            except asyncio.CancelledError:
                cancelled = True
        if after is not None and place is not None and miss is None:
            miss = separation_arcsec(from_mount(after.place), from_mount(place))
        written.facts.update(came.facts or {})
        await self._book.end(written, came.outcome, came.detail, after=after, miss_arcsec=miss)
        if cancelled:
            raise asyncio.CancelledError

    async def _failed(
        self, written: Written, error: BaseException, noted: int | None, *, moves: bool
    ) -> None:
        """Close an order that raised: what it came to, as far as that is known."""
        order = written.record.order
        on_wire = noted is None or wire_count(getattr(self._mount, "wire_log", None)) != noted
        outcome = outcome_of(error, on_wire=on_wire)
        state = getattr(self._mount, "slew_state", None)
        if state is not None:
            written.facts["slew_state"] = str(state)
        if moves and outcome is not Outcome.NOT_SENT:
            self._standing.moved()
        if order == "sync" and outcome in (Outcome.UNKNOWN, Outcome.REFUSED_BUT_DONE):
            self._standing.new_segment("a sync whose outcome isn't known")
        step(f"{order} sent")
        detail = str(error) or "cancelled on the way: what became of it isn't known"
        try:
            await self._book.end(written, outcome, detail)
        except asyncio.CancelledError:
            if not isinstance(error, asyncio.CancelledError):
                raise  # the cancellation is newer than the error, and must not be lost

    async def refused(
        self,
        order: Order,
        refusal: MountnavError,
        before: MountReading | None = None,
        place: Apparent | Icrs | None = None,
    ) -> None:
        """Write a refusal down: nothing went over the wire."""
        facts: dict[str, object] = {"order": order, "slug": refusal.slug, "why": refusal.what}
        if isinstance(refusal, OutsideLimits):
            facts["limit"] = str(refusal.limit)
        if isinstance(refusal, DeviceRefused):
            facts["reason"] = str(refusal.reason)
        if place is not None:
            facts |= {"ra_deg": place.ra_deg, "dec_deg": place.dec_deg}
        if before is not None:
            facts |= {"at_ra_deg": before.place.ra_deg, "at_dec_deg": before.place.dec_deg}
            facts["at_utc"] = before.utc.isoformat()
        await self._book.note(EntryKind.REFUSAL, f"{order} refused", facts)
