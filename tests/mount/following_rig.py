"""A simulated mount that takes rates and moves axes, if its driver can't yet; and faults on its wire."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from mountnav.devices import STARS_RATES, MountAxis, OffsetRates, RateSpan, Skill
from mountnav.errors import DeviceRefused, DeviceSilent
from mountnav.journal.memory import MemoryJournal
from mountnav.mount import CheckedMount, FollowingPolicy, SelfActing
from mountnav.pointing.limits import Limits, Mounting
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from tests.mount.mount_rig import AIR, LIMITS, NIGHT, SITE, Rig

SPANS = (RateSpan(0.001, 4.0),)


class FollowingMount(SimulatedMount):
    """Takes rates beside the sidereal one and moves axes: straight to the mechanics, nothing kept back.

    Attributes
    ----------
    fails : set of str
        Orders that fail now: "rates", "end-rates", "axis", "end-axis" are not answered, "deaf-rates" accepts
        their end and keeps them.
    slow_s : float
        How long the end of rates takes.
    """

    most: OffsetRates | None = OffsetRates(10_000.0, 10_000.0)
    slow_s = 0.0

    def __init__(self, *args: object, **kwargs: object) -> None:
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]
        self.fails: set[str] = set()
        self.ordered: list[tuple[str, float, float]] = []

    @property
    def skills(self) -> frozenset[Skill]:
        return super().skills | {Skill.OFFSET_RATES, Skill.MOVE_AXIS}

    @property
    def most_offset_arcsec_s(self) -> OffsetRates | None:
        return self.most

    async def set_offset_rates(self, rates: OffsetRates) -> None:
        await self.cable.ask()
        self.ordered.append(("rates", rates.ra_arcsec_s, rates.dec_arcsec_s))
        self._rates = None
        if rates.none:
            await self._clock.sleep(self.slow_s)
        if ("end-rates" if rates.none else "rates") in self.fails:
            raise DeviceSilent("no answer", device=self.name)
        if "refuse-rates" in self.fails:
            raise DeviceRefused("no", device=self.name)
        if not (rates.none and "deaf-rates" in self.fails):
            self.mechanics.track_beside(rates.ra_arcsec_s, rates.dec_arcsec_s)
        await self.cable.ask()
        self._rates = rates

    async def offset_rates(self) -> OffsetRates | None:
        await self.cable.ask()
        return OffsetRates(*self.mechanics.beside_arcsec_s)

    @property
    def axis_rates_deg_s(self) -> Mapping[MountAxis, tuple[RateSpan, ...]]:
        return {"primary": SPANS, "secondary": SPANS}

    async def move_axis(self, axis: MountAxis, rate_deg_s: float) -> None:
        await self.cable.ask()
        self.ordered.append((axis, rate_deg_s, 0.0))
        if ("end-axis" if rate_deg_s == 0.0 else "axis") in self.fails:
            raise DeviceSilent("no answer", device=self.name)
        plus, minus = ("e", "w") if axis == "primary" else ("n", "s")
        if rate_deg_s == 0.0:
            if "deaf-axis" not in self.fails:
                self.mechanics.stop_move(plus)  # type: ignore[arg-type]
        else:
            self.mechanics.move(plus if rate_deg_s > 0.0 else minus, abs(rate_deg_s))  # type: ignore[arg-type]


@dataclass
class Guarded:
    """A guard that only keeps what it is told."""

    told: list[str] = field(default_factory=list)
    until_utc: datetime | None = None
    missing: bool = False

    def arm(self, until_utc: datetime, what: Collection[SelfActing]) -> None:
        if self.missing:
            raise DeviceRefused("there is no guard")
        self.told.append("arm")
        self.until_utc = until_utc

    def disarm(self) -> None:
        self.told.append("disarm")
        self.until_utc = None

    def take_over(self) -> None:
        self.told.append("take over")


@dataclass
class FollowingRig(Rig):
    """A rig whose mount follows what moves."""

    guard: Guarded = field(default_factory=Guarded)

    @property
    def beside(self) -> tuple[float, float]:
        """What the mechanics truly track at, beside the sidereal rate."""
        return self.mechanics.beside_arcsec_s if self.mechanics.tracking else (0.0, 0.0)

    @property
    def following(self) -> FollowingMount:
        assert isinstance(self.driver, FollowingMount)
        return self.driver


def run_following(
    work: Callable[[FollowingRig], Awaitable[None]],
    *,
    limits: Limits = LIMITS,
    machine: Machine | None = None,
    behavior: MountBehavior | None = None,
    mounting: Mounting | None = None,
    policy: FollowingPolicy | None = None,
    utc: datetime = NIGHT,
    trusted: bool = True,
    native: bool = False,
) -> FollowingRig:
    """Do something with such a rig, in time that jumps; `native`: with the driver's own rates and axes."""
    clock = VirtualClock(utc)
    mechanics = Mechanics(SITE, AIR, PointingErrors(), machine=machine or Machine(), clock=clock)
    made = SimulatedMount if native else FollowingMount
    driver = made(mechanics, clock, behavior, trusted=trusted)
    journal, guard = MemoryJournal(), Guarded()
    mount = CheckedMount(
        driver,
        telescope="t",
        limits=limits,
        site=SITE,
        air=AIR,
        journal=journal,
        clock=clock,
        mounting=mounting,
        following=policy,
        dead_man=guard,
    )
    rig = FollowingRig(clock, mechanics, driver, mount, journal, guard=guard)
    mount.listen(lambda what, facts: rig.told.append((what, dict(facts))))

    async def all_of_it() -> None:
        await mount.open()
        try:
            await work(rig)
        finally:
            with contextlib.suppress(DeviceSilent):
                await mount.close()

    run_virtually(all_of_it(), clock)
    return rig


__all__ = ["STARS_RATES", "UTC", "FollowingMount", "FollowingRig", "run_following"]
