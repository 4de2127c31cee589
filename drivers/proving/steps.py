"""The graded steps of a trial, from mere reading to a flip of the mount; each is asked for before."""

from __future__ import annotations

import asyncio
import math
import statistics
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from drivers.places import apart_arcsec
from drivers.proving.findings import Finding
from drivers.proving.trial import REFUSED, Trial
from mountnav.navigation.devices import Direction, PierSide, Skill, SlewOutcome, SyncOutcome
from mountnav.navigation.kinds import from_mount
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import half_turn_deg, offset_arcsec

_READINGS = 20
_STOPPED_AFTER_S = 1.0
_BELOW_DEG = -5.0
_SET_OUT_ARCSEC = 1800.0
_FLIP_HOURS_DEG = 20.0
SIDEREAL_ARCSEC_S = 15.041
_STOPPED_ENDS = (SlewOutcome.STOPPED, SlewOutcome.ARRIVED)


@dataclass(frozen=True, slots=True)
class Step:
    """One step.

    Attributes
    ----------
    name : str
    asks : str
        What an owner is asked before: what will happen.
    moves : bool
        Whether anything moves.
    do : callable
    """

    name: str
    asks: str
    moves: bool
    do: Callable[[Trial], Awaitable[list[Finding]]]


async def read_only(trial: Trial) -> list[Finding]:
    """Ask many times, order nothing."""
    took_s: list[float] = []
    places = []
    for _ in range(_READINGS):
        began = time.monotonic()
        reading = await trial.mount.reading()
        took_s.append(time.monotonic() - began)
        places.append(reading)
    first, last = places[0], places[-1]
    scatter_arcsec = max(apart_arcsec(first.place, one.place) for one in places)
    report = trial.mount.report
    findings = [
        Finding("read.time.median", statistics.median(took_s), "s"),
        Finding("read.time.worst", max(took_s), "s"),
        Finding("read.scatter", scatter_arcsec, "arcsec"),
        Finding("read.resolution", trial.mount.resolution_arcsec, "arcsec"),
        Finding("read.slewing", str(last.slewing)),
        Finding("read.tracking", str(last.tracking)),
        Finding("read.parked", str(last.parked)),
        Finding("read.pier-side", str(last.pier_side or "unknown")),
        Finding("read.altitude", trial.altitude_deg(last.place), "deg"),
    ]
    if report is not None and report.clock_off_s is not None:
        findings.append(Finding("clock.off", report.clock_off_s, "s", fine=abs(report.clock_off_s) < 2.0))
    if report is not None and report.site_off_arcsec is not None:
        findings.append(
            Finding("site.off", report.site_off_arcsec, "arcsec", fine=report.site_off_arcsec < 120.0)
        )
    return findings


async def one_degree(trial: Trial) -> list[Finding]:
    """Go a degree in each direction, and back."""
    start = await trial.place()
    lower = -1.0 if trial.altitude_deg(trial.beside(start, 0.0, 1.0)) < trial.lowest_altitude_deg else 1.0
    findings = []
    for name, east_deg, north_deg in (("dec", 0.0, lower), ("ra", 1.0, 0.0)):
        findings += await trial.go(f"move.{name}", trial.beside(start, east_deg, north_deg))
        findings += await trial.go(f"move.{name}.back", start)
    return findings


async def stop(trial: Trial) -> list[Finding]:
    """Set out for a place 10° away, and stop on the way."""
    start = await trial.place()
    log = trial.mount.wire_log
    slew = asyncio.create_task(trial.outcome(trial.mount.slew(_far(trial, start))))
    await asyncio.sleep(_STOPPED_AFTER_S)
    noted, asked_s = log.count, log.now_s()
    ended, words = await trial.outcome(trial.mount.stop())
    rest_s = log.now_s() - asked_s
    outcome, slew_words = await slew
    sent = [entry.t_s for entry in log.entries(noted) if entry.way == "driver->mount"]
    findings = [
        Finding("stop", ended, fine=ended == "done", words=words),
        Finding(
            "stop.slew", outcome, fine=outcome in (SlewOutcome.STOPPED, SlewOutcome.ARRIVED), words=slew_words
        ),
        Finding("stop.to-rest", rest_s, "s"),
    ]
    if sent:
        to_wire_s = sent[0] - asked_s
        findings.append(Finding("stop.to-wire", to_wire_s, "s", fine=to_wire_s < 0.1))
    return findings + await trial.go("stop.back", start)


async def sync(trial: Trial) -> list[Finding]:
    """Sync 10 arcminutes away and back: nothing moves, the belief changes and is put right again."""
    start = await trial.place()
    findings = []
    for name, place in (("sync", trial.beside(start, 0.0, 1.0 / 6.0)), ("sync.back", None)):
        target = start if place is None else place
        order = asyncio.create_task(trial.mount.sync(target))
        outcome, words = await trial.outcome(asyncio.shield(order))
        if outcome != "done":
            findings.append(Finding(name, outcome, fine=False, words=words))
            continue
        result = order.result()
        fine = result.outcome is not SyncOutcome.IGNORED
        findings.append(Finding(name, str(result.outcome), fine=fine))
        findings.append(Finding(f"{name}.miss", result.miss_arcsec, "arcsec"))
        findings.append(Finding(f"{name}.after", result.after_s, "s"))
    return findings


async def tracking(trial: Trial) -> list[Finding]:
    """Watch it track, then rest, then track again."""
    findings = await _drift(trial, "tracking", 0.0)
    if Skill.TRACK not in trial.mount.skills:
        return [*findings, Finding("tracking.switch", f"{REFUSED}: unsupported")]
    off, words = await trial.outcome(trial.mount.set_tracking(False))
    findings.append(Finding("tracking.off", off, fine=off == "done", words=words))
    if off == "done":
        findings += await _drift(trial, "resting", SIDEREAL_ARCSEC_S)
    on, words = await trial.outcome(trial.mount.set_tracking(True))
    return [*findings, Finding("tracking.on", on, fine=on == "done", words=words)]


async def _drift(trial: Trial, key: str, expected_arcsec_s: float) -> list[Finding]:
    """How fast the right ascension that it reports runs; with tracking off it runs with the sky."""
    before = await trial.mount.reading()
    await trial.settled(trial.watch_s)
    after = await trial.mount.reading()
    seconds = (after.utc - before.utc).total_seconds()
    turned_arcsec = half_turn_deg(after.place.ra_deg - before.place.ra_deg) * 3600.0
    rate = turned_arcsec / seconds
    # two readings, each good for a step
    sure = 2.0 * trial.mount.resolution_arcsec / seconds + 0.3
    return [Finding(f"{key}.rate", rate, "arcsec/s", fine=abs(rate - expected_arcsec_s) <= sure)]


async def guiding(trial: Trial) -> list[Finding]:
    """One second in each direction."""
    findings = []
    if Skill.GUIDE not in trial.mount.skills:
        return [Finding("guide", f"{REFUSED}: unsupported")]
    for direction in Direction:
        before = await trial.place()
        outcome, words = await trial.outcome(trial.mount.guide(direction, 1.0))
        offset = offset_arcsec(from_mount(await trial.place()), from_mount(before))
        findings.append(
            Finding(f"guide.{direction.name.lower()}", outcome, fine=outcome == "done", words=words)
        )
        findings.append(Finding(f"guide.{direction.name.lower()}.moved", offset.total_arcsec, "arcsec"))
    return findings


async def limits(trial: Trial) -> list[Finding]:
    """Ask for a place below the horizon: it should say no. If it sets out, it is stopped at once."""
    # under the pole, a little below the horizon: no mount has far to go there from anywhere
    dec_deg = math.copysign(90.0 - abs(trial.site.latitude_deg) + _BELOW_DEG, trial.site.latitude_deg)
    below = trial.at_hour_angle(180.0, dec_deg)
    start = await trial.place()
    slew = asyncio.create_task(trial.outcome(trial.mount.slew(below)))
    while not slew.done() and apart_arcsec(await trial.place(), start) < _SET_OUT_ARCSEC:
        await asyncio.wait([slew], timeout=0.2)
    if slew.done():
        outcome, words = slew.result()
        fine = outcome.startswith(REFUSED)
        return [Finding("limit.below-horizon", outcome, fine=fine, words=words)]
    await trial.mount.stop()
    await slew
    moved = Finding(
        "limit.below-horizon",
        "set out",
        words="it has no horizon of its own: keep ours switched on",
    )
    return [moved, *await trial.go("limit.back", start)]


async def flip(trial: Trial) -> list[Finding]:
    """Go to a place on each side of the meridian, and tell on which side of the pier the tube hangs."""
    start = await trial.place()
    dec_deg = max(min(start.dec_deg, 60.0), -60.0)
    findings, sides = [], []
    for name, ha_deg in (("east", -_FLIP_HOURS_DEG), ("west", _FLIP_HOURS_DEG)):
        place = trial.at_hour_angle(ha_deg, dec_deg)
        if trial.altitude_deg(place) < trial.lowest_altitude_deg:
            return [Finding("flip", "not tried", words="this declination does not rise high enough")]
        findings += await trial.go(f"flip.{name}", place)
        side = (await trial.mount.reading()).pier_side
        sides.append(side)
        findings.append(Finding(f"flip.{name}.pier-side", str(side or "unknown")))
    known = [side for side in sides if side in (PierSide.EAST, PierSide.WEST)]
    word = "unknown" if len(known) < 2 else ("flips" if known[0] is not known[1] else "stays")
    findings.append(Finding("flip", word))
    return findings + await trial.go("flip.back", start)


async def parking(trial: Trial) -> list[Finding]:
    """Park, try to slew while parked (it must refuse), and unpark."""
    if not {Skill.PARK, Skill.UNPARK} <= trial.mount.skills:
        return [Finding("park", f"{REFUSED}: unsupported")]
    start = await trial.place()
    outcome, words = await trial.outcome(trial.mount.park())
    reading = await trial.mount.reading()
    findings = [
        Finding("park", outcome, fine=outcome == SlewOutcome.ARRIVED, words=words),
        Finding("park.says", str(reading.parked)),
    ]
    if reading.parked:
        while_parked, words = await trial.outcome(trial.mount.slew(trial.beside(start, 0.0, -1.0)))
        findings.append(
            Finding("park.slew", while_parked, fine=while_parked.startswith(REFUSED), words=words)
        )
    unparked, words = await trial.outcome(trial.mount.unpark())
    findings.append(Finding("unpark", unparked, fine=unparked == "done", words=words))
    return findings


def _far(trial: Trial, start: Apparent | Icrs) -> Apparent | Icrs:
    """Ten degrees away, in the direction that stands highest."""
    around = [trial.beside(start, east, north) for east, north in ((0, 10), (0, -10), (10, 0), (-10, 0))]
    return max(around, key=trial.altitude_deg)


STEPS: tuple[Step, ...] = (
    Step("read", "ask it many times where it points; nothing moves", False, read_only),
    Step("move", "move it by 1° in declination and in right ascension, and back", True, one_degree),
    Step("stop", "send it 10° away and stop it after a second, then bring it back", True, stop),
    Step("sync", "sync it 10 arcminutes off and back; nothing moves", False, sync),
    Step("track", "watch it track, switch tracking off and on", True, tracking),
    Step("guide", "send guide pulses of a second in each direction", True, guiding),
    Step("limit", "ask for a place below the horizon; if it sets out, it is stopped", True, limits),
    Step("flip", "go 20° east and 20° west of the meridian: it may flip", True, flip),
    Step("park", "park it, ask for a slew while parked, and unpark it", True, parking),
)
