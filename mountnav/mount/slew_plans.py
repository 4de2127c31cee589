"""How a slew may go: planned leg by leg, each leg checked before it is sent; refusals are written down."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from mountnav.clock import Clock
from mountnav.devices import Mount, MountReading, PierSide, Skill
from mountnav.errors import BadRequest, DeviceRefused, OutsideLimits
from mountnav.journal.records import EntryKind
from mountnav.mount.guarding import Guard, Plan
from mountnav.mount.sending import Sender
from mountnav.mount.written_orders import OrderBook
from mountnav.navigation.kinds import from_mount
from mountnav.pointing.limits import SlewCheck
from mountnav.sky.coordinates import Apparent, Icrs


class SlewPlans:
    """Plans the slews of one mount.

    Parameters
    ----------
    mount : Mount
        Only asked on which side of the pier it would end.
    guard : Guard
    sender : Sender
        Writes refusals down.
    book : OrderBook
    clock : Clock
    """

    def __init__(self, mount: Mount, guard: Guard, sender: Sender, book: OrderBook, clock: Clock) -> None:
        self._mount = mount
        self._guard = guard
        self._sender = sender
        self._book = book
        self._clock = clock

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
            The mount can't tell of this place.
        DeviceError
        """
        if Skill.DESTINATION_SIDE not in getattr(self._mount, "skills", frozenset()):
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
            return None  # it can't tell of this place: then it isn't known

    async def _prove_side(self) -> None:
        """Have a German mount that foretells its sides show that it tells the right ones."""
        guard = self._guard
        foretells = Skill.DESTINATION_SIDE in getattr(self._mount, "skills", frozenset())
        if guard.limits.past_meridian_deg is None or not foretells:
            return
        utc = self._clock.utc()

        async def foretold(place: Icrs) -> PierSide | None:
            return await self.destination_side(guard.for_mount(place, self._mount.epoch, utc))

        await guard.proof.ask(foretold, guard.site, guard.air, utc)
