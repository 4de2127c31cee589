"""What a night does about a frame: calibrate, gather evidence, correct, or leave it."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

from mountnav.night.allowed import NightRules
from mountnav.night.calibration import agreed_plate, plates_agree
from mountnav.night.events import Act, Decision, FrameSeen, Why
from mountnav.night.states import NO_OFFSET, Evidence, Hold, NightState, Phase
from mountnav.night.word_rules import Outcome, held, let_go
from mountnav.sky.sphere import Offset

USED_KEPT = 1000
"""So many frames that a correction was decided on are remembered."""
SIGMAS = 3.0
HOUR = timedelta(hours=1)


def on_frame(state: NightState, frame: FrameSeen, rules: NightRules) -> Outcome:
    """Decide on a frame: exactly one `CORRECT` or `LEAVE` of a running night."""
    if not state.running:
        return state, (_leave(frame, Why.NOT_RUNNING),)
    state = replace(state, frames=state.frames + 1)
    if not frame.placed:
        return _not_placed(state, frame, rules)
    before: tuple[Decision, ...] = ()
    state = replace(state, placed=state.placed + 1, unsolved=0)
    if Hold.CLOUD in state.holds:
        state, before = let_go(state, Hold.CLOUD, Why.CLEAR, "a frame was identified again")
    if (frame.field, frame.segment) != (state.field, state.segment):
        # another place, or other zero points: what was seen before says nothing about it
        state = replace(state, field=frame.field, segment=frame.segment, evidence=None, applied=NO_OFFSET)
    if state.phase is Phase.CALIBRATING:
        state, done = _calibrate(state, frame, rules)
        return state, (*before, *done)
    state, left = _judged(state, frame, rules)
    return state, (*before, left)


def _not_placed(state: NightState, frame: FrameSeen, rules: NightRules) -> Outcome:
    state = replace(state, unsolved=state.unsolved + 1)
    done = (_leave(frame, Why.NOT_PLACED, frame.detail),)
    if state.unsolved >= rules.pause_after_unsolved and Hold.CLOUD not in state.holds:
        text = f"{state.unsolved} frames in a row were not identified"
        state, more = held(state, Hold.CLOUD, Why.CLOUD, text)
        return state, (*done, *more)
    return state, done


def _calibrate(state: NightState, frame: FrameSeen, rules: NightRules) -> Outcome:
    if frame.plate is None or not frame.fully:
        return state, (_leave(frame, Why.CALIBRATING, "it was not identified fully"),)
    kept, agreed = agreed_plate(
        (*state.plates, frame.plate),
        rules.calibration_frames,
        scale_agrees=rules.scale_agrees,
        rotation_agrees_deg=rules.rotation_agrees_deg,
    )
    state = replace(state, plates=kept)
    text = f"{len(kept)} of {rules.calibration_frames}"
    if agreed is None:
        return state, (_leave(frame, Why.CALIBRATING, text),)
    state = replace(state, plate=agreed, phase=Phase.FOLLOWING)
    facts = {
        "scale_arcsec_px": agreed.scale_arcsec_px,
        "rotation_deg": agreed.rotation_deg,
        "parity": agreed.parity,
        "frames": len(kept),
    }
    told = Decision(Act.CALIBRATED, Why.PLATES_AGREE, f"{agreed.scale_arcsec_px:.4f} ″/px", facts=facts)
    return state, (told, _leave(frame, Why.CALIBRATING, text))


def _judged(state: NightState, frame: FrameSeen, rules: NightRules) -> tuple[NightState, Decision]:
    """Decide on a frame that was placed in a session whose plate is known."""
    told = _unusable(state, frame, rules)
    if told is not None:
        return state, told
    error = _error(state, frame)
    assert error is not None
    assert frame.mid_utc is not None
    state = replace(state, evidence=_evidence(state, frame, error, rules))
    assert state.evidence is not None
    off = error.total_arcsec
    numbers = f"{off:.1f}″ off"
    why: Why | None = None
    if off < rules.correct_when_off_by_arcsec + SIGMAS * frame.sigma_arcsec:
        why = Why.NOT_OFF_ENOUGH
    elif off > rules.max_correction_arcsec:
        why = Why.TOO_FAR_OFF
    elif rules.correct_by == "nothing":
        why = Why.ONLY_MEASURED
    elif len(state.evidence.frame_ids) < rules.frames_that_agree:
        why = Why.ALONE
    else:
        why = _not_now(state, frame, rules)
    if why is not None:
        return state, _leave(frame, why, numbers, error)
    recent = tuple(one for one in state.corrections if frame.utc - one < HOUR)
    state = replace(
        state,
        under_way=frame.frame_id,
        used=(*state.used, frame.frame_id)[-USED_KEPT:],
        corrections=(*recent, frame.utc),
        corrected=state.corrected + 1,
    )
    agreed = state.evidence
    assert agreed is not None
    text = f"{numbers}, {len(agreed.frame_ids)} frames agree"
    facts = {"frames": list(agreed.frame_ids), "by": rules.correct_by}
    return replace(state, evidence=None), Decision(Act.CORRECT, Why.OFF, text, frame.frame_id, error, facts)


def _unusable(state: NightState, frame: FrameSeen, rules: NightRules) -> Decision | None:
    """What stands against using a frame at all, whatever it shows; it was measured all the same."""
    if frame.frame_id in state.used:
        return _leave(frame, Why.USED)
    if frame.doubts:
        return _leave(frame, Why.DOUBTED, ", ".join(frame.doubts))
    if frame.error is None or frame.mid_utc is None:
        return _leave(frame, Why.NO_READING, frame.detail)
    if state.plate is not None and frame.plate is not None:
        # shifts carry the plate of the frame they are followed from: it is compared all the same
        agree = plates_agree(
            frame.plate,
            state.plate,
            scale_agrees=rules.scale_agrees,
            rotation_agrees_deg=rules.rotation_agrees_deg,
            turned=True,
        )
        if not agree:
            return _leave(frame, Why.PLATE_DIFFERS)
    begun = frame.begun_utc or frame.mid_utc
    if state.not_before is not None and begun < state.not_before:
        return _leave(frame, Why.OLDER_THAN_CORRECTION)
    if state.under_way is not None:
        return _leave(frame, Why.UNDER_WAY)
    if state.holds:
        return _leave(frame, Why.PAUSED, ", ".join(sorted(state.holds)))
    return None


def _error(state: NightState, frame: FrameSeen) -> Offset | None:
    """Seen minus wanted: what offsets have put the tube to beside the mount's belief is meant to be there."""
    if frame.error is None or frame.of_target:
        return frame.error
    return Offset(
        frame.error.east_arcsec - state.applied.east_arcsec,
        frame.error.north_arcsec - state.applied.north_arcsec,
    )


def _evidence(state: NightState, frame: FrameSeen, error: Offset, rules: NightRules) -> Evidence:
    """The frames in a row that say what this one says."""
    assert frame.mid_utc is not None
    alone = Evidence((frame.frame_id,), frame.mid_utc, error, frame.segment, frame.field)
    last = state.evidence
    if last is None or frame.frame_id in last.frame_ids:
        return alone
    apart = Offset(
        error.east_arcsec - last.error.east_arcsec, error.north_arcsec - last.error.north_arcsec
    ).total_arcsec
    age_s = (frame.mid_utc - last.utc).total_seconds()
    agrees = (
        (last.segment, last.field) == (frame.segment, frame.field)
        and 0.0 < age_s <= rules.evidence_max_age_s
        and apart <= rules.agree_arcsec + SIGMAS * frame.sigma_arcsec
    )
    if not agrees:
        return alone
    ids = (*last.frame_ids, frame.frame_id)[-max(rules.frames_that_agree, 2) :]
    return replace(alone, frame_ids=ids)


def _not_now(state: NightState, frame: FrameSeen, rules: NightRules) -> Why | None:
    """What stands against a correction at this moment."""
    if frame.moving:
        return Why.MOVING
    if not frame.held:
        if state.busy_until is not None and frame.utc < state.busy_until:
            return Why.EXPOSING
        late_s = (frame.utc - frame.arrived_utc).total_seconds()
        if not state.free and late_s >= rules.quiet_s:
            return Why.NOT_QUIET
    if sum(frame.utc - one < HOUR for one in state.corrections) >= rules.max_corrections_per_hour:
        return Why.ENOUGH_THIS_HOUR
    if state.corrected >= rules.max_corrections_per_night:
        return Why.ENOUGH_TONIGHT
    return None


def _leave(frame: FrameSeen, why: Why, text: str = "", error: Offset | None = None) -> Decision:
    return Decision(Act.LEAVE, why, text, frame.frame_id, error)


def begun_utc(mid_utc: datetime | None, exposure_s: float | None) -> datetime | None:
    """When an exposure began, as far as it is known."""
    if mid_utc is None:
        return None
    return mid_utc - timedelta(seconds=0.5 * (exposure_s or 0.0))
