"""A position that counts since the sky has shown how far it is off: of a mount that takes syncs wrongly.

It ignores syncs, refuses them, or takes another place than it was told: half of the way, twice of it, the
other way. More syncs don't make that better; the tube hasn't moved, and two frames tell where it looks. That
is as good as a mount that was never synced: corrections go beside the target by what was seen.
"""

from __future__ import annotations

import math

from mountnav.devices import MountReading
from mountnav.errors import DeviceError, DeviceRefused, SyncElsewhere
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_judge import Judge
from mountnav.navigation.undoing import turned_over
from mountnav.sky.chain import icrs_to_hour_angle
from mountnav.sky.sphere import half_turn_deg, separation_arcsec


class TookElsewhere(SyncElsewhere):
    """The mount took another place than it was told, and counts all the same: a look has shown which.

    Attributes
    ----------
    look : Look
        The one that showed it.
    """

    def __init__(self, before: SyncElsewhere, look: Look) -> None:
        super().__init__(
            before.what,
            device=before.device,
            advice="its position counts by what was seen; corrections go by offset until noon, or until its "
            "link is made anew",
        )
        self.look = look


def stays_lost(error: DeviceError, off_arcsec: float) -> DeviceError:
    """What to raise for a lost mount that took no sync, and is too far off to count by sight; with a way out.

    Parameters
    ----------
    error : DeviceError
        How its sync ended.
    off_arcsec : float
        How far off it was seen.
    """
    what = f"{error.what}; it looks {off_arcsec / 3600.0:.1f}° from where it believes to point"
    advice = (
        "a mount that takes no syncs can't be told where it points: align it at its own hand control, or "
        "open its clutches and turn the tube by hand to where it believes to point; then say trust"
    )
    if isinstance(error, DeviceRefused):
        return DeviceRefused(what, device=error.device, advice=advice, reason=error.reason)
    return type(error)(what, device=error.device, advice=advice)


def why_not(judge: Judge, found: Look) -> str | None:
    """Why a position can't count by a look, in words; None if it can.

    Parameters
    ----------
    judge : Judge
    found : Look
        Another one agrees with it, and how a German mount stands is known.
    """
    if found.segment_id != judge.mount.segment_id:
        return "its zero points have changed since the look"
    no_good = judge.no_good(found)
    if no_good is not None:
        return no_good[1]
    off_arcsec = off_at_most_arcsec(judge, found)
    if off_arcsec <= judge.policy.max_arcsec:
        return None
    return (
        f"its axes may be off by {off_arcsec / 3600.0:.1f}°, more than the "
        f"{judge.policy.max_arcsec / 3600.0:.1f}° that are believed"
    )


def off_at_most_arcsec(judge: Judge, found: Look) -> float:
    """How far off the tube may look anywhere in the sky, by what it was off at a look.

    A pole that is off shows as an offset to the east; an axis that is off turns the sky by 1 / cos δ more.
    """
    utc = found.mid_exposure_utc
    seen, believed = (
        icrs_to_hour_angle(place, utc, judge.site, judge.air) for place in (found.seen, found.believed)
    )
    turned_deg = half_turn_deg(seen.ha_deg - believed.ha_deg)
    axes_arcsec = 3600.0 * math.hypot(turned_deg, seen.dec_deg - believed.dec_deg)
    return max(axes_arcsec, found.offset.total_arcsec)


def stood_still(found: Look, before: MountReading, again: Look, allowed_arcsec: float) -> bool:
    """Whether two looks show one place of the sky, and the mount believes in the same posture.

    Parameters
    ----------
    found : Look
        Before the sync.
    before : MountReading
        The last one before it.
    again : Look
        After it.
    allowed_arcsec : float
    """
    apart = separation_arcsec(found.seen, again.seen)
    return apart <= allowed_arcsec and turned_over(before, again.after) is None


__all__ = ["TookElsewhere", "stays_lost", "stood_still", "why_not"]
