"""A night in virtual time: a simulated mount, the real navigator, a scheduler with a frame a minute."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest

from drivers.simulated.mount import SimulatedMount
from drivers.simulated.truth_camera import TruthCamera
from mountnav.catalog.embedded import embedded_catalog
from mountnav.devices import from_mount
from mountnav.frames import Frame, Hint
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import EntryKind, Journal
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.night.daylight import night_name, sun_altitude_deg
from mountnav.night.frames_in import FrameAnswer, FramesIn
from mountnav.night.memory import PARK_OVER, Remembered
from mountnav.night.parking import Preempt
from mountnav.night.placing import BySolve
from mountnav.night.rules import NightRules
from mountnav.night.session import NightSession, Recorder
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

SITE, AIR = Site(48.93, 22.27, 700.0), Air(930.0, 5.0, 0.7)
EVENING = datetime(2026, 11, 21, 18, 0, tzinfo=UTC)
ERRORS = PointingErrors(ih_arcsec=150.0, id_arcsec=-80.0)
RULES = NightRules(correct_by="sync")
POLICY = CenteringPolicy(scale_arcsec_px=2.0, settle_s=0.0)


@dataclass
class NightRig:
    """A whole night, and the truth that it may not see."""

    clock: VirtualClock
    mechanics: Mechanics
    mount: SimulatedMount
    camera: TruthCamera
    sky: SkySeen
    navigator: Navigator
    journal: MemoryJournal
    session: NightSession
    events: list[tuple[str, dict[str, object]]] = field(default_factory=list)
    frames: int = 0

    def up(self, ha_deg: float = -20.0, dec_deg: float = 30.0) -> Icrs:
        """A place that stands there now."""
        return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, self.clock.utc()), SITE, AIR)

    async def exposed(self, exposure_s: float = 20.0) -> Frame:
        """A frame of the scheduler's; the night reads the mount meanwhile, as its runner does."""
        await self.session.read_mount()
        frame = await self.camera.expose(exposure_s)
        await self.session.read_mount()
        self.frames += 1
        return frame

    async def sent(self, frame: Frame, *, name: str | None = None, **how: Any) -> FrameAnswer:
        """The frame as it comes to the night."""
        name = name or frame.source
        digest = hashlib.sha256(name.encode()).hexdigest()
        self.session.frames.offer(name, digest, lambda: frame, self.clock.utc(), **how)
        return await self.session.take(await self.session.frames.next())

    async def minutes(self, count: int, **how: Any) -> list[FrameAnswer]:
        """So many frames, one a minute."""
        answers = []
        for _ in range(count):
            due = self.clock.utc() + timedelta(seconds=60)
            await self.session.tick()
            answers.append(await self.sent(await self.exposed(), **how))
            await self.clock.sleep(max(0.0, (due - self.clock.utc()).total_seconds()))
        return answers

    async def off_arcsec(self) -> float:
        """How far the mount's belief truly is from where the tube looks."""
        reading = await self.mount.reading()
        return separation_arcsec(self.mechanics.truth(reading.utc), from_mount(reading.place))

    def told(self) -> list[tuple[str, str]]:
        """Acts and reasons of decisions in the journal, but for frames that were left."""
        rows = [one.facts for one in self.journal.entries if one.kind is EntryKind.NIGHT]
        return [(str(one["act"]), str(one["why"])) for one in rows if one["act"] not in ("leave", PARK_OVER)]

    def wrong_syncs_arcsec(self) -> list[float]:
        """How far each place that was synced on was from the truth of that moment."""
        synced = [one for one in self.journal.commands if one.order == "sync"]
        return [
            separation_arcsec(from_mount(one.place), self.mechanics.truth(one.utc))
            for one in synced
            if one.place is not None
        ]

    def again(self, rules: NightRules, remembered: Remembered) -> None:
        """The service was restarted: a new session over the same journal."""
        self.session = make_session(self.navigator, rules, self.sky, self.clock, self.journal, remembered)


def make_session(
    navigator: Navigator,
    rules: NightRules,
    sky: SkySeen,
    clock: VirtualClock,
    journal: Journal,
    remembered: Remembered | None = None,
    recorder: Recorder | None = None,
    listen: Callable[[str, dict[str, object]], None] | None = None,
    make_way: Preempt | None = None,
) -> NightSession:
    def hint(near: Icrs | None) -> Hint:
        return Hint(center=near, radius_deg=2.0, scale_low_arcsec_px=1.9, scale_high_arcsec_px=2.1)

    return NightSession(
        navigator,
        rules,
        FramesIn(),
        BySolve(sky, hint),
        name="east",
        sun_altitude_deg=lambda utc: sun_altitude_deg(utc, SITE),
        night_name=lambda utc: night_name("east", utc, SITE),
        journal=journal,
        clock=clock,
        remembered=remembered,
        recorder=recorder,
        listen=listen,
        make_way=make_way,
    )


async def make_night(
    *,
    rules: NightRules = RULES,
    errors: PointingErrors = ERRORS,
    script: SkyScript | None = None,
    start: datetime = EVENING,
    clock: VirtualClock | None = None,
    recorder: Recorder | None = None,
    journal: Callable[[MemoryJournal], Journal] = lambda journal: journal,
    make_way: Preempt | None = None,
) -> NightRig:
    clock = clock or VirtualClock(start)
    mechanics = Mechanics(SITE, AIR, errors, slew_rate_deg_s=10.0, clock=clock)
    mount = SimulatedMount(mechanics, clock, name="mount")
    script = script or SkyScript(seed=3)
    camera = TruthCamera(mechanics, clock, script, SeenThrough())
    sky = SkySeen(script, clock, SeenThrough())
    events: list[tuple[str, dict[str, object]]] = []
    rows = MemoryJournal()
    kept = journal(rows)
    navigator = Navigator(
        equip(
            name="east",
            mount=mount,
            camera=camera,
            catalog=embedded_catalog(),
            site=SITE,
            air=AIR,
            policy=POLICY,
            listen=lambda kind, data: events.append((kind, data)),
            solve=sky,
            journal=kept,
            clock=clock,
        )
    )
    await navigator.open()
    session = make_session(
        navigator,
        rules,
        sky,
        clock,
        kept,
        recorder=recorder,
        listen=lambda kind, data: events.append((kind, data)),
        make_way=make_way,
    )
    return NightRig(clock, mechanics, mount, camera, sky, navigator, rows, session, events)


def virtually(night: Callable[[VirtualClock], Coroutine[Any, Any, Any]], start: datetime = EVENING) -> Any:
    """Run a night in virtual time."""
    clock = VirtualClock(start)
    return run_virtually(night(clock), clock)


@pytest.fixture(autouse=True)
def _iers_is_read() -> None:
    """Read what would be read first in a thread."""
    sun_altitude_deg(EVENING, SITE)
