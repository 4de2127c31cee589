"""Hypotheses about a night's offsets: epoch, slips, wrong looks, hemisphere, and what zero points tell.

Each pattern of offsets is one more fit. Those that may sit at any look (slips, wrong looks) are tried where
the plain differences jump most, and their prior is divided by the number of looks where they might have been.

A turn about the pole alone is a wrong clock, a wrong longitude, or a zero point that nobody set. All three
are the same rotation, so that only their sizes part them: whole hours, twice the longitude [POINTING §9]. A
segment that begins with a sync hides them, therefore each segment counts for itself.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from mountnav.pointing.doctor.evidence import Fit, Fitted, Zeros
from mountnav.pointing.doctor.facts import Array, Facts, from_altaz, to_altaz, wrapped, wrapped_deg
from mountnav.pointing.doctor.findings import Illness
from mountnav.pointing.doctor.priors import (
    HOUR_SHARES,
    POLE_SYNC,
    POLE_SYNC_SIGMA_DEG,
    SHAPES,
    SLIP_SIGMA_DEG,
    UNALIGNED_SIGMA_DEG,
    WRONG_LOOK_SIGMA_DEG,
    ZERO_SIGMA_DEG,
    ZEROS,
)
from mountnav.sky.coordinates import SOLAR_TO_SIDEREAL, Site
from mountnav.units import RAD_PER_ARCSEC

# Of a longer night's looks, so many candidates are tried for a slip or a wrong look. Chosen for speed: each
# is a fit. Doubled, a diagnosis with many looks takes about twice as long.
_TRIED = 3
# Sizes of offsets that follow no rule, degrees, each with a third of the probability. Chosen by hand to
# span a small mistake and any direction at all.
_UNKNOWN_DEG = (0.3, 5.0, 60.0)


@dataclass(frozen=True, slots=True)
class Shape:
    """A hypothesis and how it fares.

    Attributes
    ----------
    illness : Illness or None
        None: healthy.
    log_weight : float
        Logarithm of prior times evidence.
    fitted : Fitted or None
        None for the unknown.
    axis : {"", "IH", "ID"}
        Of a slip.
    at : int
        First look after a slip; the wrong look; whole hours of a clock.
    """

    illness: Illness | None
    log_weight: float
    fitted: Fitted | None
    axis: str = ""
    at: int = -1


def shapes(
    facts: Facts, fit: Fit, zeros: Zeros, *, equatorial: bool = True, site: Site | None = None
) -> list[Shape]:
    """Weigh all hypotheses, healthy first.

    For an alt-azimuth mount a wrong clock is a pattern too, as its zero points are no turn about the pole; it
    takes the `site`.
    """
    healthy = fit.fitted(facts.read_lon, facts.read_lat, zeros)
    found = [Shape(None, _weighed(None, healthy), healthy)]
    other = fit.fitted(facts.other_lon, facts.other_lat, zeros)
    found.append(Shape(Illness.EPOCH, _weighed(Illness.EPOCH, other), other))
    if len(facts) < 2:
        return found
    if _ordinary(healthy, facts):
        return found
    if equatorial:
        # unsynced: its zero points are what they would be, were it not for the signs
        near = np.where(np.isnan(zeros.sigma), zeros.sigma, math.radians(UNALIGNED_SIGMA_DEG))
        turned = fit.fitted(
            facts.read_lon, facts.read_lat, Zeros(zeros.lon, zeros.lat, near, zeros.names), sense=-1.0
        )
        found.append(Shape(Illness.HEMISPHERE, _weighed(Illness.HEMISPHERE, turned), turned))
    elif site is not None:
        found += _clocks(facts, fit, zeros, site)
    found += _slips(facts, fit, zeros)
    found += _wrong_looks(facts, fit, zeros)
    found.append(Shape(Illness.UNKNOWN, math.log(SHAPES[Illness.UNKNOWN]) + _nothing_known(facts), None))
    return found


def _weighed(illness: Illness | None, fitted: Fitted, share: float = 1.0) -> float:
    return math.log(SHAPES[illness] * share) + fitted.log_evidence


def _ordinary(fitted: Fitted, facts: Facts) -> bool:
    """Nothing sticks out of a fit with little noise and ordinary terms: no need to look for jumps."""
    beyond = float(np.max(np.hypot(*fitted.misses.T))) / RAD_PER_ARCSEC
    ordinary = abs(fitted.best[:4]) / RAD_PER_ARCSEC < np.array([2700.0, 720.0, 5400.0, 5400.0])
    return bool(fitted.noise_arcsec <= 60.0 and beyond < 240.0 and ordinary.all()) and len(facts) > 8


def _differences(facts: Facts) -> tuple[Array, Array]:
    """Seen minus read of each axis (rad), the hour angle's not blown up near the pole."""
    lon = wrapped(facts.lon - facts.read_lon) * np.cos(facts.lat)
    return lon, (facts.lat - facts.read_lat) * np.where(facts.west, -1.0, 1.0)


def _clocks(facts: Facts, fit: Fit, zeros: Zeros, site: Site) -> list[Shape]:
    """A sky turned about the pole by whole hours, or by twice the longitude, under alt-azimuth axes."""
    latitude = math.radians(site.latitude_deg)
    reads = from_altaz(np.column_stack((facts.read_lon, facts.read_lat)), latitude)
    rest = (1.0 - sum(HOUR_SHARES.values())) / 22.0
    reasons = [
        (Illness.CLOCK, hours * 15.0 * SOLAR_TO_SIDEREAL, hours, HOUR_SHARES.get(hours, rest))
        for hours in (*range(-12, 0), *range(1, 13))
    ]
    reasons.append((Illness.LONGITUDE_SIGN, -2.0 * site.longitude_deg, 0, 0.5))
    tried = []
    for illness, turn_deg, hours, share in reasons:
        turned = to_altaz(reads + np.array([math.radians(turn_deg), 0.0]), latitude)
        lon = wrapped(facts.lon - turned[:, 0])
        lon = wrapped(lon - np.angle(np.sum(np.exp(1j * lon)))) * np.cos(facts.lat)
        lat = facts.lat - turned[:, 1]
        scatter = float(np.sum(lon**2) + np.sum((lat - lat.mean()) ** 2))
        tried.append((scatter, illness, turned, hours, share))
    found = []
    for _, illness, turned, hours, share in sorted(tried, key=lambda one: one[0])[:2]:
        fitted = fit.fitted(turned[:, 0], turned[:, 1], zeros)
        weight = math.log(ZEROS[illness] * share) + fitted.log_evidence
        found.append(Shape(illness, weight, fitted, at=hours))
    return found


def _slips(facts: Facts, fit: Fit, zeros: Zeros) -> list[Shape]:
    segments = np.array(facts.segments)
    gaps = [number for number in range(1, len(facts)) if segments[number] == segments[number - 1]]
    if not gaps:
        return []
    found = []
    for axis, difference in zip(("IH", "ID"), _differences(facts), strict=True):
        tried = sorted(gaps, key=lambda gap: _split(difference, segments, gap))
        for gap in tried if len(facts) <= 5 else tried[:_TRIED]:
            after = ((np.arange(len(facts)) >= gap) & (segments == segments[gap])).astype(float)
            nought = np.zeros(len(facts))
            lon, lat = (after, nought) if axis == "IH" else (nought, after)
            slipped = fit.fitted(
                facts.read_lon,
                facts.read_lat,
                zeros.with_columns(lon, lat, math.radians(SLIP_SIGMA_DEG), "slip"),
            )
            weight = _weighed(Illness.SLIPPED, slipped, 1.0 / (2 * len(gaps)))
            found.append(Shape(Illness.SLIPPED, weight, slipped, axis, gap))
    return found


def _split(difference: Array, segments: Array, gap: int) -> float:
    """Scatter that is left when the segment is cut there."""
    same = segments == segments[gap]
    before, after = same.copy(), same.copy()
    before[gap:] = False
    after[:gap] = False
    return float(sum(np.var(difference[part]) * part.sum() for part in (before, after)))


def _wrong_looks(facts: Facts, fit: Fit, zeros: Zeros) -> list[Shape]:
    if len(facts) < 3:
        return []
    lon, lat = _differences(facts)
    away = np.hypot(lon - np.median(lon), lat - np.median(lat))
    sigma = math.radians(WRONG_LOOK_SIGMA_DEG)
    # a look that is alone in its segment contradicts nothing
    company = [facts.segments.count(one) for one in facts.segments]
    order = [int(one) for one in np.argsort(-away) if company[int(one)] > 1]
    found = []
    for number in order if len(facts) <= 5 else order[:_TRIED]:
        rest = np.arange(len(facts)) != number
        others = facts.part(rest)
        kept = Zeros(zeros.lon[rest], zeros.lat[rest], zeros.sigma, zeros.names)
        fitted = fit.of_part(rest).fitted(others.read_lon, others.read_lat, kept)
        # anywhere within some degrees, and turned anyhow
        chance = -2.0 * math.log(sigma) - math.log(2.0 * math.pi) - 0.5 * float(away[number] / sigma) ** 2
        if np.isfinite(facts.turned[number]):
            chance -= math.log(2.0 * math.pi)
        weight = _weighed(Illness.WRONG_LOOK, fitted, 1.0 / len(facts)) + chance
        found.append(Shape(Illness.WRONG_LOOK, weight, fitted, at=number))
    return found


def _nothing_known(facts: Facts) -> float:
    """Evidence of offsets that follow no rule: each look off by some degrees, whatever the others say."""
    lon, lat = _differences(facts)
    logs = []
    for degrees in _UNKNOWN_DEG:
        sigma = math.radians(degrees)
        total = 0.0
        for segment in dict.fromkeys(facts.segments):
            mask = np.array([one == segment for one in facts.segments])
            for difference in (lon[mask], lat[mask]):
                off = (difference - float(np.mean(difference))) / sigma
                total += float(np.sum(-0.5 * off**2 - 0.5 * math.log(2.0 * math.pi) - math.log(sigma)))
                # the zero point is as free as in the other hypotheses
                total += math.log(sigma / math.sqrt(mask.sum()) / math.pi)
        logs.append(total)
    turned = -math.log(2.0 * math.pi) * int(np.isfinite(facts.turned).sum())
    return float(np.logaddexp.reduce(logs)) - math.log(len(logs)) + turned


# Probability that a segment began with a sync that hides its zero point, where that isn't known: even odds.
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
        None: it is none.
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
