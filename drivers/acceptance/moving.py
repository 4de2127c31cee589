"""Steps of a trial that let a mount move on: at rates of its own, and by its axes; judged by its readings.

A mount is believed in nothing: not that it took a rate, nor that it goes the way it was told. What it does is
its readings' change over some time. Whether these are true only the sky shows; a wrong belief of the mount
itself, of its sky or its gears, is not seen here.
"""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass

from drivers.acceptance.report import Finding
from drivers.acceptance.trial import REFUSED, Trial
from mountnav.devices import (
    STARS_RATES,
    MountAxis,
    MountReading,
    OffsetRates,
    RateSpan,
    Skill,
    from_mount,
)
from mountnav.sky.coordinates import SIDEREAL_ARCSEC_S
from mountnav.sky.sphere import half_turn_deg

_RATE_ARCSEC_S = 10.0
"""Offset rate of the step, ″/s, unless the mount takes less: clear of the sidereal rate (15.04), which one
that stops following shows, and 5 arcminutes in half a minute. Doubled, 10 arcminutes."""
_RATE_ERROR_ARCSEC_S = 0.3
"""What a measured rate may err by besides two steps of the readings, as of tracking."""
_RATE_SHARE = 0.03
"""What it may err by besides, as a share: the times of answers. Halved or doubled, a rate per sidereal second
can't be told from one per second (0.27 %): only the sky tells that."""
_AT_RATE_S = 1.0
"""Wait (s) until a mount has taken up a rate and its position is read again."""
_FACTORS = (
    (15.0 * 15.0, "15 twice"),
    (15.041, "15.04: seconds of right ascension taken for arcseconds"),
    (1.0 / 15.041, "1/15.04: arcseconds taken for seconds of right ascension"),
    (60.0, "60: per minute"),
    (1.0 / 60.0, "1/60: per minute"),
)
"""Factors that mounts and drivers had wrong, and what they mean."""
_FACTOR_SHARE = 0.06
"""So far a measured factor may lie from one of those. Doubled, 14 and 16 would count as 15."""
_AXIS_DEG_S = 0.3
"""Speed of an axis that is moved by hand, °/s: a degree in the step. Doubled, two; halved, the readings of a
coarse mount hardly show it."""
_FASTEST_AXIS_DEG_S = 1.5
"""An axis that is no slower is not tried: it would go 5° before it rests."""
_SPEEDING_S, _MOVING_S = 0.8, 2.0
"""How long (s) an axis may take to reach its speed, and how long it is watched at it."""
_AXIS_TOLERANCE = 0.35
"""Share by which a speed by hand may differ: what a driver looks at once a second, and tracking that some
suspend. Doubled, a step of a slew rate off passes."""
_REST_ARCSEC_S = 25.0
"""An axis rests if its reading changes by less, ″/s, besides two steps: the sky turns by 15."""
_HIGHEST_DEC_DEG = 75.0
"""Nearer to a pole right ascensions say too little of an axis."""
_SHARE_ACROSS = 0.2
"""Share of a motion that may be seen square to it. Doubled, an axis that isn't square passes."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What two readings show: rates of the coordinates, ″/s, and within what they are sure."""

    ra_arcsec_s: float
    dec_arcsec_s: float
    sure_arcsec_s: float


def motion(before: MountReading, after: MountReading, step_arcsec: float) -> Motion:
    """The motion between two readings, the turn of the sky in it as it was."""
    seconds = max((after.utc - before.utc).total_seconds(), 1e-3)
    turned_arcsec = 3600.0 * half_turn_deg(after.place.ra_deg - before.place.ra_deg)
    raised_arcsec = 3600.0 * (after.place.dec_deg - before.place.dec_deg)
    sure_arcsec_s = 2.0 * step_arcsec / seconds + _RATE_ERROR_ARCSEC_S
    return Motion(turned_arcsec / seconds, raised_arcsec / seconds, sure_arcsec_s)


def judged_rate(ordered: float, measured: float, other: float, sure: float) -> tuple[str, str]:
    """What a rate on one axis came to: an outcome in a word, and an explanation.

    Parameters
    ----------
    ordered, measured : float
        On that axis, ″/s.
    other : float
        Measured on the other one, where none was ordered.
    sure : float
        Within what both are sure.
    """
    free = sure + _RATE_SHARE * abs(ordered)
    if abs(ordered) <= 2.0 * sure:
        return "can't be told", f"its readings show rates from {2.0 * sure:.2g} arcsec/s on: watch it longer"
    if abs(measured) <= free:
        if abs(other) >= abs(ordered) - free:
            return "other axis", f"it moved the other axis, by {other:+.2f} arcsec/s"
        return "ignored", "it moved at the sidereal rate"
    if abs(other) > free:
        return "other axis too", f"its other axis moved by {other:+.2f} arcsec/s"
    if abs(measured - ordered) <= free:
        return "done", ""
    if abs(measured + ordered) <= free:
        return "reversed", "it moved the other way"
    factor = measured / ordered
    known = [words for number, words in _FACTORS if abs(abs(factor) / number - 1.0) <= _FACTOR_SHARE]
    if abs(measured - SIDEREAL_ARCSEC_S) <= free:
        known.append("the turn of the sky: it stopped following")
    return (
        "wrong amount",
        f"{factor:+.3g} times as fast as ordered{''.join(f' ({one})' for one in known[:1])}",
    )


async def rates(trial: Trial) -> list[Finding]:
    """Track at offset rates on each axis and on both: each must be taken, kept, read back and ended."""
    mount = trial.mount
    if Skill.OFFSET_RATES not in mount.skills:
        return [Finding("rates", f"{REFUSED}: unsupported")]
    start = await trial.place()
    if (await mount.reading()).tracking is False and Skill.TRACK in mount.skills:
        await mount.set_tracking(True)
    most = mount.most_offset_arcsec_s
    ra = _RATE_ARCSEC_S if most is None else min(_RATE_ARCSEC_S, most.ra_arcsec_s)
    dec = _RATE_ARCSEC_S if most is None else min(_RATE_ARCSEC_S, most.dec_arcsec_s)
    findings = []
    if most is not None:
        findings += [
            Finding("rates.most.ra", most.ra_arcsec_s, "arcsec/s"),
            Finding("rates.most.dec", most.dec_arcsec_s, "arcsec/s"),
        ]
    for name, ordered in (("ra", OffsetRates(ra, 0.0)), ("dec", OffsetRates(0.0, dec))):
        if ordered.none:
            findings.append(Finding(f"rates.{name}", "not tried", words="it has no rate of its own there"))
            continue
        findings += await _at_rates(trial, f"rates.{name}", ordered)
    if ra and dec:
        # back the way it came, on both at once: signs may be lost where only positive ones are tried
        findings += await _at_rates(trial, "rates.both", OffsetRates(-ra, -dec))
    ended, words = await trial.outcome(mount.set_offset_rates(STARS_RATES))
    findings.append(Finding("rates.end", ended, fine=ended == "done", words=words))
    if ended == "done":
        seen = await _watched(trial)
        rests = max(abs(seen.ra_arcsec_s), abs(seen.dec_arcsec_s)) <= seen.sure_arcsec_s
        findings.append(
            Finding(
                "rates.end.seen",
                "as for a star" if rests else "goes on",
                fine=rests,
                words=f"{seen.ra_arcsec_s:+.2f} and {seen.dec_arcsec_s:+.2f} arcsec/s",
            )
        )
    return findings + await trial.go("rates.back", start)


async def _at_rates(trial: Trial, key: str, ordered: OffsetRates) -> list[Finding]:
    if not _stays_up(trial, await trial.mount.reading(), ordered, trial.watch_s + _AT_RATE_S):
        return [Finding(key, "not tried", words="it would come too low")]
    outcome, words = await trial.outcome(trial.mount.set_offset_rates(ordered))
    if outcome != "done":
        return [Finding(key, outcome, fine=False, words=words)]
    told = await trial.mount.offset_rates()
    seen = await _watched(trial)
    ra, dec, sure = seen.ra_arcsec_s, seen.dec_arcsec_s, seen.sure_arcsec_s
    if ordered.dec_arcsec_s == 0.0:
        outcome, words = judged_rate(ordered.ra_arcsec_s, ra, dec, sure)
    elif ordered.ra_arcsec_s == 0.0:
        outcome, words = judged_rate(ordered.dec_arcsec_s, dec, ra, sure)
    else:
        outcome, words = judged_rate(ordered.ra_arcsec_s, ra, 0.0, sure)
        if outcome == "done":
            outcome, words = judged_rate(ordered.dec_arcsec_s, dec, 0.0, sure)
    return [
        Finding(key, outcome, fine=None if outcome == "can't be told" else outcome == "done", words=words),
        Finding(f"{key}.east", ra, "arcsec/s"),
        Finding(f"{key}.north", dec, "arcsec/s"),
        Finding(f"{key}.says", "nothing" if told is None else "its rates"),
    ]


async def _watched(trial: Trial) -> Motion:
    await asyncio.sleep(_AT_RATE_S)
    before = await trial.mount.reading()
    await trial.settled(trial.watch_s)
    return motion(before, await trial.mount.reading(), trial.mount.resolution_arcsec)


def _stays_up(trial: Trial, reading: MountReading, rates: OffsetRates, seconds: float) -> bool:
    """Whether it stays above the lowest altitude at some rates for some time, now and at the end."""
    icrs = from_mount(reading.place)
    cos_dec = max(math.cos(math.radians(icrs.dec_deg)), 0.05)
    east_deg = rates.ra_arcsec_s * cos_dec * seconds / 3600.0
    end = trial.beside(reading.place, east_deg, rates.dec_arcsec_s * seconds / 3600.0)
    return min(map(trial.altitude_deg, (reading.place, end))) >= trial.lowest_altitude_deg


async def axes(trial: Trial) -> list[Finding]:
    """Move each axis both ways by hand, and end that: direction, speed and rest by the readings."""
    mount = trial.mount
    if Skill.MOVE_AXIS not in mount.skills:
        return [Finding("axis", f"{REFUSED}: unsupported")]
    start = await trial.place()
    findings = []
    try:
        for axis, spans in mount.axis_rates_deg_s.items():
            speed_deg_s = speed_to_try(spans)
            if speed_deg_s is None:
                findings.append(Finding(f"axis.{axis}", "not tried", words="it moves too fast"))
                continue
            for name, sign in (("up", 1.0), ("down", -1.0)):
                findings += await _moved(trial, f"axis.{axis}.{name}", axis, sign * speed_deg_s)
    finally:
        if mount.axes_moved:
            await mount.stop()
    return findings + await trial.go("axis.back", start)


def speed_to_try(spans: tuple[RateSpan, ...]) -> float | None:
    """The speed nearest to the usual one that an axis has; None if the slowest is too fast."""
    speeds = [min(max(_AXIS_DEG_S, span.least_deg_s), span.most_deg_s) for span in spans]
    speed = min(speeds, key=lambda one: abs(math.log(max(one, 1e-6) / _AXIS_DEG_S)), default=None)
    return None if speed is None or not 0.0 < speed <= _FASTEST_AXIS_DEG_S else speed


async def _moved(trial: Trial, key: str, axis: MountAxis, rate_deg_s: float) -> list[Finding]:
    mount = trial.mount
    before = await mount.reading()
    if abs(before.place.dec_deg) > _HIGHEST_DEC_DEG:
        return [Finding(key, "not tried", words="too near to a pole")]
    arcsec_s = 3600.0 * rate_deg_s
    way = OffsetRates(arcsec_s, 0.0) if axis == "primary" else OffsetRates(0.0, arcsec_s)
    if not _stays_up(trial, before, way, 2.0 * (_SPEEDING_S + _MOVING_S)):
        return [Finding(key, "not tried", words="it would come too low")]
    outcome, words = await trial.outcome(mount.move_axis(axis, rate_deg_s))
    if outcome != "done":
        return [Finding(key, outcome, fine=False, words=words)]
    await asyncio.sleep(_SPEEDING_S)
    first = await mount.reading()
    await asyncio.sleep(_MOVING_S)
    last = await mount.reading()
    stopped = axis not in mount.axes_moved
    ended, ended_words = await trial.outcome(mount.move_axis(axis, 0.0))
    await asyncio.sleep(_SPEEDING_S)
    rest = await mount.reading()
    await asyncio.sleep(_MOVING_S)
    still = motion(rest, await mount.reading(), mount.resolution_arcsec)
    seen = motion(first, last, mount.resolution_arcsec)
    along, across = seen.ra_arcsec_s, seen.dec_arcsec_s
    if axis == "secondary":
        along, across = across, along
    if stopped:
        outcome, words = "reversed", "it went the other way, and was stopped: known from now on"
    else:
        outcome, words = judged_axis(arcsec_s, along, across, seen.sure_arcsec_s)
    rests = max(abs(still.ra_arcsec_s), abs(still.dec_arcsec_s)) <= _REST_ARCSEC_S + still.sure_arcsec_s
    return [
        # what a protocol leaves open and the driver finds out is no fault of the mount
        Finding(key, outcome, fine=None if stopped else outcome == "done", words=words),
        Finding(f"{key}.speed", along / 3600.0, "deg/s"),
        Finding(f"{key}.end", ended, fine=ended == "done", words=ended_words),
        Finding(f"{key}.rests", "rests" if rests else "goes on", fine=rests),
    ]


def judged_axis(ordered: float, along: float, across: float, sure: float) -> tuple[str, str]:
    """What a motion by hand came to: an outcome in a word, and an explanation; all in ″/s."""
    free = sure + SIDEREAL_ARCSEC_S + _AXIS_TOLERANCE * abs(ordered)
    expected = f"{ordered / 3600.0:+.3g} deg/s were ordered, {along / 3600.0:+.3g} were seen"
    if abs(across) > sure + SIDEREAL_ARCSEC_S + _SHARE_ACROSS * abs(ordered):
        return "other axis too", f"its other axis moved by {across / 3600.0:+.3g} deg/s"
    if abs(along - ordered) <= free:
        return "done", ""
    if abs(along) <= sure + SIDEREAL_ARCSEC_S:
        return "moved nothing", expected
    if along * ordered < 0.0:
        return "reversed", expected
    return "wrong amount", expected
