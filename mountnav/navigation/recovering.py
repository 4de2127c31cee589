"""What must hold before a lost mount is told where it points: two frames agree, on a place above the ground.

The cap on an offset guards against the one accepted wrong solution. Where it must be passed over, since the
mount woke up somewhere else, a second frame takes its place: two wrong solutions don't agree on a place.
"""

from __future__ import annotations

from dataclasses import replace

from mountnav.errors import BadFrame, MountMoved, OffsetImplausible, OutsideLimits
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import Look
from mountnav.pointing.limits import Limits
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Site
from mountnav.sky.sphere import displaced, offset_arcsec, separation_arcsec
from mountnav.solve_settings import SolveSettings


def everywhere(solving: SolveSettings) -> SolveSettings:
    """The settings of solving, with the whole sky allowed: a recovery asks for it by name."""
    return replace(solving, blind="after") if solving.blind == "never" else solving


def require_above_ground(found: Look, limits: Limits, site: Site, air: Air) -> float:
    """Refuse a solved place where no telescope at this site can point at this hour.

    Parameters
    ----------
    found : Look
    limits : Limits
    site : Site
    air : Air

    Returns
    -------
    float
        Its altitude, degrees.

    Raises
    ------
    OutsideLimits
        The sky that was seen isn't there: the clock, the site or the frame is wrong.
    """
    place = icrs_to_observed(found.seen, found.mid_exposure_utc, site, air)
    if limits.allow(place.alt_deg):
        return place.alt_deg
    raise OutsideLimits(
        f"the frame shows RA {found.seen.ra_deg:.3f}° Dec {found.seen.dec_deg:+.3f}°, at this hour at "
        f"altitude {place.alt_deg:.1f}°; the telescope is allowed {limits.min_altitude_deg:g}° to "
        f"{limits.max_altitude_deg:g}°",
        advice="nothing was synced; check this machine's clock, the site's settings and the frame's time",
    )


def agreement_arcsec(first: Look, second: Look, policy: CenteringPolicy, resolution_arcsec: float) -> float:
    """How far two looks at one place are apart, if that is little enough for both to be believed.

    Parameters
    ----------
    first, second : Look
        In the order they were taken.
    policy : CenteringPolicy
        `max_motion_arcsec` bounds what the mount may move between them, and what they may differ.
    resolution_arcsec : float
        The mount's; added to both bounds.

    Returns
    -------
    float
        Distance of the second solved place from where the first one and the mount's own motion lead.

    Raises
    ------
    BadFrame
        The second frame isn't a later one.
    MountMoved
        The mount's reading moved between the frames.
    OffsetImplausible
        The solved places disagree.
    """
    if second.mid_exposure_utc <= first.mid_exposure_utc:
        raise BadFrame(
            "the second frame was not exposed after the first one",
            advice="nothing was synced; does the camera hand out an old frame?",
        )
    allowed = policy.max_motion_arcsec + resolution_arcsec
    motion = offset_arcsec(second.believed, first.believed)
    if motion.total_arcsec > allowed:
        raise MountMoved(
            f"the mount moved {motion.total_arcsec:.0f}″ between the two frames (allowed {allowed:.0f}″)",
            advice="nothing was synced; is it tracking? is somebody else moving it?",
        )
    expected = displaced(first.seen, motion.east_arcsec, motion.north_arcsec)
    apart = separation_arcsec(second.seen, expected)
    if apart > allowed:
        raise OffsetImplausible(
            f"two frames, one after the other, were solved {_angle(apart)} apart (allowed {allowed:.0f}″)",
            advice="nothing was synced; does the mount track, and does the tube hold still? then try again",
        )
    return apart


def _angle(arcsec: float) -> str:
    return f"{arcsec / 3600.0:.1f}°" if arcsec >= 3600.0 else f"{arcsec:.0f}″"
