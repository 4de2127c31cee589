"""Sides of the pier: where the tube hangs, by the mount and by the solved rotation, and when it must change.

A sync made before a flip is worth nothing after it (it jumped by 2080″ [POINTING §5]): what a look may show
is widened then, and the target is centered anew.
"""

from __future__ import annotations

from datetime import timedelta

from mountnav.devices import PierSide
from mountnav.errors import LimitKind
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.reports import Crossing, Look
from mountnav.sky.coordinates import Icrs

LOOK_AHEAD_S = 3600.0
"""How far limits are looked for when nobody says how long a target is to be followed."""


def side_of(found: Look) -> PierSide:
    """The side that the mount says it is on, after the exposure."""
    return found.after.pier_side or PierSide.UNKNOWN


def side_note(found: Look, seen: PierSide) -> str | None:
    """What an operator should know when the solved rotation shows another side than the mount says.

    Parameters
    ----------
    found : Look
    seen : PierSide
        By the rotation; unknown while the camera's angle has not been learned.
    """
    said = side_of(found)
    if PierSide.UNKNOWN in (said, seen) or said is seen:
        return None
    return (
        f"the mount says that the tube hangs {said} of the pier, the image's rotation "
        f"({found.solution.rotation_deg:.1f}°) says {seen}: its limits on that side may be wrong; look at "
        "it, and set swap_sides of the mount if it is told the wrong way round"
    )


def crossing(equipment: Equipment, target: Icrs, side: PierSide, planned_s: float | None) -> Crossing | None:
    """The first limit that tracking on `target` reaches within the planned time.

    Parameters
    ----------
    equipment : Equipment
    target : Icrs
    side : PierSide
        On which the tube hangs.
    planned_s : float or None
        An hour if None.
    """
    mount, now = equipment.mount, equipment.clock.utc()
    within_s = LOOK_AHEAD_S if planned_s is None else planned_s
    if within_s <= 0.0:
        return None
    found = mount.limits.reached(
        target,
        now,
        equipment.site,
        equipment.air,
        mounting=mount.mounting,
        side=None if side is PierSide.UNKNOWN else side,
        within_s=within_s,
    )
    if found is None:
        return None
    when = now + timedelta(seconds=found.after_s)
    return Crossing(when, found.limit, _words(found.limit, found.after_s, found.alt_deg))


def _words(limit: LimitKind, after_s: float, alt_deg: float) -> str:
    minutes = after_s / 60.0
    if limit in (LimitKind.MERIDIAN, LimitKind.HOUR_ANGLE):
        return f"tracking reaches the {limit} limit in {minutes:.0f} min: the tube must change sides before"
    return f"tracking reaches the {limit} limit in {minutes:.0f} min, at altitude {alt_deg:.0f}°"


__all__ = ["LOOK_AHEAD_S", "crossing", "side_note", "side_of"]
