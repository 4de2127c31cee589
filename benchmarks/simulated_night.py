"""A ten-hour night at high speed, alone: targets centered and followed through clouds, reboots and a cable.

Run: python -m benchmarks.simulated_night [--hours 10] [--script FILE] [--journal FILE] [--verbose]

A German mount centers a target every ten minutes (near the pole, low, across the meridian; some below the
limit) and exposes science frames, by which the night's own rules keep it there; then the next. The sky
script (simulated_night.toml) brings a front, cirrus, a satellite in every tenth frame, wrong solutions, two
reboots, an unplugged cable and a silence. Time jumps; everything else is what a service runs: the navigator,
the night, the journal in a SQLite file. Afterwards the journal alone is asked for the story, and the truth
whether it is true. The exit code is 1 when a target that could be centered was not, when a sync was sent on a
place where the tube didn't look, when the tube was beyond a limit, when the journal misses something, or when
memory grew.
"""

from __future__ import annotations

import argparse
import asyncio
import gc
import hashlib
import logging
import random
import sys
import tempfile
import time
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import cast

from api.nights.nights import NightParts, NightRunner
from benchmarks.incidents import run_incidents
from benchmarks.journal_story import untold
from benchmarks.judging import Place, standing, violations, way_is_clear, wrong_syncs
from benchmarks.worlds import AIR, Observatory, World, built, drawn
from drivers.simulated.behavior import MountBehavior
from mountnav.catalog.stars import Catalog
from mountnav.errors import MountnavError, OutsideLimits
from mountnav.frames import Frame, Hint
from mountnav.journal.records import because
from mountnav.journal.sql_journal import open_journal
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.night.placing import BySolve
from mountnav.pointing.limits import Limits
from mountnav.settings.night import NightSettings
from mountnav.simulation.mechanics import Machine, PointingErrors
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec

SCRIPT = Path(__file__).with_name("simulated_night.toml")
START = datetime(2026, 11, 21, 16, 40, tzinfo=UTC)
SITE = Site(48.93, 22.27, 700.0)
SLOT_S = 600.0
SCIENCE_S = 60.0
LONGEST_S = 420.0
GROWTH_MB = 3.0
"""What may be kept more at the end than after the first two hours: caches that are bounded, no more."""


@dataclass
class Target:
    """One target of the schedule, and what came of it."""

    name: str
    place: Icrs
    at: datetime
    stands: Place = Place.INSIDE
    clear: bool = True
    ended: datetime | None = None
    said: str = ""
    off_arcsec: float | None = None
    frames: int = 0
    worst_arcsec: float = 0.0
    excuses: frozenset[str] = frozenset()

    @property
    def centered(self) -> bool:
        """Whether the service said so, and truth agrees."""
        return self.said == "centered" and self.off_arcsec is not None and self.off_arcsec <= 40.0


@dataclass
class Night:
    """What the night came to."""

    targets: list[Target] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    memory: list[tuple[float, float, float]] = field(default_factory=list)
    """Hours, traced MB, resident MB."""
    events: Counter[str] = field(default_factory=Counter)
    syncs: int = 0
    frames: int = 0
    flips: int = 0
    false_frames: int = 0
    corrections: int = 0


def world_of(script: SkyScript) -> World:
    """The observatory of the night."""
    errors = PointingErrors(
        ih_arcsec=420.0,
        id_arcsec=-310.0,
        ch_arcsec=160.0,
        np_arcsec=45.0,
        me_arcsec=240.0,
        ma_arcsec=-190.0,
        tf_arcsec=25.0,
        backlash_arcsec=12.0,
        periodic_amplitude_arcsec=6.0,
        periodic_period_s=479.0,
    )
    machine = Machine(
        mounting="german",
        slew_rate_deg_s=3.5,
        acceleration_deg_s2=2.0,
        meridian_limits_deg=(9.0, 9.0),
        lowest_altitude_deg=5.0,
        at_limit="stop",
    )
    limits = Limits(20.0, past_meridian_deg=(12.0, 12.0), sun_cone_deg=20.0, margin_deg=0.5)
    return replace(
        drawn(1),
        seed=script.seed,
        site=SITE,
        start=START,
        machine=machine,
        errors=errors,
        behavior=MountBehavior(ra_step_arcsec=1.5, dec_step_arcsec=1.0, latency_s=0.05),
        sync_behavior="normal",
        script=script,
        limits=limits,
        tolerance_arcsec=30.0,
        correct_by="sync",
        trusted=True,
        sun_up=False,
    )


def schedule(hours: float, seed: int) -> Iterator[tuple[datetime, HourAngle, str]]:
    """When which place: most of the sky, the pole, low ones, some that no telescope may go to."""
    chance = random.Random(seed)
    for number in range(int(hours * 3600.0 / SLOT_S)):
        at = START + timedelta(seconds=number * SLOT_S + 20.0)
        if number % 15 == 11:
            yield at, HourAngle(chance.uniform(-170.0, 170.0), -38.0, at), "below"
        elif number % 10 == 4:
            yield at, HourAngle(chance.uniform(-170.0, 170.0), chance.uniform(88.0, 89.9), at), "pole"
        elif number % 7 == 3:
            # it crosses the meridian while it is exposed
            yield at, HourAngle(chance.uniform(-1.8, -1.2), chance.uniform(5.0, 60.0), at), "meridian"
        else:
            yield at, HourAngle(chance.uniform(-55.0, 55.0), chance.uniform(5.0, 75.0), at), "sky"


def night(hours: float, script: SkyScript, journal_file: Path, *, verbose: bool = False) -> Night:
    """Live through it, and judge."""
    clock = VirtualClock(START)
    found = Night()
    run_virtually(_live(hours, world_of(script), clock, journal_file, found, verbose), clock)
    return found


async def _live(
    hours: float, world: World, clock: VirtualClock, journal_file: Path, found: Night, verbose: bool
) -> None:
    made = built(world, clock)
    journal = open_journal(journal_file, inline=True, fsync="never")

    def heard(kind: str, data: dict[str, object]) -> None:
        found.events[kind] += 1
        if verbose:
            facts = {key: value for key, value in data.items() if isinstance(value, int | float | str)}
            print(f"{clock.utc():%H:%M:%S} {kind:18} {str(facts)[:170]}")

    policy = CenteringPolicy(
        exposure_s=5.0,
        tolerance_arcsec=world.tolerance_arcsec,
        max_tries=8,
        timeout_s=LONGEST_S,
        scale_arcsec_px=world.configured_scale_arcsec_px,
    )
    service = Navigator(
        equip(
            name="night",
            mount=made.mount,
            camera=made.camera,
            catalog=cast("Catalog", None),
            site=world.site,
            air=AIR,
            policy=policy,
            listen=heard,
            solve=made.solve,
            limits=world.limits,
            sync=SyncPolicy(),
            journal=journal,
            clock=clock,
            mounting="german",
        )
    )
    parts = NightParts(
        telescope_id="night",
        settings=NightSettings(
            enabled=True, correct_by="offset", correct_when_off_by_arcsec=8.0, read_mount_every_s=5.0
        ),
        navigator=service,
        site=world.site,
        catalog=cast("Catalog", None),
        solving=service.solving,
        listen=heard,
        journal=journal,
        clock=clock,
        placing=BySolve(made.solve, lambda near: None if near is None else Hint(near, 2.0)),
    )
    runner = NightRunner(parts)
    await service.open()
    await runner.start()
    happening = asyncio.ensure_future(run_incidents(world.script, made.mount, clock))
    tracemalloc.start()
    sampled = 0
    try:
        for at, place, kind in schedule(hours, world.seed):
            await clock.sleep(max(0.0, (at - clock.utc()).total_seconds()))
            icrs = hour_angle_to_icrs(place, world.site, AIR)
            target = Target(f"{kind} {len(found.targets)}", icrs, clock.utc())
            found.targets.append(target)
            await _one(made, service, runner, target, at + timedelta(seconds=SLOT_S - 30.0), found)
            _judged(made, target, found)
            if clock.utc() - START > timedelta(hours=sampled):
                sampled += 1
                found.memory.append(_memory(clock))
    finally:
        happening.cancel()
        await runner.close()
        await service.close()
        found.memory.append(_memory(clock))
        tracemalloc.stop()
        await asyncio.to_thread(journal.close)
    found.syncs, found.frames = len(made.syncs), made.camera.frames
    found.false_frames = len(made.solve.false_frames)
    found.flips, found.corrections = found.events["flipped"], found.events["night-corrected"]
    found.faults += untold(journal_file, world, found.targets, made.mount.received)


async def _one(
    made: Observatory,
    service: Navigator,
    runner: NightRunner,
    target: Target,
    until: datetime,
    found: Night,
) -> None:
    """Center a target, as a scheduler orders it, and again while there is time; then expose."""
    world, clock = made.world, made.clock
    target.stands = standing(world, target.place, clock.utc(), SLOT_S)
    target.clear = way_is_clear(made, target.place)
    causes = set()
    while (until - clock.utc()).total_seconds() > 60.0:
        left_s = (until - clock.utc()).total_seconds()
        try:
            with because(job_id=target.name, why=f"target {target.name}"):
                await service.center(target.place, timeout_s=min(LONGEST_S, left_s))
        except OutsideLimits as error:
            target.said = f"OutsideLimits: {error.what}"
            break
        except MountnavError as error:
            target.said = f"{type(error).__name__}: {error.what}"
            causes |= _causes(made, target.at)
            await clock.sleep(20.0)
            continue
        target.said = "centered"
        target.off_arcsec = separation_arcsec(made.mechanics.truth(), target.place)
        break
    target.ended = clock.utc()
    causes |= _causes(made, target.at)
    target.excuses = frozenset(causes)
    if not target.centered:
        return
    while (until - clock.utc()).total_seconds() > SCIENCE_S + 20.0:
        frame = await _exposed(made, found)
        if frame is None:
            return
        digest = hashlib.sha256(f"{frame.source} {target.name} {clock.utc()}".encode()).hexdigest()
        offered = runner.offer_frame(frame.source, digest, lambda frame=frame: frame, target=target.place)
        target.frames += 1
        await runner.result(offered.frame_id, 60.0)
        off_arcsec = separation_arcsec(made.mechanics.truth(), target.place)
        target.excuses |= _causes(made, target.at)
        target.worst_arcsec = max(target.worst_arcsec, off_arcsec)


async def _exposed(made: Observatory, found: Night) -> Frame | None:
    try:
        return await made.camera.expose(SCIENCE_S)
    except MountnavError as error:
        found.faults.append(f"a science frame failed: {error}")
        return None


def _causes(made: Observatory, since: datetime) -> set[str]:
    """What stood against a target in its slot."""
    script, start = made.world.script, made.world.start
    first = (since - start).total_seconds() / 60.0
    last = (made.clock.utc() - start).total_seconds() / 60.0
    causes = {"cloud" for cloud in script.clouds if cloud.from_min < last and cloud.to_min > first}
    for incident in script.incidents:
        if incident.at_min < last and incident.at_min + incident.for_s / 60.0 > first:
            causes.add("mount")
    return causes


def _blocked(made: Observatory, target: Target) -> bool:
    """Whether the sky or the mount left too little of a target's slot to center it in."""
    script, start = made.world.script, made.world.start
    first = (target.at - start).total_seconds() / 60.0
    free = SLOT_S / 60.0
    for cloud in script.clouds:
        if not cloud.thin:
            free -= max(0.0, min(cloud.to_min, first + 10.0) - max(cloud.from_min, first))
    for incident in script.incidents:
        if first - 0.5 < incident.at_min < first + 10.0:
            free -= incident.for_s / 60.0 + 1.0
    return free < 5.0 or made.solve.poor_at(target.place)


def _judged(made: Observatory, target: Target, found: Night) -> None:
    utc = made.clock.utc()
    for when, off in wrong_syncs(made, target.at):
        found.faults.append(f"{target.name}: a sync {off:.0f}″ beside the truth at {when:%H:%M:%S}")
    for one in violations(made, target.at, utc):
        found.faults.append(f"{target.name}: beyond the {one.what} limit by {one.by_deg:.2f}°")
    if target.said == "centered" and not target.centered:
        found.faults.append(f"{target.name}: said centered, and was {target.off_arcsec:.0f}″ off")
    if target.centered and target.stands is Place.OUTSIDE:
        found.faults.append(f"{target.name}: went outside the limits")
    allowed = target.stands is Place.INSIDE and target.clear and not _blocked(made, target)
    if allowed and not target.centered:
        found.faults.append(f"{target.name}: could have been centered, and was not: {target.said}")
    if target.worst_arcsec > 60.0 and "mount" not in target.excuses:
        found.faults.append(f"{target.name}: {target.worst_arcsec:.0f}″ off while it was exposed")


def _memory(clock: VirtualClock) -> tuple[float, float, float]:
    gc.collect()
    traced = tracemalloc.get_traced_memory()[0] / 1e6
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return (clock.utc() - START) / timedelta(hours=1), traced, pages * 4096 / 1e6


def growth_mb(found: Night) -> float:
    """Traced memory at the end over that after two hours (or the first sample of a shorter night)."""
    warm = [traced for hours, traced, _ in found.memory if hours >= 2.0] or [found.memory[0][1]]
    return found.memory[-1][1] - warm[0]


def tell(found: Night, took_s: float) -> bool:
    centered = [target for target in found.targets if target.centered]
    ends = Counter("centered" if one.centered else one.said.split(":")[0] for one in found.targets)
    print(
        f"{len(found.targets)} targets: " + ", ".join(f"{count} {end}" for end, count in ends.most_common())
    )
    for target in found.targets:
        if not target.centered:
            why = ", ".join(sorted(target.excuses)) or "none"
            print(
                f"  {target.at:%H:%M} {target.name:12} {target.stands}; in the way: {why}; {target.said[:99]}"
            )
    exposed = sum(target.frames for target in found.targets)
    worst = max((target.worst_arcsec for target in centered), default=0.0)
    print(
        f"{found.frames} frames ({exposed} of science, {found.false_frames} solved wrongly), {found.syncs} "
        f"syncs, {found.flips} flips; worst pointing while exposing {worst:.0f}″"
    )
    print(
        "memory: " + ", ".join(f"{h:.1f} h {t:.1f} MB traced {r:.0f} MB resident" for h, t, r in found.memory)
    )
    grew = growth_mb(found)
    print(f"memory grew by {grew:+.2f} MB after the warm-up; the night took {took_s:.0f} s")
    if grew > GROWTH_MB:
        found.faults.append(f"memory grew by {grew:.2f} MB")
    for fault in found.faults:
        print(f"FAULT {fault}")
    return not found.faults


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hours", type=float, default=10.0)
    parser.add_argument("--script", type=Path, default=SCRIPT)
    parser.add_argument("--journal", type=Path)
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        file = asked.journal or Path(folder) / "journal.sqlite"
        found = night(asked.hours, SkyScript.from_toml(asked.script), file, verbose=asked.verbose)
    return 0 if tell(found, time.monotonic() - began) else 1


if __name__ == "__main__":
    sys.exit(main())
