"""German mounts that keep their side of the pier, sent over the sky, judged by their axes.

Run: python -m benchmarks.keeping_sides [--mounts 60] [--first N] [--verbose]

Each seed is a mount that foretells no side, and tells it or not; that keeps it or looks the way of the
target; with and without limits past the meridian, its own far beyond them or a little inside. It is sent to
six places, planned again as a navigator does where it went another way. The exit code is 1 when it was ever
beyond a limit, or a slew was given up that had been begun: what can't be had is to be refused before.
"""

from __future__ import annotations

import argparse
import asyncio
import logging
import math
import random
import sys
from collections import Counter
from datetime import UTC, datetime

from benchmarks.centerings import seed_of_the_day
from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from mountnav.devices import for_mount
from mountnav.errors import OutsideLimits
from mountnav.mount import CheckedMount, WentAnotherWay
from mountnav.navigation.slewing import PLANNED_ANEW
from mountnav.pointing.limits import Limits
from mountnav.simulation.machine import Machine
from mountnav.simulation.mechanics import Mechanics, PointingErrors
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs, icrs_to_observed
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import half_turn_deg

AIR = Air(930.0, 5.0, 0.7)
NIGHT = datetime(2026, 11, 21, 22, tzinfo=UTC)
PLACES = 6
LOWEST_DEG = 15.0
HIGHER_DEG = 3.0
"""Places are so much above the lowest altitude: what is at the edge is refused for other reasons."""
SLACK_DEG = 0.35
"""So far outside counts as outside: the mount has no errors, and is looked at twice a second."""


class Sent:
    """One mount, sent from place to place.

    Parameters
    ----------
    seed : int
    """

    def __init__(self, seed: int) -> None:
        self.chance = chance = random.Random(f"keeps its side {seed}")
        free = chance.choice((None, (chance.uniform(5.0, 20.0), chance.uniform(5.0, 20.0))))
        far = free is None or chance.random() < 0.5
        self.site = Site(chance.choice((48.93, 31.0, -33.0)), 22.27, 700.0)
        self.limits = Limits(LOWEST_DEG, past_meridian_deg=free, margin_deg=0.3, rate_ratio=(0.8, 1.25))
        self.keeps = chance.random() < 0.67
        self.tells = chance.random() < 0.5
        machine = Machine(
            mounting="german",
            starts_at=chance.choice(("home", "zenith")),
            side_rule="stay" if self.keeps else "meridian",
            meridian_limits_deg=(60.0, 60.0) if far or free is None else (free[0] - 2.0, free[1] - 2.0),
            home_axes_deg=(90.0, math.copysign(90.0, self.site.latitude_deg)),
        )
        self.clock = VirtualClock(NIGHT)
        self.mechanics = Mechanics(self.site, AIR, PointingErrors(), machine=machine, clock=self.clock)
        behavior = MountBehavior(tells_side=self.tells, tells_destination=False)
        driver = SimulatedMount(self.mechanics, self.clock, behavior, trusted=True)
        driver.sides_stated = True
        self.mount = CheckedMount(
            driver,
            telescope=f"seed {seed}",
            limits=self.limits,
            site=self.site,
            air=AIR,
            clock=self.clock,
            mounting="german",
        )
        self.results: list[tuple[str, str]] = []
        self.deepest_deg = -90.0

    async def lived(self) -> None:
        """Send it to all places."""
        await self.mount.open()
        judging = asyncio.ensure_future(self._judge())
        try:
            for _ in range(PLACES):
                await self.clock.sleep(self.chance.uniform(0.0, 120.0))
                self.results.append(await self._sent(self._place()))
        finally:
            judging.cancel()
            await self.mount.close()

    def _place(self) -> Icrs:
        north = math.copysign(1.0, self.site.latitude_deg)
        while True:
            dec_deg = north * math.degrees(math.asin(self.chance.uniform(-0.4, 1.0)))
            utc = self.clock.utc()
            place = hour_angle_to_icrs(
                HourAngle(self.chance.uniform(-180.0, 180.0), dec_deg, utc), self.site, AIR
            )
            if icrs_to_observed(place, utc, self.site, AIR).alt_deg > LOWEST_DEG + HIGHER_DEG:
                return place

    async def _sent(self, place: Icrs) -> tuple[str, str]:
        said = ""
        for number in range(1 + PLANNED_ANEW):
            try:
                await self.mount.slew(for_mount(place, self.mount.epoch, self.clock.utc()))
            except WentAnotherWay as stopped:
                said = str(stopped)
            except OutsideLimits as refused:
                return "refused", str(refused)
            else:
                return "arrived again" if number else "arrived", said
        return "GIVEN UP", said

    async def _judge(self) -> None:
        """How deep outside the tube ever was, by the true axes."""
        while True:
            await self.clock.sleep(0.5 if self.mechanics.slewing() else 2.0)
            seen = icrs_to_observed(self.mechanics.truth(), self.clock.utc(), self.site, AIR)
            self.deepest_deg = max(self.deepest_deg, LOWEST_DEG - seen.alt_deg)
            if self.limits.past_meridian_deg is not None:
                ha_deg, dec_deg = self.mechanics.true_axes()
                past_deg = abs(half_turn_deg(ha_deg - 90.0)) - 90.0
                free_deg = self.limits.past_meridian_deg[1 if abs(half_turn_deg(dec_deg)) > 90.0 else 0]
                self.deepest_deg = max(self.deepest_deg, past_deg - free_deg)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--mounts", type=int, default=60)
    parser.add_argument("--first", type=int, help="the first seed; of the day if left out")
    parser.add_argument("--verbose", action="store_true")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    first = asked.first if asked.first is not None else seed_of_the_day()
    print(f"seeds from {first}", flush=True)
    counts: Counter[tuple[str, str, str]] = Counter()
    beyond = 0
    for seed in range(first, first + asked.mounts):
        sent = Sent(seed)
        run_virtually(sent.lived(), sent.clock)
        kind = "keeps its side" if sent.keeps else "changes", "tells it" if sent.tells else "doesn't tell it"
        for number, (result, said) in enumerate(sent.results):
            counts[(*kind, result)] += 1
            if result == "GIVEN UP" or (asked.verbose and said):
                print(f"seed {seed} #{number} {result}: {said}", flush=True)
        if sent.deepest_deg > SLACK_DEG:
            beyond += 1
            print(f"seed {seed} BEYOND a limit by {sent.deepest_deg:.1f}°", flush=True)
    for (keeps, tells, result), count in sorted(counts.items()):
        print(f"{keeps:15} {tells:16} {result:13} {count:5d}")
    given_up = sum(count for (_, _, result), count in counts.items() if result == "GIVEN UP")
    print(f"{sum(counts.values())} slews: {given_up} given up, {beyond} mounts beyond a limit")
    return 1 if given_up or beyond else 0


if __name__ == "__main__":
    sys.exit(main())
