"""Frames that somebody else exposes: compared with what the mount said round them, and corrected by."""

from __future__ import annotations

from datetime import timedelta
from typing import Literal

from mountnav.errors import BadFrame, BadRequest, DeviceRefused, SyncDoubt, SyncIgnored, SyncRefused
from mountnav.frames import Frame
from mountnav.journal.records import EntryKind, because, new_id
from mountnav.navigation.devices import PierSide
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.flipping import side_of
from mountnav.navigation.looking import at_instant, look_of, not_solved_facts, solved_facts
from mountnav.navigation.looks_written import record_of
from mountnav.navigation.polar_steering import steering_for
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reports import Corrected, Correction, FrameLook, Look, SyncReport
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.steering import Sighting
from mountnav.navigation.steps import step
from mountnav.navigation.syncing import Occasion
from mountnav.navigation.undoing import SyncUndone
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec
from mountnav.solution import Verdict

WITHIN = timedelta(minutes=3)
"""The mount must have been read no longer than this before a frame's start and after its end."""

By = Literal["sync", "offset", "model"]


async def frame_look(
    equipment: Equipment, policy: CenteringPolicy, frame: Frame, verdict: Verdict, *, used: str
) -> FrameLook:
    """Compare a frame from outside, identified already, with the readings round its exposure; write it down.

    Parameters
    ----------
    equipment : Equipment
    policy : CenteringPolicy
    frame : Frame
        Its time of exposure must be known.
    verdict : Verdict
    used : str
        What it is for; the journal tells.

    Raises
    ------
    BadFrame
        No time of exposure.
    DeviceError
        The mount can't be read.
    JournalFailed
    """
    middle = frame.mid_exposure_utc
    if middle is None:
        raise BadFrame(
            f"{frame.source}: no time of exposure in the frame",
            advice="let the camera write DATE-OBS and EXPTIME: without them a frame can't be compared",
        )
    look_id = new_id()
    with because(look_id=look_id):
        half = timedelta(seconds=0.5 * (frame.exposure_s or 0.0))
        await equipment.mount.reading()
        around = equipment.readings.around(middle - half, middle + half, WITHIN)
        found: Look | None = None
        refused: tuple[str, str] | None = None
        doubts: list[SyncDoubt] = []
        words: list[str] = []
        before = after = await equipment.mount.reading()
        if around is None:
            refused = ("not-read", "the mount was not read round this frame's exposure")
            words.append(refused[1])
        else:
            before, after = around.before, around.after
            allowed = policy.max_motion_arcsec + equipment.mount.resolution_arcsec
            if around.moved_arcsec > allowed or around.slewing:
                doubts.append(SyncDoubt.MOVED)
                words.append(f"the mount moved {around.moved_arcsec:.0f}″ during its exposure")
        moved_utc = equipment.mount.last_motion_utc
        if moved_utc is not None and moved_utc > middle - half:
            doubts.append(SyncDoubt.OLDER_THAN_MOVE)
            words.append("its exposure began before the mount last came to rest")
        if around is not None and verdict.solution is not None:
            believed = at_instant(before, after, middle)
            found = look_of(
                frame,
                verdict,
                believed,
                before,
                after,
                middle,
                look_id=look_id,
                segment_id=equipment.mount.segment_id,
                model_id=equipment.pointing.model_id,
            )
        record = record_of(
            equipment,
            look_id=look_id,
            utc=middle,
            before=before,
            after=after,
            frame=frame,
            exposure_s=frame.exposure_s or 0.0,
            used=used,
            segment_id=equipment.mount.segment_id,
            model_id=equipment.pointing.model_id,
            verdict=verdict,
            look=found,
            refused=refused if verdict.solution is not None else None,
        )
        await equipment.journal.look(record)
        step("frame written")
        if verdict.solution is None:
            equipment.listen("not-solved", not_solved_facts(verdict))
            return FrameLook(None, tuple(doubts), verdict.detail)
        if found is None:
            return FrameLook(None, tuple(doubts), "; ".join(words))
        equipment.listen("solved", solved_facts(found))
        if not doubts:
            await equipment.guard.learn(found)
        return FrameLook(found, tuple(doubts), "; ".join(words))


async def correct(
    equipment: Equipment,
    slewing: Slewing,
    found: Look,
    *,
    by: By,
    target: Icrs | None,
    key: str | None,
) -> Corrected:
    """Bring the telescope back by a look: between two frames of a night.

    Parameters
    ----------
    equipment, slewing : Equipment, Slewing
    found : Look
    by : {"sync", "offset", "model"}
        "sync" goes by offset when the mount ignores, refuses or contradicts it and a target is given.
    target : Icrs or None
        Where the tube should look; None: a sync alone.
    key : str or None
        The target's name, for the policy of syncs.

    Raises
    ------
    SyncRefused
        What stands against the look, or against a sync by the policy, or that the slew would change sides;
        nothing was sent.
    BadRequest
        An offset without a target.
    OutsideLimits, DeviceError, Cancelled, TargetNotReached, JournalFailed
    """
    guard = equipment.guard
    decision = guard.consider(found, Occasion.NIGHT, target=key)
    against = decision.against_the_sky
    if against or (by == "sync" and not decision.allowed):
        facts = {"doubts": [str(one) for one in decision.doubts], "look_id": found.look_id, "by": by}
        await equipment.note(EntryKind.REFUSAL, decision.why, facts)
        raise SyncRefused(decision.why, device=equipment.name, doubts=decision.doubts)
    if target is not None:
        await _require_same_side(equipment, slewing, found, target)
    if by == "sync" and not (guard.prefers_offset and target is not None):
        done = await _by_sync(equipment, slewing, found, target, key)
        if done is not None:
            return done
    if target is None:
        raise BadRequest("an offset needs a target", device=equipment.name, advice="say where it should look")
    if by == "model":
        # its zero points have learned of the look already
        from_model = slewing.aimed(target, found.after.pier_side or await slewing.side_at(target))
        if from_model != target:
            return await _sent(slewing, Correction.MODEL, target, from_model, found.believed)
    steering = steering_for(target, equipment.mount.resolution_arcsec, equipment.site)
    now = equipment.clock.utc()
    steering.sighted(Sighting(found.believed, found.seen, side_of(found)), found.mid_exposure_utc)
    return await _sent(
        slewing, Correction.OFFSET, target, steering.next_aim(now, side_of(found)), found.believed
    )


async def _require_same_side(equipment: Equipment, slewing: Slewing, found: Look, target: Icrs) -> None:
    """Refuse a correction that would or might change sides: what was seen on this one is no use there.

    Raises
    ------
    SyncRefused
    """
    side = side_of(found)
    if equipment.mount.mounting in ("fork", "altaz") or side is PierSide.UNKNOWN:
        return
    there = await slewing.side_at(target)
    if there is side:
        return
    words = f"a correcting slew would take the tube from the {side} of the pier to the other side"
    facts = {"look_id": found.look_id, "side": str(side), "there": str(there)}
    await equipment.note(EntryKind.REFUSAL, words, facts)
    raise SyncRefused(
        words,
        device=equipment.name,
        advice="let it change sides by an order (flip), which centers the target anew",
        doubts=(SyncDoubt.NEAR_MERIDIAN,),
    )


async def _sent(slewing: Slewing, by: Correction, target: Icrs, aim: Icrs, believed: Icrs) -> Corrected:
    report = await slewing.slew(target, aim)
    moved = offset_arcsec(aim, believed)
    return Corrected(by, str(report.outcome), moved.total_arcsec, report, moved)


async def _by_sync(
    equipment: Equipment, slewing: Slewing, found: Look, target: Icrs | None, key: str | None
) -> Corrected | None:
    """Sync and slew to the target; None when it won't be told and there is a target to go to."""
    try:
        report: SyncReport = await equipment.guard.commit(found, Occasion.NIGHT, target=key)
    except (SyncIgnored, SyncUndone, DeviceRefused) as error:
        if target is None:
            raise
        equipment.listen("by-offset", {"why": error.what})
        return None
    if target is None:
        return Corrected(Correction.SYNC, str(report.outcome), 0.0, report)
    aim = slewing.aimed(target, found.after.pier_side or await slewing.side_at(target))
    await slewing.slew(target, aim)
    moved = offset_arcsec(aim, found.seen)
    return Corrected(Correction.SYNC, str(report.outcome), moved.total_arcsec, report, moved)


__all__ = ["WITHIN", "By", "correct", "frame_look"]
