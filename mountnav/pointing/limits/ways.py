"""Whether a way is allowed: every place is looked at that the tube may pass.

Each axis turns straight to its end, but how the two share the time is known only roughly. So the way is an
area in the plane of the two angles: all points (u, v) that both axes can have covered, with second-axis
rate over first-axis rate anywhere between two bounds, and one starting up to some degrees late; without
bounds it is the whole rectangle between start and end. The area is looked at in steps of 2°, and of 0.33°
where a limit is near.

A way that starts outside a limit is looked at along single paths instead: none may lead deeper outside at any
moment, and once inside it has to stay there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import LimitKind
from mountnav.pointing.limits.directions import Directions, Floats, of_axes
from mountnav.pointing.limits.postures import Standing, Way
from mountnav.pointing.limits.scene import Scene
from mountnav.sky.sphere import half_turn_deg

# Cells in which the area of a slew is looked at first, degrees. Chosen for speed: the reach of each look
# covers its cell, so nothing is missed.
_COARSE_DEG = 2.0
# Parts of a coarse cell's side in the fine search: 0.33° each. Chosen for speed.
_PARTS = 6
# How far round a fine point the horizon counts, degrees: more than half the diagonal of a fine cell, 0.24°.
_FINE_REACH_DEG = 0.25
# A way that starts outside a limit leads deeper when it gets so much worse, degrees. Chosen by hand.
_DEEPER_DEG = 0.05
# Paths tried between the lowest and the highest ratio of both axes' rates. Chosen for speed.
_PATHS = 9
# Ratio of both axes' rates that is allowed for where their rates aren't known. Chosen by hand, wide.
_STEEPEST = 30.0

LATE_START_DEG = 3.0
"""So far one axis may have turned before the other begins."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """A place on a way that isn't allowed.

    Attributes
    ----------
    depth_deg : float
        How deep outside.
    az_deg, alt_deg : float
        Where.
    share : float
        How much of the way lies before it, 0 to 1.
    started_outside : bool
        Whether the way began outside this limit, and leads deeper.
    """

    limit: LimitKind
    depth_deg: float
    az_deg: float
    alt_deg: float
    share: float
    started_outside: bool = False


def trouble_on(way: Way, scene: Scene) -> Trouble | None:
    """Find the first place on a way, its start and end included, that the limits of the sky don't allow.

    Returns
    -------
    Trouble or None
        None: the way is allowed.
    """
    area = _Area(way, scene)
    outside = {
        limit
        for limit, depth in scene.depths(area.seen(np.zeros(1), np.zeros(1)), standing=False).items()
        if depth[0] > 0.0
    }
    trouble = area.first_trouble(outside)
    if trouble is None and outside:
        trouble = area.first_deeper(outside)
    return trouble


def strays_deg(ways: Iterable[Way], at: Standing) -> float:
    """How far a standing is from what the axes pass on any of these ways.

    Returns
    -------
    float
        Degrees on the sky, 0 on the way; infinite if there is no way.
    """
    nearest = math.inf
    for way in ways:
        begins, ends = sorted((way.start.first_deg, way.end.first_deg))
        low, high = sorted((way.start.second_deg, way.end.second_deg))
        middle = 0.5 * (begins + ends)
        first = middle + half_turn_deg(at.first_deg - middle)
        u = max(begins - first, first - ends, 0.0) * abs(math.cos(math.radians(at.second_deg)))
        nearest = min(nearest, math.hypot(u, max(low - at.second_deg, at.second_deg - high, 0.0)))
    return nearest


class _Area:
    """The area that a way may cover: u and v degrees of the first and the second axis from the start."""

    def __init__(self, way: Way, scene: Scene) -> None:
        self._way, self._scene = way, scene
        first = way.end.first_deg - way.start.first_deg
        second = way.end.second_deg - way.start.second_deg
        self._signs = math.copysign(1.0, first), math.copysign(1.0, second)
        self._width, self._height = abs(first), abs(second)
        self._ratio = scene.limits.rate_ratio

    def seen(self, u: Floats, v: Floats) -> Directions:
        """Where the tube looks; shapes broadcast."""
        start = self._way.start
        return of_axes(
            start.first_deg + self._signs[0] * u,
            start.second_deg + self._signs[1] * v,
            start.mounting,
            self._scene.site.latitude_deg,
        )

    def _covers(self, u: Floats, v: Floats, wider_deg: float = 0.0) -> NDArray[np.bool_]:
        if self._ratio is None:
            return np.broadcast_to(np.True_, np.broadcast_shapes(u.shape, v.shape))
        low, high = self._ratio
        late = LATE_START_DEG + wider_deg
        # an axis that has arrived waits for the other one
        not_early = (v <= high * (u + wider_deg) + late) | (u >= self._width - wider_deg)
        not_late = (u <= (v + wider_deg) / low + late) | (v >= self._height - wider_deg)
        return np.asarray(not_early & not_late)

    def first_trouble(self, but: set[LimitKind]) -> Trouble | None:
        """First place outside any limit `but` these."""
        u = _steps(self._width, _COARSE_DEG)[None, :]
        v = _steps(self._height, _COARSE_DEG)[:, None]
        mask = self._covers(u, v, _COARSE_DEG)
        u_near, v_near = (np.broadcast_to(one, mask.shape)[mask] for one in (u, v))
        # no point is farther from one of these than half the diagonal of a cell
        depths = self._scene.depths(self.seen(u_near, v_near), standing=False, reach_deg=0.75 * _COARSE_DEG)
        doubtful = np.zeros(u_near.shape, dtype=np.bool_)
        for limit, depth in depths.items():
            if limit not in but:
                doubtful |= depth > 0.0
        if not np.any(doubtful):
            return None
        u_near, v_near = self._finer(u_near[doubtful], v_near[doubtful])
        mask = self._covers(u_near, v_near)
        u_near, v_near = u_near[mask], v_near[mask]
        seen = self.seen(u_near, v_near)
        share = (u_near + v_near) / max(self._width + self._height, 1e-9)
        worst: Trouble | None = None
        for limit, depth in self._fine_depths(seen).items():
            if limit in but:
                continue
            bad = np.flatnonzero(depth > 1e-9)
            if bad.size and (worst is None or share[bad].min() < worst.share):
                index = int(bad[np.argmin(share[bad])])
                worst = _trouble(limit, depth, seen, index, float(share[index]))
        return worst

    def _fine_depths(self, seen: Directions) -> dict[LimitKind, Floats]:
        depths = self._scene.depths(seen, standing=False)
        if LimitKind.HORIZON in depths:
            # all other limits are smooth; a pole on the horizon may stand between two steps
            near = self._scene.depths(seen, standing=False, reach_deg=_FINE_REACH_DEG)[LimitKind.HORIZON]
            depths[LimitKind.HORIZON] = near - _FINE_REACH_DEG
        return depths

    def _finer(self, u: Floats, v: Floats) -> tuple[Floats, Floats]:
        """All points of the cells round these, in small steps, none outside the area's rectangle."""
        part = ((np.arange(_PARTS) + 0.5) / _PARTS - 0.5) * _COARSE_DEG
        du, dv = np.meshgrid(part, part)
        fine_u = np.clip(u[:, None] + du.ravel()[None, :], 0.0, self._width)
        fine_v = np.clip(v[:, None] + dv.ravel()[None, :], 0.0, self._height)
        return fine_u.ravel(), fine_v.ravel()

    def first_deeper(self, outside: set[LimitKind]) -> Trouble | None:
        """First place where a single path leads deeper outside a limit outside of which it starts."""
        for u, v in self._paths():
            seen = self.seen(u, v)
            share = (u + v) / max(self._width + self._height, 1e-9)
            for limit, depth in self._scene.depths(seen, standing=False).items():
                if limit not in outside:
                    continue
                least = np.minimum.accumulate(np.concatenate((depth[:1], depth[:-1])))
                bad = np.flatnonzero(depth > np.where(least > 0.0, least + _DEEPER_DEG, 1e-9))
                if bad.size:
                    index = int(bad[0])
                    return _trouble(limit, depth, seen, index, float(share[index]), True)
        return None

    def _paths(self) -> list[tuple[Floats, Floats]]:
        low, high = self._ratio or (1.0 / _STEEPEST, _STEEPEST)
        paths = []
        for ratio in np.geomspace(low, high, _PATHS):
            # the first axis turns 1° in a unit of time, the second `ratio`
            ends = sorted((self._width, self._height / float(ratio)))
            count = math.ceil((self._width + self._height) * _PARTS / _COARSE_DEG) + 1
            t = np.concatenate((np.linspace(0.0, ends[0], count), np.linspace(ends[0], ends[1], count)))
            paths.append((np.minimum(t, self._width), np.minimum(ratio * t, self._height)))
        return paths


def _steps(length: float, step: float) -> Floats:
    return np.linspace(0.0, length, math.ceil(length / step) + 1)


def _trouble(
    limit: LimitKind, depth: Floats, seen: Directions, index: int, share: float, started: bool = False
) -> Trouble:
    az_deg = float(np.mod(seen.azimuth_deg[index], 360.0))
    return Trouble(limit, float(depth[index]), az_deg, float(seen.altitude_deg[index]), share, started)
