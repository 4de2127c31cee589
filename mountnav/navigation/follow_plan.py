"""How a mount can follow a target, before anything moves: by rates, guide pulses, small slews, or not at all.

The whole path is looked at to its end: its fastest rates and how fast they change say how often they must be
renewed, what is left between two renewals, and whether the mount can do that at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from mountnav.devices import Epoch, OffsetRates, for_mount
from mountnav.errors import DeviceRefused, Refusal
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg

__all__ = ["FollowBy", "FollowPlan", "Means", "mount_rates", "plan_follow"]

_STEP_S = 0.5
"""Half the span over which rates are differenced, s. Doubled, those of a satellite overhead are four times as
wrong, and still to a thousandth."""
_MOST_SAMPLES, _SAMPLE_S = 400, 1.5
"""So many instants of a path are looked at at most, and no closer together, s: those of a satellite's pass
are all seen. Doubled, an order for a night takes twice as long to be judged."""
_ROUNDING_ARCSEC_S2 = 1e-5
"""Changes of velocity below this are those of rounding, ″/s²: in a minute they are 0.02″. Doubled, 0.04″."""
LEFT_SHARE = 0.1
"""What rates that are kept for a while leave of a curved path: this share of the tolerance. Doubled, they are
renewed 1.4 times as seldom."""
LEAST_LEFT_ARCSEC = 0.05
"""... and no less than this, ″: below it no camera sees anything."""
LONGEST_S, SHORTEST_S = 60.0, 0.2
"""Rates are renewed no more seldom and no more often, s: links and controllers take some 0.1 s for an order.
Longest: a service that dies leaves them for as long. Shortest doubled, a pass at 1″/s² is 0.1″ further
off."""
FAST_ARCSEC_S = 60.0
"""Faster targets are waited for ahead on their path, and not looked at: stars are drawn out to lines, ″/s.
Doubled, NEOs that are centered in vain fall in."""
PULSED_SHARE = 0.5
"""Guide pulses follow what is slower than this share of the guide rate: each takes at most half of the time.
Doubled, there is no time left between pulses."""
PULSE_EVERY_S = 10.0
"""Between pulses, s; what is left is half the way of that time. Halved, slow mounts do nothing
else."""
MOST_LEFT_ARCSEC, MOST_LEFT_TOLERANCES = 60.0, 4.0
"""Pulses and slews may leave so much, ″, or so many tolerances, whichever is more: else it is no
following."""


class FollowBy(StrEnum):
    """By what a target is followed."""

    RATES = "rates"
    PULSES = "guide-pulses"
    SLEWS = "small-slews"


@dataclass(frozen=True, slots=True)
class Means:
    """What a mount can do to follow.

    Attributes
    ----------
    most : OffsetRates or None
        The largest that it takes; None: it doesn't say.
    most_arcsec_s : float
        On the sky, as the settings allow.
    order_s : float
        How long an order of rates takes.
    guide_deg_s : (float, float) or None
        Guide rates in right ascension and in declination; None: no pulses.
    slew_s : float
        How long a small slew takes, settling included.
    device : str
        Its name, for messages.
    step_arcsec : float
        In what steps it can be sent to a place; small slews come no nearer than half of one.
    """

    takes_rates: bool
    most: OffsetRates | None
    most_arcsec_s: float
    order_s: float
    guide_deg_s: tuple[float, float] | None
    slew_s: float
    device: str
    step_arcsec: float = 0.0


@dataclass(frozen=True, slots=True)
class FollowPlan:
    """How a target will be followed.

    Attributes
    ----------
    instead : FollowBy or None
        By what it may be followed if the mount doesn't keep its rates; None: by nothing.
    fastest : OffsetRates
        Largest rates on the way, both positive.
    fastest_arcsec_s : float
        The fastest way over the sky.
    bends_arcsec_s2 : float
        How fast its velocity changes at most, on the sky.
    renew_s : float
        Between two orders of rates.
    left_arcsec : float
        What is left between two orders, at most.
    fast : bool
        Whether it is waited for ahead on its path, and not looked at.
    words : str
        For people.
    """

    by: FollowBy
    instead: FollowBy | None
    fastest: OffsetRates
    fastest_arcsec_s: float
    bends_arcsec_s2: float
    renew_s: float
    left_arcsec: float
    fast: bool
    words: str


def mount_rates(path: Callable[[datetime], Icrs], utc: datetime, epoch: Epoch, over_s: float) -> OffsetRates:
    """Mean rates of a path from an instant on, in a mount's kind of coordinates.

    Parameters
    ----------
    over_s : float
        For how long; not 0.
    """
    # both of date `utc`: the frame that turns meanwhile is no motion
    begin, end = (for_mount(path(at), epoch, utc) for at in (utc, utc + timedelta(seconds=over_s)))
    return OffsetRates(
        half_turn_deg(end.ra_deg - begin.ra_deg) * 3600.0 / over_s,
        (end.dec_deg - begin.dec_deg) * 3600.0 / over_s,
    )


def plan_follow(
    path: Callable[[datetime], Icrs],
    begins: datetime,
    ends: datetime,
    epoch: Epoch,
    means: Means,
    tolerance_arcsec: float,
) -> FollowPlan:
    """How to follow a path.

    Raises
    ------
    DeviceRefused
        It is too fast for this mount, with the numbers.
    BadRequest
        The path doesn't reach as far.
    """
    fastest, speed, bends, at = _measured(path, begins, ends, epoch)
    fast = speed > FAST_ARCSEC_S
    allowed = max(LEFT_SHARE * tolerance_arcsec, LEAST_LEFT_ARCSEC)
    least_s = max(SHORTEST_S, 2.0 * means.order_s)
    renew_s = LONGEST_S if bends <= 0.0 else math.sqrt(8.0 * allowed / bends)
    renew_s = min(LONGEST_S, max(least_s, renew_s))
    left = bends * renew_s**2 / 8.0
    most_left = max(MOST_LEFT_ARCSEC, MOST_LEFT_TOLERANCES * tolerance_arcsec)
    rates = (
        f"{speed:.4g}″/s at {at:%H:%M:%S} UTC ({fastest.ra_arcsec_s:.4g} in right ascension, "
        f"{fastest.dec_arcsec_s:.4g} in declination at most), changing by up to {bends:.3g}″/s²"
    )
    why = _not_by_rates(means, fastest, speed, left, most_left, renew_s)
    others = _others(means, fastest, speed, most_left)
    if not why:
        words = f"by rates, renewed each {renew_s:.3g} s, which leaves {left:.2g}″: {rates}"
        instead = others[0][0] if others and not fast else None
        return FollowPlan(FollowBy.RATES, instead, fastest, speed, bends, renew_s, left, fast, words)
    if not others or fast:
        raise DeviceRefused(
            f"the target is too fast for this mount: {rates}; {why}",
            device=means.device,
            advice="nothing was moved; choose a slower part of its path, or a mount that takes such rates",
            reason=Refusal.LIMIT,
        )
    by, every_s, left = others[0]
    instead = others[1][0] if len(others) > 1 else None
    steps = ""
    if by is FollowBy.SLEWS and means.step_arcsec > 0.1 * left:
        steps = f", {0.5 * means.step_arcsec:.2g}″ of it by the mount's steps"
    words = f"by {by.replace('-', ' ')} ({why}), which leaves up to {left:.2g}″{steps}: {rates}"
    return FollowPlan(by, instead, fastest, speed, bends, every_s, left, fast, words)


def _not_by_rates(
    means: Means, fastest: OffsetRates, speed: float, left: float, most_left: float, renew_s: float
) -> str:
    """Why it can't be followed by rates; empty if it can."""
    if not means.takes_rates:
        return "it takes no rates"
    most = means.most
    if most is not None and (
        fastest.ra_arcsec_s > most.ra_arcsec_s or fastest.dec_arcsec_s > most.dec_arcsec_s
    ):
        return (
            f"it takes at most {most.ra_arcsec_s:.4g}″/s in right ascension and {most.dec_arcsec_s:.4g}″/s "
            "in declination"
        )
    if speed > means.most_arcsec_s:
        return f"the settings allow {means.most_arcsec_s:.4g}″/s at most"
    if left > most_left:
        return f"rates renewed each {renew_s:.2g} s, as often as it takes them, would leave {left:.3g}″"
    return ""


def _others(
    means: Means, fastest: OffsetRates, speed: float, most_left: float
) -> list[tuple[FollowBy, float, float]]:
    """By what else it can be followed, each with its period and what that leaves; the best first."""
    found = []
    if means.guide_deg_s is not None:
        ra, dec = (3600.0 * PULSED_SHARE * rate for rate in means.guide_deg_s)
        left = 0.5 * speed * PULSE_EVERY_S
        if fastest.ra_arcsec_s <= ra and fastest.dec_arcsec_s <= dec and left <= most_left:
            found.append((FollowBy.PULSES, PULSE_EVERY_S, left))
    left = speed * means.slew_s + 0.5 * means.step_arcsec
    if left <= most_left:
        found.append((FollowBy.SLEWS, max(means.slew_s, PULSE_EVERY_S), left))
    return found


def _measured(
    path: Callable[[datetime], Icrs], begins: datetime, ends: datetime, epoch: Epoch
) -> tuple[OffsetRates, float, float, datetime]:
    """Largest rates, fastest speed, largest change of velocity (on the sky), and when it is fastest."""
    seconds = max((ends - begins).total_seconds(), 4.0 * _STEP_S)
    count = max(3, min(_MOST_SAMPLES, math.ceil(seconds / _SAMPLE_S)))
    usable = max(seconds - 4.0 * _STEP_S, 0.0)
    ra = dec = speed = bends = 0.0
    fastest_at = begins
    before: tuple[float, float, float] | None = None
    for number in range(count):
        at_s = usable * number / (count - 1)
        utc = begins + timedelta(seconds=at_s)
        rates = mount_rates(path, utc, epoch, 2.0 * _STEP_S)
        later = mount_rates(path, utc + timedelta(seconds=2.0 * _STEP_S), epoch, 2.0 * _STEP_S)
        cosine = math.cos(math.radians(for_mount(path(utc), epoch, utc).dec_deg))
        east, north = rates.ra_arcsec_s * cosine, rates.dec_arcsec_s
        now = math.hypot(east, north)
        if now >= speed:
            speed, fastest_at = now, utc
        ra, dec = max(ra, abs(rates.ra_arcsec_s)), max(dec, abs(north))
        near = math.hypot((later.ra_arcsec_s - rates.ra_arcsec_s) * cosine, later.dec_arcsec_s - north) / (
            2.0 * _STEP_S
        )
        bends = max(bends, near if near > _ROUNDING_ARCSEC_S2 else 0.0)
        if before is not None and at_s > before[2]:
            bends = max(bends, math.hypot(east - before[0], north - before[1]) / (at_s - before[2]))
        before = east, north, at_s
    return OffsetRates(ra, dec), speed, bends, fastest_at
