"""The orders that a mount is given: slew, park, home, unpark, track, guide, sync.

`SlewPlanner` plans a slew leg by leg, each leg checked before it is sent. `MotionOrders` watches what moves
the mount on its way; `BriefOrders` are those that end by themselves; `SyncOrders` sends a sync and says
whether it was seen. A stop isn't here: it goes past all of this (`CheckedMount.stop`).
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace

from mountnav.devices import (
    MountReading,
    PierSide,
    Skill,
    Skilled,
    SlewOutcome,
    SyncLaw,
    SyncOutcome,
    SyncResult,
    for_mount,
    from_mount,
    rates_of,
    skills_of,
)
from mountnav.errors import BadRequest, Cancelled, DeviceRefused, OutsideLimits, Refusal
from mountnav.journal.records import EntryKind, Order, Outcome
from mountnav.mount.limits_guard import Plan
from mountnav.mount.order_rooms import OrderRooms, Orders
from mountnav.mount.sending import OrderResult, OvertakenError
from mountnav.mount.tracking_watch import LEAD_S
from mountnav.pointing.limits import SlewCheck
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import separation_arcsec


class SlewPlanner(Orders):
    """Plans the slews of one mount, which is only asked on which side of the pier it would end."""

    async def found(self, before: MountReading, place: Apparent | Icrs) -> Plan:
        """Find how to get to a place, and write nothing.

        Raises
        ------
        OutsideLimits, BadRequest, DeviceError
        """
        side = await self._destination(place)
        return await self._guard.plan(before, from_mount(place), self._clock.utc(), side, self._foretold)

    async def made(self, before: MountReading, place: Apparent | Icrs) -> Plan:
        """Find how to get to a place; a refusal or a way round is written down. Raises as `found`."""
        side = await self._destination(place)
        try:
            plan = await self._guard.plan(before, from_mount(place), self._clock.utc(), side, self._foretold)
        except (OutsideLimits, BadRequest) as refusal:
            await self._sender.refused("slew", refusal, before, place)
            raise
        if len(plan.legs) > 1:
            via = [{"ra_deg": leg.ra_deg, "dec_deg": leg.dec_deg} for leg in plan.legs[:-1]]
            await self._book.note(
                EntryKind.DECISION,
                "the direct way isn't allowed: it goes by way of other places",
                {"via": via},
            )
        return plan

    async def checked(
        self, before: MountReading, aim: Apparent | Icrs, leg: Icrs, *, passing: bool
    ) -> SlewCheck:
        """Check one leg from where the mount stands now; a refusal is written down. Raises as `found`.

        `passing`: another leg follows.
        """
        side = await self._destination(aim)
        try:
            return self._guard.check_slew(before, leg, self._clock.utc(), side, passing=passing)
        except (OutsideLimits, BadRequest) as refusal:
            await self._sender.refused("slew", refusal, before, aim)
            raise

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side of the pier the tube would hang after a slew there; None if it can't tell.

        Raises
        ------
        DeviceRefused
            The mount can't say it of this place.
        DeviceError
        """
        if Skill.DESTINATION_SIDE not in skills_of(self._mount):
            return None
        ask: Callable[[Apparent | Icrs], Awaitable[PierSide | None]] | None
        ask = getattr(self._mount, "destination_side", None)
        return None if ask is None else await ask(place)

    async def _destination(self, place: Apparent | Icrs) -> PierSide | None:
        await self._prove_side()
        return await self._side_at(place)

    async def _foretold(self, place: Icrs) -> PierSide | None:
        return await self._side_at(self._guard.for_mount(place, self._mount.epoch, self._clock.utc()))

    async def _side_at(self, place: Apparent | Icrs) -> PierSide | None:
        try:
            return await self.destination_side(place)
        except DeviceRefused:
            return None  # it can't say it of this place: then it isn't known

    async def _prove_side(self) -> None:
        """Have a German mount that foretells its sides show that it reports the right ones."""
        guard = self._guard
        foretells = Skill.DESTINATION_SIDE in skills_of(self._mount)
        if guard.limits.past_meridian_deg is None or not foretells:
            return
        utc = self._clock.utc()

        async def foretold(place: Icrs) -> PierSide | None:
            return await self.destination_side(guard.for_mount(place, self._mount.epoch, utc))

        await guard.proof.ask(foretold, guard.site, guard.air, utc)


_SLEW_OUTCOMES = {
    SlewOutcome.ARRIVED: Outcome.DONE,
    SlewOutcome.STALLED: Outcome.STALLED,
    SlewOutcome.STOPPED: Outcome.STOPPED,
}


_ANEW = 2
"""So often a way by legs is planned again whose next leg isn't allowed any more: the mount may have come to a
place on the other side of the pier than was reckoned with. Doubled, a mount wanders longer before it is
refused."""


class _LegRefused(Exception):
    """A leg after the first one isn't allowed from where the mount has come to."""

    def __init__(self, why: OutsideLimits, before: MountReading) -> None:
        self.why = why
        self.before = before


class MotionOrders(Orders):
    """Moves one mount; one order at a time, `Admission` sees to that."""

    def __init__(self, rooms: OrderRooms, plans: SlewPlanner) -> None:
        super().__init__(rooms)
        self._plans = plans
        self._before: Callable[[str], Awaitable[None]] | None = None

    def before_moving(self, end: Callable[[str], Awaitable[None]]) -> None:
        """Have `end(order)` end what goes on by itself before each order to move is sent."""
        self._before = end

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go there, directly or by way of other places. See `CheckedMount.slew`."""
        # those that come while it waits for an earlier one count
        stops = self._sender.stops
        async with self._admission.held("slew"):
            before = await self._admission.ready("slew", place=place)
            for anew in reversed(range(1 + _ANEW)):
                plan = await self._plans.made(before, place)
                try:
                    return await self._by_legs(plan, place, before, stops)
                except _LegRefused as refused:
                    if not anew:
                        raise refused.why from None
                    before = refused.before
            raise AssertionError  # the last one raises

    async def _by_legs(
        self, plan: Plan, place: Apparent | Icrs, before: MountReading, stops: int
    ) -> SlewOutcome:
        legs, check = plan.legs, plan.check
        for number, leg in enumerate(legs, start=1):
            aim = place if number == len(legs) else for_mount(leg, self._mount.epoch, self._clock.utc())
            if number > 1:
                before = await self._admission.ready("slew", place=aim)
            if len(legs) > 1:
                try:
                    check = await self._plans.checked(before, aim, leg, passing=number < len(legs))
                except OutsideLimits as why:
                    if number == 1:
                        raise
                    raise _LegRefused(why, before) from None
            facts = check.facts | ({} if len(legs) == 1 else {"leg": number, "of": len(legs)})
            outcome = await self._leg(aim, before, facts, stops, check)
            if outcome is not SlewOutcome.ARRIVED:
                return outcome
            self._guard.arrived(check)
        return SlewOutcome.ARRIVED

    async def _leg(
        self,
        aim: Apparent | Icrs,
        before: MountReading,
        facts: Mapping[str, object],
        stops: int,
        check: SlewCheck,
    ) -> SlewOutcome:
        return await self._followed(
            "slew",
            lambda: self._mount.slew(aim),
            before,
            stops=stops,
            place=aim,
            facts=facts,
            check=check,
        )

    async def station(
        self,
        order: Order,
        send: Callable[[Skilled], Awaitable[SlewOutcome]],
        *,
        needs_trust: bool,
        new_segment: str = "",
    ) -> SlewOutcome:
        """Go where the mount alone knows: its park position or its home.

        Parameters
        ----------
        send : callable
            Gives it to the driver.
        needs_trust : bool
            Whether it goes there by its position.
        new_segment : str
            Why a new segment begins when it has arrived; empty if none does.
        """
        stops = self._sender.stops
        async with self._admission.held(order):
            mount = await self._admission.skilled(order)
            before = await self._admission.ready(order, needs_trust=needs_trust, parked_too=order == "park")
            return await self._followed(
                order, lambda: send(mount), before, stops=stops, new_segment=new_segment
            )

    async def _followed(
        self,
        order: Order,
        send: Callable[[], Awaitable[SlewOutcome]],
        before: MountReading,
        *,
        stops: int,
        place: Apparent | Icrs | None = None,
        facts: Mapping[str, object] | None = None,
        new_segment: str = "",
        check: SlewCheck | None = None,
    ) -> SlewOutcome:
        """Send an order to move, with the watch on its way."""

        def came(outcome: SlewOutcome) -> OrderResult:
            left = following.left
            arrived = outcome is SlewOutcome.ARRIVED
            detail = "" if left is None else f"stopped by the limits: {left.what}"
            if arrived and new_segment:
                self._state.regained()
            if arrived and check is None:
                self._guard.at_station()
            return OrderResult(_SLEW_OUTCOMES[outcome], detail, new_segment=new_segment if arrived else "")

        if self._before is not None:
            await self._before(order)
        self._guard.set_out()
        following = self._watch.follow(order, before, check)
        try:
            outcome = await self._sender.send(
                order,
                send,
                came,
                place=place,
                facts=facts,
                before=before,
                stops=stops,
                moves=True,
                reads=True,
            )
            if order == "slew" and following.left is not None:
                # the stop goes on until it rests: one planned before that would be stopped by it too
                await self._watch.halted()
        except OvertakenError:
            return SlewOutcome.STOPPED
        finally:
            self._watch.unfollow(following)
        if following.left is not None and outcome is not SlewOutcome.ARRIVED:
            raise following.left
        return outcome


class BriefOrders(Orders):
    """Gives one mount the orders that nobody has to follow on their way."""

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
            before = await self._admission.ready(order, needs_trust=moves)
            if self._watch.lost_for_long:
                # else by many short whiles it would be tracked from there to anywhere
                lost = DeviceRefused(
                    f"the {order} refused: {self._watch.lost_words}",
                    device=self._mount.name,
                    advice="looks need a mount that tracks: order home, if a sensor finds it, or put the "
                    "tube by hand where it takes itself to be, then order trust; "
                    "limits.untrusted_tracking_s allows more",
                    reason=Refusal.UNTRUSTED,
                )
                await self._sender.refused(order, lost, before)
                raise lost
            try:
                self._guard.check_tracking(before, self._clock.utc(), LEAD_S)
            except OutsideLimits as refusal:
                await self._sender.refused(order, refusal, before)
                raise
        try:
            await self._sender.send(
                order,
                lambda: send(mount),
                lambda _nothing: OrderResult(Outcome.DONE),
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
        if present is None or Skill.SET_PARK not in skills_of(self._mount):
            raise await self._admission.unsupported("set-park")
        setting = present
        await self.give("set-park", lambda _mount: setting())


_SYNC_OUTCOMES = {
    SyncOutcome.SEEN: Outcome.DONE,
    SyncOutcome.LATE: Outcome.LATE,
    SyncOutcome.IGNORED: Outcome.IGNORED,
    SyncOutcome.ELSEWHERE: Outcome.ELSEWHERE,
}


class SyncOrders(Orders):
    """Syncs one mount."""

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Tell the mount that it points there. See `CheckedMount.sync`."""
        stops = self._sender.stops
        async with self._admission.held("sync"):
            # read here, though the caller has read it, and the driver will: a stop may have been waited
            # for since that decision, and the driver's reading goes through its filter and into no row
            before = await self._state.reading()
            try:
                self._guard.require_above_ground(from_mount(place), self._clock.utc())
            except (OutsideLimits, BadRequest) as refusal:
                await self._sender.refused("sync", refusal, before, place)
                raise
            self._guard.told_anew(self._clock.utc())
            try:
                return await self._sender.send(
                    "sync",
                    lambda: self._sent_and_read(place, before),
                    self._came,
                    place=place,
                    before=before,
                    stops=stops,
                    moves=True,
                )
            except OvertakenError:
                raise Cancelled("stopped before the sync was sent", device=self._mount.name) from None

    async def _sent_and_read(self, place: Apparent | Icrs, before: MountReading) -> SyncResult:
        result: SyncResult | None = await self._mount.sync(place)
        way_arcsec = separation_arcsec(from_mount(before.place), from_mount(place))
        law = SyncLaw.of(way_arcsec, self._mount.resolution_arcsec)
        if result is None:
            # the drivers of others may leave the reading to us
            after = await self._state.reading()
            miss_arcsec = separation_arcsec(from_mount(after.place), from_mount(place))
            outcome = law.outcome(miss_arcsec, before, after, rates_of(self._mount))
            return SyncResult(outcome, after, miss_arcsec, 0.0)
        if result.outcome is SyncOutcome.IGNORED:
            # nor may they know that a mount can take another place
            outcome = law.unseen(before, result.read_back, rates_of(self._mount))
            return replace(result, outcome=outcome)
        return result

    def _came(self, result: SyncResult) -> OrderResult:
        counts = result.outcome.seen
        if counts:
            self._state.regained()
        if result.outcome is SyncOutcome.ELSEWHERE and self._state.trusted:
            self._state.distrust(
                f"it synced to another place: it believes that it is {result.miss_arcsec:.0f}″ from there"
            )
        return OrderResult(
            _SYNC_OUTCOMES[result.outcome],
            after=result.read_back,
            miss_arcsec=result.miss_arcsec,
            facts={"after_s": result.after_s},
            new_segment="a sync was seen" if counts else "",
            synced_on=self._guard.side(result.read_back) or PierSide.UNKNOWN,
        )
