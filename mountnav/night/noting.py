"""What a night writes down and tells: decisions with the state they leave, to journal and listeners."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any, Protocol

from mountnav.clock import Clock
from mountnav.errors import JournalFailed
from mountnav.journal.records import Entry, EntryKind, Journal
from mountnav.night.events import Decision
from mountnav.night.memory import FRAME, STATE, state_record
from mountnav.night.states import NightState

_log = logging.getLogger(__name__)

Listen = Callable[[str, dict[str, object]], None]


class Recorder(Protocol):
    """Who keeps what happens, for `mountnav replay`."""

    def keep(self, kind: str, utc: datetime, facts: Mapping[str, object]) -> None:
        """Keep one thing that came in, or was decided. Never raises."""
        ...


class Unrecorded:
    """Keeps nothing."""

    def keep(self, kind: str, utc: datetime, facts: Mapping[str, object]) -> None:
        """Forget."""


class NightNotes:
    """Writes down what one telescope's nights decide.

    Parameters
    ----------
    name : str
        Of the telescope, in the journal.
    journal : Journal
    clock : Clock
    listen : callable
        Told of each decision.
    """

    def __init__(self, name: str, journal: Journal, clock: Clock, listen: Listen) -> None:
        self._name = name
        self._journal = journal
        self._clock = clock
        self._listen = listen

    async def decided(self, decision: Decision, state: NightState, *, ended: str = "") -> bool:
        """Tell of a decision and write it down; whether it is written."""
        self._listen("night", _facts(decision, state))
        return await self._written(self._entry(decision, state, ended=ended))

    def decided_now(self, decision: Decision, state: NightState, *, ended: str) -> None:
        """Leave a row, without waiting."""
        self._journal.note_now(self._entry(decision, state, ended=ended))

    async def note(self, kind: EntryKind, what: str, facts: Mapping[str, object] | None = None) -> bool:
        """Write down anything else; whether it is written."""
        return await self._written(Entry(self._clock.utc(), self._name, kind, what, dict(facts or {})))

    def _entry(self, decision: Decision, state: NightState, *, ended: str = "") -> Entry:
        facts = _facts(decision, state)
        facts[STATE] = state_record(state)
        if ended:
            facts["outcome"] = ended
        what = f"{decision.act}: {decision.why}" + (f" ({decision.text})" if decision.text else "")
        return Entry(self._clock.utc(), self._name, EntryKind.NIGHT, what, facts)

    async def _written(self, entry: Entry) -> bool:
        try:
            await self._journal.note(entry)
        except JournalFailed as error:
            _log.error("%s: %s", self._name, error)
            return False
        return True


def _facts(decision: Decision, state: NightState) -> dict[str, Any]:
    error = decision.error
    return {
        "act": str(decision.act),
        "why": str(decision.why),
        "text": decision.text,
        FRAME: decision.frame_id,
        "night_id": state.night_id,
        "phase": str(state.phase),
        "error_east_arcsec": None if error is None else error.east_arcsec,
        "error_north_arcsec": None if error is None else error.north_arcsec,
        **decision.facts,
    }
