"""A thousand acquisitions at random pixels, judged by the truth that only the simulator knows.

Run: python -m benchmarks.aiming [--acquisitions 1000] [--first N] [--verbose]

Each seed is a telescope (mounting, pointing errors, how the camera stands on the tube, mirrored or not,
scale, size, distortion, tolerance) with three targets over the whole allowed sky, the pole included, each
brought to another pixel. An acquisition is right when the sky at that pixel is truly the target's within the
tolerance; or when no posture of the mount can bring the pixel there, and the service says so. The exit code
is 1 if one is not.
"""

from __future__ import annotations

import argparse
import logging
import math
import random
import sys
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import cast

from drivers.simulated.behavior import MountBehavior
from drivers.simulated.mount import SimulatedMount
from drivers.simulated.truth_camera import TruthCamera
from mountnav.catalog.stars import Catalog
from mountnav.devices import PierSide
from mountnav.errors import MountnavError, NotReached, OutsideLimits, TargetNotReached
from mountnav.journal.memory import MemoryJournal
from mountnav.navigation.aim_points import PixelPoint
from mountnav.navigation.equipment import equip
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.policy import CenteringPolicy, CorrectBy
from mountnav.pointing.limits import Limits
from mountnav.simulation.mechanics import Machine, Mechanics, PointingErrors
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.simulation.virtual_time import VirtualClock, run_virtually
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle, Icrs, Site
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs import icrs_at_pixel

AIR = Air(pressure_hpa=930.0, temperature_c=5.0, relative_humidity=0.7)
EACH = 3
"""Targets of one telescope: the later ones are aimed by what the earlier ones taught."""
LOWEST_DEG = 20.0
_TOLD_EVERY = 50
"""After so many telescopes it is told how it stands."""


@dataclass(frozen=True, slots=True)
class Acquired:
    """One acquisition.

    Attributes
    ----------
    result : {"acquired", "refused rightly", "FAILED"}
    flipped : bool
        Whether the tube hung on the west of the pier at the end.
    first_off_arcsec : float
        How far off the point was after the first slew.
    """

    seed: int
    number: int
    result: str
    why: str
    off_arcsec: float = 0.0
    tolerance_arcsec: float = 0.0
    looks: int = 0
    west: bool = False
    parity: int = 1
    first_off_arcsec: float = 0.0


def true_place(
    mechanics: Mechanics, through: SeenThrough, turned_deg: float, pixel: tuple[float, float], utc: datetime
) -> Icrs:
    """Where a pixel truly looks: by the simulated tube alone, whatever was solved."""
    turn = math.radians(mechanics.tube_angle_deg(utc) + turned_deg)
    center, scale_deg = mechanics.truth(utc), through.scale_arcsec_px / 3600.0
    right, up = (
        value - (side - 1) / 2.0
        for value, side in zip(pixel, (through.width_px, through.height_px), strict=True)
    )
    straight = 1.0 - through.distortion_px2 * (right**2 + up**2)
    cards: dict[str, object] = {
        "CTYPE1": "RA---TAN",
        "CRPIX1": 1.0,
        "CRPIX2": 1.0,
        "CRVAL1": center.ra_deg,
        "CRVAL2": center.dec_deg,
        "CD1_1": -through.parity * scale_deg * math.cos(turn),
        "CD1_2": scale_deg * math.sin(turn),
        "CD2_1": through.parity * scale_deg * math.sin(turn),
        "CD2_2": scale_deg * math.cos(turn),
    }
    return icrs_at_pixel(cards, right * straight, up * straight)


def lived(seed: int, each: int = EACH, *, verbose: bool = False) -> list[Acquired]:
    """Let one telescope acquire its targets, in virtual time."""
    chance = random.Random(f"aiming {seed}")
    site = Site(chance.choice([-1, 1]) * chance.uniform(20.0, 60.0), chance.uniform(-180.0, 180.0), 500.0)
    start = datetime(2026, 1, 1, tzinfo=UTC) + timedelta(hours=chance.uniform(0.0, 24.0 * 365.0))
    machine = Machine(mounting=chance.choice(["german", "german", "fork"]))
    errors = PointingErrors(
        ih_arcsec=chance.gauss(0.0, 900.0),
        id_arcsec=chance.gauss(0.0, 900.0),
        ch_arcsec=chance.gauss(0.0, 150.0),
        np_arcsec=chance.gauss(0.0, 60.0),
        me_arcsec=chance.gauss(0.0, 300.0),
        ma_arcsec=chance.gauss(0.0, 300.0),
        tf_arcsec=chance.gauss(0.0, 30.0),
    )
    width_px, height_px = chance.choice([(3000, 2000), (1024, 1024), (6248, 4176)])
    corner_px = math.hypot(width_px, height_px) / 2.0
    # fields of 3° from corner to corner at most
    scale = min(math.exp(chance.uniform(math.log(0.4), math.log(4.0))), 5400.0 / corner_px)
    through = SeenThrough(
        width_px,
        height_px,
        scale,
        chance.choice([1, -1]),
        distortion_px2=chance.choice([0.0, 1.0, -1.0]) * chance.uniform(0.0, 0.01) / corner_px**2,
    )
    turned_deg, tolerance = chance.uniform(0.0, 360.0), max(10.0, 4.0 * scale)
    clock = VirtualClock(start)
    mechanics = Mechanics(site, AIR, errors, machine=machine, clock=clock)
    correct_by = chance.choice(list(CorrectBy))
    script = SkyScript(seed=seed)

    async def run() -> list[Acquired]:
        navigator = Navigator(
            equip(
                name=f"seed {seed}",
                mount=SimulatedMount(mechanics, clock, MountBehavior()),
                camera=TruthCamera(mechanics, clock, script, through, turned_deg=turned_deg),
                catalog=cast("Catalog", None),  # the solver brings its own
                site=site,
                air=AIR,
                policy=CenteringPolicy(
                    tolerance_arcsec=tolerance,
                    scale_arcsec_px=scale,
                    timeout_s=3600.0,
                    max_tries=10,
                    correct_by=correct_by,
                ),
                listen=lambda kind, facts: print(f"    {kind} {facts}") if verbose else None,
                # by which way a German mount changes sides is no subject here
                limits=Limits(min_altitude_deg=LOWEST_DEG, way_min_altitude_deg=-90.0),
                solve=SkySeen(script, clock, through),
                journal=MemoryJournal(),
                clock=clock,
                mounting=machine.mounting,
            )
        )
        await navigator.open()
        found = []
        for number in range(each):
            pixel = (chance.uniform(0.0, width_px - 1.0), chance.uniform(0.0, height_px - 1.0))
            target = _target(site, clock.utc(), chance)
            found.append(await _one(navigator, mechanics, through, turned_deg, pixel, target, number, seed))
        await navigator.close()
        return found

    return run_virtually(run(), clock)


async def _one(
    navigator: Navigator,
    mechanics: Mechanics,
    through: SeenThrough,
    turned_deg: float,
    pixel: tuple[float, float],
    target: Icrs,
    number: int,
    seed: int,
) -> Acquired:
    where = f"pixel ({pixel[0]:.0f}, {pixel[1]:.0f}), δ {target.dec_deg:+.2f}°"
    try:
        report = await navigator.center(target, at=PixelPoint("", *pixel))
    except MountnavError as error:
        rightly = _rightly(error, mechanics, through, pixel, target)
        said = f"{where}: {type(error).__name__}: {error}"
        return Acquired(seed, number, "refused rightly" if rightly else "FAILED", said)
    utc = navigator._equipment.clock.utc()
    off = separation_arcsec(true_place(mechanics, through, turned_deg, pixel, utc), target)
    # what a solve may be wrong by, at the frame's edge too
    room = 4.0 * report.error_sigma_arcsec + 0.002 * report.tolerance_arcsec + _turned_by(report.at)
    good = off <= report.tolerance_arcsec + room
    return Acquired(
        seed,
        number,
        "acquired" if good else "FAILED",
        f"{where}: {off:.1f}″ off, {report.tolerance_arcsec:.1f}″ allowed",
        off,
        report.tolerance_arcsec,
        len(report.tries),
        mechanics.pier_side() is PierSide.WEST,
        through.parity,
        report.error_before_arcsec,
    )


def _rightly(
    error: MountnavError,
    mechanics: Mechanics,
    through: SeenThrough,
    pixel: tuple[float, float],
    target: Icrs,
) -> bool:
    """Whether it is true that the pixel can't be brought there."""
    if isinstance(error, OutsideLimits):
        return True
    if not isinstance(error, TargetNotReached):
        return False
    off_px = math.hypot(pixel[0] - (through.width_px - 1) / 2, pixel[1] - (through.height_px - 1) / 2)
    # what the mount's errors and the polar axis may add
    arm_deg = math.atan(math.radians(off_px * through.scale_arcsec_px / 3600.0)) * math.degrees(1.0) + 0.6
    polar_deg = 90.0 - abs(target.dec_deg)
    if error.reason is NotReached.POLE:
        return polar_deg < arm_deg
    here = mechanics.true_hour_angle()
    from_the_meridian_deg = abs(math.sin(math.radians(here.ha_deg))) * math.degrees(
        math.cos(math.radians(target.dec_deg))
    )
    return (
        error.reason is NotReached.SIDE
        and mechanics.machine.mounting == "german"
        and (from_the_meridian_deg < 2.0 * arm_deg or polar_deg < 3.0 * arm_deg)
    )


def _turned_by(at: object) -> float:
    """What a solved rotation that is wrong by 0.02° (twice its sigma) moves the point by, arcsec."""
    return math.radians(0.02) * float(getattr(at, "from_middle_arcsec", 0.0))


def _target(site: Site, utc: datetime, chance: random.Random) -> Icrs:
    """A place above the limit, each tenth near the pole."""
    north = 1.0 if site.latitude_deg > 0.0 else -1.0
    while True:
        dec_deg = math.degrees(math.asin(chance.uniform(-1.0, 1.0)))
        if chance.random() < 0.1:
            dec_deg = north * chance.uniform(85.0, 89.9)
        ha_deg = chance.uniform(-180.0, 180.0)
        altitude = math.asin(
            math.sin(math.radians(dec_deg)) * math.sin(math.radians(site.latitude_deg))
            + math.cos(math.radians(dec_deg))
            * math.cos(math.radians(site.latitude_deg))
            * math.cos(math.radians(ha_deg))
        )
        if LOWEST_DEG + 6.0 < math.degrees(altitude) < 88.0:
            return hour_angle_to_icrs(HourAngle(ha_deg, dec_deg, utc), site, AIR)


def report(all_of_them: Iterable[Acquired], took_s: float, *, verbose: bool = False) -> bool:
    """Print what came of it; whether all was right."""
    found = list(all_of_them)
    counts = Counter(one.result for one in found)
    acquired = [one for one in found if one.result == "acquired"]
    for one in found:
        if one.result == "FAILED" or (verbose and one.result != "acquired"):
            print(f"{one.result} seed {one.seed} #{one.number}: {one.why}")
    sides = Counter("west" if one.west else "east or fork" for one in acquired)
    parities = Counter(one.parity for one in acquired)
    looks = sorted(one.looks for one in acquired)
    print(
        f"{counts['acquired']} acquired, {counts['refused rightly']} refused rightly, "
        f"{counts['FAILED']} failed; {dict(sides)}, parities {dict(parities)}"
    )
    if acquired:
        shares = sorted(one.off_arcsec / one.tolerance_arcsec for one in acquired)
        print(
            f"off by {shares[len(shares) // 2]:.2f} of the tolerance in the median, {shares[-1]:.2f} at "
            f"most; "
            f"looks: median {looks[len(looks) // 2]}, most {looks[-1]}; {took_s:.0f} s"
        )
    return not counts["FAILED"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--acquisitions", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, nargs="*")
    parser.add_argument("--verbose", action="store_true")
    parser.add_argument("--refused", action="store_true", help="tell each refusal, too")
    asked = parser.parse_args()
    logging.disable(logging.WARNING)
    began = time.monotonic()
    seeds = asked.seeds or range(asked.first, asked.first + math.ceil(asked.acquisitions / EACH))
    found: list[Acquired] = []
    for count, seed in enumerate(seeds, 1):
        found += lived(seed, verbose=asked.verbose)
        if count % _TOLD_EVERY == 0:
            report(found, time.monotonic() - began)
    return 0 if report(found, time.monotonic() - began, verbose=asked.refused) else 1


if __name__ == "__main__":
    sys.exit(main())
