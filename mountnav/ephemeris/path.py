"""A way by waypoints: places at times, joined smoothly on the sphere, with an end.

Between two waypoints runs a cubic of Bézier's on the sphere: its control points lie along the tangents, and
straight lines are great circles [Shoemake 1985, De Casteljau's construction by slerp]. The tangent of a
waypoint is that of the parabola through it and its neighbors, so that place and rate are without a step,
whatever the times, at the poles too. Two waypoints make an even motion on a great circle.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.ephemeris.ephemeris import require_within
from mountnav.errors import BadRequest
from mountnav.sky.chain import observed_to_icrs
from mountnav.sky.coordinates import Air, Icrs, Observed, Site
from mountnav.sky.observer import direction

Vector = NDArray[np.float64]

MOST_WAYPOINTS = 2000
"""Waypoints of a way: 8 h each 15 s. Doubled, an order is twice as long."""
_NO_AIR = Air()
_LONGEST_STEP_DEG = 120.0
"""Farthest two waypoints may lie apart: near 180° it isn't told which way round is meant."""
LONGEST_PATH = timedelta(days=30)
"""Longest time from the first to the last waypoint. Doubled, nothing breaks; a list for longer is a table."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A place at a time.

    Attributes
    ----------
    utc : datetime
        Aware.
    lon_deg, lat_deg : float
        Right ascension and declination (ICRS, astrometric), or azimuth and altitude (observed).
    """

    utc: datetime
    lon_deg: float
    lat_deg: float


def _unit(lon_deg: float, lat_deg: float) -> Vector:
    lon, lat = math.radians(lon_deg), math.radians(lat_deg)
    return np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])


def _toward(a: Vector, b: Vector) -> Vector:
    """Tangent at `a` that leads to `b`, as long as the arc, radians."""
    cross = float(np.linalg.norm(np.cross(a, b)))
    arc = math.atan2(cross, float(a @ b))
    if cross < 1e-15:
        return np.zeros(3)
    aside: Vector = b - a * float(a @ b)
    return aside * (arc / float(np.linalg.norm(aside)))


def _along(a: Vector, tangent: Vector) -> Vector:
    """Where one comes by a tangent."""
    arc = float(np.linalg.norm(tangent))
    if arc < 1e-15:
        return a
    return a * math.cos(arc) + tangent * (math.sin(arc) / arc)


def _slerp(a: Vector, b: Vector, part: float) -> Vector:
    return _along(a, _toward(a, b) * part)


@dataclass(frozen=True, slots=True)
class Path:
    """A target that goes from waypoint to waypoint.

    Attributes
    ----------
    waypoints : tuple of Waypoint
        At least two, in the order of their times.
    kind : {"icrs", "altaz"}
        What their numbers are.
    air : Air
        For ``altaz``.

    Raises
    ------
    BadRequest
        Too few or too many, times that don't grow, numbers out of range, or two that lie too far apart.
    """

    waypoints: tuple[Waypoint, ...]
    kind: Literal["icrs", "altaz"] = "icrs"
    air: Air = _NO_AIR
    name: str = "a path by waypoints"
    sigma_arcsec_told: float = 0.0
    _units: tuple[Vector, ...] = field(init=False, repr=False, compare=False)
    _tangents: tuple[Vector, ...] = field(init=False, repr=False, compare=False)
    _times_s: tuple[float, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Refuse what is no way; find the tangents."""
        points = self.waypoints
        if not 2 <= len(points) <= MOST_WAYPOINTS:
            raise BadRequest(f"a path has 2 to {MOST_WAYPOINTS} waypoints, not {len(points)}")
        for number, one in enumerate(points, 1):
            if one.utc.utcoffset() is None:
                raise BadRequest(
                    f"waypoint {number} doesn't say its time zone", advice="give UTC, ending in Z"
                )
            if not (-360.0 <= one.lon_deg <= 720.0 and -90.0 <= one.lat_deg <= 90.0):
                raise BadRequest(
                    f"waypoint {number} ({one.lon_deg}, {one.lat_deg}) is no place on the sphere"
                )
        if points[-1].utc - points[0].utc > LONGEST_PATH:
            raise BadRequest(f"a path lasts {LONGEST_PATH.days} days at most")
        times_s = tuple((one.utc - points[0].utc).total_seconds() for one in points)
        units = tuple(_unit(one.lon_deg, one.lat_deg) for one in points)
        for number, (before, after) in enumerate(pairwise(times_s), 2):
            if not before < after:
                raise BadRequest(f"waypoint {number} is no later than the one before it")
        for number, (start, end) in enumerate(pairwise(units), 2):
            arc_deg = math.degrees(float(np.linalg.norm(_toward(start, end))))
            if arc_deg > _LONGEST_STEP_DEG or float(start @ end) < -0.999999:
                raise BadRequest(
                    f"waypoint {number} lies {arc_deg:.0f}° from the one before it: which way round?",
                    advice=f"give more waypoints; {_LONGEST_STEP_DEG:g}° is the farthest",
                )
        object.__setattr__(self, "_times_s", times_s)
        object.__setattr__(self, "_units", units)
        object.__setattr__(self, "_tangents", _tangents(times_s, units))

    @property
    def begins_utc(self) -> datetime | None:
        """The first waypoint."""
        return self.waypoints[0].utc

    @property
    def ends_utc(self) -> datetime | None:
        """The last waypoint."""
        return self.waypoints[-1].utc

    def icrs(self, utc: datetime, site: Site) -> Icrs:
        """Where it stands. Raises `BadRequest` outside its span."""
        require_within(self.name, utc, self.begins_utc, self.ends_utc)
        here = direction(self._unit_at((utc - self.waypoints[0].utc).total_seconds()))
        if self.kind == "icrs":
            return here
        return observed_to_icrs(Observed(az_deg=here.ra_deg, alt_deg=here.dec_deg, utc=utc), site, self.air)

    def sigma_arcsec(self, utc: datetime) -> float:
        """As told."""
        return self.sigma_arcsec_told

    def _unit_at(self, since_s: float) -> Vector:
        row = min(max(bisect_right(self._times_s, since_s) - 1, 0), len(self._times_s) - 2)
        span_s = self._times_s[row + 1] - self._times_s[row]
        part = (since_s - self._times_s[row]) / span_s
        start, end = self._units[row], self._units[row + 1]
        controls = [
            start,
            _along(start, self._tangents[row] * (span_s / 3.0)),
            _along(end, self._tangents[row + 1] * (-span_s / 3.0)),
            end,
        ]
        while len(controls) > 1:
            controls = [_slerp(a, b, part) for a, b in pairwise(controls)]
        return controls[0]


def _tangents(times_s: Sequence[float], units: Sequence[Vector]) -> tuple[Vector, ...]:
    """Rate at each waypoint, radians per second along the sphere."""
    last = len(units) - 1
    found = []
    for row in range(last + 1):
        after = before = None
        if row < last:
            after = _toward(units[row], units[row + 1]) / (times_s[row + 1] - times_s[row])
        if row > 0:
            before = -_toward(units[row], units[row - 1]) / (times_s[row] - times_s[row - 1])
        if after is None or before is None:
            found.append(after if after is not None else before)
            continue
        ahead_s, behind_s = times_s[row + 1] - times_s[row], times_s[row] - times_s[row - 1]
        found.append((after * behind_s + before * ahead_s) / (ahead_s + behind_s))
    return tuple(one for one in found if one is not None)
