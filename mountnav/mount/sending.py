"""Sending one order: what stands before it, its row in the journal, the wire, and its end.

`Admission` asks whether the mount is busy, able, parked, trusted; a refusal is written down. `Sender` writes
the order down, sends it unless a stop has overtaken it, and closes it whatever becomes of it.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass
from typing import TypeVar

from mountnav.clock import Clock
from mountnav.devices import Mount, MountReading, PierSide, Skilled, from_mount
from mountnav.errors import (
    Busy,
    DeviceError,
    DeviceRefused,
    JournalFailed,
    MountnavError,
    OutsideLimits,
    Refusal,
)
from mountnav.journal.records import EntryKind, Order, Outcome
from mountnav.mount.kill_points import kill_point
from mountnav.mount.limits_guard import LimitsGuard
from mountnav.mount.mount_state import MountState
from mountnav.mount.order_book import OrderBook, OrderRow, outcome_of, wire_count
from mountnav.mount.trust import SiteTimeAgreement
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec

T = TypeVar("T")

_BY_THE_SKY: frozenset[Order] = frozenset({"slew", "offset-rates", "move-axis"})
"""Orders that are judged by where the sky stands: refused while mount and settings contradict each other."""


class OvertakenError(Exception):
    """A stop came before the order was sent."""


@asynccontextmanager
async def stopped_if_broken_off(mount: Mount) -> AsyncIterator[None]:
    """Stop a mount if what is done with it ends by an error or is cancelled, and pass the error on.

    For scripts that hold a driver themselves, without limits, journal or watch.
    """
    try:
        yield
    except BaseException:
        with suppress(DeviceError):
            await mount.stop()
        raise


@dataclass(frozen=True, slots=True)
class OrderResult:
    """What an order that didn't raise has come to.

    Attributes
    ----------
    after : MountReading or None
        The mount's, if its answer held one.
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

    Attributes
    ----------
    stops : int
        How many stops were ordered.
    """

    def __init__(self, mount: Mount, book: OrderBook, state: MountState) -> None:
        self._mount = mount
        self._book = book
        self._state = state
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
        came: Callable[[T], OrderResult],
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
                order, self._state.segments.segment_id, place=place, facts=facts, before=before
            )
        except JournalFailed as failure:
            self._state.tell("journal-failed", {"order": order, "why": failure.what})
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
        kill_point(f"{order} sent")
        if moves:
            self._state.moved()
        await self._close(written, came(result), place if reads else None, reads=reads)
        return result

    async def _close(
        self, written: OrderRow, came: OrderResult, place: Apparent | Icrs | None, *, reads: bool
    ) -> None:
        after, miss, cancelled = came.after, came.miss_arcsec, False
        if came.new_segment:
            self._state.new_segment(came.new_segment, came.synced_on)
        if reads and after is None:
            try:
                after = await self._state.reading()
            except DeviceError:
                pass  # the order is done all the same; a caller that needs the place asks again
            except asyncio.CancelledError:
                cancelled = True
        if after is not None and place is not None and miss is None:
            miss = separation_arcsec(from_mount(after.place), from_mount(place))
        written.facts.update(came.facts or {})
        await self._book.end(written, came.outcome, came.detail, after=after, miss_arcsec=miss)
        if cancelled:
            raise asyncio.CancelledError

    async def _failed(
        self, written: OrderRow, error: BaseException, noted: int | None, *, moves: bool
    ) -> None:
        """Close an order that raised: what it came to, as far as that is known."""
        order = written.record.order
        on_wire = noted is None or wire_count(getattr(self._mount, "wire_log", None)) != noted
        outcome = outcome_of(error, on_wire=on_wire)
        state = getattr(self._mount, "slew_state", None)
        if state is not None:
            written.facts["slew_state"] = str(state)
        if moves and outcome is not Outcome.NOT_SENT:
            self._state.moved()
        if order == "sync" and outcome in (Outcome.UNKNOWN, Outcome.REFUSED_BUT_DONE):
            self._state.new_segment("a sync whose outcome isn't known")
        kill_point(f"{order} sent")
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


class Admission:
    """Lets orders to one mount pass, or refuses them.

    Parameters
    ----------
    mount : Mount
        Only asked for its name and its skills.
    sender : Sender
        Writes refusals down.
    agreement : SiteTimeAgreement
        Of mount and settings: nothing is slewed without.

    Attributes
    ----------
    job : str or None
        The order that holds the mount.
    """

    def __init__(
        self,
        mount: Mount,
        guard: LimitsGuard,
        state: MountState,
        sender: Sender,
        clock: Clock,
        agreement: SiteTimeAgreement,
    ) -> None:
        self._agreement = agreement
        self._mount = mount
        self._guard = guard
        self._state = state
        self._sender = sender
        self._clock = clock
        self.job: Order | None = None

    @asynccontextmanager
    async def held(self, order: Order) -> AsyncIterator[None]:
        """Hold the mount for one order to move; a second one is refused, a stop under way waited for.

        `MountOrders.work` of navigation holds the telescope for a whole piece of work; this here is for each
        order, also of the watch over the limits. A driver holds its wire for itself besides: it may be used
        without this room, as by `drivers.acceptance`.
        """
        await self.require_free(order)
        self.job = order
        try:
            yield
        finally:
            self.job = None

    async def require_free(self, order: Order) -> None:
        """Refuse an order while another one holds the mount, once no stop is under way. Raises `Busy`."""
        await self._sender.settled()
        if self.job is not None:
            busy = self.busy()
            await self._sender.refused(order, busy)
            raise busy

    def busy(self) -> Busy:
        """The refusal of an order while another one holds the mount."""
        return Busy(f"a {self.job} is running", device=self._mount.name, advice="wait for it, or stop it")

    async def skilled(self, order: Order) -> Skilled:
        """Give the mount as one that has skills. Raises `DeviceRefused` if it has none."""
        if isinstance(self._mount, Skilled):
            return self._mount
        raise await self.unsupported(order)

    async def unsupported(self, order: Order) -> DeviceRefused:
        """Write down that the mount can't do this, and give what is to be raised."""
        refusal = DeviceRefused(
            f"it can't do this: {order}", device=self._mount.name, reason=Refusal.UNSUPPORTED
        )
        await self._sender.refused(order, refusal)
        return refusal

    async def ready(
        self,
        order: Order,
        *,
        place: Apparent | Icrs | None = None,
        needs_trust: bool = True,
        parked_too: bool = False,
    ) -> MountReading:
        """Read the mount, and refuse to move one that is parked, lost, or by day.

        Raises
        ------
        DeviceRefused, OutsideLimits, DeviceError
        """
        before = await self._state.reading()
        if self._state.trusted:
            self._guard.stood(before)
        refusal = self.unfit(order, before, needs_trust=needs_trust, parked_too=parked_too)
        if refusal is not None:
            await self._sender.refused(order, refusal, before, place)
            raise refusal
        if order in _BY_THE_SKY:
            # to park and to go home is to go by its own axes: both stay possible, as do stop and recover
            try:
                await self._agreement.require(order)
            except DeviceRefused as contradicted:
                await self._sender.refused(order, contradicted, before, place)
                raise
        return before

    def unfit(
        self, order: Order, before: MountReading, *, needs_trust: bool = True, parked_too: bool = False
    ) -> MountnavError | None:
        """What speaks against moving the mount as it stands, as what is to be raised; None: nothing.

        A driver refuses by its own trust as well. That is not the same: this room also distrusts a mount for
        what looks at the sky and earlier runs have shown, a driver for what it has seen over its wire.
        """
        if before.parked and not parked_too:
            return DeviceRefused(
                f"the {order} refused: it is parked",
                device=self._mount.name,
                advice="unpark it first",
                reason=Refusal.PARKED,
            )
        if needs_trust and not self._state.trusted:
            return DeviceRefused(
                f"the {order} refused: its position can't be trusted ({self._state.why_untrusted})",
                device=self._mount.name,
                advice="order first light if it was just set up, else recover: both look at the sky; or "
                "let it find its home",
                reason=Refusal.UNTRUSTED,
            )
        if order == "home":
            try:
                self._guard.require_night(self._clock.utc())
            except OutsideLimits as day:
                return day
        return None
