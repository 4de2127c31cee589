"""Orders that end by themselves: unpark, track, guide, set the park position; and stop, that never waits."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from mountnav.clock import Clock
from mountnav.devices import Mount, MountReading, Skill, Skilled
from mountnav.errors import Cancelled, OutsideLimits
from mountnav.journal.records import Order, Outcome
from mountnav.mount.admission import Admission
from mountnav.mount.guarding import Guard
from mountnav.mount.sending import Came, OvertakenError, Sender
from mountnav.mount.standing import Standing
from mountnav.mount.tracking_watch import LEAD_S, TrackingWatch
from mountnav.mount.written_orders import OrderBook, outcome_of
from mountnav.navigation.steps import step


class BriefOrders:
    """Gives one mount the orders that nobody has to follow on their way.

    Parameters
    ----------
    mount : Mount
    guard : Guard
    standing : Standing
    sender : Sender
    admission : Admission
    watch : TrackingWatch
    book : OrderBook
    clock : Clock
    """

    def __init__(
        self,
        mount: Mount,
        guard: Guard,
        standing: Standing,
        sender: Sender,
        admission: Admission,
        watch: TrackingWatch,
        book: OrderBook,
        clock: Clock,
    ) -> None:
        self._mount = mount
        self._guard = guard
        self._standing = standing
        self._sender = sender
        self._admission = admission
        self._watch = watch
        self._book = book
        self._clock = clock

    async def give(
        self,
        order: Order,
        send: Callable[[Skilled], Awaitable[None]],
        *,
        facts: Mapping[str, object] | None = None,
        follows: bool = False,
        moves: bool = False,
    ) -> None:
        """Send an order that ends by itself.

        Parameters
        ----------
        order : str
        send : callable
            Gives it to the driver.
        facts : mapping, optional
            For its row.
        follows : bool
            Refuse it where the sky leads out of the limits at once.
        moves : bool
            Whether it moves the mount.
        """
        mount, stops = await self._admission.skilled(order), self._sender.stops
        await self._admission.require_free(order)
        before: MountReading | None = None
        if follows:
            before = await self._admission.ready(order, needs_trust=moves or self._watch.lost_for_long)
            try:
                self._guard.check_tracking(before, self._clock.utc(), LEAD_S)
            except OutsideLimits as refusal:
                await self._sender.refused(order, refusal, before)
                raise
        try:
            await self._sender.send(
                order,
                lambda: send(mount),
                lambda _nothing: Came(Outcome.DONE),
                facts=facts,
                before=before,
                stops=stops,
                moves=moves,
            )
        except OvertakenError:
            raise Cancelled(
                f"stopped before the order to {order} was sent", device=self._mount.name
            ) from None
        self._watch.wake()

    async def set_park(self) -> None:
        """Take the present place for the park position. See `CheckedMount.set_park`."""
        present: Callable[[], Awaitable[None]] | None = getattr(self._mount, "set_park", None)
        if present is None or Skill.SET_PARK not in getattr(self._mount, "skills", frozenset()):
            raise await self._admission.unsupported("set-park")
        setting = present
        await self.give("set-park", lambda _mount: setting())

    async def stop(self) -> None:
        """Stop all motion now; waits for no check and no disk. See `CheckedMount.stop`."""
        with self._sender.stopping():
            written = self._book.begin_now("stop", self._standing.segments.segment_id)
            try:
                await self._mount.stop()
            except BaseException as error:
                detail = str(error) or "cancelled: whether it was heard isn't known"
                self._book.end_soon(written, outcome_of(error, on_wire=True), detail)
                raise
            finally:
                self._standing.moved()
                step("stop sent")
            self._book.end_soon(written, Outcome.DONE)
