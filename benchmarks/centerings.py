"""A thousand centerings over random observatories, judged by the truth that only the simulator knows.

Run: python -m benchmarks.centerings [--centerings 1000] [--wired 100] [--first N] [--seeds 17 23]
     [--latitudes 0 -75] [--verbose]

Each seed is an observatory (mount, errors, backlash, steps, what it does with syncs, clouds, false
solutions, incidents) with four targets one after the other; `--wired` of the centerings go through the real
drivers, over lines in memory. A centering is right when the tube truly looks at the target within the
tolerance and the service says so; or when the sky, the limits or the mount don't allow it, and the service
says that. What passes (a cloud, an unplugged cable) is waited for and ordered again, as an operator does. The
exit code is 1 when fewer than 99.9 % of those that physics allows were centered, when anything was said
wrongly, when a sync was sent on a place where the tube didn't look, or when the tube was ever beyond a limit.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import random
import sys
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from itertools import cycle
from typing import Any, cast

from benchmarks.incidents import run_incidents
from benchmarks.judging import (
    Place,
    Violation,
    can_look_at,
    hour_angle_deg,
    standing,
    violations,
    way_is_clear,
    wrong_syncs,
)
from benchmarks.worlds import (
    AIR,
    WIRES,
    Observatory,
    ShiftedClock,
    World,
    built,
    drawn,
    met_again,
    put_right_by_hand,
    target,
)
from mountnav.catalog.stars import Catalog
from mountnav.devices import PierSide
from mountnav.errors import (
    DeviceError,
    DeviceRefused,
    MountMoved,
    MountnavError,
    NotReached,
    OutsideLimits,
    SolveFailed,
    SyncDoubt,
    SyncIgnored,
    SyncRefused,
    TargetNotReached,
)
from mountnav.journal.memory import MemoryJournal
from mountnav.mount.pier_side import SideUnproven
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy, CorrectBy
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.virtual_time import VirtualClock, VirtualLoop, for_all_modules
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec

TARGETS = 4
LONGEST_S = 900.0
TRIES = 4
WAYS = 3
"""So many ways out are followed, one named by the refusal of the other, before they count as a dead end."""
WANTED = 0.999
_TOLD_EVERY = 50
"""After so many observatories it is told how it stands."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One centering.

    Attributes
    ----------
    seed, number : int
    wire : str or None
    result : str
        "centered", "centered later", "refused rightly", "FAILED".
    why : str
        What was said, with what truth says to it.
    """

    seed: int
    number: int
    wire: str | None
    result: str
    why: str
    looks: int = 0
    took_s: float = 0.0


@dataclass
class Outcome:
    """What one observatory came to."""

    trials: list[Trial] = field(default_factory=list)
    wrong_syncs: list[str] = field(default_factory=list)
    beyond: list[str] = field(default_factory=list)
    unclosed: list[str] = field(default_factory=list)
    syncs: int = 0
    false_frames: int = 0
    hours: float = 0.0


def navigator(made: Observatory, journal: MemoryJournal, events: list[tuple[str, Any]]) -> Navigator:
    world = made.world
    policy = CenteringPolicy(
        exposure_s=5.0,
        tolerance_arcsec=world.tolerance_arcsec,
        max_tries=10,
        timeout_s=LONGEST_S,
        settle_s=1.0,
        search_radius_deg=2.0,
        scale_arcsec_px=world.configured_scale_arcsec_px,
        scale_tolerance=0.05,
        correct_by=CorrectBy(world.correct_by),
    )
    return Navigator(
        equip(
            name=f"seed {world.seed}",
            mount=made.mount,
            camera=made.camera,
            catalog=cast("Catalog", None),  # the solver brings its own
            site=world.service_site,
            air=AIR,
            policy=policy,
            listen=lambda kind, data: events.append((kind, data)),
            solve=made.solve,
            limits=world.limits,
            sync=SyncPolicy(),
            journal=journal,
            clock=ShiftedClock(made.clock, world.service_clock_off_s),
            mounting=world.machine.mounting,
        )
    )


@dataclass
class Run:
    """An observatory that runs, with the service that is in charge of it."""

    made: Observatory
    service: Navigator
    journal: MemoryJournal
    events: list[tuple[str, Any]]

    async def look_at_the_tube(self) -> None:
        """See on which side of the pier it hangs, set it, and start the service again."""
        await self.service.close()
        self.made.world = replace(self.made.world, sides_stated=True)
        if self.made.world.wire is not None:
            met_again(self.made)
        else:
            self.made.mount.sides_stated = True
        self.service = navigator(self.made, self.journal, self.events)
        self.service.guard.restore(self.journal.entries)
        await self.service.open()


def lived(
    seed: int,
    wire: str | None = None,
    targets: int = TARGETS,
    verbose: bool = False,
    latitude_deg: float | None = None,
) -> Outcome:
    """Let an observatory center its targets, in virtual time."""
    world = drawn(seed, wire=wire, latitude_deg=latitude_deg)
    clock = VirtualClock(world.start)
    outcome = Outcome()
    loop = VirtualLoop(clock)
    ours = ShiftedClock(clock, world.service_clock_off_s)
    patched = for_all_modules(ours) if wire is not None else contextlib.nullcontext()
    with patched:
        try:
            loop.run_until_complete(_life(world, clock, outcome, targets, verbose))
        finally:
            loop.close()
    return outcome


async def _life(world: World, clock: VirtualClock, outcome: Outcome, targets: int, verbose: bool) -> None:
    import asyncio

    made = built(world, clock)
    journal, events = MemoryJournal(), list[tuple[str, Any]]()
    run = Run(made, navigator(made, journal, events), journal, events)
    chance = random.Random(f"targets {world.seed}")
    await run.service.open()
    if world.wire == "skywatcher":
        # bare motors know nothing when they are switched on; whoever does so at home says it
        run.service.trust()
    happening = asyncio.ensure_future(_incidents(made))
    try:
        for number in range(targets):
            await clock.sleep(chance.uniform(0.0, 240.0))
            place = target(world, clock.utc(), chance)
            if verbose:
                events.clear()
            trial, since = await _centered(run, place, number)
            outcome.trials.append(trial)
            _judge(made, since, number, outcome)
            if verbose:
                _tell(trial, events, clock)
    finally:
        happening.cancel()
        await run.service.close()
    outcome.unclosed += [f"{one.order} of {one.utc:%H:%M:%S}" for one in journal.in_flight]
    outcome.syncs = len(made.syncs)
    outcome.false_frames = len(made.solve.false_frames)
    outcome.hours = (clock.utc() - world.start) / timedelta(hours=1)


async def _incidents(made: Observatory) -> None:
    if made.line is None:
        await run_incidents(made.world.script, made.mount, made.clock)
        return
    for incident in made.world.script.incidents:
        await made.clock.sleep(60.0 * incident.at_min)
        if incident.what == "unplug":
            made.line.unplug(incident.for_s)
        else:
            made.line.silence(incident.for_s)


def _judge(made: Observatory, since: datetime, number: int, outcome: Outcome) -> None:
    seed = made.world.seed
    for utc, off_arcsec in wrong_syncs(made, since):
        outcome.wrong_syncs.append(f"seed {seed} #{number}: {off_arcsec:.0f}″ off at {utc:%H:%M:%S}")
    found: list[Violation] = violations(made, since, made.clock.utc())
    for one in found:
        outcome.beyond.append(f"seed {seed} #{number}: {one.what} by {one.by_deg:.2f}° at {one.utc:%H:%M:%S}")


async def _centered(run: Run, place: Icrs, number: int) -> tuple[Trial, datetime]:
    """Order a centering, and again when what stood against it has passed; judge what is said each time."""
    made = run.made
    world, clock = made.world, made.clock
    began = clock.utc()

    def trial(result: str, why: str, looks: int = 0) -> tuple[Trial, datetime]:
        took_s = (clock.utc() - began).total_seconds()
        where = f"δ {place.dec_deg:+.1f}° h {hour_angle_deg(world, place, began):+.0f}°"
        return Trial(world.seed, number, world.wire, result, f"{where}: {why}", looks, took_s), began

    said = ""
    for attempt in range(1, TRIES + 1):
        ordered = clock.utc()
        stands = standing(world, place, ordered, LONGEST_S + 300.0)
        clear = way_is_clear(made, place)
        try:
            report = await run.service.center(place)
        except MountnavError as error:
            said = f"{type(error).__name__}: {error.what}"
            allowed = _allowed(made, run.service, error, place, stands, clear, ordered)
            if allowed is None:
                return trial("FAILED", f"said without a cause (try {attempt}): {said}")
            if allowed == "for good":
                return trial("refused rightly", said)
            if allowed == "look":
                await run.look_at_the_tube()
                continue
            if allowed == "home" and not await _homed(run.service):
                return trial("FAILED", f"can't be homed: {said}")
            if allowed == "as named":
                led = await _done_as_named(run, error)
                if led is not None and not _causes(made, ordered) & {"cloud", "mount", "poor"}:
                    return trial("FAILED", f"the way out led nowhere: {said} → {led}")
            await clock.sleep(_until_over_s(made))
            continue
        except Exception as error:  # a proof counts crashes too
            return trial("FAILED", f"crashed: {type(error).__name__}: {error}")
        off_arcsec = separation_arcsec(made.mechanics.truth(), place)
        sigma = report.error_sigma_arcsec
        room = 4.0 * sigma + 3.0 + 0.3 * world.errors.periodic_amplitude_arcsec
        if off_arcsec > max(report.tolerance_arcsec, world.tolerance_arcsec) + room:
            return trial("FAILED", f"said centered, and is {off_arcsec:.0f}″ off", len(report.tries))
        if stands is Place.OUTSIDE:
            return trial("FAILED", "went to a target outside the limits", len(report.tries))
        return trial("centered" if attempt == 1 else "centered later", said, len(report.tries))
    return trial("FAILED", f"not in {TRIES} tries, at last {said}")


def _allowed(
    made: Observatory,
    service: Navigator,
    error: MountnavError,
    place: Icrs,
    stands: Place,
    clear: bool,
    since: datetime,
) -> str | None:
    """Whether it is true: "for good", "for now", "home", "look" (at the tube), "as named"; None: no."""
    unproven = isinstance(error, OutsideLimits) and "nothing has shown yet" in (error.advice or "")
    if unproven or isinstance(error, SideUnproven):
        return None if made.world.sides_stated else "look"
    if isinstance(error, OutsideLimits):
        return "for good" if stands is not Place.INSIDE or not clear else None
    causes = _causes(made, since)
    trusted = made.mount.trusted and service.mount.trusted
    deaf = made.world.sync_behavior in ("ignore", "refuse")
    if deaf and not trusted and isinstance(error, SyncIgnored | DeviceRefused):
        # it lost its place and can't be told any: only an operator's word helps
        return "for good"
    if isinstance(error, DeviceRefused | DeviceError) and causes & {"mount"}:
        return "for now"
    if not trusted and isinstance(error, SyncRefused) and SyncDoubt.WRONG_SIDE in error.doubts:
        # a German mount that lost its place: what tells in which posture it stands is named
        return "home" if made.world.machine.home_sensor else "as named"
    if not trusted and _wrong_posture(made):
        # it woke up believing the other side of the pier: no sync tells it, somebody has to turn it
        return "home" if made.world.machine.home_sensor else "for good"
    if not trusted and abs(made.mechanics.true_hour_angle().dec_deg) > 85.0:
        # near the pole a frame doesn't tell the hour angle
        return "home" if made.world.machine.home_sensor else "for good"
    if isinstance(error, TargetNotReached) and not can_look_at(made, place):
        return "for good"
    if isinstance(error, TargetNotReached) and error.reason is NotReached.POLE:
        return None
    if isinstance(error, SolveFailed | TargetNotReached | MountMoved | SyncRefused):
        if causes & {"poor"}:
            return "for good"
        if causes & {"cloud", "mount"}:
            return "for now"
    if isinstance(error, DeviceRefused) and stands is not Place.INSIDE:
        return "for good"
    return None


async def _homed(service: Navigator) -> bool:
    """What an operator does with a mount that has lost its place and has a sensor at its home."""
    try:
        await service.home()
        await service.set_tracking(True)
    except MountnavError:
        return False
    return True


async def _done_as_named(run: Run, error: MountnavError) -> str | None:
    """Do what a refusal names, and the refusal of that; None if it led on, else what was said last."""
    for _ in range(WAYS):
        text = str(error)
        by_hand = "by hand" in text and "say trust" in text
        try:
            if by_hand:
                put_right_by_hand(run.made)
                run.service.trust()
            if "order first light" in text:
                await run.service.first_light()
            elif not by_hand:
                break
        except MountnavError as another:
            error = another
            continue
        return None
    return str(error)


def _wrong_posture(made: Observatory) -> bool:
    """Whether a German mount takes its tube to hang on the other side than it does."""
    believed = made.mechanics.pier_side()
    beyond = abs(half_turn_deg(made.mechanics.true_axes()[1])) > 90.0
    return believed is not PierSide.UNKNOWN and (believed is PierSide.WEST) is not beyond


def _causes(made: Observatory, since: datetime) -> set[str]:
    """What went on in the simulated world between `since` and now."""
    world, script = made.world, made.world.script
    first = (since - world.start).total_seconds() / 60.0
    last = (made.clock.utc() - world.start).total_seconds() / 60.0
    causes = set()
    if any(cloud.from_min < last and cloud.to_min > first for cloud in script.clouds):
        causes.add("cloud")
    if any(
        incident.at_min < last and incident.at_min + incident.for_s / 60.0 + 1.0 > first
        for incident in script.incidents
    ):
        causes.add("mount")
    if made.solve.poor_at(made.mechanics.truth()):
        causes.add("poor")
    return causes


def _until_over_s(made: Observatory) -> float:
    script: SkyScript = made.world.script
    now = (made.clock.utc() - made.world.start).total_seconds() / 60.0
    ends = [one.at_min + one.for_s / 60.0 for one in script.incidents if one.at_min <= now]
    return 60.0 * max(script.clear_from(now), *ends, now) - 60.0 * now + 20.0


def _tell(trial: Trial, events: list[tuple[str, Any]], clock: VirtualClock) -> None:
    print(f"  #{trial.number} {trial.result} after {trial.took_s:.0f} s: {trial.why}")
    for kind, data in events:
        facts = {key: value for key, value in data.items() if isinstance(value, int | float | str | bool)}
        print(f"      {kind:16} {str(facts)[:200]}")


def report(outcomes: Iterable[Outcome], took_s: float) -> bool:
    """Print the table and all that was wrong; whether it is good enough."""
    outcomes = list(outcomes)
    trials = [trial for outcome in outcomes for trial in outcome.trials]
    counts: Counter[tuple[str, str]] = Counter()
    for trial in trials:
        counts["wired" if trial.wire else "simulated", trial.result] += 1
    results = ("centered", "centered later", "refused rightly", "FAILED")
    print(f"{'':12}" + "".join(f"{result:>17}" for result in results))
    for kind in ("simulated", "wired"):
        print(f"{kind:12}" + "".join(f"{counts[kind, result]:17d}" for result in results))
    failed = [trial for trial in trials if trial.result == "FAILED"]
    possible = [trial for trial in trials if trial.result != "refused rightly"]
    reached = len(possible) - len(failed)
    share = reached / len(possible) if possible else 1.0
    looks = sorted(trial.looks for trial in trials if trial.looks)
    if looks:
        print(f"looks: median {looks[len(looks) // 2]}, most {looks[-1]}")
    syncs = sum(outcome.syncs for outcome in outcomes)
    false = sum(outcome.false_frames for outcome in outcomes)
    hours = sum(outcome.hours for outcome in outcomes)
    print(f"{syncs} syncs sent, {false} frames solved wrongly, {hours:.0f} h of sky in {took_s:.0f} s")
    wrong = [one for outcome in outcomes for one in outcome.wrong_syncs]
    beyond = [one for outcome in outcomes for one in outcome.beyond]
    unclosed = [one for outcome in outcomes for one in outcome.unclosed]
    for trial in failed:
        wired = f" --wire {trial.wire}" if trial.wire else ""
        print(f"FAILED seed {trial.seed}{wired} #{trial.number}: {trial.why}")
    for what, found in (("WRONG SYNC", wrong), ("BEYOND A LIMIT", beyond), ("NOT CLOSED", unclosed)):
        for one in found:
            print(f"{what} {one}")
    print(
        f"{reached} of {len(possible)} that physics allows centered ({share:.2%}); {len(wrong)} wrong syncs, "
        f"{len(beyond)} limit violations, {len(unclosed)} commands not closed"
    )
    return share >= WANTED and not (wrong or beyond or unclosed)


def seed_of_the_day() -> int:
    """Seeds that change: what a benchmark has been made to pass isn't all that it is asked."""
    return 1_000_000 * int(datetime.now(UTC).strftime("%j")) + 10_000 * (datetime.now(UTC).year % 100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--centerings", type=int, default=1000)
    parser.add_argument("--wired", type=int, default=100)
    parser.add_argument("--first", type=int, help="the first seed; of the day if left out")
    parser.add_argument("--seeds", type=int, nargs="*")
    parser.add_argument("--wire", choices=WIRES)
    parser.add_argument(
        "--latitudes", type=float, nargs="*", default=[], help="degrees, one seed after the other; else drawn"
    )
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    began = time.monotonic()
    runs: list[tuple[int, str | None]]
    first = asked.first if asked.first is not None else seed_of_the_day()
    if asked.seeds:
        runs = [(seed, asked.wire) for seed in asked.seeds]
    else:
        wired = asked.wired // TARGETS
        free = asked.centerings // TARGETS - wired
        print(f"seeds from {first}")
        runs = [(first + number, None) for number in range(free)]
        runs += [(first + 100_000 + number, WIRES[number % len(WIRES)]) for number in range(wired)]
    outcomes = []
    latitudes = cycle(asked.latitudes or [None])
    for (seed, wire), latitude_deg in zip(runs, latitudes, strict=False):
        if asked.verbose:
            print(f"seed {seed}: {drawn(seed, wire=wire, latitude_deg=latitude_deg)}")
        outcomes.append(lived(seed, wire, verbose=asked.verbose, latitude_deg=latitude_deg))
        if len(outcomes) % _TOLD_EVERY == 0:
            # a run that is broken off counts as far as it came
            report(outcomes, time.monotonic() - began)
            print(flush=True)
    return 0 if report(outcomes, time.monotonic() - began) else 1


if __name__ == "__main__":
    sys.exit(main())
