"""When a target will next be allowed: it sets and rises, and the Sun goes."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import LimitKind
from mountnav.pointing.limits.directions import Floats, of_axes
from mountnav.pointing.limits.postures import Standing
from mountnav.pointing.limits.scene import Scene
from mountnav.sky.chain import hour_angle_to_observed, icrs_to_hour_angle, icrs_to_observed
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs, Site
from mountnav.units import SECONDS_PER_DAY

if TYPE_CHECKING:
    from mountnav.pointing.limits.bounds import Limits

_SIDEREAL_DEG_PER_DAY = SIDEREAL_DEG_S * SECONDS_PER_DAY
_PRECISION = timedelta(seconds=1)
# Step of the search, s; what is allowed for less than this may be missed. Chosen by hand for speed.
_SCAN_S = 60.0


def place_depths(limits: Limits, target: Icrs, utc: datetime, site: Site, air: Air) -> dict[LimitKind, float]:
    """How deep outside each limit of the sky a target stands at an instant; no margins."""
    scene = Scene(limits, utc, site)
    here = icrs_to_hour_angle(target, utc, site, air)
    return {kind: float(depth[0]) for kind, depth in _depths(scene, here, np.zeros(1)).items()}


def _depths(scene: Scene, here: HourAngle, later_s: Floats) -> dict[LimitKind, Floats]:
    ha_deg = here.ha_deg + SIDEREAL_DEG_S * later_s
    seen = of_axes(ha_deg, np.full(later_s.shape, here.dec_deg), "fork", scene.site.latitude_deg)
    margin = scene.limits.margin_deg
    found = {
        limit: depth if limit is LimitKind.DAYLIGHT else depth - margin
        for limit, depth in scene.depths(seen, standing=True, later_s=later_s).items()
    }
    if scene.limits.horizon is not None:  # the margin also widens its edges
        found[LimitKind.HORIZON] = scene.limits.horizon.altitudes(seen.azimuth_deg) - seen.altitude_deg
    if scene.limits.hour_angle_deg is not None:
        fork = Standing("fork", PierSide.UNKNOWN, here.ha_deg, here.dec_deg)
        found[LimitKind.HOUR_ANGLE] = scene.axis_depths(fork, ha_deg)[LimitKind.HOUR_ANGLE] - margin
    return found


def next_allowed(limits: Limits, target: Icrs, utc: datetime, site: Site, air: Air) -> datetime | None:
    """Find the first instant within 24 hours at which a target is allowed; see `Limits.next_allowed`."""

    def allowed(at: datetime) -> bool:
        return all(depth <= 0.0 for depth in place_depths(limits, target, at, site, air).values())

    if allowed(utc):
        return utc
    if _altitude_only(limits):
        return _next_altitude(limits, target, utc, site, air)
    # the sky turns evenly but for refraction and the Sun's own way: a guess, then the truth
    scene = Scene(limits, utc, site)
    here = icrs_to_hour_angle(target, utc, site, Air())
    later_s = np.arange(0.0, SECONDS_PER_DAY + _SCAN_S, _SCAN_S)
    # refraction turns the hour angle of what is near the pole by degrees
    near = {LimitKind.HOUR_ANGLE: 0.7 + 0.2 / max(math.cos(math.radians(here.dec_deg)), 5e-4)}
    depths = _depths(scene, here, later_s)
    inside = np.all([depth <= near.get(limit, 0.7) for limit, depth in depths.items()], axis=0)
    before = utc
    for guess_s in later_s[np.flatnonzero(inside)]:
        at = utc + timedelta(seconds=float(min(guess_s, SECONDS_PER_DAY)))
        if at > before and allowed(at):
            start = max(before, at - timedelta(seconds=_SCAN_S))
            return at if allowed(start) else _first_true(allowed, start, at)
        before = max(before, at - timedelta(seconds=_SCAN_S))
    return None


def _altitude_only(limits: Limits) -> bool:
    asked = (limits.horizon, limits.hour_angle_deg, limits.declination_deg)
    cones = limits.sun_cone_deg > 0.0 or limits.moon_cone_deg > 0.0
    return all(one is None for one in asked) and not cones and limits.daylight == "allow"


def _next_altitude(limits: Limits, target: Icrs, utc: datetime, site: Site, air: Air) -> datetime | None:
    """As `next_allowed`, with no limits but of altitude: to the second however short it is allowed.

    Between one culmination and the next the altitude only rises or only falls, so that one crossing
    at most lies between two of them, and is found by halving.
    """

    def altitude_deg(at: datetime) -> float:
        return icrs_to_observed(target, at, site, air).alt_deg

    now = icrs_to_hour_angle(target, utc, site, air)
    if limits.allow(hour_angle_to_observed(now, site).alt_deg):
        return utc
    end = utc + timedelta(days=1)
    to_culmination_deg = (-now.ha_deg) % 180.0
    half_turn = timedelta(days=180.0 / _SIDEREAL_DEG_PER_DAY)
    first = utc + timedelta(days=to_culmination_deg / _SIDEREAL_DEG_PER_DAY)
    marks = [utc, *(first + i * half_turn for i in range(3))]
    marks = [mark for mark in marks if mark < end] + [end]
    for start, stop in pairwise(marks):
        before_deg, after_deg = altitude_deg(start), altitude_deg(stop)
        if before_deg < limits.min_altitude_deg <= after_deg:
            return _first_true(lambda at: altitude_deg(at) >= limits.min_altitude_deg, start, stop)
        if before_deg > limits.max_altitude_deg >= after_deg:
            return _first_true(lambda at: altitude_deg(at) <= limits.max_altitude_deg, start, stop)
    return None


def _first_true(holds: Callable[[datetime], bool], start: datetime, stop: datetime) -> datetime:
    """When a condition begins to hold that does not at `start` but does at `stop`; to the second."""
    while stop - start > _PRECISION:
        middle = start + (stop - start) / 2
        if holds(middle):
            stop = middle
        else:
            start = middle
    whole = stop.replace(microsecond=0) + _PRECISION
    return whole if holds(whole) else stop
