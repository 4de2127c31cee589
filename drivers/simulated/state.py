"""What a mount without a wire is, says and remembers; its orders stand in `rates` and `mount`."""

from __future__ import annotations

import asyncio

from drivers.generic.coordinates import apart_arcsec
from drivers.generic.link_supervisor import LinkState
from drivers.generic.refusal_words import untrusted
from drivers.generic.session import Listener
from drivers.simulated.behavior import MountBehavior
from drivers.simulated.link import Cable, Trouble
from mountnav.clock import Clock
from mountnav.devices import (
    STARS_RATES,
    Epoch,
    MountAxis,
    MountReading,
    OffsetRates,
    PierSide,
    Skill,
    SlewState,
)
from mountnav.errors import Busy, DeviceRefused, Refusal, RefusedButDone
from mountnav.simulation.mechanics import Mechanics
from mountnav.sky.chain import apparent_to_icrs
from mountnav.sky.coordinates import Apparent, Icrs


class SimulatedState:
    """All of a `SimulatedMount` except its orders; see there."""

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
        self._why_untrusted = "no look at the sky was made since it was connected"
        self._boots = mechanics.boots
        self._state = SlewState.NONE
        self._job: str | None = None
        self._stops = 0
        self._stop_owed = False
        self.sides_stated = False
        self._rates: OffsetRates | None = STARS_RATES
        self._rates_ours = False
        self._axes: dict[MountAxis, float] = {}
        self._late: tuple[Apparent | Icrs, float] | None = None
        self.cable = Cable(name, clock, self.behavior, back=self._on_back, lost=self._on_lost)

    # -- what it is --------------------------------------------------------------------------------

    @property
    def name(self) -> str:
        """Name, for messages."""
        return self._name

    @property
    def epoch(self) -> Epoch:
        """Kind of coordinates that it speaks."""
        return self.behavior.epoch

    @property
    def resolution_arcsec(self) -> float:
        """Coarsest step."""
        return self.behavior.resolution_arcsec

    @property
    def skills(self) -> frozenset[Skill]:
        """Park, home, tracking and guiding; the pier side if it reports it."""
        skills = {Skill.PARK, Skill.UNPARK, Skill.HOME, Skill.TRACK, Skill.TRACKING_RATES, Skill.GUIDE}
        if self.behavior.takes_rates:
            skills.add(Skill.OFFSET_RATES)
        if self.behavior.moves_axes:
            skills.add(Skill.MOVE_AXIS)
        if self.mechanics.machine.home_sensor:
            skills.add(Skill.FIND_HOME)
        if self.behavior.tells_side and self.mechanics.machine.mounting == "german":
            skills.add(Skill.PIER_SIDE)
        if self.behavior.tells_destination and self.mechanics.machine.mounting == "german":
            skills.add(Skill.DESTINATION_SIDE)
        return frozenset(skills)

    @property
    def link(self) -> LinkState:
        """State of the link."""
        return self.cable.state

    @property
    def slew_state(self) -> SlewState:
        """What the last order to move has come to."""
        return self._state

    @property
    def trusted(self) -> bool:
        """Whether its own position can be trusted."""
        self._see_reboots()
        return self._trusted

    def trust(self) -> None:
        """Trust the position: an operator says that it is right."""
        self._see_reboots()
        self._believe("an operator confirmed it")

    def listen(self, listener: Listener) -> None:
        """Call `listener(what, facts)` at each event of the link and of the trust in the position."""
        self.cable.listeners.append(listener)

    # -- what happens to it ------------------------------------------------------------------------

    def cut(self, for_s: float, trouble: Trouble = "missing") -> None:
        """Let the link fail: the port is gone ("missing"), or nothing answers ("silent")."""
        self.cable.cut(for_s, trouble)

    def reboot(self, for_s: float = 4.0) -> None:
        """Switch it off and on: it stops, forgets its position, and is silent for `for_s`."""
        self.mechanics.reboot()
        self.cable.cut(for_s, "silent")
        asyncio.get_running_loop().call_later(for_s + 0.5, self._see_reboots)

    # -- reading -----------------------------------------------------------------------------------

    async def open(self) -> None:
        """Connect. Moves nothing."""
        await self.cable.open()
        self._see_reboots()
        self.cable.emit("connected", {"identity": self._name, "trusted": self._trusted, "problems": []})

    async def close(self) -> None:
        """End what moves on by our order, and release the link."""
        if self.cable.state is LinkState.UP:
            if self._axes:
                self._stop_now()
            self._end_rates()
        self._axes.clear()
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
        side = None if side is None else self._as_reported(side)
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

    def _as_reported(self, side: PierSide) -> PierSide:
        return side.other if self.behavior.side_swapped else side

    def _stop_now(self) -> None:
        self.received.append("stop")
        self.mechanics.stop()

    def _require_no_job(self, *, by_hand: bool = False) -> None:
        if self._job is not None:
            raise Busy(f"a {self._job} is running", device=self._name, advice="wait for it, or stop it")
        if self._axes and not by_hand:
            raise Busy(
                f"its {' and '.join(sorted(self._axes))} axis is moved by hand",
                device=self._name,
                advice="end that, or stop it",
            )

    def _end_rates(self) -> None:
        """End the offset rates that we ordered, if any may be in force."""
        if self._rates_ours:
            self.received.append("rates")
            self.mechanics.track_beside(0.0, 0.0)
            self._rates, self._rates_ours = STARS_RATES, False

    def _may_drift(self) -> tuple[OffsetRates, ...]:
        """The rates at which it may move by itself, but those of a star."""
        told = OffsetRates(*self.mechanics.beside_arcsec_s)
        return tuple(one for one in (self._rates, told) if one is not None and not one.none)

    def _require_trust(self, what: str) -> None:
        if not self._trusted:
            raise untrusted(what, self._why_untrusted, device=self._name)

    def _believe(self, why: str) -> None:
        if not self._trusted:
            self._trusted = True
            self.cable.emit("trusted", {"why": why})

    def _distrust(self, why: str) -> None:
        self._why_untrusted = why
        if self._trusted:
            self._trusted = False
            self.cable.emit("untrusted", {"why": why})

    def _see_reboots(self) -> None:
        if self.mechanics.boots != self._boots:
            self._boots = self.mechanics.boots
            self._late = None
            self._rates = None
            self._axes.clear()
            self._distrust("it was switched off and on")

    def _went_elsewhere(self, miss_arcsec: float) -> None:
        self.cable.emit("sync-elsewhere", {"miss_arcsec": round(miss_arcsec, 1)})
        self._distrust(f"it synced to another place: it believes that it is {miss_arcsec:.0f}″ from there")

    def _see_a_late_sync(self, reading: MountReading) -> None:
        if self._late is not None and self._job is None:
            place, near_arcsec = self._late
            miss_arcsec = apart_arcsec(reading.place, place)
            if miss_arcsec <= near_arcsec:
                self._late = None
                self.cable.emit("sync-late", {"miss_arcsec": round(miss_arcsec, 1)})
                self._believe("a sync was seen, late")

    def _on_lost(self, why: str) -> None:
        if self._job is not None or self._axes:
            self._state, self._stop_owed = SlewState.LOST, True
        self._axes.clear()
        self._rates = None
        self._distrust("its link was lost")

    def _on_back(self) -> None:
        if self._stop_owed:
            self._stop_now()
            self._stop_owed = False
        self._end_rates()
        self._see_reboots()
        if not self._trusted:
            self.cable.emit("untrusted", {"why": self._why_untrusted})

    def _require_skill(self, skill: Skill) -> None:
        if skill not in self.skills:
            raise DeviceRefused(
                f"it can't: {skill.replace('-', ' ')}", device=self._name, reason=Refusal.UNSUPPORTED
            )

    def _denied(self, order: str, what: str) -> RefusedButDone:
        said = f"{order}: said refused, but {what}"
        self.cable.emit("refused-but-done", {"order": order, "why": said})
        return RefusedButDone(
            said, device=self._name, advice="its position is not trusted: solve a frame and sync (recover)"
        )
