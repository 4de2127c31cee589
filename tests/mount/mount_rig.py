"""A checked mount over a simulated one, in time that jumps: what it was told, what it wrote."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import EntryKind, Outcome
from mountnav.mount import CheckedMount
from mountnav.pointing.limits import Limits, Mounting
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_apparent
from mountnav.sky.coordinates import Air, Apparent, HourAngle, Site

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(930.0, 5.0, 0.7)
NIGHT = datetime(2026, 11, 21, 22, tzinfo=UTC)
LIMITS = Limits(15.0)
Work = Callable[["Rig"], Awaitable[None]]


@dataclass
class Rig:
    """A checked mount, what it drives, and what it wrote."""

    clock: VirtualClock
    mechanics: Mechanics
    driver: SimulatedMount
    mount: CheckedMount
    journal: MemoryJournal
    told: list[tuple[str, dict[str, object]]] = field(default_factory=list)

    def place(self, ha_deg: float, dec_deg: float) -> Apparent:
        """Where this hour angle and declination are now, as the mount wants it."""
        now = self.clock.utc()
        return icrs_to_apparent(hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, now), SITE, AIR), now)

    def outcomes(self) -> list[tuple[str, Outcome | None]]:
        """All orders with their outcomes; None: not closed."""
        ends = self.journal.ends
        return [
            (one.order, ends[one.command_id].outcome if one.command_id in ends else None)
            for one in self.journal.commands
        ]

    def refusals(self) -> list[dict[str, object]]:
        """Facts of all refusals."""
        return [dict(one.facts) for one in self.journal.entries if one.kind is EntryKind.REFUSAL]

    def segments(self) -> list[str]:
        """Why segments began."""
        return [one.what for one in self.journal.entries if one.kind is EntryKind.SEGMENT]


def run(
    work: Work,
    *,
    limits: Limits = LIMITS,
    machine: Machine | None = None,
    behavior: MountBehavior | None = None,
    journal: MemoryJournal | None = None,
    mounting: Mounting | None = None,
    trusted: bool = True,
    utc: datetime = NIGHT,
) -> Rig:
    """Do something with a rig, in time that jumps."""
    clock = VirtualClock(utc)
    mechanics = Mechanics(SITE, AIR, PointingErrors(), machine=machine or Machine(), clock=clock)
    driver = SimulatedMount(mechanics, clock, behavior, trusted=trusted)
    journal = journal or MemoryJournal()
    mount = CheckedMount(
        driver,
        telescope="t",
        limits=limits,
        site=SITE,
        air=AIR,
        journal=journal,
        clock=clock,
        mounting=mounting,
    )
    rig = Rig(clock, mechanics, driver, mount, journal)
    mount.listen(lambda what, facts: rig.told.append((what, dict(facts))))

    async def all_of_it() -> None:
        await mount.open()
        try:
            await work(rig)
        finally:
            await mount.close()

    run_virtually(all_of_it(), clock)
    return rig
