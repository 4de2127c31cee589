"""A mount without a wire: the face of a driver, the mechanics behind it, and what goes wrong between the two.

"Simulated" means the same Python face and no wire; its answers and its errors are those that
`drivers.generic.DrivenMount` gives over one: a slew has arrived when the mount rests and is where it was
sent, a sync has happened when the readings show it, a position that may be wrong doesn't count.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.generic.keeping import LinkState
from drivers.generic.places import apart_arcsec, check_kind
from drivers.simulated.state import SimulatedState
from mountnav.devices import (
    Direction,
    MountReading,
    PierSide,
    Skill,
    SlewOutcome,
    SlewState,
    SyncOutcome,
    SyncResult,
    TrackingRate,
)
from mountnav.errors import BadRequest, DeviceError, DeviceRefused, Refusal, RefusedButDone
from mountnav.navigation.sync_outcomes import miss_arcsec, moved_arcsec, near_arcsec, unseen
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.turning import SIDEREAL_DEG_S

_GUIDE_DEG_S = 0.5 * SIDEREAL_DEG_S
_LONGEST_PULSE_S = 60.0
_STOPS_WITHIN_S = 20.0
_START_GRACE_S = 3.0
"""So long a refusal is watched, s, as real mounts are (`Timing.start_grace_s`)."""
_STATES = {
    SlewOutcome.ARRIVED: SlewState.ARRIVED,
    SlewOutcome.STALLED: SlewState.STALLED,
    SlewOutcome.STOPPED: SlewState.STOPPED,
}


class SimulatedMount(SimulatedState):
    """A `mountnav.devices.Mount` over the mechanics; skilled, trusting, announcing.

    Parameters
    ----------
    mechanics : Mechanics
        With this clock as its own.
    clock : Clock
    behavior : MountBehavior, optional
    name : str
    trusted : bool
        Whether its position counts when it is opened first.

    Attributes
    ----------
    received : list of str
        Every order that reached the mechanics, in its order: "slew", "sync", "stop", "park", ...
    denies : set of str
        Orders of those names it carries out, and says no to.
    """

    # -- orders ------------------------------------------------------------------------------------

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Go to a place in its own coordinates; return when at rest.

        Raises
        ------
        BadRequest, Busy
        DeviceRefused
            When it says no, is parked, or its position can't be trusted; nothing moves.
        DeviceSilent, DeviceMissing
            When it can't be followed any more.
        """
        check_kind(place, self.epoch, device=self._name)
        asked = self._as_understood(place)
        async with self._moving("slew") as (links, stops):
            self._require_trust("the slew")
            if self.mechanics.parked:
                raise DeviceRefused(
                    "the slew refused: it is parked",
                    device=self._name,
                    advice="unpark it first",
                    reason=Refusal.PARKED,
                )
            refusal = self.mechanics.refusal(asked) if self.behavior.refuses else None
            if refusal is not None:
                raise DeviceRefused(f"the slew refused: {refusal}", device=self._name, reason=refusal)

            def there() -> bool:
                allowed = max(self.behavior.near_arcsec, 2.0 * self.resolution_arcsec)
                return apart_arcsec(self._reading().place, place) <= allowed

            if stops != self._stops:
                return self._ended(SlewOutcome.STOPPED)
            return await self._ordered("slew", lambda: self.mechanics.slew(asked), there, links, stops)

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Tell it that it points at a place in its own coordinates, once, and read back.

        Raises
        ------
        BadRequest, Busy
        DeviceRefused
            When it says no, or slews.
        DeviceSilent, DeviceMissing
            When it can't be read back: whether it was carried out is not known.
        """
        check_kind(place, self.epoch, device=self._name)
        self._require_no_job()
        await self.cable.ask()
        self._see_reboots()
        if self.mechanics.slewing():
            raise DeviceRefused("the sync refused: it slews", device=self._name, reason=Refusal.BUSY)
        links = self.cable.links
        before = self._reading()
        self.received.append("sync")
        refusal = self.mechanics.sync(self._as_understood(place))
        if refusal is not None:
            raise DeviceRefused(f"the sync refused: {refusal}", device=self._name, reason=refusal)
        if "sync" in self.denies:
            raise await self._belied("the sync", before)
        way_arcsec = apart_arcsec(before.place, place)
        near = near_arcsec(way_arcsec, self.resolution_arcsec, self.behavior.near_arcsec)
        began_s, told_utc = self._clock.monotonic_s(), self._clock.utc()
        while True:
            await self.cable.ask()
            self.cable.require(links)
            now, after_s = self._reading(), self._clock.monotonic_s() - began_s
            seen = miss_arcsec(place, told_utc, now) <= near
            if seen or after_s > self.behavior.sync_wait_s:
                break
            await self._clock.sleep(0.2)
        miss = apart_arcsec(now.place, place)
        if not seen:
            self._late = (place, near)
            outcome = unseen(before, now, self.resolution_arcsec)
            if outcome is SyncOutcome.ELSEWHERE:
                self._went_elsewhere(miss)
            return SyncResult(outcome, now, miss, after_s)
        self._believe("a sync was seen")
        late = after_s > self.behavior.late_s
        return SyncResult(SyncOutcome.LATE if late else SyncOutcome.SEEN, now, miss, after_s)

    async def stop(self) -> None:
        """Stop all motion now; return when it rests.

        Raises
        ------
        DeviceSilent, DeviceMissing
            When it can't be told.
        DeviceRefused
            When it still moves.
        """
        self._stops += 1
        self._stop_owed = True
        await self.cable.ask()
        self._stop_now()
        began_s = self._clock.monotonic_s()
        while self.mechanics.slewing():
            if self._clock.monotonic_s() - began_s > _STOPS_WITHIN_S:
                raise DeviceRefused(
                    "was told to stop and still moves", device=self._name, advice="cut its power"
                )
            await self._clock.sleep(min(0.1, self.behavior.poll_s))
            await self.cable.ask()
            self._stop_now()
        self._stop_owed = False

    async def park(self) -> SlewOutcome:
        """Go to its park position and stay. Raises as `slew` does."""
        async with self._moving("parking") as (links, stops):
            self._require_trust("parking")
            if self.mechanics.parked:
                return self._ended(SlewOutcome.ARRIVED)
            return await self._ordered(
                "park", self.mechanics.park, lambda: self.mechanics.parked, links, stops
            )

    async def unpark(self) -> None:
        """Be ready to move again."""
        await self._told("unpark", self.mechanics.unpark)

    async def home(self) -> SlewOutcome:
        """Go home; where a sensor finds it, its position counts again. Raises as `slew` does."""
        async with self._moving("homing") as (links, stops):
            if not self.mechanics.machine.home_sensor:
                self._require_trust("going home")

            def there() -> bool:
                return self.mechanics.at_home

            def go() -> None:
                refusal = self.mechanics.home()
                if refusal is not None:
                    raise DeviceRefused(f"homing refused: {refusal}", device=self._name, reason=refusal)

            outcome = await self._ordered("home", go, there, links, stops)
            if outcome is SlewOutcome.ARRIVED and self.mechanics.machine.home_sensor:
                self._believe("it has found its home")
            return outcome

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Follow the sky, or rest. Raises `DeviceRefused` when it is parked."""

        def track() -> None:
            self.mechanics.rate = rate
            self.mechanics.tracking = on

        await self._told("track", track)
        if self.mechanics.tracking is not on:
            raise DeviceRefused("accepted switching tracking and didn't do it", device=self._name)

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for a moment; return when that is over."""
        if not 0.0 < duration_s <= _LONGEST_PULSE_S:
            raise BadRequest(f"a guide pulse of {duration_s} s", device=self._name)
        await self._told("guide", lambda: None)
        if not self.mechanics.pulse(direction.value, _GUIDE_DEG_S, duration_s):
            raise DeviceRefused("the guide pulse refused: it is parked or slews", device=self._name)
        await self._clock.sleep(duration_s)

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """On which side of the pier it would look at a place; None if it can't tell."""
        check_kind(place, self.epoch, device=self._name)
        await self.cable.ask()
        if Skill.DESTINATION_SIDE not in self.skills:
            return None
        side = self.mechanics.destination_side(self._as_understood(place))
        return self._as_told(side)

    # -- inside ------------------------------------------------------------------------------------

    def _as_understood(self, place: Apparent | Icrs) -> Apparent:
        if isinstance(place, Icrs):
            return icrs_to_apparent(self.behavior.icrs_in_steps(place), self._clock.utc())
        return self.behavior.in_steps(place)

    @asynccontextmanager
    async def _moving(self, what: str) -> AsyncIterator[tuple[int, int]]:
        self._require_no_job()
        self._job, sent = what, len(self.received)
        stops = self._stops
        try:
            await self.cable.ask()
            self._see_reboots()
            yield self.cable.links, stops
        except DeviceRefused:
            self._state = SlewState.REFUSED
            raise
        except RefusedButDone:
            raise  # it was stopped
        except (DeviceError, asyncio.CancelledError):
            self._state, self._stop_owed = SlewState.LOST, len(self.received) > sent
            # nobody watches it any more: a mount that may be moving is not left so
            if self.cable.state is LinkState.UP and self._stop_owed:
                with contextlib.suppress(DeviceError):
                    await self.cable.ask()
                    self._stop_now()
            raise
        finally:
            self._job = None

    async def _ordered(
        self, order: str, send: Callable[[], object], there: Callable[[], bool], links: int, stops: int
    ) -> SlewOutcome:
        stood = self._reading()
        self.received.append(order)
        send()
        if order in self.denies:
            raise await self._belied(f"the {order}", stood)
        self._stop_owed = False
        self._state = SlewState.UNDER_WAY
        began_s = changed_s = self._clock.monotonic_s()
        before = self.mechanics.true_axes()
        boots = self.mechanics.boots
        while True:
            await self._clock.sleep(self.behavior.poll_s)
            await self.cable.ask()
            self.cable.require(links)
            now_s, now = self._clock.monotonic_s(), self.mechanics.true_axes()
            if self.mechanics.boots != boots:
                self._see_reboots()
                return self._ended(SlewOutcome.STALLED)
            if self.mechanics.slewing():
                if max(abs(a - b) for a, b in zip(before, now, strict=True)) > 0.01:
                    before, changed_s = now, now_s
                if now_s - changed_s > self.behavior.stall_s:
                    await self.stop()
                    return self._ended(SlewOutcome.STALLED)
                continue
            if stops != self._stops:
                return self._ended(SlewOutcome.STOPPED)
            if there():
                return self._ended(SlewOutcome.ARRIVED)
            if now_s - began_s > self.behavior.rest_s:
                return self._ended(SlewOutcome.STALLED)

    def _ended(self, outcome: SlewOutcome) -> SlewOutcome:
        self._state = _STATES[outcome]
        return outcome

    async def _told(self, order: str, send: Callable[[], object]) -> None:
        self._require_no_job()
        await self.cable.ask()
        self.received.append(order)
        send()
        if order in self.denies:
            self._distrust(f"it said no to {order}, and did it")
            raise self._denied(order, "did it")
        await self.cable.ask()

    async def _belied(self, order: str, before: MountReading) -> DeviceError:
        """Look after an order that was refused, as `drivers.generic.refused` does; what is to be raised."""
        began_s = self._clock.monotonic_s()
        free_arcsec = 5.0 + 2.0 * self.resolution_arcsec
        while self._clock.monotonic_s() - began_s <= _START_GRACE_S:
            await self.cable.ask()
            moves = self.mechanics.slewing()
            if moves or moved_arcsec(before, self._reading()) > free_arcsec:
                self._distrust(f"it said no to {order}, and moved")
                if moves:
                    await self.stop()
                self._state = SlewState.STOPPED
                return self._denied(order, "moved; stopped" if moves else "moved")
            await self._clock.sleep(0.2)
        return DeviceRefused(f"{order} refused", device=self._name)

    def _denied(self, order: str, what: str) -> RefusedButDone:
        said = f"{order}: said refused, but {what}"
        self.cable.tell("refused-but-done", {"order": order, "why": said})
        return RefusedButDone(
            said, device=self._name, advice="its position doesn't count: solve a frame and sync (recover)"
        )
