"""Tracking into a limit: which one comes first, and when."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mountnav.devices import PierSide
from mountnav.errors import LimitKind
from mountnav.pointing.limits.directions import Floats, of_axes
from mountnav.pointing.limits.postures import Mounting, Standing, side_by_rule, standing_at
from mountnav.pointing.limits.scene import Depths, Scene
from mountnav.sky.chain import hour_angle_to_observed, icrs_to_hour_angle
from mountnav.sky.coordinates import SIDEREAL_DEG_S, Air, HourAngle, Icrs

# Step in which a tracked path is looked at, s: the sky turns 0.25° in it. Chosen by hand; doubled, a thin
# obstacle may be missed.
_STEP_S = 60.0
# A path that starts outside a limit leads deeper when it gets so much worse, degrees. Chosen by hand, above
# the noise of numbers.
_DEEPER_DEG = 0.02
VACUUM = Air(pressure_hpa=0.0)
"""Without refraction: as most mounts reckon the angles of their axes. By the pole that differs from how the
sky is seen by any amount: 50″ of refraction turn the hour angle by 16° at 3′ from it."""
AT_POLE_DEG = 30.0 / 3600.0
"""Nearer to the pole than this a place tells nothing of the hour angle axis: its steps are up to 20″."""
OF_BODIES = (LimitKind.SUN, LimitKind.MOON, LimitKind.DAYLIGHT)
"""Tracking doesn't lead out of these: what is in them is so at once."""


@dataclass(frozen=True, slots=True)
class Reached:
    """A limit that tracking leads to.

    Attributes
    ----------
    after_s : float
        0 if it is passed already and tracking leads deeper.
    az_deg, alt_deg : float
        Where.
    """

    limit: LimitKind
    after_s: float
    az_deg: float
    alt_deg: float


def reached(
    scene: Scene,
    place: Icrs,
    air: Air,
    *,
    mounting: Mounting | None,
    side: PierSide | None,
    within_s: float,
    step_s: float = _STEP_S,
) -> Reached | None:
    """Find which limit tracking on a place reaches first; see `Limits.reached`."""
    here, bare = (icrs_to_hour_angle(place, scene.utc, scene.site, one) for one in (air, VACUUM))
    return reached_from(
        scene, here, bare=bare, mounting=mounting, side=side, within_s=within_s, step_s=step_s
    )


def reached_from(
    scene: Scene,
    here: HourAngle,
    *,
    bare: HourAngle | None = None,
    mounting: Mounting | None,
    side: PierSide | None,
    within_s: float,
    step_s: float = _STEP_S,
    settled: bool = False,
) -> Reached | None:
    """As `reached`, from an observed place, and `bare`: without refraction.

    `settled`: what is outside at once counts.
    """
    count = max(2, math.ceil(within_s / step_s) + 1)
    later_s = np.linspace(0.0, within_s, count)
    depths, seen = tracked_depths(scene, here, later_s, bare=bare, mounting=mounting, side=side)
    first: tuple[float, LimitKind] | None = None
    for limit, depth in depths.items():
        after_s = crossing_s(depth, later_s, settled or limit in OF_BODIES)
        if after_s is not None and (first is None or after_s < first[0]):
            first = after_s, limit
    if first is None:
        return None
    az_deg, alt_deg = seen
    index = int(np.searchsorted(later_s, first[0]))
    return Reached(first[1], first[0], float(az_deg[index]), float(alt_deg[index]))


def tracked_depths(
    scene: Scene,
    here: HourAngle,
    later_s: Floats,
    *,
    bare: HourAngle | None = None,
    mounting: Mounting | None,
    side: PierSide | None,
    standing: bool = True,
) -> tuple[Depths, tuple[Floats, Floats]]:
    """Depths outside all limits while a place is tracked, with its azimuths and altitudes.

    Those of the axes are the deepest of what the place says with refraction and without (`bare`): nobody
    knows by which the mount reckons.
    """
    latitude_deg = scene.site.latitude_deg
    turned = SIDEREAL_DEG_S * later_s
    seen = of_axes(here.ha_deg + turned, np.full(later_s.shape, here.dec_deg), "fork", latitude_deg)
    depths = scene.depths(seen, standing=standing, later_s=later_s)
    stands = standing_for(scene, here, mounting, side)
    if stands.mounting == "altaz":
        azimuths = np.degrees(np.unwrap(np.radians(seen.azimuth_deg)))
        depths |= scene.axis_depths(stands, azimuths, seen.altitude_deg)
    else:
        depths |= scene.axis_depths(stands, stands.first_deg + turned)
        if bare is not None and 90.0 - abs(bare.dec_deg) > AT_POLE_DEG:
            reckoned = standing_for(scene, bare, mounting, side)
            for limit, depth in scene.axis_depths(reckoned, reckoned.first_deg + turned).items():
                depths[limit] = np.maximum(depths[limit], depth)
    return depths, (np.mod(seen.azimuth_deg, 360.0), seen.altitude_deg)


def standing_for(scene: Scene, here: HourAngle, mounting: Mounting | None, side: PierSide | None) -> Standing:
    """How the mount stands at a place; a German one that doesn't say it on the usual side."""
    told = side in (PierSide.EAST, PierSide.WEST)
    kind: Mounting = mounting or ("german" if told else "fork")
    posture = side if told and side is not None else side_by_rule(here.ha_deg)
    observed = hour_angle_to_observed(here, scene.site)
    return standing_at(here, observed, kind, posture, scene.site.latitude_deg)


def crossing_s(depth: Floats, later_s: Floats, settled: bool) -> float | None:
    """When a depth first rises above 0; from outside on, when it gets deeper."""
    if depth[0] > 0.0:
        if settled:
            return 0.0
        back = np.flatnonzero(depth <= 0.0)
        until = int(back[0]) if back.size else depth.size
        least = np.minimum.accumulate(depth[:until])
        deeper = np.flatnonzero(depth[:until] > least + _DEEPER_DEG)
        if deeper.size:
            return float(later_s[max(int(deeper[0]) - 1, 0)])
        if not back.size:
            return None
        depth, later_s = depth[until:], later_s[until:]
    outside = np.flatnonzero(depth > 0.0)
    if not outside.size:
        return None
    index = int(outside[0])
    low, high = float(depth[index - 1]), float(depth[index])
    if low < -90.0:  # a cone that begins to count when the Sun rises
        return float(later_s[index - 1])
    share = -low / (high - low)
    return float(later_s[index - 1] + share * (later_s[index] - later_s[index - 1]))
