"""What is allowed at one instant at one site: how deep outside each limit a direction or an axis angle lies.

Depths are degrees, above 0 outside, below 0 inside. Directions are observed (refracted) ones, as the
horizon is.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import TYPE_CHECKING

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import LimitKind
from mountnav.pointing.limits.bodies import MOON_DEG_PER_S, SUN_DEG_PER_S, Bodies, bodies
from mountnav.pointing.limits.directions import Directions, Floats, of_body
from mountnav.pointing.limits.postures import Standing
from mountnav.sky.coordinates import Site

if TYPE_CHECKING:
    from mountnav.pointing.limits.bounds import Limits

# Depth, degrees, that stands for "far inside a limit": below any angle there is.
_FAR_INSIDE_DEG = -999.0

Depths = dict[LimitKind, Floats]


@dataclass(frozen=True, slots=True)
class Scene:
    """The limits at an instant, with Sun and Moon where they are then."""

    limits: Limits
    utc: datetime
    site: Site

    @property
    def bodies(self) -> Bodies | None:
        """Sun and Moon, if any limit asks for them."""
        limits = self.limits
        asked = limits.sun_cone_deg > 0.0 or limits.moon_cone_deg > 0.0 or limits.daylight == "refuse"
        return bodies(self.utc, self.site) if asked else None

    def depths(
        self,
        seen: Directions,
        *,
        standing: bool,
        reach_deg: float = 0.0,
        later_s: Floats | float = 0.0,
    ) -> Depths:
        """How deep outside the limits of the sky directions lie.

        Parameters
        ----------
        standing : bool
            Whether the tube stands or tracks there, or only passes.
        reach_deg : float
            Each direction stands for all that are so near to it: the deepest of them counts.
        later_s : float or ndarray
            So much later than the scene; for the Sun and the Moon.

        Returns
        -------
        dict of LimitKind to ndarray
            Degrees, one a direction; 0 or less: inside.
        """
        limits = self.limits
        margin = limits.margin_deg + reach_deg
        altitude = seen.altitude_deg
        lowest = limits.min_altitude_deg
        if not standing and limits.way_min_altitude_deg is not None:
            lowest = min(lowest, limits.way_min_altitude_deg)
        found: Depths = {LimitKind.ALTITUDE: lowest + margin - altitude}
        if limits.max_altitude_deg < 90.0:
            above = altitude + margin - limits.max_altitude_deg
            found[LimitKind.ALTITUDE] = np.maximum(found[LimitKind.ALTITUDE], above)
        if limits.horizon is not None:
            found[LimitKind.HORIZON] = self._below_horizon(seen, altitude, margin)
        if limits.declination_deg is not None:
            dec = seen.declination_deg(self.site.latitude_deg)
            low, high = limits.declination_deg
            found[LimitKind.DECLINATION] = np.maximum(low - dec, dec - high) + margin
        known = self.bodies
        if known is not None:
            found |= self._near_bodies(known, seen, margin, later_s)
        return found

    def _below_horizon(self, seen: Directions, altitude: Floats, margin_deg: float) -> Floats:
        horizon = self.limits.horizon
        assert horizon is not None
        depth = horizon.highest_deg + margin_deg - altitude
        doubtful = depth > 0.0
        if np.any(doubtful):
            some = seen.chosen(doubtful)
            if margin_deg > 0.0:
                wide = margin_deg / np.maximum(np.cos(np.radians(altitude[doubtful])), 1e-6)
                edge = horizon.highest_near(some.azimuth_deg, wide)
            else:
                edge = horizon.altitudes(some.azimuth_deg)
            depth[doubtful] = edge + margin_deg - altitude[doubtful]
        return depth

    def _near_bodies(
        self, known: Bodies, seen: Directions, margin_deg: float, later_s: Floats | float
    ) -> Depths:
        limits, latitude_deg = self.limits, self.site.latitude_deg
        found: Depths = {}
        sun = of_body(known.sun, latitude_deg, SUN_DEG_PER_S * np.asarray(later_s))
        if limits.sun_cone_deg > 0.0:
            near = limits.sun_cone_deg + margin_deg - seen.separation_deg(sun)
            up = sun.altitude_deg >= limits.sun_cone_from_altitude_deg
            found[LimitKind.SUN] = np.where(up, near, _FAR_INSIDE_DEG)
        if limits.daylight == "refuse":
            depth = sun.altitude_deg - limits.daylight_from_altitude_deg
            found[LimitKind.DAYLIGHT] = np.broadcast_to(depth, np.shape(seen.up))
        if limits.moon_cone_deg > 0.0:
            moon = of_body(known.moon, latitude_deg, MOON_DEG_PER_S * np.asarray(later_s))
            near = limits.moon_cone_deg + margin_deg - seen.separation_deg(moon)
            found[LimitKind.MOON] = np.where(moon.altitude_deg >= 0.0, near, _FAR_INSIDE_DEG)
        return found

    def axis_depths(
        self, standing: Standing, first_deg: Floats | None = None, second_deg: Floats | None = None
    ) -> Depths:
        """How deep outside the limits of the axes a standing is, or its axes at other angles.

        Parameters
        ----------
        first_deg, second_deg : ndarray, optional
            Instead of the standing's own.

        Returns
        -------
        dict of LimitKind to ndarray
            Degrees; 0 or less: inside.
        """
        limits = self.limits
        first = np.array([standing.first_deg]) if first_deg is None else first_deg
        second = np.full(np.shape(first), standing.second_deg) if second_deg is None else second_deg
        found: Depths = {}
        if limits.hour_angle_deg is not None and standing.mounting != "altaz":
            flipped = standing.side is PierSide.WEST
            ha = np.mod(first - (180.0 if flipped else 0.0) + 180.0, 360.0) - 180.0
            low, high = limits.hour_angle_deg
            found[LimitKind.HOUR_ANGLE] = np.maximum(low - ha, ha - high) + limits.margin_deg
        past = limits.past_meridian_deg
        if past is not None and standing.mounting == "german":
            free = past[0] if standing.side is PierSide.EAST else past[1]
            found[LimitKind.MERIDIAN] = np.maximum(-free - first, first - 180.0 - free)
        depth = np.full(np.shape(first), _FAR_INSIDE_DEG)
        if limits.first_axis_deg is not None:
            low, high = limits.first_axis_deg
            depth = np.maximum(depth, np.maximum(low - first, first - high))
        if limits.second_axis_deg is not None:
            low, high = limits.second_axis_deg
            depth = np.maximum(depth, np.maximum(low - second, second - high))
        found[LimitKind.UNREACHABLE] = depth
        return found
