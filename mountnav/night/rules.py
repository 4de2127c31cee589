"""The rules of a night: state and event make the next state and decisions; no clock, no device, no file."""

from __future__ import annotations

from mountnav.night.allowed import NightRules
from mountnav.night.events import CorrectionEnded, Event, FrameSeen, Said, Tick
from mountnav.night.frame_rules import on_frame
from mountnav.night.states import NightState
from mountnav.night.word_rules import Outcome, on_end, on_tick, on_word


def decide(state: NightState, event: Event, rules: NightRules) -> Outcome:
    """Tell what a night does about an event.

    Parameters
    ----------
    state : NightState
    event : Tick, Said, FrameSeen or CorrectionEnded
    rules : NightRules

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


__all__ = ["NightRules", "decide"]
