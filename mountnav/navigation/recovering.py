"""What must hold before a lost mount is synced: two frames agree, on a place above the ground.

The cap on an offset guards against the one accepted wrong solution. Where it must be passed over, since the
mount woke up somewhere else, a second frame takes its place: two wrong solutions don't agree on a place.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace

from mountnav.devices import PierSide, Skill, SyncOutcome
from mountnav.errors import (
    BadFrame,
    DeviceError,
    DeviceRefused,
    MountMoved,
    MountnavError,
    OffsetTooLarge,
    OutsideLimits,
    Refusal,
    SkyError,
    SyncDoubt,
    SyncElsewhere,
    SyncIgnored,
    SyncRefused,
)
from mountnav.mount import CheckedMount
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.camera import camera_sample
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.look_retries import PersistentLook
from mountnav.navigation.policy import CenteringPolicy, Tactic
from mountnav.navigation.reports import Look, RecoverReport, angle_words
from mountnav.navigation.sync import SyncTrigger
from mountnav.navigation.sync_transaction import stays_lost, stood_still
from mountnav.navigation.vetoes import apart_arcsec
from mountnav.pointing.limits import Limits
from mountnav.sky.chain import icrs_to_observed
from mountnav.sky.coordinates import Air, Icrs, Site
from mountnav.sky.sphere import half_turn_deg, offset_arcsec

TURNED_DEG = 1.0
"""A sky that was turned by less is no danger to a limit, and an honest mount is as far off. Chosen by hand.
Doubled, a site that is 8 min of longitude wrong is believed."""
AWAY_DEG = 5.0
"""So near the pole a few minutes of arc are degrees of right ascension, °. Chosen by hand: 1′ is 11′ of right
ascension there. Doubled, fewer places show that a clock is wrong."""
FURTHEST_DEG = 10.0
"""A mount that was set up by eye, levelled and with its clock and site right, is not further off than this
(the issue of a bad night is 5°), and first light goes to it. Doubled, a clock that is an hour wrong would be
synced away."""
MOST_LOOKS = 4
"""So many frames are taken for two that agree: one in between may be wrong. Doubled, a camera that never
gives two equal skies costs four more exposures."""


async def recover(
    equipment: Equipment, policy: CenteringPolicy, exposure_s: float | None = None
) -> RecoverReport:
    """Find out where a mount points that doesn't know, and sync it. Never slews it.

    A look, solved anywhere in the sky; a second look, taken afterwards, must agree with it, or a third with
    one of the two; their place must stand within the limits at this hour. Then the mount is synced on the
    last one, however far that is from what it believed, and read back: longer than otherwise, since nothing
    can be done without. A mount that doesn't track is ordered to.

    Raises
    ------
    SolveFailed, BadFrame, MountMoved
        As a look does.
    OutsideLimits
        The solved place is below the limit: clock, site or frame are wrong; nothing was synced.
    OffsetTooLarge
        The frames disagree; nothing was synced.
    SyncRefused
        It points so near the pole that a frame doesn't show the hour angle, or the posture of a German mount
        is not known; or as `GuardedSync.commit`.
    SyncIgnored, DeviceError, JournalFailed
    """
    equipment.listen("recovering", {})
    async with tracked(equipment):
        return await _recover(equipment, policy, exposure_s)


async def _recover(equipment: Equipment, policy: CenteringPolicy, exposure_s: float | None) -> RecoverReport:
    clock, site, air = equipment.clock, equipment.site, equipment.air
    began = clock.monotonic_s()
    # nothing may be slewed, and each frame is searched from what the mount believes then
    resting = replace(
        policy.persistence, tactics=policy.persistence.tactics - {Tactic.NEIGHBOR, Tactic.WIDER}
    )

    async def look() -> Look:
        looking = PersistentLook(equipment, policy, resting, used="recovery", anywhere=True)
        return (await looking.look(exposure_s)).look

    first, second, apart = await two_that_agree(equipment, policy, look)
    require_away_from_pole(second, policy, device=equipment.name)
    altitude_deg = require_above_ground(second, equipment.mount.limits, site, air)
    require_rightly_set(second, equipment.mount, device=equipment.name)
    require_known_posture(second, equipment)
    believed = icrs_to_observed(second.believed, second.mid_exposure_utc, site, air)
    equipment.listen(
        "confirmed",
        {
            "look_id": second.look_id,
            "ra_deg": second.seen.ra_deg,
            "dec_deg": second.seen.dec_deg,
            "apart_arcsec": apart,
            "offset_arcsec": second.offset.total_arcsec,
            "altitude_deg": altitude_deg,
            "believed_altitude_deg": believed.alt_deg,
        },
    )
    kill_point("recovery confirmed")
    told = await sync_or_count_by_sight(equipment, policy, second, look, SyncTrigger.RECOVERY)
    return RecoverReport(
        outcome=told.outcome,
        first=first,
        second=told.look,
        apart_arcsec=apart,
        altitude_deg=altitude_deg,
        believed_altitude_deg=believed.alt_deg,
        read_back=told.read_back,
        read_back_miss_arcsec=told.miss_arcsec,
        elapsed_s=clock.monotonic_s() - began,
    )


@dataclass(frozen=True, slots=True)
class RecoverySync:
    """What a lost mount made of its sync.

    Attributes
    ----------
    outcome : SyncOutcome
        Seen, or late. Else its position counts by sight; `IGNORED` also where it said no, and where no sync
        was sent since it took none in this night.
    look : Look
        The last one.
    """

    outcome: SyncOutcome
    look: Look
    read_back: Icrs
    miss_arcsec: float


async def sync_or_count_by_sight(
    equipment: Equipment,
    policy: CenteringPolicy,
    found: Look,
    look: Callable[[], Awaitable[Look]],
    trigger: SyncTrigger,
) -> RecoverySync:
    """Tell a mount where it points; one that takes no syncs counts by sight, if it isn't too far off.

    Parameters
    ----------
    found : Look
        Another one agrees with it, and the posture of a German mount is known.
    look : callable
        Takes another one.

    Raises
    ------
    As `GuardedSync.commit`.
    """
    guard = equipment.guard
    if guard.prefers_offset and await guard.count_by_sight(found):
        return RecoverySync(SyncOutcome.IGNORED, found, found.believed, found.offset.total_arcsec)
    try:
        done = await guard.commit(found, trigger)
    except (SyncIgnored, SyncElsewhere, DeviceRefused) as error:
        elsewhere = isinstance(error, SyncElsewhere)
        if not (elsewhere or guard.prefers_offset):
            raise
        kill_point("told, and not taken")
        try:
            again = await look()
        except (SkyError, BadFrame, DeviceError) as unseen:
            # the tracking may have been ended, say, since it believes to be below the ground now
            raise stays_lost(error, found.offset.total_arcsec) from unseen
        allowed = policy.max_motion_arcsec + equipment.mount.resolution_arcsec
        if not stood_still(found, found.after, again, allowed) or not await guard.count_by_sight(again):
            raise stays_lost(error, again.offset.total_arcsec) from error
        outcome = SyncOutcome.ELSEWHERE if elsewhere else SyncOutcome.IGNORED
        return RecoverySync(outcome, again, again.believed, again.offset.total_arcsec)
    return RecoverySync(done.outcome, found, done.read_back, done.read_back_miss_arcsec)


async def two_that_agree(
    equipment: Equipment, policy: CenteringPolicy, look: Callable[[], Awaitable[Look]]
) -> tuple[Look, Look, float]:
    """Look until a frame agrees with one before it; the earlier one, the later one, and how far apart.

    Where they look is judged afterwards: one frame alone that shows the ground or the pole may be wrong.
    """
    looks = [await look()]
    while True:
        latest = await look()
        said: MountnavError | None = None
        for before in reversed(looks):
            try:
                apart = agreement_arcsec(before, latest, policy, equipment.mount.resolution_arcsec)
            except (BadFrame, MountMoved, OffsetTooLarge) as error:
                said = said or error
            else:
                return before, latest, apart
        looks.append(latest)
        if len(looks) >= MOST_LOOKS and said is not None:
            raise said


@asynccontextmanager
async def tracked(equipment: Equipment) -> AsyncIterator[None]:
    """Let a mount track for as long as this takes to find out where it points.

    If that isn't found out, or somebody stops it, a mount that was switched on for it is switched off again:
    nobody knows where it points, so it must not be tracked to wherever that leads.
    """
    switched_on = await _let_track(equipment)
    try:
        yield
    except BaseException:
        if switched_on:
            with contextlib.suppress(DeviceError):
                await equipment.mount.set_tracking(False)
        raise


async def _let_track(equipment: Equipment) -> bool:
    """Let a mount follow the sky unless it says that it does; whether it was ordered to.

    Two frames of a sky that runs through can't agree: where it may not track any more since nobody knows its
    place, that refusal is raised.
    """
    mount = equipment.mount
    if Skill.TRACK not in mount.skills or (await mount.reading()).tracking is True:
        return False
    try:
        await mount.set_tracking(True)
    except DeviceRefused as error:
        if error.reason is Refusal.UNTRUSTED:
            raise
        equipment.listen("not-tracking", {"why": error.what})
        return False
    return True


def require_known_posture(found: Look, equipment: Equipment) -> None:
    """Refuse to sync a German mount while nobody knows how it stands.

    It takes the place for the posture that it believes in. If that is the wrong one, its declination axis
    turns the wrong way from then on, and its next slew goes anywhere. The image's rotation shows the posture,
    once the camera's angle has been learned.

    Raises
    ------
    SyncRefused
    """
    mounting, said = equipment.mount.mounting, found.after.side
    if mounting in ("fork", "altaz"):
        return
    learned = equipment.guard.learned
    sample = camera_sample(found, equipment.site, equipment.air, mounting, lost=True)
    seen = learned.side_seen(sample)
    if said is not PierSide.UNKNOWN and said is seen:
        return
    off_deg = found.offset.total_arcsec / 3600.0
    advice = "order first light: it finds the posture by a small move; or let the mount find its home"
    if off_deg > FURTHEST_DEG:
        advice = (
            f"it looks {off_deg:.0f}° from where it believes, too far for a first light: let it find its "
            "home, or put the tube at its home or park position by hand, say trust, and order first light"
        )
    raise SyncRefused(
        f"the mount says that the tube is on the side {said}, the image's rotation says {seen}: "
        "a sync in the wrong posture would turn its next slew the wrong way",
        device=equipment.name,
        advice=f"nothing was synced; {advice}; if it is not a German mount, set mount.mounting",
        doubts=(SyncDoubt.WRONG_SIDE,),
    )


def require_away_from_pole(found: Look, policy: CenteringPolicy, *, device: str) -> None:
    """Refuse to sync where a frame doesn't show the hour angle: it would put that of the whole sky wrong.

    Raises
    ------
    SyncRefused
    """
    away_deg = 90.0 - abs(found.seen.dec_deg)
    if away_deg >= policy.pole_deg:
        return
    raise SyncRefused(
        f"the tube looks {away_deg:.1f}° from the pole, where a frame does not show the hour angle "
        f"({policy.pole_deg:g}° are needed)",
        device=device,
        advice="nothing was synced; order first light: it leaves the pole before it syncs; or let the mount "
        "find its home",
        doubts=(SyncDoubt.NEAR_POLE,),
    )


def require_above_ground(found: Look, limits: Limits, site: Site, air: Air) -> float:
    """Refuse a solved place where no telescope at this site can point at this hour.

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


def require_rightly_set(found: Look, mount: CheckedMount, *, device: str) -> None:
    """Refuse a place that shows that a mount was right before its site and clock were set to ours.

    Then it is ours that are wrong, and every limit would be judged by the wrong sky.

    Raises
    ------
    OffsetTooLarge
    """
    turned_deg = mount.turned_deg
    if turned_deg is None:
        return
    off_deg = half_turn_deg(found.seen.ra_deg - found.believed.ra_deg)
    # near the pole a place says nothing of the hour angle
    tells = 90.0 - abs(found.seen.dec_deg) > AWAY_DEG
    if abs(turned_deg) < TURNED_DEG or abs(off_deg) <= abs(off_deg - turned_deg) or not tells:
        if tells:
            mount.sky_agrees()
        return
    raise OffsetTooLarge(
        f"the tube looks {off_deg:+.1f}° in right ascension from where the mount believes, and its sky was "
        f"turned by {turned_deg:+.1f}° when site and clock were set: the mount "
        "was right, and mountnav's are wrong",
        device=device,
        advice="nothing was synced; correct [site] and this machine's clock, start again, and correct the "
        "mount (order set-site-time). If they are certainly right, order set-site-time once more: it is then "
        "accepted",
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
    OffsetTooLarge
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
    apart = apart_arcsec(first, second)
    if apart > allowed:
        raise OffsetTooLarge(
            f"two frames, one after the other, were solved {angle_words(apart)} apart "
            f"(allowed {allowed:.0f}″)",
            advice="nothing was synced; does the mount track, and does the tube keep still? then try again",
        )
    return apart
