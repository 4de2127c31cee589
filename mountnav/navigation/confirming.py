"""A second look before a sync that nothing known can judge: two wrong solutions don't agree on a place.

On the first looks of a night, or of a segment, the camera's angle or the offset to be expected is not known:
a false solution would pass. Afterwards both are, and one look is enough.
"""

from __future__ import annotations

from collections import deque

from mountnav.navigation.doubts import SyncContext, claimed, surprise_arcsec
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec

_NEAR_DEG = 5.0
_KEPT = 3


class Witnesses:
    """The last looks of the present segment, as they were learned from."""

    def __init__(self) -> None:
        self._looks: deque[Look] = deque(maxlen=_KEPT)

    def add(self, found: Look) -> None:
        """Keep a look that nothing but its place stands against."""
        self._looks.append(found)

    def forget(self) -> None:
        """Begin anew: the zero points are others."""
        self._looks.clear()

    def for_look(self, found: Look, policy: SyncPolicy, resolution_arcsec: float) -> Look | None:
        """An earlier look, of this segment and near in the sky, that shows the same offset."""
        for other in reversed(self._looks):
            if other.mid_exposure_utc >= found.mid_exposure_utc:
                continue
            if separation_arcsec(other.believed, found.believed) > _NEAR_DEG * 3600.0:
                continue
            if apart_arcsec(other, found) <= policy.max_motion_arcsec + resolution_arcsec:
                return other
        return None


def to_be_confirmed(found: Look, policy: SyncPolicy, context: SyncContext, rotation_judged: bool) -> bool:
    """Whether a look needs a second one: it is far off, and what is known can't tell whether it may be.

    Parameters
    ----------
    found : Look
    policy : SyncPolicy
    context : SyncContext
    rotation_judged : bool
        Whether the camera's angle is known, and means something at that place.
    """
    if not policy.confirm:
        return False
    surprise, allowed = surprise_arcsec(claimed(found), policy, context)
    if surprise is None:
        surprise = found.offset.total_arcsec
    if surprise <= policy.confirm_above_arcsec:
        return False
    return not rotation_judged or allowed >= 0.5 * policy.max_arcsec


def disagreement(first: Look, again: Look, policy: SyncPolicy, resolution_arcsec: float) -> str | None:
    """Tell in words why a second look doesn't confirm the first one; None if it does."""
    if again.look_id == first.look_id or again.mid_exposure_utc <= first.mid_exposure_utc:
        return "the confirming look was not taken after the first one"
    allowed = policy.max_motion_arcsec + resolution_arcsec
    apart = apart_arcsec(first, again)
    if apart <= allowed:
        return None
    return f"two frames, one after the other, were solved {apart:.0f}″ apart (allowed {allowed:.0f}″)"


def apart_arcsec(first: Look, again: Look) -> float:
    """Distance between the solved places of two looks, the mount's own motion taken off."""
    motion = offset_arcsec(again.believed, first.believed)
    return separation_arcsec(again.seen, displaced(first.seen, motion.east_arcsec, motion.north_arcsec))


__all__ = ["Witnesses", "apart_arcsec", "disagreement", "to_be_confirmed"]
