"""The graded steps of a trial, from mere reading to a flip, run in order; the owner is asked before each.

A step orders something, looks at what the mount's readings show afterwards, and makes findings of it. It
never judges by the mount's own word alone.
"""

from __future__ import annotations

import asyncio
import math
import statistics
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

from drivers.acceptance.moving import axes, rates
from drivers.acceptance.report import Capabilities, Finding, StepResult
from drivers.acceptance.trial import REFUSED, Trial, halt
from drivers.generic.comparison import CLOCK_TOLERANCE_S, SITE_TOLERANCE_ARCSEC
from drivers.generic.coordinates import apart_arcsec
from mountnav.clock import utc_now
from mountnav.devices import Direction, PierSide, Skill, SlewOutcome, from_mount
from mountnav.errors import MountnavError
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S, Apparent, Icrs
from mountnav.sky.sphere import half_turn_deg, offset_arcsec
from mountnav.tasks import waited_for

_READINGS = 20
"""How many readings give the median time of an answer: some seconds. Doubled, the median is a third more
precise."""
_STOPPED_AFTER_S = 1.0
"""Time (s) from the slew to the stop: the mount is then at full speed. Doubled, a fast one arrives
before."""
_TO_WIRE_S = 0.1
"""Time (s) within which a stop must be on the wire: nothing may queue before it. Chosen by hand. Doubled, a
stop that waits for an answer at 9600 baud passes; halved, a busy machine fails a good driver."""
_BELOW_DEG = -5.0
"""Altitude of the place that must be refused: clearly below any horizon, and no mount goes far before it is
stopped."""
_SET_OUT_ARCSEC = 1800.0
"""A mount that moved by half a degree has set out. Chosen: above any jitter, below what a wall allows.
Doubled, it is stopped half a degree later."""
_FLIP_HOURS_DEG = 20.0
"""Hour angles (east and west) of the two places for a flip, °. Chosen by hand: beyond the 5 to 15° that
mounts track past the meridian. Halved, such a mount doesn't flip."""
_LOWEST_RATE_ERROR_ARCSEC_S = 0.3
"""What a measured tracking rate may err by besides two steps of the readings: 2 % of the sidereal rate.
Halved, times of answers over a slow line make a good mount fail."""
_SYNC_AWAY_DEG = 1.0 / 6.0
"""How far the sync step goes, 10 arcminutes: more than any mount's step, and less than hand controls
refuse."""
_USUAL_GUIDE_ARCSEC_S = 0.5 * SIDEREAL_ARCSEC_S
"""Guide rate of a mount that reports none: half the sidereal rate, as most are delivered."""
_GUIDE_RATES = (0.1, 2.5)
"""Lowest and highest guide rates, in sidereal rates, of mounts that report none."""
_SHORTEST_PULSE_S, _LONGEST_PULSE_S = 1.0, 12.0
"""A shorter pulse (s) drowns in tracking and rounding; a longer one isn't accepted by all (16.4 s by
OnStep)."""
_PULSE_STEPS = 2.0
"""A pulse is made so long that it should move by so many steps of the readings: fewer prove nothing."""
_PULSE_TOLERANCE = 0.5
"""Share by which a pulse may differ from its rate: a board's timer, the time on the wire, an order that
begins late. Doubled, a pulse that moves a hundredth of its way passes."""
_PULSE_FREE_ARCSEC = 1.0
"""What a pulse may err by besides steps of the readings: the tracking of a fifteenth of a second."""
_STILL_ARCSEC = 0.3
"""Below this nothing moved: what an error of tracking makes in a second."""
_AFTER_PULSE_S = 0.5
"""Wait (s) after a pulse, for mounts that update their position twice a second."""
_REFUSED_STAYS_S = 2.0
"""How long (s) a mount is watched after a refusal: a slew shows within a second of its order."""
_STAYS_ARCSEC = 120.0
"""A mount that refused may have drifted by so much, not tracking, while it was watched (15 arcsec/s for 8
s)."""
_OTHER_REASONS = ("untrusted", "parked", "busy", "not-aligned", "not-tracking", "unsupported")
"""Reasons of a refusal that prove no limit."""
_STOPPED_ENDS = (SlewOutcome.STOPPED, SlewOutcome.ARRIVED)
"""How a slew may end that was stopped on its way."""


@dataclass(frozen=True, slots=True)
class Step:
    """One step.

    Attributes
    ----------
    asks : str
        What the owner is asked before: what will happen.
    moves : bool
        Whether anything moves.
    do : callable
        Carries it out and returns its findings.
    """

    name: str
    asks: str
    moves: bool
    do: Callable[[Trial], Awaitable[list[Finding]]]


async def read_only(trial: Trial) -> list[Finding]:
    """Read the mount many times; order nothing."""
    took_s: list[float] = []
    readings = []
    for _ in range(_READINGS):
        began = time.monotonic()
        reading = await trial.mount.reading()
        took_s.append(time.monotonic() - began)
        readings.append(reading)
    first, last = readings[0], readings[-1]
    scatter_arcsec = max(apart_arcsec(first.place, reading.place) for reading in readings)
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
        findings.append(
            Finding("clock.off", report.clock_off_s, "s", fine=abs(report.clock_off_s) < CLOCK_TOLERANCE_S)
        )
    if report is not None and report.site_off_arcsec is not None:
        findings.append(
            Finding(
                "site.off",
                report.site_off_arcsec,
                "arcsec",
                fine=report.site_off_arcsec < SITE_TOLERANCE_ARCSEC,
            )
        )
    return findings


async def one_degree(trial: Trial) -> list[Finding]:
    """Slew by a degree in declination and in right ascension, and back."""
    start = await trial.place()
    lower = -1.0 if trial.altitude_deg(trial.beside(start, 0.0, 1.0)) < trial.lowest_altitude_deg else 1.0
    findings = []
    for name, east_deg, north_deg in (("dec", 0.0, lower), ("ra", 1.0, 0.0)):
        findings += await trial.go(f"move.{name}", trial.beside(start, east_deg, north_deg))
        findings += await trial.go(f"move.{name}.back", start)
    return findings


async def stop(trial: Trial) -> list[Finding]:
    """Slew towards a position 10° away, and stop on the way."""
    start = await trial.place()
    log = trial.mount.wire_log
    slew = waited_for(trial.outcome(trial.mount.slew(_far(trial, start))))
    await asyncio.sleep(_STOPPED_AFTER_S)
    noted, asked_s = log.count, log.now_s()
    ended, words = await trial.outcome(trial.mount.stop())
    rest_s = log.now_s() - asked_s
    outcome, slew_words = await slew
    sent = [entry.t_s for entry in log.entries(noted) if entry.way == "driver->mount"]
    findings = [
        Finding("stop", ended, fine=ended == "done", words=words),
        Finding("stop.slew", outcome, fine=outcome in _STOPPED_ENDS, words=slew_words),
        Finding("stop.to-rest", rest_s, "s"),
    ]
    if sent:
        to_wire_s = sent[0] - asked_s
        findings.append(Finding("stop.to-wire", to_wire_s, "s", fine=to_wire_s < _TO_WIRE_S))
    return findings + await trial.go("stop.back", start)


async def sync(trial: Trial) -> list[Finding]:
    """Sync 10 arcminutes away and back: nothing moves, and the position is right again at the end."""
    start = await trial.place()
    findings = []
    for name, place in (("sync", trial.beside(start, 0.0, _SYNC_AWAY_DEG)), ("sync.back", None)):
        target = start if place is None else place
        order = waited_for(trial.mount.sync(target))
        outcome, words = await trial.outcome(asyncio.shield(order))
        if outcome != "done":
            findings.append(Finding(name, outcome, fine=False, words=words))
            continue
        result = order.result()
        fine = result.outcome.seen
        findings.append(Finding(name, str(result.outcome), fine=fine))
        findings.append(Finding(f"{name}.miss", result.miss_arcsec, "arcsec"))
        findings.append(Finding(f"{name}.after", result.after_s, "s"))
    return findings


async def tracking(trial: Trial) -> list[Finding]:
    """Measure the rate while it tracks and while it rests, then let it track again."""
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
    """The rate of the reported right ascension: 0 while it tracks, sidereal while it rests."""
    before = await trial.mount.reading()
    await trial.settled(trial.watch_s)
    after = await trial.mount.reading()
    seconds = (after.utc - before.utc).total_seconds()
    turned_arcsec = half_turn_deg(after.place.ra_deg - before.place.ra_deg) * 3600.0
    rate = turned_arcsec / seconds
    # two readings, each right to within a step
    sure = 2.0 * trial.mount.resolution_arcsec / seconds + _LOWEST_RATE_ERROR_ARCSEC_S
    return [Finding(f"{key}.rate", rate, "arcsec/s", fine=abs(rate - expected_arcsec_s) <= sure)]


async def guiding(trial: Trial) -> list[Finding]:
    """Pulses in each direction: each must move the right way, along one axis, as far as its rate says."""
    mount = trial.mount
    if Skill.GUIDE not in mount.skills:
        return [Finding("guide", f"{REFUSED}: unsupported")]
    if (await mount.reading()).tracking is False and Skill.TRACK in mount.skills:
        # otherwise the right ascension grows with the sky meanwhile
        await mount.set_tracking(True)
    wanted_arcsec = max(_SHORTEST_PULSE_S * _USUAL_GUIDE_ARCSEC_S, _PULSE_STEPS * mount.resolution_arcsec)
    duration_s = min(wanted_arcsec / _USUAL_GUIDE_ARCSEC_S, _LONGEST_PULSE_S)
    findings = [Finding("guide.pulse", duration_s, "s")]
    for direction in Direction:
        findings += await _guided(trial, direction, duration_s)
    return findings


async def _guided(trial: Trial, direction: Direction, duration_s: float) -> list[Finding]:
    key = f"guide.{direction.name.lower()}"
    before = await trial.mount.reading()
    outcome, words = await trial.outcome(trial.mount.guide(direction, duration_s))
    await trial.settled(_AFTER_PULSE_S)
    after = await trial.mount.reading()
    offset = offset_arcsec(from_mount(after.place), from_mount(before.place))
    # without tracking, the turn of the sky adds to the pulse: taken off again
    turned_arcsec = 0.0
    if after.tracking is False:
        elapsed_s = (after.utc - before.utc).total_seconds()
        turned_arcsec = SIDEREAL_ARCSEC_S * elapsed_s * math.cos(math.radians(after.place.dec_deg))
    east_arcsec, north_arcsec = offset.east_arcsec - turned_arcsec, offset.north_arcsec
    along = {
        Direction.NORTH: (north_arcsec, east_arcsec),
        Direction.SOUTH: (-north_arcsec, east_arcsec),
        Direction.EAST: (east_arcsec, north_arcsec),
        Direction.WEST: (-east_arcsec, north_arcsec),
    }
    moved_arcsec, across_arcsec = along[direction]
    turns = direction in (Direction.EAST, Direction.WEST)
    cos_dec = math.cos(math.radians(after.place.dec_deg)) if turns else 1.0
    if outcome == "done":
        rates = trial.mount.guide_rates_deg_s
        rate_deg_s = None if rates is None else rates[0 if turns else 1]
        step_arcsec = trial.mount.resolution_arcsec * max(cos_dec, 0.1)
        outcome, words = _judged_pulse(
            moved_arcsec, across_arcsec, duration_s, rate_deg_s, cos_dec=cos_dec, step_arcsec=step_arcsec
        )
    return [
        Finding(key, outcome, fine=outcome == "done", words=words),
        Finding(f"{key}.moved", moved_arcsec, "arcsec"),
        Finding(f"{key}.across", across_arcsec, "arcsec"),
    ]


def _judged_pulse(
    moved_arcsec: float,
    across_arcsec: float,
    duration_s: float,
    rate_deg_s: float | None,
    *,
    cos_dec: float,
    step_arcsec: float,
) -> tuple[str, str]:
    """Whether a pulse moved as it should: an outcome in a word, and an explanation.

    Parameters
    ----------
    moved_arcsec, across_arcsec : float
        On the sky, in the direction that was ordered, and perpendicular to it.
    rate_deg_s : float or None
        Of the axis, as the mount reports it; if None, any usual rate counts.
    cos_dec : float
        Motion on the sky for one of the axis: the cosine of the declination for right ascension, else 1.
    step_arcsec : float
        Step of the readings.
    """
    free_arcsec = 2.0 * step_arcsec + _PULSE_FREE_ARCSEC
    if rate_deg_s is None:
        low, high = (rate * SIDEREAL_ARCSEC_S * duration_s * cos_dec for rate in _GUIDE_RATES)
    else:
        wanted_arcsec = rate_deg_s * 3600.0 * duration_s * cos_dec
        low, high = (1.0 - _PULSE_TOLERANCE) * wanted_arcsec, (1.0 + _PULSE_TOLERANCE) * wanted_arcsec
    # a motion below a step may be rounding alone: then nothing has moved
    least = max(low - free_arcsec, min(0.5 * low, step_arcsec), _STILL_ARCSEC)
    expected = f"{low:.1f} to {high:.1f} arcsec were to be expected"
    if moved_arcsec <= -least:
        return "reversed", f"it went the other way; {expected}"
    if abs(across_arcsec) > max(free_arcsec, abs(moved_arcsec), least):
        return "wrong axis", f"it went {across_arcsec:.1f} arcsec square to its direction; {expected}"
    if abs(moved_arcsec) < least:
        return "moved nothing", expected
    if moved_arcsec > high + free_arcsec:
        return "too far", expected
    return "done", ""


async def limits(trial: Trial) -> list[Finding]:
    """Order a slew below the horizon: the mount must refuse and stay. One that sets out is stopped."""
    # under the pole, a little below the horizon: far from all usual positions, so that it is stopped early
    dec_deg = math.copysign(90.0 - abs(trial.site.latitude_deg) + _BELOW_DEG, trial.site.latitude_deg)
    below = trial.at_hour_angle(180.0, dec_deg)
    start = await trial.place()
    slew = waited_for(trial.outcome(trial.mount.slew(below)))
    while not slew.done() and apart_arcsec(await trial.place(), start) < _SET_OUT_ARCSEC:
        await asyncio.wait([slew], timeout=0.2)
    outcome, words = "set out", ""
    if slew.done():
        outcome, words = slew.result()
        # its refusal alone proves nothing: it may move all the same
        await trial.settled(_REFUSED_STAYS_S)
    went_arcsec = apart_arcsec(await trial.place(), start)
    stays = went_arcsec < _STAYS_ARCSEC + 2.0 * trial.mount.resolution_arcsec
    if outcome.startswith(REFUSED) and stays:
        proves = not outcome.endswith(_OTHER_REASONS)
        return [
            Finding(
                "limit.below-horizon",
                outcome,
                fine=proves,
                words=words if proves else f"{words}; refused for another reason, which proves no limit",
            )
        ]
    await trial.mount.stop()
    if not slew.done():
        await slew
    said = "" if outcome == "set out" else f" ({outcome})"
    moved = Finding(
        "limit.below-horizon",
        "set out",
        fine=False,
        words=f"it went {went_arcsec / 3600.0:.1f}° towards a place below the horizon{said}: it has no "
        "horizon of its own, or not ours; keep ours switched on",
    )
    return [moved, *await trial.go("limit.back", start)]


async def flip(trial: Trial) -> list[Finding]:
    """Slew to both sides of the meridian, and report on which side of the pier the tube hangs there."""
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
    """The highest of four positions ten degrees away."""
    around = [trial.beside(start, east, north) for east, north in ((0, 10), (0, -10), (10, 0), (-10, 0))]
    return max(around, key=trial.altitude_deg)


STEPS: tuple[Step, ...] = (
    Step("read", "ask it many times where it points; nothing moves", False, read_only),
    Step("move", "move it by 1° in declination and in right ascension, and back", True, one_degree),
    Step("stop", "send it 10° away and stop it after a second, then bring it back", True, stop),
    Step("sync", "sync it 10 arcminutes off and back; nothing moves", False, sync),
    Step("track", "watch it track, switch tracking off and on", True, tracking),
    Step("guide", "send guide pulses of a second or some in each direction", True, guiding),
    Step("rates", "track at 10 arcsec/s beside the stars, on each axis and on both", True, rates),
    Step("move-axis", "move each axis by a degree or less as a hand control does, both ways", True, axes),
    Step("limit", "ask for a place below the horizon; if it sets out, it is stopped", True, limits),
    Step("flip", "go 20° east and 20° west of the meridian: it may flip", True, flip),
    Step("park", "park it, ask for a slew while parked, and unpark it", True, parking),
)


Ask = Callable[[str], Awaitable[bool]]
"""Asks the owner a question; True for yes."""


async def run_trial(
    trial: Trial,
    steps: Sequence[Step],
    ask: Ask,
    *,
    driver: str,
) -> Capabilities:
    """Run steps on a mount, from an empty report.

    Parameters
    ----------
    trial : Trial
        Its mount is open.
    steps : sequence of Step
        In order of danger.
    ask : callable
        Called before each step, and before a position that isn't trusted is declared right.
    driver : str
        For the report.
    """
    found = empty_report(trial, driver)
    await run_steps(found, trial, steps, ask)
    return found


def empty_report(trial: Trial, driver: str) -> Capabilities:
    """The report of a trial before its first step."""
    report = trial.mount.report
    return Capabilities(
        mount=trial.mount.name,
        identity=report.identity if report else "unknown",
        driver=driver,
        began_utc=utc_now().isoformat(timespec="seconds"),
        skills=sorted(trial.mount.skills),
        problems=list(report.problems) if report else [],
    )


async def run_steps(
    found: Capabilities,
    trial: Trial,
    steps: Sequence[Step],
    ask: Ask,
    on_result: Callable[[StepResult], None] = lambda _: None,
) -> None:
    """Run the steps and add each result to the report at once, so that it is there however the trial ends."""
    for step in steps:
        result = await _one(trial, step, ask)
        found.steps.append(result)
        on_result(result)


async def _one(trial: Trial, step: Step, ask: Ask) -> StepResult:
    if not await ask(f"{step.name}: {step.asks}?"):
        return StepResult(step.name, done=False, why_not="declined")
    if step.moves and not trial.mount.trusted:
        if not await ask("its position may be wrong; is what it says about where it points right?"):
            return StepResult(step.name, done=False, why_not="its position can't be trusted")
        trial.mount.trust()
    noted = trial.mount.wire_log.count
    trial.mount.wire_log.note("event", meaning=f"step {step.name}")
    try:
        findings = await step.do(trial)
    except MountnavError as error:
        stopped = await halt(trial) if step.moves else ""
        return StepResult(step.name, done=False, why_not=f"{error}{stopped}")
    assert trial.mount.wire_log.count > noted, "the step noted itself"
    return StepResult(step.name, findings=findings)
