"""Each event of a night is kept with what was decided by it, so that a replay can decide it once more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime

from mountnav.night.events import Decision, Event
from mountnav.night.noting import Recorder
from mountnav.night.states import NightState

STATE_EVERY = 200
"""So many events from one state to the next: after a line that was lost a replay goes on with the next state
(at a tick every 5 s a quarter of an hour); a night of ticks alone gets some 50 of them."""


class EventsKept:
    """Numbers the events of one session, and keeps the state before the first and then now and again.

    Parameters
    ----------
    recorder : Recorder
    night_name : callable
        Names the night of an instant: each has a recording of its own, which begins with the state.
    """

    def __init__(self, recorder: Recorder, night_name: Callable[[datetime], str]) -> None:
        self._recorder = recorder
        self._night_name = night_name
        self._name = ""
        self._number = 0
        self._since_state = 0

    def keep(self, state: NightState, event: Event, decisions: Sequence[Decision]) -> None:
        """Keep an event.

        Parameters
        ----------
        state : NightState
            Before it.
        event : Event
        decisions : sequence of Decision
            What was decided by it.
        """
        name = self._night_name(event.utc)
        if name != self._name or self._since_state >= STATE_EVERY:
            self._name, self._since_state = name, 0
            self._recorder.keep("state", event.utc, {"number": self._number, "state": state})
        facts = {"number": self._number, "event": event, "decisions": decisions}
        self._recorder.keep("event", event.utc, facts)
        self._number += 1
        self._since_state += 1


__all__ = ["STATE_EVERY", "EventsKept"]
