"""Centerings in worse worlds: what is set up wrongly, or breaks, and whether the service does harm by it.

Run: python -m benchmarks.worse_worlds [--worlds 12] [--first N] [--only NAME ...] [--verbose]

Each scenario is laid over the random observatories of `benchmarks.centerings`. It is right when nothing is
said wrongly: a target called centered is in the middle of the frame within the tolerance, each sync is sent
on a place where the tube looks, the tube is never beyond a limit by the simulator's truth; and when a refusal
has a way out that works: what the error names is done, as an operator would, and the target is ordered
again. The seeds change from day to day unless `--first` is given; they are printed. The exit code is 1 when
anything was wrong, or a way out led nowhere.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import logging
import math
import random
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from typing import Any

from benchmarks.centerings import LONGEST_S, navigator, seed_of_the_day
from benchmarks.incidents import run_incidents
from benchmarks.judging import Place, can_look_at, standing, violations, way_is_clear, wrong_syncs
from benchmarks.worlds import (
    AIR,
    Observatory,
    ShiftedClock,
    World,
    built,
    drawn,
    met_again,
    put_right_by_hand,
    target,
)
from mountnav.errors import DeviceRefused, MountnavError, OutsideLimits, Refusal, TargetNotReached
from mountnav.journal.memory import MemoryJournal
from mountnav.simulation.sky_script import Cloud, SkyScript
from mountnav.simulation.virtual_time import VirtualClock, VirtualLoop, for_all_modules
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import HourAngle, Icrs
from mountnav.sky.sphere import separation_arcsec

TARGETS = 3
STAYS_S = 30
"""A target that is called centered is in the middle for so long at least, s, and not for a moment only."""
LOOKED_S = 12.0
"""Wind that blew so long before, s, blew while the last look was taken."""
WAYS = 6
"""So many ways out are followed, one after the other, before a target counts as lost."""
OBEYED = "-obeyed"
"""Scenarios in which the operator takes the service's word for site and time, which are wrong."""
_WIRES = ("lx200", "nexstar", "ioptron")
"""Those whose mounts have a clock and a site that can be asked for."""


def _zero_point(world: World, chance: random.Random) -> World:
    off = 5.0 * 3600.0
    turn = chance.uniform(0.0, 6.28)
    errors = replace(world.errors, ih_arcsec=off * math.cos(turn), id_arcsec=off * math.sin(turn))
    return replace(world, errors=errors, trusted=True)


def _new_telescope(world: World, chance: random.Random) -> World:
    off, turn = 3600.0 * chance.uniform(2.0, 5.0), chance.uniform(0.0, math.tau)
    errors = replace(world.errors, ih_arcsec=off * math.cos(turn), id_arcsec=off * math.sin(turn))
    machine = replace(world.machine, mounting="german")
    sync = chance.choice(("normal", "normal", "late"))
    return replace(
        world,
        errors=errors,
        machine=machine,
        trusted=True,
        sync_behavior=sync,
        sync_late_s=4.0,
    )


def _backlash(world: World, chance: random.Random) -> World:
    errors = replace(world.errors, backlash_arcsec=180.0)
    return replace(world, errors=errors)


def _script(world: World, **changes: Any) -> World:
    return replace(world, script=replace(world.script, **changes))


def _clouds(world: World, chance: random.Random) -> World:
    starts = [chance.uniform(0.0, 40.0) for _ in range(6)]
    clouds = tuple(Cloud(at, at + chance.uniform(0.5, 6.0), thin=chance.random() < 0.4) for at in starts)
    return _script(world, clouds=clouds)


def _behaving(**changes: Any) -> Callable[[World, random.Random], World]:
    def made(world: World, chance: random.Random) -> World:
        return replace(world, behavior=replace(world.behavior, **changes))

    return made


def _with(**changes: Any) -> Callable[[World, random.Random], World]:
    def made(world: World, chance: random.Random) -> World:
        given = {name: one(chance) if callable(one) else one for name, one in changes.items()}
        return replace(world, **given)

    return made


def _machine(**changes: Any) -> Callable[[World, random.Random], World]:
    def made(world: World, chance: random.Random) -> World:
        given = {name: one(chance) if callable(one) else one for name, one in changes.items()}
        return replace(world, machine=replace(world.machine, **given))

    return made


def _either(amount: float) -> Callable[[random.Random], float]:
    return lambda chance: chance.choice((-1.0, 1.0)) * amount


@dataclass(frozen=True, slots=True)
class Scenario:
    """What is worse in a world, and whether that asks for a mount whose clock and site can be read."""

    change: Callable[[World, random.Random], World]
    wired: bool = False


SCENARIOS: dict[str, Scenario] = {
    "zero-point-5deg": Scenario(_zero_point),
    "new-telescope": Scenario(_new_telescope),
    "mount-clock-10min": Scenario(_machine(clock_offset_s=_either(600.0)), wired=True),
    "mount-clock-1h": Scenario(_machine(clock_offset_s=_either(3600.0)), wired=True),
    "service-clock-10min": Scenario(_with(service_clock_off_s=_either(600.0)), wired=True),
    "service-clock-1h": Scenario(_with(service_clock_off_s=_either(3600.0)), wired=True),
    "service-longitude": Scenario(
        _with(service_longitude_off_deg=lambda chance: _either(chance.uniform(3.0, 60.0))(chance)), wired=True
    ),
    "mount-longitude": Scenario(
        _with(mount_longitude_off_deg=lambda chance: _either(chance.uniform(3.0, 60.0))(chance)), wired=True
    ),
    "service-clock-10min-obeyed": Scenario(_with(service_clock_off_s=_either(600.0)), wired=True),
    "service-clock-1h-obeyed": Scenario(_with(service_clock_off_s=_either(3600.0)), wired=True),
    "service-longitude-obeyed": Scenario(
        _with(service_longitude_off_deg=lambda chance: _either(chance.uniform(3.0, 60.0))(chance)), wired=True
    ),
    "camera-frozen": Scenario(_with(camera="frozen")),
    "camera-one-behind": Scenario(_with(camera="one-behind")),
    "camera-clock": Scenario(
        _with(camera_clock_off_s=lambda chance: _either(chance.uniform(1.0, 40.0))(chance))
    ),
    "mirror-flop": Scenario(_with(loose="flop", loose_arcsec=lambda chance: chance.uniform(60.0, 600.0))),
    "wind": Scenario(_with(loose="wind", loose_arcsec=lambda chance: chance.uniform(10.0, 90.0))),
    "cloud": Scenario(_clouds),
    "satellite": Scenario(lambda world, chance: _script(world, satellite_every=1)),
    "backlash-180": Scenario(_backlash),
    "side-swapped": Scenario(_behaving(side_swapped=True, tells_side=True)),
    "syncs-refused": Scenario(_with(sync_behavior="refuse")),
    "syncs-ignored": Scenario(_with(sync_behavior="ignore")),
    "syncs-doubled": Scenario(_with(sync_behavior="double")),
    "syncs-reversed": Scenario(_with(sync_behavior="reverse")),
    "syncs-halved": Scenario(_with(sync_behavior="half")),
}


@dataclass
class Outcome:
    """What a scenario came to over its worlds."""

    name: str
    results: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    syncs: int = 0


def lived(name: str, seed: int, outcome: Outcome, verbose: bool = False) -> None:
    """Let a world of this scenario center its targets, in virtual time."""
    scenario = SCENARIOS[name]
    chance = random.Random(f"{name.removesuffix(OBEYED)} {seed}")
    wire = chance.choice(_WIRES) if scenario.wired else None
    world = drawn(seed, wire=wire)
    # one thing is worse at a time: what else goes wrong is the ordinary benchmark's
    quiet = SkyScript(seed=seed, satellite_every=10)
    world = scenario.change(replace(world, script=quiet), chance)
    world = replace(world, tolerance_arcsec=max(world.tolerance_arcsec, world.floor_arcsec))
    clock = VirtualClock(world.start)
    ours = ShiftedClock(clock, world.service_clock_off_s)
    loop = VirtualLoop(clock)
    with for_all_modules(ours) if wire is not None else contextlib.nullcontext():
        try:
            life = Life(name, world, clock, ours, outcome, verbose)
            loop.run_until_complete(life.lived())
        finally:
            loop.close()


class Life:
    """One observatory of a scenario, and the operator who does what is named.

    Parameters
    ----------
    name : str
    world : World
    clock : VirtualClock
        The true one.
    ours : ShiftedClock
        The service's.
    outcome : Outcome
        What came of it is added.
    verbose : bool
    """

    def __init__(
        self,
        name: str,
        world: World,
        clock: VirtualClock,
        ours: ShiftedClock,
        outcome: Outcome,
        verbose: bool,
    ) -> None:
        self.name = name
        self.clock = clock
        self.ours = ours
        self.outcome = outcome
        self.verbose = verbose
        self.made = built(world, clock)
        self.journal = MemoryJournal()
        self.events: list[tuple[str, Any]] = []
        self.service = navigator(self.made, self.journal, self.events)
        self._synced_away = False

    async def lived(self) -> None:
        """Center the targets, one after the other."""
        made, clock, outcome, world = self.made, self.clock, self.outcome, self.made.world
        chance = random.Random(f"targets {self.name.removesuffix(OBEYED)} {world.seed}")
        try:
            await self.service.open()
        except MountnavError as error:
            outcome.results["refused to open"] += TARGETS
            outcome.lost.append(f"seed {world.seed}: could not be opened: {error}")
            return
        happening = (
            None if world.wire else asyncio.ensure_future(run_incidents(world.script, made.mount, clock))
        )
        try:
            for number in range(TARGETS):
                await clock.sleep(chance.uniform(0.0, 240.0))
                place = target(world, clock.utc(), chance)
                self.events.clear()
                self._synced_away = False
                since = clock.utc()
                result, why = await self._centered(place)
                self._note(number, since, result, why)
        finally:
            if happening is not None:
                happening.cancel()
            await self.service.close()
        outcome.syncs += len(made.syncs)

    def _note(self, number: int, since: datetime, result: str, why: str) -> None:
        outcome, made, clock = self.outcome, self.made, self.clock
        outcome.results[result] += 1
        where = f"{self.name} seed {made.world.seed} {made.world.wire or ''} #{number}"
        if result.startswith("WRONG"):
            outcome.wrong.append(f"{where}: {why}")
        if result == "no way out":
            outcome.lost.append(f"{where}: {why}")
        for utc, off in wrong_syncs(made, since):
            outcome.wrong.append(f"{where}: WRONG SYNC {off:.0f}″ off at {utc:%H:%M:%S}")
        for one in violations(made, since, clock.utc()):
            outcome.wrong.append(f"{where}: BEYOND {one.what} by {one.by_deg:.2f}° at {one.utc:%H:%M:%S}")
        if self.verbose:
            print(f"  {where} {result}: {why}")
            for kind, data in self.events:
                facts = {
                    key: value for key, value in data.items() if isinstance(value, int | float | str | bool)
                }
                print(f"      {kind:16} {str(facts)[:220]}")

    async def _centered(self, place: Icrs) -> tuple[str, str]:
        """Order a centering, and do what each refusal names; what came of it, in words."""
        made, clock = self.made, self.clock
        said: list[str] = []
        for attempt in range(WAYS + 1):
            world = made.world
            stands = standing(world, place, clock.utc(), LONGEST_S + 300.0)
            clear = way_is_clear(made, place)
            try:
                report = await self.service.center(place)
            except MountnavError as error:
                said.append(f"{type(error).__name__}: {error}")
                sides = isinstance(error, OutsideLimits) and "set swap_sides" in str(error)
                if sides and (done := await self._sides_stated()) is not None:
                    said.append(f"→ {done}")
                    continue
                if isinstance(error, OutsideLimits) and (stands is not Place.INSIDE or not clear):
                    return "outside", said[-1]
                if stands is not Place.INSIDE:
                    return "outside", said[-1]
                if isinstance(error, TargetNotReached) and not can_look_at(made, place):
                    # the hole at the mount's own pole
                    return "outside", said[-1]
                done = await self._way_out(error)
                if done is None:
                    return "no way out", " | ".join(said)
                said.append(f"→ {done}")
                continue
            except Exception as error:  # a proof counts crashes too
                return "WRONG", f"crashed: {type(error).__name__}: {error}"
            room = 4.0 * report.error_sigma_arcsec + 3.0 + 0.3 * world.errors.periodic_amplitude_arcsec
            room += max(report.tolerance_arcsec, world.tolerance_arcsec)
            beyond, later_s, off_arcsec = max(_beyond(made, place, room))
            if beyond > 0.0:
                what = f"said centered, and is {off_arcsec:.0f}″ off {later_s} s later"
                return "WRONG centered", f"{what}; {' | '.join(said)}"
            return ("centered" if attempt == 0 else "by the way out"), " | ".join(said)
        return "no way out", " | ".join(said)

    # -- what an operator does -----------------------------------------------------------------------

    async def _way_out(self, error: MountnavError) -> str | None:
        """Do what an error's own words name; None when they name nothing that helps."""
        try:
            return await self._done(error)
        except MountnavError as second:
            try:
                # it names another way
                done = await self._done(second)
            except MountnavError as third:
                return f"[{type(second).__name__}: {second}] [{type(third).__name__}: {third}]"
            return f"[{type(second).__name__}: {second}] {done}"

    async def _done(self, error: MountnavError) -> str | None:
        text, service, camera = str(error), self.service, self.made.camera
        if isinstance(error, DeviceRefused) and error.reason is Refusal.SITE_OR_TIME:
            return await self._site_and_time()
        if "set it at its hand control" in text:
            self.made.mechanics.set_believed_site(self.made.world.service_site)
            self.made.mechanics.set_believed_utc(self.ours.utc())
            return "set at its hand control"
        named = ("this machine" in text and "[site]" in text) or "the site's settings" in text
        if named and (done := await self._all_right()) is not None:
            return done
        if error.slug == "camera-stale":
            camera.mend()
            return "the camera was restarted"
        if "camera's clock" in text:
            camera.mend()
            return "the camera's clock was set right"
        if "set swap_sides" in text and (done := await self._sides_stated()) is not None:
            return done
        if "by way of a place that stands high" in text:
            site, utc = self.made.world.site, self.clock.utc()
            for ha_deg in (-10.0, 10.0):
                with contextlib.suppress(OutsideLimits):
                    high = HourAngle(ha_deg, 0.8 * site.latitude_deg, utc)
                    await service.slew(hour_angle_to_icrs(high, site, AIR))
                    return "by way of a high place"
        if "by hand" in text and "say trust" in text:
            put_right_by_hand(self.made)
            service.trust()
            if "order first light" in text:
                await service.first_light()
            return "put right by hand, trusted"
        if "sync it further from the pole" in text and not self._synced_away:
            self._synced_away = True
            site, utc = self.made.world.site, self.clock.utc()
            away = HourAngle(-40.0, math.copysign(50.0, site.latitude_deg), utc)
            await service.center(hour_angle_to_icrs(away, site, AIR))
            await service.sync()
            return "synced further from the pole"
        if "first light" in text or "first-light" in text:
            await service.first_light()
            return "first light"
        if isinstance(error, DeviceRefused) and error.reason is Refusal.UNTRUSTED:
            await service.recover()
            return "recovered"
        if error.retryable or "look again" in text:
            await self.clock.sleep(240.0)
            return "waited"
        if self.made.mechanics.machine.home_sensor and "home" in text:
            await service.home()
            await service.set_tracking(True)
            return "homed"
        return None

    async def _site_and_time(self) -> str:
        """Set right what is wrong: an operator knows place and time. One who obeys doesn't."""
        done = None if self.name.endswith(OBEYED) else await self._all_right()
        if done is None:
            await self.service.set_site_and_time()
            done = "the mount was set right"
        return done

    async def _all_right(self) -> str | None:
        """Set settings and clock of the service right, if they are wrong; None if they aren't."""
        world = self.made.world
        if world.service_clock_off_s == world.service_longitude_off_deg == 0.0:
            return None
        await self.service.close()
        self.made.world = replace(world, service_clock_off_s=0.0, service_longitude_off_deg=0.0)
        self.ours.set_right()
        self.made.camera.mend()
        met_again(self.made)
        await self._started_again()
        return "settings and clock were set right, and the service was started again"

    async def _sides_stated(self) -> str | None:
        """Look where the tube hangs, and set in the settings whether the mount says so."""
        mount = self.made.mount
        told = (await mount.reading()).pier_side
        if told is None or mount.sides_stated:
            return None
        swapped = told is not self.made.mechanics.pier_side()
        await self.service.close()
        self.made.world = replace(self.made.world, sides_stated=True)
        if self.made.world.wire is not None:
            met_again(self.made)
        else:
            mount.behavior = replace(mount.behavior, side_swapped=False)
            mount.sides_stated = True
        await self._started_again()
        return f"swap_sides = {str(swapped).lower()} was set, and the service was started again"

    async def _started_again(self) -> None:
        self.service = navigator(self.made, self.journal, self.events)
        self.service.guard.restore(self.journal.entries)
        await self.service.open()


def _beyond(made: Observatory, place: Icrs, room_arcsec: float) -> Iterator[tuple[float, int, float]]:
    """By how much the tube is further off than it may be, when, and how far off it is then.

    What is called centered stays so while it is tracked. Only wind that comes up after it can't be told.
    """
    now, mechanics = made.clock.utc(), made.mechanics
    known = max(mechanics.gust_arcsec(now - timedelta(seconds=one)) for one in range(int(LOOKED_S)))
    for later_s in range(STAYS_S + 1):
        utc = now + timedelta(seconds=later_s)
        off_arcsec = separation_arcsec(mechanics.truth(utc), place)
        grown = 1.12 * max(0.0, mechanics.gust_arcsec(utc) - known)
        yield off_arcsec - room_arcsec - grown, later_s, off_arcsec


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--worlds", type=int, default=12, help="of each scenario, with 3 targets each")
    parser.add_argument("--first", type=int, help="the first seed; of the day if left out")
    parser.add_argument("--only", nargs="*", choices=sorted(SCENARIOS))
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    first = asked.first if asked.first is not None else seed_of_the_day()
    print(f"seeds from {first}", flush=True)
    began = time.monotonic()
    outcomes = []
    for name in asked.only or SCENARIOS:
        outcome = Outcome(name)
        for seed in range(first, first + asked.worlds):
            lived(name, seed, outcome, asked.verbose)
        outcomes.append(outcome)
        told = ", ".join(f"{count} {what}" for what, count in outcome.results.most_common())
        # at once: a run that is broken off counts as far as it came
        print(f"{name:20} {told}; {outcome.syncs} syncs, {len(outcome.wrong)} wrong", flush=True)
        for line in (*outcome.wrong, *outcome.lost):
            print(f"    {line}", flush=True)
    wrong = sum(len(one.wrong) for one in outcomes)
    lost = sum(len(one.lost) for one in outcomes)
    total = sum(sum(one.results.values()) for one in outcomes)
    print(f"{total} targets in {time.monotonic() - began:.0f} s: {wrong} wrong, {lost} without a way out")
    return 1 if wrong or lost else 0


if __name__ == "__main__":
    sys.exit(main())
