"""Random observatories for the proofs: how the mount is built and lies, what its sky does, from one seed."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from typing import Any, Literal

import erfa

from drivers.fakes.bench.memory import MemoryLine
from drivers.generic.mount import GenericMount
from drivers.generic.options import Timing
from drivers.ioptron.language import IoptronLanguage
from drivers.lx200.language import Lx200Language
from drivers.nexstar.language import NexstarLanguage
from drivers.registry import fake_machine as usual_machine
from drivers.registry import make_fake
from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from drivers.simulated.truth_camera import TruthCamera
from drivers.skywatcher.language import SkywatcherLanguage
from drivers.wire.exchange import Patience
from drivers.wire.link import Link
from drivers.wire.wire_log import WireLog
from mountnav.devices import from_mount
from mountnav.pointing.limits import Limits
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors, SyncBehavior
from mountnav.simulation.sky_script import Cloud, Incident, SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_observed
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import displaced, separation_arcsec

AIR = Air(pressure_hpa=930.0, temperature_c=5.0, relative_humidity=0.7)
WIRES = ("lx200", "nexstar", "synscan", "ioptron", "skywatcher")
_LANGUAGES: dict[str, Callable[[Link, Site], Any]] = {
    "lx200": lambda link, site: Lx200Language(link),
    "nexstar": lambda link, site: NexstarLanguage(link),
    "synscan": lambda link, site: NexstarLanguage(link, epoch="icrs"),
    "ioptron": lambda link, site: IoptronLanguage(link),
    "skywatcher": SkywatcherLanguage,
}


@dataclass(frozen=True, slots=True)
class World:
    """One observatory on one night; all of it follows from the seed.

    Attributes
    ----------
    seed : int
    wire : str or None
        Protocol that it speaks over a line in memory; None: no wire.
    site : Site
    start : datetime
    machine : Machine
    errors : PointingErrors
    behavior : MountBehavior
    sync_behavior : str
    sync_late_s : float
    script : SkyScript
    through : SeenThrough
    configured_scale_arcsec_px : float
        What the operator set; wrong in some.
    turned_deg : float
    limits : Limits
    tolerance_arcsec : float
    correct_by : str
    trusted : bool
        False: it was switched on just now, somewhere.
    sun_up : bool
    camera : {"sound", "frozen", "one-behind"}
        What its camera does with its frames.
    camera_clock_off_s : float
        The camera's clock minus UTC.
    service_longitude_off_deg, service_clock_off_s : float
        What the service's settings and clock are wrong by.
    mount_longitude_off_deg : float
        What the site in the mount is wrong by; its clock is the machine's.
    loose : {"", "flop", "wind"}
        "flop": a mirror that lies otherwise on each side of the meridian; "wind": gusts that shake the tube.
    loose_arcsec : float
        By how much.
    sides_stated : bool
        Somebody has looked whether the mount tells the right side of the pier, and set it.
    """

    seed: int
    wire: str | None
    site: Site
    start: datetime
    machine: Machine
    errors: PointingErrors
    behavior: MountBehavior
    sync_behavior: SyncBehavior
    sync_late_s: float
    script: SkyScript
    through: SeenThrough
    configured_scale_arcsec_px: float
    turned_deg: float
    limits: Limits
    tolerance_arcsec: float
    correct_by: str
    trusted: bool
    sun_up: bool
    camera: Literal["sound", "frozen", "one-behind"] = "sound"
    camera_clock_off_s: float = 0.0
    service_longitude_off_deg: float = 0.0
    service_clock_off_s: float = 0.0
    mount_longitude_off_deg: float = 0.0
    loose: Literal["", "flop", "wind"] = ""
    loose_arcsec: float = 0.0
    sides_stated: bool = False

    @property
    def service_site(self) -> Site:
        """Where the service takes the telescope to stand."""
        return _moved(self.site, self.service_longitude_off_deg)

    @property
    def worst_error_deg(self) -> float:
        """By how much belief and truth may differ at first, over the whole sky."""
        errors = self.errors
        parts = (
            errors.ih_arcsec,
            errors.id_arcsec,
            errors.ch_arcsec,
            errors.np_arcsec,
            errors.me_arcsec,
            errors.ma_arcsec,
            errors.tf_arcsec,
            errors.backlash_arcsec,
            errors.periodic_amplitude_arcsec,
        )
        # a clock or a site in the mount that is wrong is told, and nothing is slewed by it
        return (sum(abs(part) for part in parts) + self.loose_arcsec) / 3600.0

    @property
    def floor_arcsec(self) -> float:
        """A tolerance below this asks for more than the mount can do."""
        steps = math.hypot(self.behavior.ra_step_arcsec, self.behavior.dec_step_arcsec)
        return steps + self.errors.periodic_amplitude_arcsec + 4.0 * self.through.scale_arcsec_px + 3.0


def drawn(seed: int, *, wire: str | None = None, latitude_deg: float | None = None) -> World:
    """The observatory of a seed; over a wire of this protocol if one is given, at a latitude of choice."""
    chance = random.Random(seed)
    site = Site(48.93, 22.27, 700.0)
    if chance.random() < 0.4:
        latitude = chance.choice((-1.0, 1.0, 1.0)) * chance.uniform(28.0, 60.0)
        site = Site(latitude, chance.uniform(-180.0, 180.0), chance.uniform(0.0, 2500.0))
    if latitude_deg is not None:
        site = replace(site, latitude_deg=latitude_deg)
    day = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(days=chance.uniform(0.0, 365.0))
    sun_up = chance.random() < 0.1
    start = _when(day, site, sun_up)
    german = chance.random() < 0.65
    if wire is not None:
        german = wire == "skywatcher" or usual_machine(wire).mounting == "german"
    behavior = _behavior(chance, german)
    if wire is not None:
        behavior = MountBehavior()
    errors = _errors(chance)
    through = SeenThrough(
        scale_arcsec_px=chance.uniform(0.5, 4.0),
        parity=chance.choice((1, -1)),
        sigma_px=chance.uniform(0.02, 0.3),
    )
    limits = _limits(chance, german and behavior.tells_side)
    machine = Machine(
        mounting="german" if german else "fork",
        slew_rate_deg_s=chance.uniform(1.5, 8.0),
        acceleration_deg_s2=chance.uniform(1.0, 5.0),
        side_rule=chance.choice(("meridian", "meridian", "stay")) if german else "meridian",
        meridian_limits_deg=_own_meridian(chance, limits) if german else None,
        lowest_altitude_deg=chance.choice((None, 0.0, 5.0)),
        starts_at="zenith" if chance.random() < 0.6 else "home",
        home_sensor=chance.random() < 0.4,
    )
    if wire == "skywatcher":
        # bare motors: switched on at home, at rest, told where by whoever drives them
        machine = Machine(
            mounting="german",
            slew_rate_deg_s=machine.slew_rate_deg_s,
            starts_at="home",
            tracks_at_start=False,
        )
    elif wire is not None:
        machine = replace(usual_machine(wire), slew_rate_deg_s=machine.slew_rate_deg_s, tracks_at_start=True)
    sync_behavior: SyncBehavior = chance.choices(("normal", "ignore", "refuse", "late"), (60, 12, 12, 16))[0]
    world = World(
        seed=seed,
        wire=wire,
        site=site,
        start=start,
        machine=machine,
        errors=errors,
        behavior=behavior,
        sync_behavior="normal" if wire == "skywatcher" else sync_behavior,
        sync_late_s=chance.uniform(1.5, 7.0) if chance.random() < 0.8 else chance.uniform(8.5, 25.0),
        script=_script(chance, seed, wire),
        through=through,
        configured_scale_arcsec_px=through.scale_arcsec_px
        * (chance.uniform(0.75, 1.35) if chance.random() < 0.1 else chance.uniform(0.99, 1.01)),
        turned_deg=chance.uniform(0.0, 360.0),
        limits=limits,
        tolerance_arcsec=0.0,
        correct_by=chance.choices(("sync", "offset", "model"), (65, 20, 15))[0],
        trusted=wire is not None or chance.random() > 0.08,
        sun_up=sun_up,
    )
    steps = 25.0 if wire is not None else 0.0
    floor = max(world.floor_arcsec, steps)
    return replace(world, tolerance_arcsec=max(floor, chance.uniform(floor, 60.0)))


def _when(day: datetime, site: Site, sun_up: bool) -> datetime:
    """An instant of that day at which the Sun is up, or well down (or as low as it gets)."""
    hours = [day + timedelta(minutes=20 * step) for step in range(72)]
    heights = [icrs_to_observed(sun_at(hour), hour, site, Air()).alt_deg for hour in hours]
    wanted = [hour for hour, height in zip(hours, heights, strict=True) if (height > 5.0) is sun_up]
    night = [hour for hour, height in zip(hours, heights, strict=True) if height < -9.0]
    return wanted[0] if sun_up and wanted else (night or hours)[0]


def sun_at(utc: datetime) -> Icrs:
    """Where the Sun is, to an arcminute: from the Earth's own motion alone."""
    days = (utc - datetime(2000, 1, 1, 12, tzinfo=UTC)) / timedelta(days=1)
    heliocentric, _ = erfa.epv00(2451545.0, days)
    x, y, z = (-float(one) for one in heliocentric["p"])
    return Icrs(math.degrees(math.atan2(y, x)) % 360.0, math.degrees(math.atan2(z, math.hypot(x, y))))


def _errors(chance: random.Random) -> PointingErrors:
    def within(arcsec: float) -> float:
        return chance.uniform(-arcsec, arcsec)

    grown = chance.choice((0.3, 1.0, 1.0))
    return PointingErrors(
        ih_arcsec=grown * within(900.0),
        id_arcsec=grown * within(900.0),
        ch_arcsec=grown * within(600.0),
        np_arcsec=grown * within(200.0),
        me_arcsec=grown * within(500.0),
        ma_arcsec=grown * within(500.0),
        tf_arcsec=within(60.0),
        backlash_arcsec=chance.choice((0.0, 0.0, chance.uniform(5.0, 60.0))),
        periodic_amplitude_arcsec=chance.choice((0.0, chance.uniform(2.0, 12.0))),
        periodic_period_s=chance.uniform(200.0, 640.0),
    )


def _behavior(chance: random.Random, german: bool) -> MountBehavior:
    ra_step, dec_step = chance.choice(((0.0, 0.0), (0.0, 0.0), (15.0, 1.0), (19.8, 19.8), (1.5, 0.1)))
    return MountBehavior(
        epoch=chance.choice(("apparent", "apparent", "icrs")),
        ra_step_arcsec=ra_step,
        dec_step_arcsec=dec_step,
        refuses=chance.random() < 0.8,
        tells_motion=chance.random() < 0.85,
        tells_side=chance.random() < 0.85,
        tells_destination=german and chance.random() < 0.5,
        latency_s=chance.choice((0.01, 0.05, 0.2)),
    )


def _own_meridian(chance: random.Random, limits: Limits) -> tuple[float, float]:
    """The mount's own limits: mostly a little inside those that the operator set, in some far beyond."""
    if limits.past_meridian_deg is None or chance.random() < 0.15:
        return (60.0, 60.0)
    east, west = limits.past_meridian_deg
    return (east - chance.uniform(1.5, 4.0), west - chance.uniform(1.5, 4.0))


def _limits(chance: random.Random, german: bool) -> Limits:
    return Limits(
        min_altitude_deg=chance.choice((10.0, 15.0, 20.0, 25.0)),
        past_meridian_deg=(chance.uniform(5.0, 20.0), chance.uniform(5.0, 20.0)) if german else None,
        sun_cone_deg=20.0,
        margin_deg=0.5,
        # its operator knows that both axes are built alike
        rate_ratio=(0.8, 1.25),
    )


def _script(chance: random.Random, seed: int, wire: str | None) -> SkyScript:
    clouds: list[Cloud] = []
    for _ in range(chance.choices((0, 1, 2), (70, 20, 10))[0]):
        from_min = chance.uniform(0.0, 25.0)
        clouds.append(Cloud(from_min, from_min + chance.uniform(0.5, 8.0), thin=chance.random() < 0.3))
    incidents: list[Incident] = []
    if chance.random() < 0.25:
        whats = ("unplug", "silence") if wire else (
            "unplug", "silence", "reboot", "block-ha", "block-dec", "sync-deaf",
        )  # fmt: skip
        what = chance.choice(whats)
        incidents.append(Incident(chance.uniform(0.1, 8.0), what, chance.uniform(3.0, 40.0)))  # type: ignore[arg-type]
    return SkyScript(
        seed=seed,
        clouds=tuple(clouds),
        incidents=tuple(incidents),
        satellite_every=10,
        false_share=chance.choice((0.0, 0.0, 0.02, 0.05)),
        poor_share=chance.choice((0.0, 0.03)),
        slow_share=chance.choice((0.0, 0.02)),
        stale_share=chance.choice((0.0, 0.02)),
    )


class ShiftedClock(VirtualClock):
    """The service's clock, wrong by so many seconds."""

    def __init__(self, true: VirtualClock, off_s: float) -> None:
        super().__init__(true.utc())
        self._true = true
        self._off_s = off_s

    def set_right(self) -> None:
        """Let it show the true time from now on."""
        self._off_s = 0.0

    def utc(self) -> datetime:
        """What the service takes for UTC."""
        return self._true.utc() + timedelta(seconds=self._off_s)

    def monotonic(self) -> float:
        """Its seconds."""
        return self._true.monotonic()

    def monotonic_s(self) -> float:
        """Its seconds."""
        return self._true.monotonic_s()


class LooseTube(Mechanics):
    """Mechanics with a tube in which something lies loose: what the mount can't know of at all."""

    def __init__(self, world: World, clock: VirtualClock) -> None:
        super().__init__(world.site, AIR, world.errors, machine=world.machine, clock=clock)
        self._world = world
        self._gust_s = random.Random(f"wind {world.seed}").uniform(7.0, 23.0)
        if world.mount_longitude_off_deg:
            self.set_believed_site(_moved(world.site, world.mount_longitude_off_deg))

    def truth(self, utc: datetime | None = None) -> Icrs:
        """Where the optical axis looks."""
        place = super().truth(utc)
        world = self._world
        if world.loose == "flop":
            east = self.true_hour_angle(utc).ha_deg > 0.0
            return displaced(place, world.loose_arcsec * (0.5 if east else -0.5), 0.2 * world.loose_arcsec)
        if world.loose == "wind":
            utc = utc or self._clock()
            at_s = (utc - world.start).total_seconds()
            swing = self.gust_arcsec(utc) * math.sin(at_s * math.tau / self._gust_s)
            return displaced(place, swing, 0.5 * swing)
        return place

    def gust_arcsec(self, utc: datetime) -> float:
        """How far the tube swings east and west at an instant: gusts that come and go within minutes."""
        if self._world.loose != "wind":
            return 0.0
        at_s = (utc - self._world.start).total_seconds()
        return self._world.loose_arcsec * max(0.0, math.sin(at_s / 97.0) * math.sin(at_s / 41.0))


def _moved(site: Site, longitude_deg: float) -> Site:
    return replace(site, longitude_deg=(site.longitude_deg + longitude_deg + 180.0) % 360.0 - 180.0)


@dataclass
class Observatory:
    """A world that runs: what the service gets, and what only the judge may see."""

    world: World
    clock: VirtualClock
    mechanics: LooseTube
    mount: Any
    camera: TruthCamera
    solve: SkySeen
    line: MemoryLine | None = None
    syncs: list[tuple[datetime, float]] = field(default_factory=list)
    """Of each sync that was sent: when, and how far the synced place was from where the tube looked."""


def built(world: World, clock: VirtualClock) -> Observatory:
    """Build it; within a `VirtualLoop`, and `for_all_modules` where it has a wire."""
    mechanics = LooseTube(world, clock)
    mechanics.sync_behavior = world.sync_behavior
    mechanics.sync_late_s = world.sync_late_s
    mount: Any
    line = None
    if world.wire is None:
        ours = ShiftedClock(clock, world.service_clock_off_s)
        mount = SimulatedMount(mechanics, ours, world.behavior, trusted=world.trusted)
        mount.sides_stated = world.sides_stated
    else:
        fake = make_fake(world.wire, None, mechanics, clock=clock, monotonic=clock.monotonic)
        line = MemoryLine(fake, clock, WireLog(monotonic=clock.monotonic))
        mount = _driven(world, line, clock)
    camera = TruthCamera(
        mechanics,
        clock,
        world.script,
        world.through,
        turned_deg=world.turned_deg,
        clock_off_s=world.camera_clock_off_s + world.service_clock_off_s,
        habit=world.camera,
        ails_from=random.Random(f"ails {world.seed}").randrange(6) if world.camera == "frozen" else 0,
    )
    solve = SkySeen(world.script, clock, world.through, began_utc=world.start)
    if not world.trusted:
        # it was switched on just now: it takes itself to be at home, and doesn't track
        mechanics.reboot()
    made = Observatory(world, clock, mechanics, mount, camera, solve, line)
    _judge_syncs(made)
    return made


def met_again(made: Observatory) -> None:
    """A new driver for its mount, as after a start of the service with the world's present settings."""
    assert made.world.wire is not None
    assert made.line is not None
    made.mount = _driven(made.world, made.line, made.clock)
    _judge_syncs(made)


def _driven(world: World, line: MemoryLine, clock: VirtualClock) -> GenericMount:
    assert world.wire is not None
    log = WireLog(monotonic=clock.monotonic)
    language = _LANGUAGES[world.wire](Link(line, Patience(), log), world.service_site)
    return GenericMount(
        language,
        timing=Timing(longest_backoff_s=4.0),
        site=world.service_site,
        swap_sides=False if world.sides_stated else None,
    )


def put_right_by_hand(made: Observatory) -> None:
    """Turn the tube to where the mount believes to point, to ten minutes of arc or so."""
    mechanics, chance = made.mechanics, random.Random(made.world.seed)
    _, t_s, motion = mechanics._asked(None)
    believed = mechanics._believed_axes(motion, motion.belief_at(t_s), t_s)
    stands = mechanics.true_axes()
    errors = mechanics.errors
    mechanics.errors = replace(
        errors,
        ih_arcsec=errors.ih_arcsec + 3600.0 * (believed[0] - stands[0]) + chance.uniform(-600.0, 600.0),
        id_arcsec=errors.id_arcsec + 3600.0 * (believed[1] - stands[1]) + chance.uniform(-600.0, 600.0),
    )


def _judge_syncs(made: Observatory) -> None:
    """Take down how far each synced place is from the truth, before the mount gets it."""
    send = made.mount.sync

    async def judged(place: Any) -> Any:
        utc = made.clock.utc()
        seen = from_mount(replace(place, utc=utc) if hasattr(place, "utc") else place)
        made.syncs.append((utc, separation_arcsec(seen, made.mechanics.truth(utc))))
        return await send(place)

    made.mount.sync = judged


_POLE_CLEAR_DEG = 5.0
"""So far above the limit the pole stands where places near it are drawn."""


def target(world: World, utc: datetime, chance: random.Random) -> Icrs:
    """A place somewhere in the sky: mostly what is allowed, some near the pole, a few below the limit."""
    toward = math.copysign(1.0, world.site.latitude_deg)
    roll = chance.random()
    # from low latitudes the pole is below the limit
    pole_deg = abs(world.site.latitude_deg) - world.limits.min_altitude_deg
    while True:
        if roll < 0.15 and pole_deg > _POLE_CLEAR_DEG:
            place = HourAngle(chance.uniform(-180.0, 180.0), toward * chance.uniform(85.0, 89.9), utc)
        else:
            dec_deg = math.degrees(math.asin(chance.uniform(-1.0, 1.0)))
            place = HourAngle(chance.uniform(-180.0, 180.0), dec_deg, utc)
        icrs = hour_angle_to_icrs(place, world.site, AIR)
        height_deg = icrs_to_observed(icrs, utc, world.site, AIR).alt_deg
        if (height_deg < world.limits.min_altitude_deg - 1.0) is (0.15 <= roll < 0.19):
            return icrs
