"""Orders that move the mount, watched on their way: a slew leg by leg, the park position, home."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping

from mountnav.clock import Clock
from mountnav.devices import Mount, MountReading, Skilled, SlewOutcome
from mountnav.errors import OutsideLimits
from mountnav.journal.records import Order, Outcome
from mountnav.mount.admission import Admission
from mountnav.mount.guarding import Guard, Plan
from mountnav.mount.sending import Came, OvertakenError, Sender
from mountnav.mount.slew_plans import SlewPlans
from mountnav.mount.standing import Standing
from mountnav.mount.tracking_watch import TrackingWatch
from mountnav.navigation.kinds import for_mount
from mountnav.pointing.limits import SlewCheck
from mountnav.sky.coordinates import Apparent, Icrs

_OUTCOMES = {
    SlewOutcome.ARRIVED: Outcome.DONE,
    SlewOutcome.STALLED: Outcome.STALLED,
    SlewOutcome.STOPPED: Outcome.STOPPED,
}


_ANEW = 2
"""So often a way by legs is planned anew whose next leg isn't allowed any more: the mount may have come to a
place on the other side of the pier than was reckoned with. Doubled, a mount wanders longer before it is
refused."""


class _LegRefused(Exception):
    """A leg after the first one isn't allowed from where the mount has come to."""

    def __init__(self, why: OutsideLimits, before: MountReading) -> None:
        self.why = why
        self.before = before


class Motions:
    """Moves one mount; one order at a time, `Admission` sees to that.

    Parameters
    ----------
    mount : Mount
    guard : Guard
    standing : Standing
    sender : Sender
    admission : Admission
    plans : SlewPlans
    watch : TrackingWatch
        Follows each motion, and ends it where it leaves the limits.
    clock : Clock
    """

    def __init__(
        self,
        mount: Mount,
        guard: Guard,
        standing: Standing,
        sender: Sender,
        admission: Admission,
        plans: SlewPlans,
        watch: TrackingWatch,
        clock: Clock,
    ) -> None:
        self._mount = mount
        self._guard = guard
        self._standing = standing
        self._sender = sender
        self._admission = admission
        self._plans = plans
        self._watch = watch
        self._clock = clock

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
        order : {"park", "home"}
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

        def came(outcome: SlewOutcome) -> Came:
            left = following.left
            arrived = outcome is SlewOutcome.ARRIVED
            detail = "" if left is None else f"stopped by the limits: {left.what}"
            if arrived and new_segment:
                self._standing.regained()
            if arrived and check is None:
                self._guard.at_station()
            return Came(_OUTCOMES[outcome], detail, new_segment=new_segment if arrived else "")

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
                # the stop goes on until it rests: one planned anew before that would be stopped by it too
                await self._watch.halted()
        except OvertakenError:
            return SlewOutcome.STOPPED
        finally:
            self._watch.unfollow(following)
        if following.left is not None and outcome is not SlewOutcome.ARRIVED:
            raise following.left
        return outcome
