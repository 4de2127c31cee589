"""What a night does about time, words and the ends of corrections: begin, end, hold, let go."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta

from mountnav.night.allowed import NightRules
from mountnav.night.events import (
    Act,
    CorrectionEnded,
    Decision,
    Said,
    Tick,
    Why,
    Word,
)
from mountnav.night.states import NO_OFFSET, Hold, NightState, Phase

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
    return tuple(one for one in state.unsafe if one[0] != event.by)


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
