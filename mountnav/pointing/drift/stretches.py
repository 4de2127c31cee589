"""A night's looks cut at moves and syncs: the drift of each stretch, and how long a slew takes to settle.

Drift is the change of seen minus believed: a guide pulse or a dither that the mount knows of changes both and
is no drift. Rates and jumps are found as in `mountnav.series.drift`, in looks instead of followed frames.

Settling is measured by the looks that follow each slew. A look outside the noise of the later ones says
"longer than this"; the first one after which all stay within the noise says "no longer than that". Without
the times at which slews ended nothing is known.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np

from mountnav.pointing.drift.values import Jump, Rates, Settling, Stretch
from mountnav.pointing.observation import PointingObservation
from mountnav.series.drift import Array, Drift, Track, fit_drift, joined, jumps
from mountnav.sky.chain import (
    hour_angle_to_icrs,
    icrs_to_apparent,
    icrs_to_hour_angle,
)
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Apparent, HourAngle, Site
from mountnav.sky.sphere import Offset, half_turn_deg, offset_arcsec, separation_arcsec

MOVED_ARCSEC = 120.0
"""A reading that changes by more was moved; guiding and rounding change less."""
# A step of the offset between looks that is larger than this, arcsec, parts a stretch. Chosen by hand.
# Doubled, smaller jumps count as drift.
JUMP_ARCSEC = 3.0
# Least cos δ (1.1° from the pole) that right ascension is divided by, so that no angle is infinite.
_NEAR_POLE_COS = 0.02


@dataclass(frozen=True, slots=True)
class Looks:
    """Looks between two moves, as numbers.

    Attributes
    ----------
    seconds : ndarray, shape (n,)
        Since the first look.
    east, north : ndarray, shape (n,)
        Seen minus believed minus refraction's own drift, arcsec.
    sigma : ndarray, shape (n,)
        One sigma of each look.
    refraction : ndarray, shape (n, 2)
        What was taken off.
    """

    observations: tuple[PointingObservation, ...]
    seconds: Array
    east: Array
    north: Array
    sigma: Array
    refraction: Array
    ha_deg: float
    dec_deg: float

    def track(self) -> Track:
        """As a track about the origin, where east is a difference of right ascension."""
        n = self.seconds.size
        return Track(
            self.seconds / 60.0,
            self.east / 3600.0,
            self.north / 3600.0,
            self.sigma,
            np.zeros(n, dtype=np.int64),
            np.zeros(n),
        )


def cut(
    observations: Sequence[PointingObservation], moved_arcsec: float
) -> list[tuple[PointingObservation, ...]]:
    """Cut where the reading moved, the segment or the side of the pier changed."""
    parts: list[list[PointingObservation]] = []
    last: PointingObservation | None = None
    for one in sorted(observations, key=lambda each: each.utc):
        if last is None or _moved(last, one, moved_arcsec):
            parts.append([])
        parts[-1].append(one)
        last = one
    return [tuple(part) for part in parts]


def _moved(last: PointingObservation, one: PointingObservation, moved_arcsec: float) -> bool:
    if (
        one.segment_id != last.segment_id
        or one.side is not last.side
        or type(one.reading) is not type(last.reading)
    ):
        return True
    a, b = last.reading, one.reading
    if isinstance(a, Apparent):
        assert isinstance(b, Apparent)
        return separation_arcsec(Apparent(a.ra_deg, a.dec_deg, b.utc), b) > moved_arcsec
    assert not isinstance(b, Apparent)
    return separation_arcsec(a, b) > moved_arcsec


def looks_of(part: tuple[PointingObservation, ...], site: Site, *, refracts: bool) -> Looks:
    """Make numbers of a stretch.

    Parameters
    ----------
    refracts : bool
        The mount corrects refraction itself: nothing is taken off.
    """
    start = part[0].utc
    offsets = [_offset(one) for one in part]
    natural = [Offset(0.0, 0.0) if refracts else _refraction_drift(part[0], one, site) for one in part]
    seconds = np.array([(one.utc - start).total_seconds() for one in part])
    middle = part[len(part) // 2]
    angle = icrs_to_hour_angle(middle.seen, middle.utc, site, middle.air)
    taken = np.array([(one.east_arcsec, one.north_arcsec) for one in natural])
    seen = np.array([(one.east_arcsec, one.north_arcsec) for one in offsets])
    return Looks(
        part,
        seconds,
        seen[:, 0] - taken[:, 0],
        seen[:, 1] - taken[:, 1],
        np.array([max(one.sigma_arcsec, 0.01) for one in part]),
        taken,
        angle.ha_deg,
        angle.dec_deg,
    )


def _offset(one: PointingObservation) -> Offset:
    if isinstance(one.reading, Apparent):
        reading = Apparent(one.reading.ra_deg, one.reading.dec_deg, one.utc)
        return offset_arcsec(icrs_to_apparent(one.seen, one.utc), reading)
    return offset_arcsec(one.seen, one.reading)


def _refraction_drift(first: PointingObservation, one: PointingObservation, site: Site) -> Offset:
    """Where a tube that turns evenly about the pole comes to look, for refraction alone."""
    if first.air.pressure_hpa <= 0.0:
        return Offset(0.0, 0.0)
    start = icrs_to_hour_angle(first.seen, first.utc, site, first.air)
    turned = SIDEREAL_DEG_S * (one.utc - first.utc).total_seconds()
    now = HourAngle(half_turn_deg(start.ha_deg + turned), start.dec_deg, one.utc)
    return offset_arcsec(hour_angle_to_icrs(now, site, first.air), first.seen)


def stretch_of(looks: Looks) -> tuple[Stretch, Drift | None]:
    """Fit the drift of a stretch, cut at its jumps."""
    track = looks.track()
    n = len(track)
    edges = [0, *jumps(track, JUMP_ARCSEC), n]
    bounds = list(pairwise(edges))
    drift = joined([one for one in (fit_drift(track.part(*each)) for each in bounds) if one is not None])
    natural = _straight(looks.seconds, looks.refraction)
    first, last = looks.observations[0], looks.observations[-1]
    rates = None
    if drift is not None:
        rates = Rates(
            drift.ra_arcsec_min * 60.0,
            drift.dec_arcsec_min * 60.0,
            drift.ra_sigma_arcsec_min * 60.0,
            drift.dec_sigma_arcsec_min * 60.0,
        )
    stretch = Stretch(
        start=first.utc,
        stop=last.utc,
        looks=n,
        ha_deg=looks.ha_deg,
        dec_deg=looks.dec_deg,
        rates=rates,
        refraction=natural if np.any(looks.refraction) else None,
        rms_arcsec=drift.rms_arcsec if drift else None,
        jumps=tuple(_jump(looks, at, drift) for at in edges[1:-1]),
        reason="" if drift else f"{n} looks without a move or jump between them, 3 are needed",
    )
    return stretch, drift


def _straight(seconds: Array, values: Array) -> Rates | None:
    if seconds.size < 2 or np.ptp(seconds) <= 0.0:
        return None
    slope = np.polynomial.polynomial.polyfit(seconds / 3600.0, values, 1)[1]
    return Rates(float(slope[0]), float(slope[1]), 0.0, 0.0)


def _jump(looks: Looks, at: int, drift: Drift | None) -> Jump:
    minutes = float(looks.seconds[at] - looks.seconds[at - 1]) / 60.0
    east, north = float(looks.east[at] - looks.east[at - 1]), float(looks.north[at] - looks.north[at - 1])
    sigma = math.hypot(float(looks.sigma[at]), float(looks.sigma[at - 1]))
    if drift is not None:
        east, north = east - drift.ra_arcsec_min * minutes, north - drift.dec_arcsec_min * minutes
        sigma = math.hypot(sigma, minutes * math.hypot(drift.ra_sigma_arcsec_min, drift.dec_sigma_arcsec_min))
    return Jump(looks.observations[at].utc, east, north, sigma)


def sky_cosine(dec_deg: float) -> float:
    """Cosine of a declination, kept off zero."""
    return max(abs(math.cos(math.radians(dec_deg))), _NEAR_POLE_COS)


# A stretch whose first look is later than this after a slew, s, tells nothing of settling. Chosen by hand.
LATEST_S = 600.0
# A look is outside the noise beyond so many sigmas. Chosen by hand: one in 2,000 honest values is.
_WITHIN_SIGMAS = 3.5
# Looks that say where the tube comes to rest: a line and its scatter take three.
_REST_LOOKS = 3


def settling(
    stretches: Sequence[tuple[Looks, Drift | None]], slew_ends: Sequence[datetime]
) -> tuple[Settling | None, str]:
    """Measure the settle time; None, and why, if it can't be.

    Parameters
    ----------
    slew_ends : sequence of datetime
        When slews arrived.
    """
    if not slew_ends:
        return None, "the ends of slews aren't known"
    lower, upper, both = [], [], []
    for looks, _ in stretches:
        before = [one for one in slew_ends if one <= looks.observations[0].utc]
        if not before:
            continue
        since = (looks.observations[0].utc - max(before)).total_seconds()
        if since > LATEST_S:
            continue
        limits = _limits(looks, since)
        if limits is None:
            continue
        low, high = limits
        upper.append(high)
        if low is not None:
            lower.append(low)
            both.append((low, high))
    if not upper:
        return None, f"no slew was followed by {_REST_LOOKS + 1} looks, the first within {LATEST_S:.0f} s"
    typical = sigma = None
    if both:
        middles = np.array([0.5 * (low + high) for low, high in both])
        widths = np.array([(high - low) / np.sqrt(12.0) for low, high in both])
        typical = float(np.median(middles))
        sigma = float(np.sqrt(np.mean(widths**2) + np.var(middles)) / np.sqrt(len(both)))
    return (
        Settling(
            least_s=max(lower) if lower else None,
            most_s=max(upper),
            typical_s=typical,
            sigma_s=sigma,
            slews=len(upper),
        ),
        "",
    )


def _limits(looks: Looks, since_s: float) -> tuple[float | None, float] | None:
    """Longer than, no longer than (s after the slew); the place of rest is that of the later looks."""
    n = looks.seconds.size
    if n < _REST_LOOKS + 1:
        return None
    rest = slice(max(n // 2, 1), n)
    if n - rest.start < _REST_LOOKS:
        rest = slice(n - _REST_LOOKS, n)
    off = np.zeros(n)
    for values in (looks.east, looks.north):
        line = np.polynomial.polynomial.polyfit(
            looks.seconds[rest], values[rest], 1 if n - rest.start >= 4 else 0
        )
        left = values - np.polynomial.polynomial.polyval(looks.seconds, line)
        spread = float(np.std(left[rest], ddof=min(2, n - rest.start - 1)))
        # the line is less sure where it is carried on to
        reach = 1.0 + np.abs(looks.seconds - looks.seconds[rest].mean()) / max(
            np.ptp(looks.seconds[rest]), 1.0
        )
        off = np.maximum(off, np.abs(left) / (np.maximum(looks.sigma, spread) * reach))
    outside = np.flatnonzero(off > _WITHIN_SIGMAS)
    outside = outside[outside < rest.start]
    if outside.size == 0:
        return None, since_s
    last = int(outside[-1])
    return since_s + float(looks.seconds[last]), since_s + float(looks.seconds[last + 1])
