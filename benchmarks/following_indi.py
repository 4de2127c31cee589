"""Following behind a real `indiserver` with INDI's own drivers, whose mounts get rates wrong.

Run: python -m benchmarks.following_indi [--minutes 4] [--driver NAME] [--fault NAME]

The fakes of the mounts stand behind INDI's drivers, faults of rates strike in their mechanics, and looks see
where the tube truly points. In real time; all faults of a driver run side by side. A fault is named, or the
target is within the tolerance, or the driver refuses its rates or denies to have them. Exit code 1 otherwise,
if rates are left, or if the tube came under the limit.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import tempfile
from dataclasses import replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from benchmarks.following import FAULTS, POLICY, TOLERANCE_ARCSEC, Run
from drivers.simulated.truth_camera import TruthCamera
from mountnav.catalog.embedded import embedded_catalog
from mountnav.clock import SystemClock
from mountnav.ephemeris import SkyRatesTarget
from mountnav.errors import MountnavError
from mountnav.journal.memory import MemoryJournal
from mountnav.navigation.equipment import equip
from mountnav.navigation.follow_plan import FollowBy
from mountnav.navigation.navigator import Navigator
from mountnav.navigation.rates_seen import words_of
from mountnav.pointing.limits import Limits
from mountnav.simulation.rate_faults import RateFault
from mountnav.simulation.sky_script import SkyScript
from mountnav.simulation.sky_seen import SeenThrough, SkySeen
from mountnav.sky.chain import hour_angle_to_icrs
from mountnav.sky.coordinates import Air, HourAngle
from mountnav.sky.sphere import separation_arcsec
from tests.drivers.indi.test_language_over_real_drivers import REAL, SITE, served

AIR = Air(pressure_hpa=930.0, temperature_c=5.0)
LOWEST_DEG = 15.0
DRIVERS = {"indi_eqmod_telescope": (3.0, 1.7), "indi_ioptronv3_telescope": (3.0, 0.0)}
"""INDI drivers that keep rates, and those of the targets, ″/s."""
SETTLED_S = 120.0
"""So long after following began the truth counts, s."""


async def follow(
    driver: str, fault: RateFault, rates: tuple[float, float], minutes: float, home: Path
) -> Run:
    """Follow one target."""
    done, clock = Run(), SystemClock()
    async with served(REAL[driver], home) as (mechanics, mount):
        mechanics.fail_rates(fault)
        through, script = SeenThrough(scale_arcsec_px=1.5), SkyScript(seed=1)
        navigator = Navigator(
            equip(
                name="bench",
                mount=mount,
                camera=TruthCamera(mechanics, clock, script, through),
                catalog=embedded_catalog(),
                site=SITE,
                air=AIR,
                policy=replace(POLICY, exposure_s=2.0, timeout_s=600.0),
                listen=lambda *_: None,
                solve=SkySeen(script, clock, through),
                journal=MemoryJournal(),
                clock=clock,
                mounting="german",
                limits=Limits(min_altitude_deg=LOWEST_DEG),
            )
        )
        await navigator.open()
        navigator.trust()
        if (await mount.reading()).parked:
            await navigator.unpark()
        await navigator.set_tracking(True)
        begins = clock.utc()
        place = hour_angle_to_icrs(HourAngle(-30.0, 35.0, begins), SITE, AIR)
        target = SkyRatesTarget(place, *rates, begins, begins + timedelta(hours=2), "a moving target")
        began: list[float] = []

        async def watch() -> None:
            while True:
                await clock.sleep(1.0)
                now = clock.utc()
                if not began:
                    continue
                done.violated = done.violated or mechanics.true_observed(now).alt_deg < LOWEST_DEG - 0.1
                if clock.monotonic_s() > began[0] + SETTLED_S and navigator.activity == "following":
                    done.truly.append(separation_arcsec(mechanics.truth(now), target.icrs(now, SITE)))

        def heard(progress: Any) -> None:
            if progress.phase == "following" and not began:
                began.append(clock.monotonic_s())

        watching = asyncio.ensure_future(watch())
        try:
            done.report = await navigator.follow(
                target, until_utc=begins + timedelta(minutes=minutes), look_every_s=8.0, heard=heard
            )
        except MountnavError as error:
            done.error = error
        finally:
            watching.cancel()
            await clock.sleep(5.0)
            done.left = await _left(mechanics)
            await navigator.close()
    return done


async def _left(mechanics: Any) -> tuple[float, float]:
    """How fast it goes among the stars at last, ″/s."""
    before = mechanics.reported()
    await asyncio.sleep(3.0)
    after = mechanics.reported()
    seconds = (after.utc - before.utc).total_seconds()
    return (
        3600.0 * (after.ra_deg - before.ra_deg) / seconds,
        3600.0 * (after.dec_deg - before.dec_deg) / seconds,
    )


def judged(driver: str, name: str, done: Run) -> tuple[bool, str]:
    """Whether it went well, and in words."""
    expected = FAULTS[name][1]
    report = done.report
    found = None if report is None else report.fault
    said = str(done.error or "") + " ".join(() if report is None else report.notes)
    named = found in expected or any(words_of(one) in said for one in expected)
    told = "refused the rates" in said or "says that it has" in said
    near = found is None and done.worst <= TOLERANCE_ARCSEC + 1.0
    if report is not None and report.by is not FollowBy.RATES and report.plan.by is report.by:
        # it has no such rates, and none were used: it is held to what small slews promise
        near = found is None and done.worst <= report.plan.left_arcsec + 1.0
    rests = max(abs(one) for one in done.left) < 0.5
    ok = (named or told or near) and rests and not done.violated
    by = "-" if report is None else str(report.by)
    worst = "" if not done.truly else f"{done.worst:.2f}″"
    how = "named" if named else "told by its driver" if told else "near" if near else "WRONG"
    return ok, f"{driver:26s} {name:14s} {by:13s} {worst:>9s} {found} {how} {'' if ok else said[:300]}"


async def side_by_side(driver: str, names: list[str], minutes: float) -> int:
    """All faults of one driver; how many went wrong."""
    with tempfile.TemporaryDirectory() as folder:
        runs = [
            follow(driver, FAULTS[name][0], DRIVERS[driver], minutes, Path(folder) / f"home{number}")
            for number, name in enumerate(names)
        ]
        found = await asyncio.gather(*runs, return_exceptions=True)
    wrong = 0
    for name, done in zip(names, found, strict=True):
        if isinstance(done, BaseException):
            wrong += 1
            print(f"{driver:26s} {name:14s} failed: {done!r}")
            continue
        ok, words = judged(driver, name, done)
        wrong += not ok
        print(words, flush=True)
    return wrong


def main() -> int:
    """Run what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--driver", action="append", choices=list(DRIVERS))
    parser.add_argument("--fault", action="append", choices=list(FAULTS))
    asked = parser.parse_args()
    wrong = 0
    for driver in asked.driver or DRIVERS:
        wrong += asyncio.run(side_by_side(driver, asked.fault or list(FAULTS), asked.minutes))
    print(f"{wrong} wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
