"""What zero points tell: a turn about the pole alone is a clock, a longitude, or a zero point nobody set.

All three are the same turn, so no look can tell them apart but by their sizes: whole hours, twice the
longitude [POINTING §9]. A segment that begins with a sync hides them: each segment counts for itself.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from mountnav.pointing.doctor.facts import wrapped_deg
from mountnav.pointing.doctor.findings import Illness
from mountnav.pointing.doctor.fit import Fitted
from mountnav.pointing.doctor.priors import (
    HOUR_SHARES,
    POLE_SYNC,
    POLE_SYNC_SIGMA_DEG,
    UNALIGNED_SIGMA_DEG,
    ZERO_SIGMA_DEG,
    ZEROS,
)
from mountnav.sky.turning import SOLAR_TO_SIDEREAL

_SYNCED = 0.5


@dataclass(frozen=True, slots=True)
class ZeroPoint:
    """Zero points of one segment, tube minus reading, deg."""

    segment: str
    ih_deg: float
    ih_sigma_deg: float
    id_deg: float
    id_sigma_deg: float


@dataclass(frozen=True, slots=True)
class Turn:
    """A reason for the zero points and how it fares.

    Attributes
    ----------
    illness : Illness or None
    log_weight : float
    hours : int
        Of a clock that is wrong by whole hours.
    segments : tuple of ZeroPoint
        Where it shows.
    """

    illness: Illness | None
    log_weight: float
    hours: int = 0
    segments: tuple[ZeroPoint, ...] = ()


def zero_points(fitted: Fitted, segments: Iterable[str]) -> list[ZeroPoint]:
    """Zero points of each segment, from a fit."""
    found = []
    for segment in dict.fromkeys(segments):
        (ih, ih_sigma), (dec, dec_sigma) = fitted.zero(f"IH {segment}"), fitted.zero(f"ID {segment}")
        found.append(
            ZeroPoint(
                segment,
                wrapped_deg(math.degrees(ih)),
                math.degrees(ih_sigma),
                wrapped_deg(math.degrees(dec)),
                math.degrees(dec_sigma),
            )
        )
    return found


def turns(
    points: list[ZeroPoint],
    longitude_deg: float,
    zero_sigma_deg: float = ZERO_SIGMA_DEG,
    synced: Collection[str] | None = None,
) -> list[Turn]:
    """Weigh all reasons, healthy first.

    Parameters
    ----------
    points : list of ZeroPoint
    longitude_deg : float
        Of the site; east positive.
    zero_sigma_deg : float
        How well a healthy mount knows its zero points.
    synced : collection of str, optional
        Segments that began with a sync: they tell nothing of clocks. None: it isn't known which did.
    """
    z = zero_sigma_deg
    if synced is None:
        healthy = [_maybe_synced(one, z) for one in points]
    else:
        points = [one for one in points if one.segment not in synced]
        healthy = [_at(one, 0.0, z, z) for one in points]
    base = math.log(ZEROS[None]) + sum(healthy)
    found = [Turn(None, base)]
    if not points:
        return found

    def weigh(illness: Illness, share: float, ill: list[float], hours: int = 0) -> None:
        # in each segment it shows, or a sync has hidden it
        gains = [a - b for a, b in zip(ill, healthy, strict=True)]
        shown = [math.log(_SYNCED) + float(np.logaddexp(0.0, gain)) for gain in gains]
        nowhere = len(points) * math.log(_SYNCED)
        # at least one segment has to show it
        total = sum(shown)
        total += math.log(max(-math.expm1(nowhere - total), 1e-12))
        where = tuple(one for one, gain in zip(points, gains, strict=True) if gain > 0.0) or tuple(points)
        found.append(Turn(illness, math.log(share) + base - math.log(ZEROS[None]) + total, hours, where))

    wide = UNALIGNED_SIGMA_DEG
    weigh(Illness.NOT_ALIGNED, ZEROS[Illness.NOT_ALIGNED], [_at(one, 0.0, wide, wide) for one in points])
    rest = (1.0 - sum(HOUR_SHARES.values())) / 22.0
    for hours in (*range(-12, 0), *range(1, 13)):
        share = ZEROS[Illness.CLOCK] * HOUR_SHARES.get(hours, rest)
        # a clock ahead makes the read right ascension too large, the read hour angle is the axis' own:
        # seen minus read hour angle grows with it
        turned = hours * 15.0 * SOLAR_TO_SIDEREAL
        weigh(Illness.CLOCK, share, [_at(one, turned, z, z) for one in points], hours)
    sign = [_at(one, -2.0 * longitude_deg, z, z) for one in points]
    weigh(Illness.LONGITUDE_SIGN, ZEROS[Illness.LONGITUDE_SIGN], sign)
    anywhere = [-math.log(360.0) + _normal(one.id_deg, math.hypot(one.id_sigma_deg, z)) for one in points]
    weigh(Illness.LONGITUDE, ZEROS[Illness.LONGITUDE], anywhere)
    return found


def _maybe_synced(one: ZeroPoint, z: float) -> float:
    """A healthy segment that may have begun with a sync anywhere, the pole's neighborhood included."""
    return float(
        np.logaddexp(
            math.log(1.0 - POLE_SYNC) + _at(one, 0.0, z, z),
            math.log(POLE_SYNC) + _at(one, 0.0, POLE_SYNC_SIGMA_DEG, z),
        )
    )


def _at(one: ZeroPoint, ih_deg: float, ih_wide: float, id_wide: float) -> float:
    return _normal(wrapped_deg(one.ih_deg - ih_deg), math.hypot(one.ih_sigma_deg, ih_wide)) + _normal(
        one.id_deg, math.hypot(one.id_sigma_deg, id_wide)
    )


def _normal(off: float, sigma: float) -> float:
    return -0.5 * (off / sigma) ** 2 - math.log(sigma) - 0.5 * math.log(2.0 * math.pi)
