"""Slews that are allowed, made by simulated machines: the truth never leaves the limits."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import pytest

from mountnav.devices import PierSide
from mountnav.errors import OutsideLimits
from mountnav.pointing.limits import Horizon, Limits, Mounting
from mountnav.pointing.limits.bodies import bodies
from mountnav.pointing.limits.detours import legs_to
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.sky_clock import FastClock
from mountnav.sky.chain import apparent_to_icrs, icrs_to_apparent, icrs_to_observed, observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site

AIR = Air(930.0, 5.0, 0.7)
NIGHT = datetime(2026, 11, 21, 22, tzinfo=UTC)
MORNING = datetime(2026, 6, 21, 7, tzinfo=UTC)
WALLS = Horizon(
    ((0.0, 12.0), (60.0, 12.0), (60.0, 31.0), (100.0, 28.0), (100.0, 12.0), (181.0, 12.0),
     (181.2, 40.0), (181.4, 12.0), (250.0, 20.0), (300.0, 35.0), (359.0, 12.0))
)  # fmt: skip
ERRORS = PointingErrors(
    ih_arcsec=120.0,
    id_arcsec=-90.0,
    ch_arcsec=100.0,
    np_arcsec=60.0,
    me_arcsec=150.0,
    ma_arcsec=-120.0,
    tf_arcsec=30.0,
)
ERROR_DEG = 0.15
"""More than the errors above can add up to."""
STEP_S = 0.5


@dataclass
class Trial:
    """A machine at a site, the limits it is kept to, and what came of it."""

    machine: Machine
    site: Site
    limits: Limits
    utc: datetime
    tells_side: bool = True
    slews: int = 0
    detours: int = 0
    refused: int = 0
    given_up: int = 0

    def __post_init__(self) -> None:
        self.clock = FastClock(0.0, self.utc)
        self.mechanics = Mechanics(self.site, AIR, ERRORS, machine=self.machine, clock=self.clock)
        self.least: dict[str, float] = {}

    def where(self) -> Icrs:
        """Where it believes to be."""
        return apparent_to_icrs(self.mechanics.reported())

    def side(self) -> PierSide | None:
        """What it tells of its side."""
        return self.mechanics.pier_side() if self.tells_side and self.machine.mounting == "german" else None

    def ordered(self, target: Icrs, anew: int = 2) -> None:
        """Slew to a target if that is allowed, by the legs that are allowed, judged all the way.

        Planned again where a leg isn't allowed any more when it comes to it, as `Motions` does.
        """
        mounting: Mounting = self.machine.mounting
        self.least = {}
        try:
            self.limits.check_slew(
                self.where(), target, self.clock(), self.site, AIR, mounting=mounting, side=self.side()
            )
            legs: tuple[Icrs, ...] = (target,)
        except OutsideLimits:
            legs = legs_to(
                self.limits, self.where(), target, self.clock(), self.site, AIR, mounting, self.side()
            )
            self.detours += bool(legs)
            self.refused += not legs
        for number, leg in enumerate(legs):
            if number:
                try:
                    self.limits.check_slew(
                        self.where(),
                        leg,
                        self.clock(),
                        self.site,
                        AIR,
                        mounting=mounting,
                        side=self.side(),
                        track_for_s=None if leg is target else 0.0,
                    )
                except OutsideLimits:
                    if anew:
                        self.ordered(target, anew - 1)
                    else:
                        # it stays where it came to, within the limits
                        self.given_up += 1
                    return
            self.slews += 1
            assert self.mechanics.slew(icrs_to_apparent(leg, self.clock())) is None
            self.judged(until_rest=True)
        if legs:
            self.judged(until_rest=False)

    def judged(self, *, until_rest: bool) -> None:
        """Put the clock on and look at the truth: during the slew, or for a minute of tracking."""
        began = self.clock()
        for _ in range(4000):
            if until_rest and not self.mechanics.slewing():
                return
            for limit, depth_deg in self.depths().items():
                least = max(0.0, self.least.get(limit, depth_deg))
                assert depth_deg <= least + 2.0 * ERROR_DEG, (limit, depth_deg, least, self)
                self.least[limit] = min(least, depth_deg)
            self.clock.on(STEP_S)
            if not until_rest and self.clock() > began + timedelta(seconds=60):
                return
        raise AssertionError("it never came to rest")

    def depths(self) -> dict[str, float]:
        """How deep outside its limits the truth is, by ERFA's chain and plain trigonometry."""
        utc, limits, found = self.clock(), self.limits, {}
        seen = icrs_to_observed(self.mechanics.truth(), utc, self.site, AIR)
        found["low"] = limits.min_altitude_deg - seen.alt_deg
        found["high"] = seen.alt_deg - limits.max_altitude_deg
        if limits.horizon is not None:
            wide_deg = ERROR_DEG / max(math.cos(math.radians(seen.alt_deg)), 1e-3)
            near = min(limits.horizon.altitude_at(seen.az_deg + step * wide_deg) for step in (-1.0, 0.0, 1.0))
            found["horizon"] = near - seen.alt_deg
        sun = bodies(utc, self.site).sun
        h, d, lat = (math.radians(x) for x in (sun.ha_deg, sun.dec_deg, self.site.latitude_deg))
        up = math.sin(lat) * math.sin(d) + math.cos(lat) * math.cos(d) * math.cos(h)
        north = math.cos(lat) * math.sin(d) - math.sin(lat) * math.cos(d) * math.cos(h)
        az = math.atan2(-math.cos(d) * math.sin(h), north)
        a, z = math.radians(seen.alt_deg), math.radians(seen.az_deg)
        cosine = math.sin(a) * up + math.cos(a) * math.sqrt(1.0 - up * up) * math.cos(z - az)
        apart = math.degrees(math.acos(max(-1.0, min(1.0, cosine))))
        if math.degrees(math.asin(up)) >= -6.0:
            found["sun"] = limits.sun_cone_deg - apart
        if limits.past_meridian_deg is not None and self.machine.mounting == "german":
            first = self.mechanics.axis_angle("ha")
            free = max(limits.past_meridian_deg)
            found["meridian"] = max(-free - first, first - 180.0 - free)
        return found


def random_target(chance: random.Random, trial: Trial) -> Icrs:
    """Anywhere above 10°."""
    alt_deg = math.degrees(math.asin(chance.uniform(0.17, 1.0)))
    return observed_to_icrs(Observed(chance.uniform(0.0, 360.0), alt_deg, trial.clock()), trial.site, AIR)


def trials(chance: random.Random, count: int) -> list[Trial]:
    """Machines of all kinds, at sites of both hemispheres, by night and by day."""
    found = []
    for number in range(count):
        german = number % 2 == 0
        rate = chance.uniform(2.0, 6.0)
        machine = Machine(
            mounting="german" if german else "fork",
            slew_rate_deg_s=rate,
            dec_slew_rate_deg_s=rate * chance.uniform(0.6, 1.7),
            acceleration_deg_s2=chance.uniform(1.0, 6.0),
            side_rule=chance.choice(("meridian", "stay")) if german else "meridian",
            meridian_limits_deg=(9.0, 9.0) if german else None,
        )
        limits = Limits(
            min_altitude_deg=15.0,
            max_altitude_deg=chance.choice((90.0, 88.0)),
            horizon=chance.choice((None, WALLS)),
            past_meridian_deg=(10.0, 10.0),
            sun_cone_deg=20.0,
            moon_cone_deg=0.0,
        )
        site = Site(chance.choice((48.9, 35.0, -33.0, -52.0)), chance.uniform(-180.0, 180.0), 200.0)
        utc = chance.choice((NIGHT, MORNING)) + timedelta(hours=chance.uniform(0.0, 24.0))
        found.append(Trial(machine, site, limits, utc))
    return found


def run(seed: int, machines: int, targets: int) -> tuple[int, int, int, int]:
    """Slews made, of them detours, refusals, and targets given up on the way."""
    chance = random.Random(seed)
    all_of_them = trials(chance, machines)
    for trial in all_of_them:
        for _ in range(targets):
            trial.ordered(random_target(chance, trial))
    counted = ("slews", "detours", "refused", "given_up")
    return tuple(sum(getattr(one, name) for one in all_of_them) for name in counted)


@pytest.mark.long
def test_the_truth_of_allowed_slews_stays_within_the_limits() -> None:
    slews, detours, _, given_up = run(seed=1, machines=6, targets=5)
    assert slews >= 20
    assert detours >= 3
    assert given_up == 0


@pytest.mark.long
def test_the_truth_of_many_allowed_slews_stays_within_the_limits() -> None:
    slews, detours, refused, given_up = run(seed=2, machines=12, targets=12)
    assert slews > 120
    assert detours > 10
    assert refused < 0.5 * slews
    assert given_up <= 2
