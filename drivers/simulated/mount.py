"""A mount without a wire: the face of a driver, the mechanics behind it, and what goes wrong between."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.generic.coordinates import apart_arcsec, check_kind
from drivers.generic.link_supervisor import LinkState
from drivers.generic.mount import LONGEST_PULSE_S
from drivers.generic.refusal_words import parked
from drivers.generic.syncing import SyncReadBack
from drivers.simulated.rates import REAL, SimulatedRates
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
    moved_arcsec,
)
from mountnav.errors import BadRequest, DeviceError, DeviceRefused, Refusal, RefusedButDone
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs

_GUIDE_DEG_S = 0.5 * SIDEREAL_DEG_S
"""Guide rate: half the sidereal rate, as most mounts are delivered."""
_READ_BACK_S = 0.2
"""s between two readings after a sync or a refusal, as `drivers.generic` has it."""
_MOVED_DEG = 0.01
"""An axis that moved by less between two readings stands: far below a slew's step, above any tracking."""
_STATES = {
    SlewOutcome.ARRIVED: SlewState.ARRIVED,
    SlewOutcome.STALLED: SlewState.STALLED,
    SlewOutcome.STOPPED: SlewState.STOPPED,
}


class SimulatedMount(SimulatedRates):
    """A `mountnav.devices.Mount` over the mechanics; it is all else that a mount may be, too.

    Parameters
    ----------
    mechanics : Mechanics
        Made with the same clock.
    trusted : bool
        Whether its position is trusted when it is opened first.

    Attributes
    ----------
    received : list of str
        Every order that reached the mechanics, in sequence: "slew", "sync", "stop", "park", ...
    denies : set of str
        Names of the orders that it carries out although it refuses them.
    """

    # -- orders ------------------------------------------------------------------------------------

    async def slew(self, place: Apparent | Icrs) -> SlewOutcome:
        """Slew to a position in its own coordinates; return when at rest.

        Raises
        ------
        BadRequest, Busy
        DeviceRefused
            If it refuses, is parked, or its position can't be trusted; nothing moves.
        DeviceSilent, DeviceMissing
            If it can't be followed any more.
        """
        check_kind(place, self.epoch, device=self._name)
        asked = self._as_understood(place)
        async with self._moving("slew") as (links, stops):
            self._require_trust("the slew")
            if self.mechanics.parked:
                raise parked("the slew", device=self._name)
            refusal = self.mechanics.refusal(asked) if self.behavior.refuses else None
            if refusal is not None:
                raise DeviceRefused(f"the slew refused: {refusal}", device=self._name, reason=refusal)

            def there() -> bool:
                allowed = max(self.behavior.near_arcsec, 2.0 * self.resolution_arcsec)
                return apart_arcsec(self._reading().place, place) <= allowed

            if stops != self._stops:
                return self._ended(SlewOutcome.STOPPED)
            self._end_rates()
            return await self._ordered("slew", lambda: self.mechanics.slew(asked), there, links, stops)

    async def sync(self, place: Apparent | Icrs) -> SyncResult:
        """Send a sync on a position in its own coordinates, once, and read back.

        Raises
        ------
        BadRequest, Busy
        DeviceRefused
            If it refuses, or slews.
        DeviceSilent, DeviceMissing
            If it can't be read back: whether the sync was carried out is not known.
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
        read_back = SyncReadBack(
            place,
            before,
            resolution_arcsec=self.resolution_arcsec,
            most_arcsec=self.behavior.near_arcsec,
            rates=self._may_drift(),
        )
        began_s = self._clock.monotonic_s()
        read_back.sent(self._clock.utc())
        while True:
            await self.cable.ask()
            self.cable.require(links)
            now, after_s = self._reading(), self._clock.monotonic_s() - began_s
            if read_back.shows(now) or after_s > self.behavior.sync_wait_s:
                break
            await self._clock.sleep(_READ_BACK_S)
        result = read_back.result(now, after_s=after_s, late=after_s > self.behavior.late_s)
        if result.outcome.seen:
            self._believe("a sync was seen")
            return result
        self._late = (place, read_back.near_arcsec)
        if result.outcome is SyncOutcome.ELSEWHERE:
            self._went_elsewhere(result.miss_arcsec)
        return result

    async def park(self) -> SlewOutcome:
        """Go to its park position and stay. Raises as `slew` does."""
        async with self._moving("parking") as (links, stops):
            self._require_trust("parking")
            if self.mechanics.parked:
                return self._ended(SlewOutcome.ARRIVED)
            self._end_rates()
            return await self._ordered(
                "park", self.mechanics.park, lambda: self.mechanics.parked, links, stops
            )

    async def unpark(self) -> None:
        """Be ready to move again."""
        await self._order("unpark", self.mechanics.unpark)

    async def home(self) -> SlewOutcome:
        """Go home; if a sensor finds it, the position is trusted again. Raises as `slew` does."""
        async with self._moving("homing") as (links, stops):
            if not self.mechanics.machine.home_sensor:
                self._require_trust("going home")

            def there() -> bool:
                return self.mechanics.at_home

            def go() -> None:
                refusal = self.mechanics.home()
                if refusal is not None:
                    raise DeviceRefused(f"homing refused: {refusal}", device=self._name, reason=refusal)

            self._end_rates()
            outcome = await self._ordered("home", go, there, links, stops)
            if outcome is SlewOutcome.ARRIVED and self.mechanics.machine.home_sensor:
                self._believe("it has found its home")
            return outcome

    async def set_tracking(self, on: bool, rate: TrackingRate = TrackingRate.SIDEREAL) -> None:
        """Track the sky, or rest. Raises `DeviceRefused` if it is parked."""

        def track() -> None:
            self.mechanics.rate = rate
            self.mechanics.tracking = on

        self._require_no_job()
        self._end_rates()
        await self._order("track", track)
        if self.mechanics.tracking is not on:
            raise DeviceRefused("accepted switching tracking and didn't do it", device=self._name)

    async def guide(self, direction: Direction, duration_s: float) -> None:
        """Move at the guide rate for some time; return when that is over."""
        if not 0.0 < duration_s <= LONGEST_PULSE_S:
            raise BadRequest(f"a guide pulse of {duration_s} s", device=self._name)
        await self._order("guide", lambda: None)
        if not self.mechanics.pulse(direction.value, _GUIDE_DEG_S, duration_s):
            raise DeviceRefused("the guide pulse refused: it is parked or slews", device=self._name)
        await self._clock.sleep(duration_s)

    async def destination_side(self, place: Apparent | Icrs) -> PierSide | None:
        """The side of the pier after a slew to a position; None if it can't say."""
        check_kind(place, self.epoch, device=self._name)
        await self.cable.ask()
        if Skill.DESTINATION_SIDE not in self.skills:
            return None
        side = self.mechanics.destination_side(self._as_understood(place))
        return self._as_reported(side)

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
            # it is not watched any more: a mount that may be moving must not go on
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
                if max(abs(a - b) for a, b in zip(before, now, strict=True)) > _MOVED_DEG:
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

    async def _order(self, order: str, send: Callable[[], object]) -> None:
        self._require_no_job()
        await self.cable.ask()
        self.received.append(order)
        send()
        if order in self.denies:
            self._distrust(f"it said no to {order}, and did it")
            raise self._denied(order, "did it")
        await self.cable.ask()

    async def _belied(self, order: str, before: MountReading) -> DeviceError:
        """The error for an order that was refused, after readings as in `drivers.generic.refusals`."""
        began_s = self._clock.monotonic_s()
        free_arcsec = REAL.resting_free_arcsec(self.resolution_arcsec)
        while self._clock.monotonic_s() - began_s <= REAL.start_grace_s:
            await self.cable.ask()
            moves = self.mechanics.slewing()
            if moves or moved_arcsec(before, self._reading(), self._may_drift()) > free_arcsec:
                self._distrust(f"it said no to {order}, and moved")
                if moves:
                    await self.stop()
                self._state = SlewState.STOPPED
                return self._denied(order, "moved; stopped" if moves else "moved")
            await self._clock.sleep(_READ_BACK_S)
        return DeviceRefused(f"{order} refused", device=self._name)
