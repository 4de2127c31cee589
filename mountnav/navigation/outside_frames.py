"""Frames that somebody else exposes: compared with the mount's readings round them, and corrected by."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import Literal

from mountnav.devices import PierSide
from mountnav.errors import BadFrame, BadRequest, DeviceRefused, SyncDoubt, SyncIgnored, SyncRefused
from mountnav.frames import Frame
from mountnav.journal.records import EntryKind, because, new_id
from mountnav.mount.kill_points import kill_point
from mountnav.navigation.equipment import Equipment
from mountnav.navigation.frames_seen import fingerprint
from mountnav.navigation.look import (
    at_instant,
    judge_freshness,
    look_of,
    not_solved_facts,
    record_of,
    report_stale,
    solved_facts,
)
from mountnav.navigation.policy import CenteringPolicy
from mountnav.navigation.reading_history import Meanwhile
from mountnav.navigation.reports import Corrected, Correction, FrameLook, Look, SyncReport, camera_of
from mountnav.navigation.slewing import Slewing
from mountnav.navigation.steering import Sighting, steering_for
from mountnav.navigation.sync_transaction import SyncUndone
from mountnav.navigation.sync_trigger import SyncTrigger
from mountnav.navigation.vetoes import AGAINST_THE_LOOK, SyncContext
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import offset_arcsec
from mountnav.solution import Verdict

__all__ = [
    "NOT_READ",
    "WITHIN",
    "By",
    "Judged",
    "compare_frame",
    "compared",
    "correct",
    "forbids",
    "half_exposure",
]


NOT_READ = "the mount was not read round this frame's exposure"


def compared(
    frame: Frame, verdict: Verdict, middle: datetime, meanwhile: Meanwhile, *, look_id: str
) -> FrameLook:
    """What a frame shows, and what stands against using it.

    Parameters
    ----------
    middle : datetime
        Of its exposure.
    """
    doubts: list[SyncDoubt] = []
    words: list[str] = []
    around, moved_utc = meanwhile.around, meanwhile.moved_utc
    if around is None:
        words.append(NOT_READ)
    elif around.moved_arcsec > meanwhile.allowed_arcsec or around.slewing:
        doubts.append(SyncDoubt.MOVED)
        words.append(f"the mount moved {around.moved_arcsec:.0f}″ during its exposure")
    if moved_utc is not None and moved_utc > middle - half_exposure(frame):
        doubts.append(SyncDoubt.OLDER_THAN_MOVE)
        words.append("its exposure began before the mount last came to rest")
    if verdict.solution is None:
        return FrameLook(None, tuple(doubts), verdict.detail)
    found: Look | None = None
    if around is not None:
        found = look_of(
            frame,
            verdict,
            at_instant(around.before, around.after, middle),
            around.before,
            around.after,
            middle,
            look_id=look_id,
            segment_id=meanwhile.segment_id,
            model_id=meanwhile.model_id,
            camera=camera_of(frame),
            tolerance_arcsec=meanwhile.tolerance_arcsec,
        )
        if not doubts and meanwhile.not_fresh:
            doubts.append(SyncDoubt.NOT_FRESH)
            words.append(meanwhile.not_fresh)
    return FrameLook(found, tuple(doubts), "; ".join(words))


def half_exposure(frame: Frame) -> timedelta:
    """From a frame's middle to its begin or its end, as far as it is known."""
    return timedelta(seconds=0.5 * (frame.exposure_s or 0.0))


WITHIN = timedelta(minutes=3)
"""The mount must have been read no longer than this before a frame's start and after its end. Chosen by hand.
Doubled, a frame is compared with a mount that may have been moved and moved back."""

By = Literal["sync", "offset", "model"]


async def compare_frame(
    equipment: Equipment, policy: CenteringPolicy, frame: Frame, verdict: Verdict, *, used: str
) -> FrameLook:
    """Compare a frame from outside, identified already, with the readings round its exposure; write it down.

    Parameters
    ----------
    frame : Frame
        Its time of exposure must be known.
    used : str
        What it is for, as the journal keeps it.

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
            advice="make the camera write DATE-OBS and EXPTIME: without them a frame can't be compared",
        )
    look_id = new_id()
    with because(look_id=look_id):
        half = half_exposure(frame)
        frames = equipment.frames.of(camera_of(frame))
        repeated = ""
        if frames.repeats(frame, await asyncio.to_thread(fingerprint, frame.pixels)):
            repeated = "pixel for pixel it is an earlier frame with another time"
        await equipment.mount.reading()
        around = equipment.readings.around(middle - half, middle + half, WITHIN)
        before = after = await equipment.mount.reading()
        if around is not None:
            before, after = around.before, around.after
        meanwhile = Meanwhile(
            around=around,
            allowed_arcsec=policy.max_motion_arcsec + equipment.mount.resolution_arcsec,
            moved_utc=equipment.mount.last_motion_utc,
            segment_id=equipment.mount.segment_id,
            model_id=equipment.pointing.model_id,
            tolerance_arcsec=policy.tolerance_arcsec,
        )
        told = compared(frame, verdict, middle, meanwhile, look_id=look_id)
        refused = ("not-read", NOT_READ) if around is None else None
        agreed: tuple[Look, ...] = ()
        if told.look is not None and not told.doubts:
            # another frame can't be asked for: the next one that comes may agree
            sight = judge_freshness(equipment, policy, told.look, confirmed_later=False)
            agreed = sight.agreed
            if repeated or sight.doubt:
                meanwhile = replace(meanwhile, not_fresh=repeated or sight.doubt)
                told = compared(frame, verdict, middle, meanwhile, look_id=look_id)
                refused = (str(SyncDoubt.NOT_FRESH), meanwhile.not_fresh)
            if repeated or sight.lagged:
                await report_stale(equipment, repeated or sight.lagged, source=frame.source)
        record = record_of(
            equipment,
            look_id=look_id,
            utc=middle,
            before=before,
            after=after,
            frame=frame,
            exposure_s=frame.exposure_s or 0.0,
            used=used,
            segment_id=meanwhile.segment_id,
            model_id=meanwhile.model_id,
            verdict=verdict,
            look=told.look,
            refused=refused if verdict.solution is not None else None,
        )
        await equipment.journal.look(record)
        kill_point("frame written")
        if verdict.solution is None:
            equipment.listen("not-solved", not_solved_facts(verdict))
        elif told.look is not None:
            equipment.listen("solved", solved_facts(told.look))
            if not told.doubts:
                for look in (*agreed, told.look):
                    await equipment.guard.learn(look)
        return replace(told, meanwhile=meanwhile)


async def correct(
    equipment: Equipment,
    slewing: Slewing,
    found: Look,
    *,
    by: By,
    target: Icrs | None,
    key: str | None,
    heard: Callable[[Judged], None] | None = None,
) -> Corrected:
    """Bring the telescope back by a look: between two frames of a night.

    Parameters
    ----------
    by : {"sync", "offset", "model"}
        "sync" goes by offset when the mount ignores, refuses or contradicts it and a target is given.
    target : Icrs or None
        Where the tube should look; None: a sync alone.
    key : str or None
        The target's name, for the policy of syncs.
    heard : callable, optional
        Told of the judgement before anything is done by it.

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
    context = guard.context(found, SyncTrigger.NIGHT, target=key)
    decision = guard.judge(found, SyncTrigger.NIGHT, context)
    if heard is not None:
        heard(Judged(by, context, decision.doubts))
    if forbids(decision.doubts, by):
        facts = {"doubts": [str(doubt) for doubt in decision.doubts], "look_id": found.look_id, "by": by}
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
    steering.sighted(Sighting(found.believed, found.seen, found.after.side), found.mid_exposure_utc)
    return await _sent(
        slewing, Correction.OFFSET, target, steering.next_aim(now, found.after.side), found.believed
    )


@dataclass(frozen=True, slots=True)
class Judged:
    """What a correction was judged by, and what stood against it."""

    by: By
    context: SyncContext
    doubts: tuple[SyncDoubt, ...]


def forbids(doubts: Iterable[SyncDoubt], by: By) -> bool:
    """Whether doubts forbid a correction: a look that is no good forbids any, the rest only a sync."""
    against = set(doubts)
    return bool(against & AGAINST_THE_LOOK) or (by == "sync" and bool(against))


async def _require_same_side(equipment: Equipment, slewing: Slewing, found: Look, target: Icrs) -> None:
    """Refuse a correction that would or might change sides: what was seen on this one is no use there.

    Raises
    ------
    SyncRefused
    """
    side = found.after.side
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
        advice="let it change sides by an order (flip), which centers the target again",
        doubts=(SyncDoubt.NEAR_MERIDIAN,),
    )


async def _sent(slewing: Slewing, by: Correction, target: Icrs, aim: Icrs, believed: Icrs) -> Corrected:
    report = await slewing.slew(target, aim)
    moved = offset_arcsec(aim, believed)
    return Corrected(by, str(report.outcome), moved.total_arcsec, report, moved)


async def _by_sync(
    equipment: Equipment, slewing: Slewing, found: Look, target: Icrs | None, key: str | None
) -> Corrected | None:
    """Sync and slew to the target; None when it takes no sync and there is a target to go to."""
    try:
        # judged once more there: the mount was asked for its side since, and may have lost its position
        report: SyncReport = await equipment.guard.commit(found, SyncTrigger.NIGHT, target=key)
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
