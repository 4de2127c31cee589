"""A guarded sync over the real driver, its fake on a line in memory, and looks that show the truth."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import datetime
from itertools import count
from typing import Any, TypeVar

import numpy as np

from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.lx200.language import Lx200Language
from drivers.registry import make_fake
from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import MountReading, for_mount, from_mount
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import Entry, EntryKind
from mountnav.mount import CheckedMount
from mountnav.navigation.learned import Learned
from mountnav.navigation.reports import Look
from mountnav.navigation.sync import GuardedSync
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.pointing.limits import Limits
from mountnav.pointing.model.in_force import Expected, NoModel, Pointing
from mountnav.pointing.observation import PointingObservation
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.virtual_time import VirtualClock, for_all_modules, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.solution import IdentifiedPairs, Solution, Times, Verdict
from tests.drivers.virtual_wire import MemoryLine

SITE = Site(48.93, 22.27, 700.0)
AIR = Air(pressure_hpa=930.0, temperature_c=5.0, relative_humidity=0.7)
ERRORS = PointingErrors(ih_arcsec=700.0, id_arcsec=-500.0, ch_arcsec=200.0, me_arcsec=300.0, ma_arcsec=-200.0)
CAMERA_DEG = 33.0
SCALE = 2.34
T = TypeVar("T")


def no_pairs() -> IdentifiedPairs:
    none = np.zeros(0)
    whole = np.zeros(0, dtype=np.int64)
    used = np.zeros(0, dtype=np.bool_)
    return IdentifiedPairs(
        none, none, none, none, none, none, none, none, none, none, none, whole, used, none
    )


def solution_at(
    place: Icrs,
    rotation_deg: float,
    *,
    scale_arcsec_px: float = SCALE,
    parity: int = 1,
    pairs: int = 40,
    false_probability: float = 1e-30,
    wcs: dict[str, Any] | None = None,
    center_sigma_arcsec: float = 0.2,
) -> Solution:
    return Solution(
        center=place,
        center_sigma_arcsec=center_sigma_arcsec,
        scale_arcsec_px=scale_arcsec_px,
        rotation_deg=rotation_deg % 360.0,
        parity=parity,
        rms_arcsec=0.5,
        pairs=pairs,
        rejected=0,
        false_probability=false_probability,
        mode="full/cubic",
        wcs=wcs or {},
        center_covariance_arcsec2=np.eye(2) * 0.04,
        identified=no_pairs(),
    )


def look_of(
    seen: Icrs, before: MountReading, after: MountReading, utc: datetime, solution: Solution, look_id: str
) -> Look:
    first, last = from_mount(before.place), from_mount(after.place)
    way = offset_arcsec(last, first)
    believed = displaced(first, way.east_arcsec / 2, way.north_arcsec / 2)
    return Look(
        look_id=look_id,
        verdict=Verdict(solution, None, "", solution.pairs, Times()),
        solution=solution,
        seen=seen,
        believed=believed,
        offset=offset_arcsec(seen, believed),
        before=before,
        after=after,
        mid_exposure_utc=utc,
    )


class HeardPointing(NoModel):
    """No model, and a memory of what it was told."""

    def __init__(self) -> None:
        super().__init__()
        self.looks: list[PointingObservation] = []
        self.segments: list[tuple[str, PointingObservation | None]] = []

    def observed(self, observation: PointingObservation) -> None:
        self.looks.append(observation)
        super().observed(observation)

    def new_segment(self, segment_id: str, synced: PointingObservation | None) -> None:
        self.segments.append((segment_id, synced))
        super().new_segment(segment_id, synced)


class SureModel(NoModel):
    """A model that knows what to expect."""

    model_id = "sure"

    def __init__(self, expected: Expected) -> None:
        super().__init__()
        self._expected = expected

    def expected(self, *_: object) -> Expected:
        return self._expected


class SyncRig:
    """All of it, and the truth that the guarded sync may not see."""

    def __init__(self, clock: VirtualClock, given: dict[str, Any]) -> None:
        self.clock = clock
        self.mechanics = Mechanics(
            SITE,
            AIR,
            given.get("errors", ERRORS),
            machine=given.get("machine", Machine(mounting="german", slew_rate_deg_s=8.0)),
            clock=clock,
        )
        self.fake = make_fake(
            "lx200", given.get("dialect", "onstep"), self.mechanics, clock=clock, monotonic=clock.monotonic
        )
        log = WireLog(monotonic=clock.monotonic)
        self.line = MemoryLine(self.fake, clock, log)
        self.driver = GenericMount(
            Lx200Language(Link(self.line, Patience(), log)), timing=Timing(), site=SITE
        )
        self.journal = given.get("journal") or MemoryJournal()
        self.mount = CheckedMount(
            self.driver,
            telescope="rig",
            limits=Limits(5.0),
            site=SITE,
            air=AIR,
            journal=self.journal,
            clock=clock,
        )
        self.policy: SyncPolicy = given.get("policy", SyncPolicy(confirm=False))
        self.pointing: Pointing = given.get("pointing") or HeardPointing()
        self.learned: Learned = given.get("learned") or Learned(mounting="german", policy=self.policy)
        self.events: list[tuple[str, dict[str, object]]] = []
        self.guard = GuardedSync(
            self.mount,
            telescope="rig",
            policy=self.policy,
            learned=self.learned,
            pointing=self.pointing,
            journal=self.journal,
            clock=clock,
            listen=lambda kind, data: self.events.append((kind, data)),
        )
        self._numbers = count(1)

    # -- what is done ------------------------------------------------------------------------------

    def up(self, ha_deg: float = 20.0, dec_deg: float = 30.0) -> Icrs:
        """A place that stands there now."""
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, self.clock.utc()), SITE, AIR)

    async def slew(self, place: Icrs) -> None:
        await self.mount.slew(for_mount(place, self.mount.epoch, self.clock.utc()))
        await self.clock.sleep(2.0)

    async def look(
        self, *, wrong: tuple[float, float] | None = None, turned_deg: float = 0.0, **solved: Any
    ) -> Look:
        """Expose and solve; `wrong` moves the solved place by so many arcseconds east and north."""
        before = await self.mount.reading()
        await self.clock.sleep(1.0)
        utc = self.clock.utc()
        seen = self.mechanics.truth(utc)
        if wrong is not None:
            seen = displaced(seen, *wrong)
        rotation_deg = self.mechanics.tube_angle_deg(utc) + CAMERA_DEG + turned_deg
        await self.clock.sleep(1.0)
        after = await self.mount.reading()
        look_id = f"look-{next(self._numbers)}"
        return look_of(seen, before, after, utc, solution_at(seen, rotation_deg, **solved), look_id)

    async def taught(self, looks: int = 4) -> None:
        for _ in range(looks):
            await self.guard.learn(await self.look())

    # -- what is judged ----------------------------------------------------------------------------

    async def off_arcsec(self) -> float:
        """How far the mount's belief is from the truth."""
        reading = await self.mount.reading()
        return separation_arcsec(from_mount(reading.place), self.mechanics.truth(reading.utc))

    @property
    def syncs(self) -> int:
        """How many went over the wire."""
        return sum(command.startswith(b":CM") for command in self.fake.obeyed)

    def notes(self, kind: EntryKind) -> list[Entry]:
        return [entry for entry in self.journal.entries if entry.kind is kind]

    def decisions(self) -> list[Entry]:
        """Those on syncs."""
        return [entry for entry in self.notes(EntryKind.DECISION) if entry.what.startswith("sync")]

    def told(self, kind: str) -> list[dict[str, object]]:
        return [data for what, data in self.events if what == kind]


def rigged(work: Callable[[SyncRig], Awaitable[T]], **given: Any) -> T:
    """Run a test's work over a rig, in virtual time; `start` is when it begins."""
    clock = VirtualClock(**({"start": given.pop("start")} if "start" in given else {}))

    async def whole() -> T:
        rig = SyncRig(clock, given)
        await rig.mount.open()
        try:
            return await work(rig)
        finally:
            await rig.mount.close()

    with for_all_modules(clock):
        return run_virtually(whole(), clock)
