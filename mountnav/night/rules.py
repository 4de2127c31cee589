"""The rules of a night: state and event make the next state and decisions; no clock, no device, no file."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from statistics import median

from mountnav.night.events import (
    NO_OFFSET,
    Act,
    CorrectionEnded,
    Decision,
    Event,
    Evidence,
    FrameSeen,
    Hold,
    NightState,
    Phase,
    PlateSeen,
    Said,
    Tick,
    Why,
    Word,
)
from mountnav.sky.sphere import Offset

__all__ = ["NightRules", "decide"]


@dataclass(frozen=True, slots=True)
class NightRules:
    """What is allowed; each as in `mountnav.settings.night.NightSettings`."""

    correct_by: str = "nothing"
    correct_when_off_by_arcsec: float = 30.0
    max_correction_arcsec: float = 1800.0
    max_corrections_per_hour: int = 6
    max_corrections_per_night: int = 40
    agree_arcsec: float = 10.0
    frames_that_agree: int = 2
    evidence_max_age_s: float = 900.0
    quiet_s: float = 10.0
    settle_s: float = 2.0
    calibration_frames: int = 3
    scale_agrees: float = 0.005
    rotation_agrees_deg: float = 1.0
    begin_sun_below_deg: float = -12.0
    end_sun_above_deg: float = -10.0
    pause_after_unsolved: int = 5
    when_unsafe: str = "pause"
    park_at_end: bool = False
    resume: bool = True

    @property
    def moves(self) -> bool:
        """Whether a correction moves the tube."""
        return self.correct_by in ("offset", "model")


def plates_agree(
    one: PlateSeen, other: PlateSeen, *, scale_agrees: float, rotation_agrees_deg: float, turned: bool
) -> bool:
    """Tell whether two frames are of one telescope and camera.

    Parameters
    ----------
    scale_agrees : float
        How near, as a share.
    turned : bool
        Whether half a turn counts as none: the tube may have gone to the other side of the pier.

    Returns
    -------
    bool
        False as well for another parity or another size: a flip turns an image, it never mirrors it.
    """
    if one.parity != other.parity or one.size != other.size:
        return False
    if abs(one.scale_arcsec_px / other.scale_arcsec_px - 1.0) > scale_agrees:
        return False
    apart = abs(math.remainder(one.rotation_deg - other.rotation_deg, 360.0))
    if turned:
        apart = min(apart, 180.0 - apart)
    return apart <= rotation_agrees_deg


def agreed_plate(
    plates: tuple[PlateSeen, ...], count: int, *, scale_agrees: float, rotation_agrees_deg: float
) -> tuple[tuple[PlateSeen, ...], PlateSeen | None]:
    """Take the newest plates that agree with each other.

    Parameters
    ----------
    plates : tuple of PlateSeen
        In the order of their frames.
    count : int
        How many must agree.
    scale_agrees, rotation_agrees_deg : float
        As in `plates_agree`; half a turn counts.

    Returns
    -------
    kept : tuple of PlateSeen
        Those that go on counting: the newest run of plates that agree pair by pair.
    agreed : PlateSeen or None
        Their median, once there are `count`.
    """
    kept: tuple[PlateSeen, ...] = ()
    for plate in reversed(plates):
        if not all(
            plates_agree(
                plate,
                other,
                scale_agrees=scale_agrees,
                rotation_agrees_deg=rotation_agrees_deg,
                turned=True,
            )
            for other in kept
        ):
            break
        kept = (plate, *kept)
    if len(kept) < count:
        return kept, None
    newest = kept[-1]
    scale = median(plate.scale_arcsec_px for plate in kept)
    return kept, PlateSeen(scale, newest.rotation_deg, newest.parity, newest.size)


Outcome = tuple[NightState, tuple[Decision, ...]]


def on_tick(state: NightState, event: Tick, rules: NightRules) -> Outcome:
    """Begin when it is dark, end when it is not; notice a safety monitor that is not heard of any more."""
    if state.safe_until is not None and event.utc > state.safe_until:
        state, unsafe = _unsafe(state, _silence(state, state.safe_until, event), rules)
        state, done = on_tick(state, event, rules)
        return state, (*unsafe, *done)
    dark = event.sun_altitude_deg < rules.begin_sun_below_deg
    if state.running:
        if event.sun_altitude_deg > rules.end_sun_above_deg and (state.was_dark or not state.forced):
            return _end(state, rules, Why.DAYLIGHT, f"the Sun is at {event.sun_altitude_deg:+.1f}°")
        if dark and not state.was_dark:
            state = replace(state, was_dark=True)
        return state, ()
    # a stopped night stays so until its day is over; the next one has another name
    if not dark or (state.night_id == event.night_id and state.phase is Phase.STOPPED):
        return state, ()
    if not rules.resume and state.night_id not in ("", event.night_id):
        return state, ()
    return _begin(state, event.night_id, Why.DARK, f"the Sun is at {event.sun_altitude_deg:+.1f}°")


def _begin(state: NightState, night_id: str, why: Why, text: str, *, forced: bool = False) -> Outcome:
    """Open a night; the same one once more keeps its counts, so that its caps hold."""
    fresh = NightState(
        holds=state.holds - {Hold.OPERATOR, Hold.CLOUD},
        unsafe=state.unsafe,
        safe_for_s=state.safe_for_s,
        safe_until=state.safe_until,
    )
    if state.night_id == night_id:
        fresh = replace(
            fresh,
            used=state.used,
            corrections=state.corrections,
            corrected=state.corrected,
            frames=state.frames,
            placed=state.placed,
        )
    begun = replace(
        fresh,
        phase=Phase.CALIBRATING,
        night_id=night_id,
        forced=forced,
        was_dark=not forced,
        busy_until=state.busy_until,
        free=state.free,
    )
    return begun, (Decision(Act.BEGIN, why, text),)


def _end(state: NightState, rules: NightRules, why: Why, text: str) -> Outcome:
    done = [Decision(Act.END, why, text)]
    if state.under_way is not None:
        done.insert(0, Decision(Act.HALT, why, text, state.under_way))
    phase = Phase.STOPPED if why is Why.ORDERED else Phase.WAITING
    if why is Why.DAYLIGHT and rules.park_at_end and Hold.MOUNT not in state.holds:
        done.append(Decision(Act.PARK, why, text))
    return replace(state, phase=phase, evidence=None, under_way=None, forced=False, was_dark=False), tuple(
        done
    )


def on_word(state: NightState, event: Said, rules: NightRules) -> Outcome:
    """Do what somebody says: an operator, a safety monitor, another program, the mount's link."""
    text = event.why
    match event.word:
        case Word.BUSY:
            return replace(state, busy_until=event.until, free=False), ()
        case Word.FREE:
            return replace(state, busy_until=None, free=True), ()
        case Word.START:
            if state.running:
                return state, ()
            return _begin(state, event.night_id, Why.ORDERED, text, forced=True)
        case Word.STOP:
            if state.running:
                return _end(state, rules, Why.ORDERED, text)
            stopped = replace(state, phase=Phase.STOPPED, night_id=event.night_id or state.night_id)
            return stopped, (Decision(Act.END, Why.ORDERED, text),)
        case Word.PAUSE:
            return held(state, Hold.OPERATOR, Why.ORDERED, text)
        case Word.RESUME:
            return let_go(state, Hold.OPERATOR, Why.ORDERED, text)
        case Word.UNSAFE:
            return _unsafe(state, event, rules)
        case Word.SAFE:
            return _safe(state, event)
        case Word.MOUNT_LOST:
            return held(state, Hold.MOUNT, Why.MOUNT_LOST, text)
        case Word.MOUNT_BACK:
            return let_go(state, Hold.MOUNT, Why.MOUNT_BACK, text)
        case Word.RESTARTED:
            return _restarted(state, event, rules)


def _unsafe(state: NightState, event: Said, rules: NightRules) -> Outcome:
    new = Hold.UNSAFE not in state.holds
    saying = tuple(sorted((*_unsafe_by_others(state, event), (event.by, event.why))))
    state = _safe_for(replace(state, unsafe=saying), event)
    state, done = held(state, Hold.UNSAFE, Why.UNSAFE, event.why)
    if new and state.running and rules.when_unsafe == "park":
        done = (*done, Decision(Act.PARK, Why.UNSAFE, event.why))
    return state, done


def _safe(state: NightState, event: Said) -> Outcome:
    """One says that it is safe: it is, when nobody says otherwise any more."""
    saying = _unsafe_by_others(state, event)
    state = _safe_for(replace(state, unsafe=saying), event)
    return (state, ()) if saying else let_go(state, Hold.UNSAFE, Why.SAFE, event.why)


def _safe_for(state: NightState, event: Said) -> NightState:
    """Take over for how long a monitor's word holds; a safety file has an age of its own."""
    if event.by:
        return state
    for_s = None if event.until is None else (event.until - event.utc).total_seconds()
    return replace(state, safe_for_s=for_s, safe_until=event.until)


def _silence(state: NightState, until: datetime, event: Tick) -> Said:
    """What a monitor says that is not heard of any more."""
    said = until - timedelta(seconds=state.safe_for_s or 0.0)
    why = (
        f"nobody has said since {said:%H:%M:%S} UTC that it is safe, which held for {state.safe_for_s:.0f} s"
    )
    return Said(event.utc, Word.UNSAFE, why, night_id=event.night_id)


def _unsafe_by_others(state: NightState, event: Said) -> tuple[tuple[str, str], ...]:
    return tuple(report for report in state.unsafe if report[0] != event.by)


def held(state: NightState, hold: Hold, why: Why, text: str) -> Outcome:
    """Correct nothing from now on; what is under way is ended, and its outcome comes as an event."""
    if hold in state.holds:
        return state, ()
    halted = () if state.under_way is None else (Decision(Act.HALT, why, text, state.under_way),)
    paused = replace(state, holds=state.holds | {hold}, evidence=None)
    return paused, (*halted, Decision(Act.PAUSE, why, text))


def let_go(state: NightState, hold: Hold, why: Why, text: str) -> Outcome:
    """End a hold; corrections go on when none is left."""
    if hold not in state.holds:
        return state, ()
    free = replace(state, holds=state.holds - {hold}, evidence=None)
    if hold is Hold.MOUNT:
        # it may have been moved, or have forgotten a correction
        free = replace(free, applied=NO_OFFSET, segment="", not_before=None)
    return free, (Decision(Act.GO_ON, why, text),)


def _restarted(state: NightState, event: Said, rules: NightRules) -> Outcome:
    """Go on with a remembered night: a correction that was in flight counts as made, and proves nothing."""
    if state.safe_for_s is not None:
        # a monitor that goes on speaking has its time once more: when it spoke last is not written down
        state = replace(state, safe_until=event.utc + timedelta(seconds=state.safe_for_s))
    if not state.running:
        return state, ()
    state = replace(
        state,
        under_way=None,
        evidence=None,
        busy_until=None,
        free=False,
        unsolved=0,
        applied=NO_OFFSET,
        segment="",
        not_before=event.utc,
        phase=Phase.FOLLOWING if state.plate is not None else Phase.CALIBRATING,
        holds=state.holds - {Hold.MOUNT, Hold.CLOUD},
    )
    if not rules.resume:
        return _end(state, rules, Why.ORDERED, "nights are not resumed after a restart")
    return state, (Decision(Act.GO_ON, Why.RESTARTED, event.why),)


def on_end(state: NightState, event: CorrectionEnded, rules: NightRules) -> Outcome:
    """Take in what came of a correction: frames from before it count no more."""
    if state.under_way != event.frame_id:
        return state, ()
    applied = state.applied if event.meant is None else event.meant
    settled = event.utc + timedelta(seconds=rules.settle_s)
    return replace(state, under_way=None, evidence=None, applied=applied, not_before=settled), ()


USED_KEPT = 1000
"""So many frames that a correction was decided on are remembered. Chosen by hand, more than a night's frames
that correct. Doubled, so is that memory."""
SIGMAS = 3.0
"""An error counts from so many sigma of the frame's own noise beyond the bound on, and frames agree within as
many: 1 of 370 by chance. Doubled, faint frames correct nothing."""
HOUR = timedelta(hours=1)
"""Over which `NightRules.max_corrections_per_hour` counts."""


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
    recent = tuple(corrected_utc for corrected_utc in state.corrections if frame.utc - corrected_utc < HOUR)
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
    if (
        sum(frame.utc - corrected_utc < HOUR for corrected_utc in state.corrections)
        >= rules.max_corrections_per_hour
    ):
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


def decide(state: NightState, event: Event, rules: NightRules) -> Outcome:
    """Tell what a night does about an event.

    Returns
    -------
    state : NightState
        To be given with the next event.
    decisions : tuple of Decision
        In their order. Each frame of a running night gets exactly one `CORRECT` or `LEAVE`.
    """
    match event:
        case Tick():
            return on_tick(state, event, rules)
        case Said():
            return on_word(state, event, rules)
        case FrameSeen():
            return on_frame(state, event, rules)
        case CorrectionEnded():
            return on_end(state, event, rules)
