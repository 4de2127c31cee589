"""A mount without a wire: the face of a driver, the mechanics behind it, and what goes wrong between."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from drivers.generic.coordinates import apart_arcsec, check_kind
from drivers.generic.link_supervisor import LinkState
from drivers.simulated.behavior import MountBehavior
from drivers.simulated.link import Cable, Listener, Trouble
from mountnav.clock import Clock
from mountnav.devices import (
    Direction,
    Epoch,
    MountReading,
    PierSide,
    Skill,
    SlewOutcome,
    SlewState,
    SyncLaw,
    SyncOutcome,
    SyncResult,
    TrackingRate,
    miss_arcsec,
    moved_arcsec,
)
from mountnav.errors import BadRequest, Busy, DeviceError, DeviceRefused, Refusal, RefusedButDone
from mountnav.simulation.mechanics import Mechanics
from mountnav.simulation.posture import other_side
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, Icrs


class SimulatedState:
    """All of a `SimulatedMount` but its orders; see there."""

    def __init__(
        self,
        mechanics: Mechanics,
        clock: Clock,
        behavior: MountBehavior | None = None,
        *,
        name: str = "simulated mount",
        trusted: bool = True,
    ) -> None:
        self.mechanics = mechanics
        self.behavior = behavior or MountBehavior()
        self.received: list[str] = []
        self.denies: set[str] = set()
        self._clock = clock
        self._name = name
        self._trusted = trusted
        self._why_untrusted = "nobody has looked at the sky since it was connected"
        self._boots = mechanics.boots
        self._state = SlewState.NONE
        self._job: str | None = None
        self._stops = 0
        self._stop_owed = False
        self.sides_stated = False
        self._late: tuple[Apparent | Icrs, float] | None = None
        self.cable = Cable(name, clock, self.behavior, back=self._on_back, lost=self._on_lost)

    # -- what it is --------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._name

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates it speaks."""
        return self.behavior.epoch

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step."""
        return self.behavior.resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """Park, home, tracking and guiding; the pier side if it tells it."""
        skills = {Skill.PARK, Skill.UNPARK, Skill.HOME, Skill.TRACK, Skill.TRACKING_RATES, Skill.GUIDE}
        if self.mechanics.machine.home_sensor:
            skills.add(Skill.FIND_HOME)
        if self.behavior.tells_side and self.mechanics.machine.mounting == "german":
            skills.add(Skill.PIER_SIDE)
        if self.behavior.tells_destination and self.mechanics.machine.mounting == "german":
            skills.add(Skill.DESTINATION_SIDE)
        return frozenset(skills)

    @property
    def link(self) -> LinkState:
        """What is known of the link."""
        return self.cable.state

    @property
    def slew_state(self) -> SlewState:
        """What the last order to move has come to."""
        return self._state

    @property
    def trusted(self) -> bool:
        """Whether its own position counts."""
        self._see_reboots()
        return self._trusted

    def trust(self) -> None:
        """An operator's word that the position is right."""
        self._see_reboots()
        self._believe("the operator says so")

    def listen(self, listener: Listener) -> None:
        """Tell of what happens to the link and to the position."""
        self.cable.listeners.append(listener)

    # -- what happens to it ------------------------------------------------------------------------

    def cut(self, for_s: float, trouble: Trouble = "missing") -> None:
        """Let the link fail: the cable is unplugged ("missing"), or nothing answers ("silent")."""
        self.cable.cut(for_s, trouble)

    def reboot(self, for_s: float = 4.0) -> None:
        """Switch it off and on: it stands, forgets, and is silent for a while."""
        self.mechanics.reboot()
        self.cable.cut(for_s, "silent")
        asyncio.get_running_loop().call_later(for_s + 0.5, self._see_reboots)

    # -- reading -----------------------------------------------------------------------------------

    async def open(self) -> None:
        """Connect. Moves nothing."""
        await self.cable.open()
        self._see_reboots()
        self.cable.tell("connected", {"identity": self._name, "trusted": self._trusted, "problems": []})

    async def close(self) -> None:
        """Release the link."""
        self.cable.close()

    async def reading(self) -> MountReading:
        """Where the mount believes it points.

        Raises
        ------
        DeviceSilent, DeviceMissing
        """
        await self.cable.ask()
        self._see_reboots()
        reading = self._reading()
        self._see_a_late_sync(reading)
        return reading

    def _reading(self) -> MountReading:
        behavior, mechanics = self.behavior, self.mechanics
        utc = self._clock.utc()
        place: Apparent | Icrs = mechanics.reported(utc)
        if isinstance(place, Apparent):
            place = (
                behavior.icrs_in_steps(apparent_to_icrs(place))
                if behavior.epoch == "icrs"
                else behavior.in_steps(place)
            )
        side = mechanics.pier_side(utc) if behavior.tells_side else None
        side = None if side is None else self._as_told(side)
        if not behavior.tells_motion:
            return MountReading(place, utc, pier_side=side)
        return MountReading(
            place,
            utc,
            slewing=mechanics.slewing(utc),
            tracking=mechanics.tracking and not mechanics.at_limit,
            parked=mechanics.parked,
            at_home=mechanics.at_home,
            pier_side=side,
        )

    # -- inside ------------------------------------------------------------------------------------

    def _as_told(self, side: PierSide) -> PierSide:
        return other_side(side) if self.behavior.side_swapped else side

    def _stop_now(self) -> None:
        self.received.append("stop")
        self.mechanics.stop()

    def _require_no_job(self) -> None:
        if self._job is not None:
            raise Busy(f"a {self._job} is running", device=self._name, advice="wait for it, or stop it")

    def _require_trust(self, what: str) -> None:
        if not self._trusted:
            raise DeviceRefused(
                f"{what} refused: its position can't be trusted ({self._why_untrusted})",
                device=self._name,
                advice="order first light if it was just set up, else recover: both look at the sky; or let "
                "it find its home",
                reason=Refusal.UNTRUSTED,
            )

    def _believe(self, why: str) -> None:
        if not self._trusted:
            self._trusted = True
            self.cable.tell("trusted", {"why": why})

    def _distrust(self, why: str) -> None:
        self._why_untrusted = why
        if self._trusted:
            self._trusted = False
            self.cable.tell("untrusted", {"why": why})

    def _see_reboots(self) -> None:
        if self.mechanics.boots != self._boots:
            self._boots = self.mechanics.boots
            self._late = None
            self._distrust("it was switched off and on")

    def _went_elsewhere(self, miss_arcsec: float) -> None:
        self.cable.tell("sync-elsewhere", {"miss_arcsec": round(miss_arcsec, 1)})
        self._distrust(f"it took a sync for another place: it believes to be {miss_arcsec:.0f}″ from there")

    def _see_a_late_sync(self, reading: MountReading) -> None:
        if self._late is not None and self._job is None:
            place, near_arcsec = self._late
            miss_arcsec = apart_arcsec(reading.place, place)
            if miss_arcsec <= near_arcsec:
                self._late = None
                self.cable.tell("sync-late", {"miss_arcsec": round(miss_arcsec, 1)})
                self._believe("a sync was seen, late")

    def _on_lost(self, why: str) -> None:
        if self._job is not None:
            self._state, self._stop_owed = SlewState.LOST, True
        self._distrust("its link was lost")

    def _on_back(self) -> None:
        if self._stop_owed:
            self._stop_now()
            self._stop_owed = False
        self._see_reboots()
        if not self._trusted:
            self.cable.tell("untrusted", {"why": self._why_untrusted})


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
        law = SyncLaw.of(way_arcsec, self.resolution_arcsec, self.behavior.near_arcsec)
        began_s, told_utc = self._clock.monotonic_s(), self._clock.utc()
        while True:
            await self.cable.ask()
            self.cable.require(links)
            now, after_s = self._reading(), self._clock.monotonic_s() - began_s
            seen = law.seen(miss_arcsec(place, told_utc, now))
            if seen or after_s > self.behavior.sync_wait_s:
                break
            await self._clock.sleep(0.2)
        miss = apart_arcsec(now.place, place)
        if not seen:
            self._late = (place, law.near_arcsec)
            outcome = law.unseen(before, now)
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
        """Look after an order that was refused, as `drivers.generic.refusals` does; what is to be raised."""
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
