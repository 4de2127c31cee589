"""Following on fake mounts of every family, in virtual time, judged by the mechanics' truth.

``python -m benchmarks.following [targets] [faults] [clean] [--targets 100] [--clean 1000] [--family NAME]``

- targets: comets, NEOs, planets, the Moon and passes are drawn, centered and followed; the tube must stay
within the tolerance and 1″, where the mount has rates; small slews and pulses are held to what they promise.
- faults: each fault of the fakes' rates on each family: it must be named, or made good without a name where
it shows in nothing. - clean: mounts that drift (polar axis, worm, refraction) and have no fault: none may be
named.

No limit may be violated and no rates may be left in any run. Exit code 1 if something was.
"""

from __future__ import annotations

import argparse
import asyncio
import math
import random
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any

from drivers.fakes.bench.memory import MemoryLine
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.ioptron.language import IoptronLanguage
from drivers.lx200.codec.greeting import dialect_named
from drivers.lx200.language import Lx200Language
from drivers.nexstar.language import NexstarLanguage
from drivers.registry import fake_machine, make_fake, open_mount
from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from drivers.simulated.truth_camera import TruthCamera
from drivers.skywatcher.language import SkywatcherLanguage
from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.catalog.embedded import embedded_catalog
from mountnav.ephemeris import Ephemeris, SkyRatesTarget, SolarSystemBody
from mountnav.errors import DeviceRefused, MountnavError, TargetNotReached
from mountnav.journal.memory import MemoryJournal
from mountnav.navigation.equipment import equip
from mountnav.navigation.follow_plan import FollowBy
from mountnav.navigation.follow_report import FollowReport
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.rates_seen import RateFault as Named
from mountnav.navigation.rates_seen import words_of
from mountnav.pointing.limits import Limits
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.rate_faults import RateFault
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.virtual_time import VirtualClock, VirtualLoop, for_all_modules
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_observed, observed_to_icrs
from mountnav.sky.coordinates import (
    SIDEREAL_ARCSEC_S,
    SOLAR_TO_SIDEREAL,
    Air,
    HourAngle,
    Icrs,
    Observed,
    Site,
)
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.alpaca.alpaca_server import FakeTelescope
from tests.drivers.alpaca.in_memory import InMemory, reached_in_memory

SITE, AIR = Site(47.0, 11.0, 600.0), Air(pressure_hpa=930.0, temperature_c=5.0)
START = datetime(2026, 11, 21, 20, 0, tzinfo=UTC)
TOLERANCE_ARCSEC = 5.0
LOWEST_DEG = 15.0
GOOD = PointingErrors(ih_arcsec=8.0, id_arcsec=-6.0, ch_arcsec=4.0, me_arcsec=15.0, ma_arcsec=-12.0)
"""A mount with a good model: some seconds of arc are left."""
POLICY = CenteringPolicy(
    exposure_s=4.0, scale_arcsec_px=1.5, timeout_s=1800.0, max_tries=8, tolerance_arcsec=TOLERANCE_ARCSEC
)
FAMILIES = (
    "simulated",
    "lx200/onstep",
    "lx200/10micron",
    "lx200/am5",
    "lx200/ap",
    "lx200/lx200gps",
    "nexstar",
    "synscan",
    "ioptron",
    "skywatcher",
    "alpaca/3",
    "alpaca/4",
)
_LANGUAGES: dict[str, Callable[[Link, str | None], Any]] = {
    "lx200": lambda link, dialect: Lx200Language(link, dialect_named(dialect) if dialect else None),
    "nexstar": lambda link, _: NexstarLanguage(link),
    "synscan": lambda link, _: NexstarLanguage(link, epoch="icrs"),
    "ioptron": lambda link, _: IoptronLanguage(link),
    "skywatcher": lambda link, _: SkywatcherLanguage(link, SITE),
}


@dataclass(frozen=True, slots=True)
class Pass:
    """A satellite's pass: along a great circle over the horizon, fastest where it is highest.

    Attributes
    ----------
    az_deg, alt_deg : float
        Where it is highest.
    speed_deg_s : float
        There.
    top_utc : datetime
    """

    az_deg: float
    alt_deg: float
    speed_deg_s: float
    top_utc: datetime
    half_s: float = 100.0
    name: str = "a satellite"

    @property
    def begins_utc(self) -> datetime | None:
        """Of the pass."""
        return self.top_utc - timedelta(seconds=4.0 * self.half_s)

    @property
    def ends_utc(self) -> datetime | None:
        """Of the pass."""
        return self.top_utc + timedelta(seconds=self.half_s)

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """On a straight line at its height: its angle is the arc tangent of the way."""
        way = math.radians(self.speed_deg_s) * (utc - self.top_utc).total_seconds()
        angle = math.atan(way)
        top, az = math.radians(self.alt_deg), math.radians(self.az_deg)
        up = math.sin(top) * math.cos(angle)
        ahead = math.cos(top) * math.cos(angle)
        east = ahead * math.sin(az) + math.sin(angle) * math.cos(az)
        north = ahead * math.cos(az) - math.sin(angle) * math.sin(az)
        alt_deg = math.degrees(math.asin(max(-1.0, min(1.0, up))))
        here = Observed(math.degrees(math.atan2(east, north)) % 360.0, alt_deg, utc)
        return observed_to_icrs(here, site, AIR)

    def sigma_arcsec(self, utc: datetime) -> float:
        """Not told."""
        return 0.0


@dataclass
class Run:
    """What came of one."""

    report: FollowReport | None = None
    error: MountnavError | None = None
    truly: list[float] = field(default_factory=list)
    left: tuple[float, float] = (0.0, 0.0)
    violated: bool = False

    @property
    def worst(self) -> float:
        """Of the truth, apart from 1 % of it."""
        return sorted(self.truly)[int(0.99 * (len(self.truly) - 1))] if self.truly else math.inf


@contextmanager
def virtual_time(clock: VirtualClock) -> Iterator[VirtualLoop]:
    """A loop in which all modules have the clock's time."""
    with for_all_modules(clock):
        loop = VirtualLoop(clock)
        try:
            asyncio.set_event_loop(loop)
            yield loop
        finally:
            asyncio.set_event_loop(None)
            loop.close()


def run(
    family: str,
    target_of: Callable[[VirtualClock], Ephemeris],
    *,
    minutes: float,
    fault: RateFault | None = None,
    errors: PointingErrors = GOOD,
    settled_s: float = 90.0,
    seed: int = 0,
    finder: bool = False,
) -> Run:
    """Follow a target on a fake mount of a family; with a camera that sees stars in moments, if `finder`."""
    clock = VirtualClock(START)
    done = Run()
    protocol, _, dialect = family.partition("/")
    served = protocol == "alpaca"
    machine = Machine() if protocol == "simulated" else fake_machine("lx200" if served else protocol)
    held = ExitStack()

    async def work() -> None:
        mechanics = Mechanics(SITE, AIR, errors, machine=machine, clock=clock)
        if fault is not None:
            mechanics.fail_rates(fault)
        mount: Any
        if protocol == "simulated":
            mount = SimulatedMount(mechanics, clock, MountBehavior(most_rate_arcsec_s=7_200.0))
        elif served:
            telescope = FakeTelescope(mechanics, int(dialect))
            telescope.connects_in_s = 0.0
            telescope.site = [SITE.latitude_deg, SITE.longitude_deg, SITE.height_m]
            held.enter_context(reached_in_memory(InMemory({"telescope/0": telescope}), clock))
            mount = open_mount("alpaca+http://127.0.0.1:11111/telescope/0", site=SITE)
        else:
            fake = make_fake(protocol, dialect or None, mechanics, clock=clock, monotonic=clock.monotonic)
            if hasattr(fake, "aligned"):
                fake.aligned = True
            log = WireLog(monotonic=clock.monotonic)
            link = Link(MemoryLine(fake, clock, log), Patience(), log)
            mount = GenericMount(_LANGUAGES[protocol](link, dialect or None), timing=Timing(), site=SITE)
        through = SeenThrough(scale_arcsec_px=1.5)
        if finder:
            through = SeenThrough(scale_arcsec_px=6.0, usual_exposure_s=0.3)
        script = SkyScript(seed=seed)
        navigator = Navigator(
            equip(
                name="bench",
                mount=mount,
                camera=TruthCamera(mechanics, clock, script, through),
                catalog=embedded_catalog(),
                site=SITE,
                air=AIR,
                policy=replace(POLICY, scale_arcsec_px=through.scale_arcsec_px),
                listen=lambda *_: None,
                solve=SkySeen(script, clock, through),
                journal=MemoryJournal(),
                clock=clock,
                mounting=machine.mounting,
                limits=Limits(min_altitude_deg=LOWEST_DEG),
            )
        )
        await navigator.open()
        navigator.trust()
        if not mechanics.tracking:
            await navigator.set_tracking(True)
        target = target_of(clock)
        phase = {"begun": math.inf}

        async def watch() -> None:
            while True:
                await clock.sleep(1.0)
                now = clock.utc()
                if mechanics.tracking and mechanics.true_observed(now).alt_deg < LOWEST_DEG - 0.1:
                    done.violated = done.violated or clock.monotonic_s() > phase["begun"]
                if clock.monotonic_s() > phase["begun"] + settled_s and navigator.activity == "following":
                    done.truly.append(separation_arcsec(mechanics.truth(now), target.icrs(now, SITE)))

        def heard(progress: Any) -> None:
            if progress.phase == "following":
                phase["begun"] = min(phase["begun"], clock.monotonic_s())

        watching = asyncio.ensure_future(watch())
        try:
            done.report = await navigator.follow(
                target, until_utc=clock.utc() + timedelta(minutes=minutes), heard=heard
            )
        except MountnavError as error:
            done.error = error
        finally:
            watching.cancel()
            await clock.sleep(5.0)
            done.left = mechanics.beside_arcsec_s
            await navigator.close()

    with held, virtual_time(clock) as loop:
        loop.run_until_complete(work())
    return done


def place(clock: VirtualClock, ha_deg: float, dec_deg: float) -> Icrs:
    """At that hour angle now."""
    return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, clock.utc()), SITE, AIR)


def moving(chance: random.Random, fastest: float) -> Callable[[VirtualClock], Ephemeris]:
    """Something that moves among the stars at up to so many ″/s, high enough."""
    ha_deg, dec_deg = chance.choice([-1, 1]) * chance.uniform(10.0, 45.0), chance.uniform(5.0, 60.0)
    angle, speed = chance.uniform(0.0, math.tau), fastest * chance.uniform(0.3, 1.0)
    east, north = speed * math.sin(angle), speed * math.cos(angle)

    def make(clock: VirtualClock) -> Ephemeris:
        begins = clock.utc()
        return SkyRatesTarget(
            place(clock, ha_deg, dec_deg),
            east / math.cos(math.radians(dec_deg)),
            north,
            begins,
            begins + timedelta(hours=2),
            "a moving target",
        )

    return make


def body(name: str) -> Callable[[VirtualClock], Ephemeris]:
    """Of the solar system."""
    return lambda clock: SolarSystemBody(name)


def satellite(chance: random.Random) -> Callable[[VirtualClock], Ephemeris]:
    """A pass that a mount with fast rates can follow."""
    az_deg, alt_deg = chance.choice([90.0, 270.0]) + chance.uniform(-30.0, 30.0), chance.uniform(35.0, 55.0)
    speed = chance.uniform(0.1, 0.4)
    return lambda clock: Pass(az_deg, alt_deg, speed, clock.utc() + timedelta(seconds=220.0))


def is_up(name: str) -> bool:
    """Whether a body is well above the limit at the start and for an hour."""
    found = SolarSystemBody(name)
    return all(
        icrs_to_observed(found.icrs(utc, SITE), utc, SITE, AIR).alt_deg > LOWEST_DEG + 8.0
        for utc in (START, START + timedelta(minutes=40))
    )


def targets(count: int, families: tuple[str, ...]) -> int:
    """Draw targets on all families; how many went wrong."""
    bodies = [name for name in ("moon", "jupiter", "saturn", "uranus", "neptune", "mars") if is_up(name)]
    wrong, tally = 0, Counter[str]()
    for number in range(count):
        chance = random.Random(number)
        family = families[number % len(families)]
        kind = ("comet", "neo", "body", "pass", "neo")[(number // len(families)) % 5]
        if kind == "pass" and family not in ("simulated", "skywatcher", "lx200/10micron"):
            kind = "comet"
        match kind:
            case "body":
                make = body(chance.choice(bodies or ["moon"]))
            case "pass":
                make = satellite(chance)
            case _:
                make = moving(chance, 0.1 if kind == "comet" else 1.0)
        done = run(
            family,
            make,
            minutes=5.2 if kind == "pass" else 10.0,
            seed=number,
            settled_s=30.0 if kind == "pass" else 90.0,
        )
        report = done.report
        by = "refused" if report is None else str(report.by)
        # a mount's coarse steps allow no less than that
        allowed = (TOLERANCE_ARCSEC if report is None else report.tolerance_arcsec) + 1.0
        if report is not None and report.by is not FollowBy.RATES:
            allowed = max(allowed, report.plan.left_arcsec + 1.0)
        if kind == "pass":
            allowed = 60.0  # its camera sees no streaks: the model's, and what a tenth of a second comes to
        refused = (
            done.error is not None and isinstance(done.error, DeviceRefused) and "too fast" in str(done.error)
        )
        good = (refused or done.worst <= allowed) and done.left == (0.0, 0.0) and not done.violated
        named = None if report is None else report.fault
        good = good and named is None
        wrong += not good
        tally[f"{kind} {by} {'good' if good else 'WRONG'}"] += 1
        worst = "" if not done.truly else f"{done.worst:.2f}″"
        told = "" if good and not refused else f" {done.error} {named}"
        print(
            f"{number:4d} {family:16s} {kind:6s} {by:13s} {worst:>9s} {'' if good else 'WRONG'}{told[:150]}",
            flush=True,
        )
    print(dict(tally))
    return wrong


FAULTS: dict[str, tuple[RateFault, frozenset[Named]]] = {
    "reversed ra": (RateFault(ra_factor=-1.0), frozenset({Named.SIGN_RA})),
    "reversed dec": (RateFault(dec_factor=-1.0), frozenset({Named.SIGN_DEC})),
    "reversed both": (RateFault(ra_factor=-1.0, dec_factor=-1.0), frozenset({Named.SIGNS})),
    "15.04 ra": (RateFault(ra_factor=SIDEREAL_ARCSEC_S), frozenset({Named.FACTOR_15})),
    "15.04 both": (RateFault(SIDEREAL_ARCSEC_S, SIDEREAL_ARCSEC_S), frozenset({Named.FACTOR_15})),
    "1/15.04 ra": (RateFault(ra_factor=1.0 / SIDEREAL_ARCSEC_S), frozenset({Named.FACTOR_1_15})),
    "1/15.04 both": (
        RateFault(1.0 / SIDEREAL_ARCSEC_S, 1.0 / SIDEREAL_ARCSEC_S),
        frozenset({Named.FACTOR_1_15}),
    ),
    "220 ra": (RateFault(ra_factor=220.0), frozenset({Named.FACTOR_220})),
    "1.0027 dec": (RateFault(dec_factor=SOLAR_TO_SIDEREAL), frozenset({Named.FACTOR_SIDEREAL})),
    "ignored": (RateFault(0.0, 0.0), frozenset({Named.IGNORED})),
    "dropped": (RateFault(0.0, 0.0, reads_zero=True), frozenset({Named.IGNORED})),
    "ignored ra": (RateFault(ra_factor=0.0), frozenset({Named.ONLY_DEC})),
    "ignored dec": (RateFault(dec_factor=0.0), frozenset({Named.ONLY_RA})),
    "swapped": (RateFault(swapped=True), frozenset({Named.SWAPPED})),
    "forgotten": (RateFault(lost_by_slew=True), frozenset({Named.FORGOTTEN})),
    "lost at flip": (RateFault(lost_by_flip=True), frozenset({Named.LOST_AT_FLIP})),
    "unturned": (RateFault(unturned=True), frozenset({Named.SIGN_DEC})),
}
RA_ALONE = frozenset({"lx200/ap", "ioptron"})
"""Families that take rates in right ascension alone: their targets move along it, or they were followed by
other means, and no fault could show."""
BY_READINGS_ARCSEC = 15.0
"""What is too fast for looks comes no nearer than its pointing errors change on the way, ″. Chosen by hand,
for those of `GOOD`. Doubled, half a faulty rate might pass at 60″/s."""
Spans = tuple[tuple[float, float], tuple[float, float]]
HARMLESS = frozenset({"forgotten", "lost at flip", "unturned", "1.0027 dec"})
"""Faults that may show in nothing: rates are sent again after each slew and each minute, the tube may hang on
the side where they are right, and 0.3 % of slow rates is less than any drift."""


def faults(families: tuple[str, ...], only: tuple[str, ...] = (), times: float = 1.0) -> int:
    """Plant each fault on each family, at so many times the usual rates; how many went wrong."""
    wrong, named_right, harmless, refused, ended = 0, 0, 0, 0, 0
    for family in families:
        for name, (fault, expected) in FAULTS.items():
            if only and name not in only:
                continue
            chance = random.Random(f"{family} {name}")
            spans = ((3.0 * times, 4.0 * times), (1.5 * times, 2.0 * times))
            if family in RA_ALONE:
                spans = (spans[0], (0.0, 0.0))

            def make(clock: VirtualClock, chance: random.Random = chance, spans: Spans = spans) -> Ephemeris:
                begins = clock.utc()
                ra, dec = (chance.choice([-1.0, 1.0]) * chance.uniform(*span) for span in spans)
                return SkyRatesTarget(
                    place(clock, -30.0, 35.0), ra, dec, begins, begins + timedelta(hours=2), "a moving target"
                )

            done = run(family, make, minutes=15.0, fault=fault, settled_s=420.0)
            report = done.report
            found = None if report is None else report.fault
            said = str(done.error or "") + " ".join(() if report is None else report.notes)
            ok = found in expected
            if ok:
                named_right += 1
            elif (
                report is not None
                and report.by is not FollowBy.RATES
                and "takes no rates" in report.plan.words
            ):
                refused, ok = refused + 1, True  # it has none: nothing can be wrong with them
            elif isinstance(done.error, TargetNotReached) and any(words_of(one) in said for one in expected):
                named_right, ok = named_right + 1, True  # without other means: ended, and said why
            elif isinstance(done.error, TargetNotReached) and "the mount itself says" in said:
                ended, ok = ended + 1, True  # its motors can't be as fast as the fault: no name
            elif "refused the rates" in said or "says afterwards" in said or "right ascension alone" in said:
                refused, ok = refused + 1, True  # the driver's read-back has seen it
            elif (
                (name in HARMLESS or (family in RA_ALONE and "dec" in name))
                and found is None
                and done.worst <= (BY_READINGS_ARCSEC if times > 6.0 else TOLERANCE_ARCSEC + 1.0)
            ):
                harmless, ok = harmless + 1, True
            ok = ok and done.left == (0.0, 0.0) and not done.violated
            wrong += not ok
            by = "-" if report is None else str(report.by)
            worst = "" if not done.truly else f"{done.worst:.2f}″"
            print(
                f"{family:16s} {name:14s} {by:13s} {worst:>9s} {found} {'' if ok else 'WRONG ' + said[:300]}",
                flush=True,
            )
    print(
        f"named {named_right}, showed in nothing {harmless}, ended without a name {ended}, no rates or seen "
        f"by the driver {refused}, wrong {wrong}"
    )
    return wrong


def clean(count: int) -> int:
    """Mounts that drift and have no fault; how many were given one."""
    wrong = 0
    for number in range(count):
        chance = random.Random(number + 1_000_000)
        errors = PointingErrors(
            ih_arcsec=chance.uniform(-600.0, 600.0),
            id_arcsec=chance.uniform(-600.0, 600.0),
            ch_arcsec=chance.uniform(-120.0, 120.0),
            np_arcsec=chance.uniform(-60.0, 60.0),
            me_arcsec=chance.uniform(-600.0, 600.0),
            ma_arcsec=chance.uniform(-600.0, 600.0),
            tf_arcsec=chance.uniform(0.0, 60.0),
            periodic_amplitude_arcsec=chance.uniform(0.0, 12.0),
            periodic_period_s=chance.uniform(300.0, 640.0),
        )
        fastest = 10.0 ** chance.uniform(-2.0, 1.0)
        done = run("simulated", moving(chance, fastest), minutes=8.0, errors=errors, seed=number)
        report = done.report
        bad = report is not None and (report.fault is not None or report.correction != "")
        bad = bad or done.left != (0.0, 0.0) or done.violated
        wrong += bad
        if bad or report is None:
            print(
                f"clean {number}: {fastest:.3f}″/s {report and report.fault} {done.error} "
                f"{'' if report is None else report.notes[-1:]}",
                flush=True,
            )
    print(f"clean: {count} runs, {wrong} wrong")
    return wrong


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("what", nargs="*", choices=["targets", "faults", "clean", []], default=[])
    parser.add_argument("--targets", type=int, default=100)
    parser.add_argument("--clean", type=int, default=1000)
    parser.add_argument("--family", action="append", choices=FAMILIES)
    parser.add_argument("--fault", action="append", choices=list(FAULTS))
    parser.add_argument("--times", type=float, default=1.0, help="rates of the faults' targets: 1 is 4″/s")
    asked = parser.parse_args()
    families = tuple(asked.family or FAMILIES)
    wanted = asked.what or ["targets", "faults", "clean"]
    wrong = 0
    if "targets" in wanted:
        wrong += targets(asked.targets, families)
    if "faults" in wanted:
        wrong += faults(families, tuple(asked.fault or ()), asked.times)
    if "clean" in wanted:
        wrong += clean(asked.clean)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
