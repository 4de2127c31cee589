"""What a night writes down: its state, decisions and events, from which it goes on after a restart."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any, Protocol

from mountnav.clock import Clock
from mountnav.errors import JournalFailed
from mountnav.journal.records import Entry, EntryKind, Journal
from mountnav.night.events import Act, Decision, Event, Hold, NightState, Phase, PlateSeen, Why
from mountnav.sky.sphere import Offset

__all__ = ["STATE_EVERY", "EventsKept"]


USED_WRITTEN = 50
"""So many of the frames that a correction was decided on stand in each row of state. Chosen by hand: a
restart must not decide on one of the last frames again. Doubled, each row of a night grows by 1.7 kB."""
STATE = "state"
FRAME = "frame_id"
PARK_OVER = "park over"
"""The act of a row that says how a park ended."""


@dataclass(frozen=True, slots=True)
class OwedPark:
    """A park that was decided on and isn't done.

    Attributes
    ----------
    night_id : str
        Of its night.
    """

    decision: Decision
    night_id: str

    def after(self, decision: Decision, night_id: str) -> OwedPark | None:
        """What is owed after another decision.

        One that takes the reason away ends it, and one that says that somebody has taken over. A park for
        a park for rain stays one: the morning's would wait for those who work.
        """
        for_rain = self.decision.why is Why.UNSAFE
        if decision.act is Act.PARK:
            return self if for_rain else OwedPark(decision, night_id)
        over = (Act.GO_ON, Why.SAFE) if for_rain else (Act.BEGIN, decision.why)
        return None if (decision.act, decision.why) in (over, (Act.END, Why.ORDERED)) else self


@dataclass(frozen=True, slots=True)
class Remembered:
    """What the journal knows of a telescope's nights.

    Attributes
    ----------
    state : NightState or None
        As of the last row that has it.
    frame_ids : tuple of str
        Frames that were looked at, oldest first.
    owed : OwedPark or None
        A park that was decided on and of whose end nothing is written.
    """

    state: NightState | None
    frame_ids: tuple[str, ...]
    owed: OwedPark | None = None


def remembered(entries: Iterable[Entry]) -> Remembered:
    """Read a telescope's night rows.

    Parameters
    ----------
    entries : iterable of Entry
        Of the kind `NIGHT`, oldest first.
    """
    state: NightState | None = None
    owed: OwedPark | None = None
    frames: dict[str, None] = {}
    for entry in entries:
        if entry.kind is not EntryKind.NIGHT:
            continue
        frame_id = entry.facts.get(FRAME)
        if isinstance(frame_id, str) and frame_id:
            frames[frame_id] = None
        told = entry.facts.get(STATE)
        if isinstance(told, Mapping):
            state = state_of(told)
        if entry.facts.get("act") == PARK_OVER:
            owed = None
        elif (decision := _decision(entry.facts)) is not None:
            night_id = str(entry.facts.get("night_id", ""))
            if owed is not None:
                owed = owed.after(decision, night_id)
            elif decision.act is Act.PARK:
                owed = OwedPark(decision, night_id)
    return Remembered(state, tuple(frames), owed)


def _decision(facts: Mapping[str, Any]) -> Decision | None:
    try:
        return Decision(Act(facts["act"]), Why(facts["why"]), str(facts.get("text", "")))
    except (KeyError, ValueError):
        return None  # no decision, or one of another version


def state_record(state: NightState) -> dict[str, Any]:
    """JSON values of a state: what must outlive a restart."""
    plate = state.plate
    return {
        "phase": str(state.phase),
        "night_id": state.night_id,
        "forced": state.forced,
        "was_dark": state.was_dark,
        "plate": None if plate is None else _plate_record(plate),
        "plates": [_plate_record(plate) for plate in state.plates],
        "holds": sorted(str(hold) for hold in state.holds),
        "unsafe": [list(report) for report in state.unsafe],
        "safe_for_s": state.safe_for_s,
        "field": state.field,
        "segment": state.segment,
        "applied_east_arcsec": state.applied.east_arcsec,
        "applied_north_arcsec": state.applied.north_arcsec,
        "under_way": state.under_way,
        "used": list(state.used[-USED_WRITTEN:]),
        "corrections": [utc.isoformat() for utc in state.corrections],
        "corrected": state.corrected,
        "not_before": None if state.not_before is None else state.not_before.isoformat(),
        "frames": state.frames,
        "placed": state.placed,
        "unsolved": state.unsolved,
    }


def state_of(record: Mapping[str, Any]) -> NightState:
    """Inverse of `state_record`.

    Raises
    ------
    KeyError, ValueError, TypeError
        It is no such record.
    """
    applied = Offset(float(record["applied_east_arcsec"]), float(record["applied_north_arcsec"]))
    return state_with(record, applied)


def state_with(record: Mapping[str, Any], applied: Offset) -> NightState:
    """What the journal and a recording write alike of a state, with the offset that each writes in its way.

    Raises
    ------
    KeyError, ValueError, TypeError
        It is no such record.
    """
    not_before = record["not_before"]
    plate = record["plate"]
    return NightState(
        phase=Phase(record["phase"]),
        night_id=str(record["night_id"]),
        forced=bool(record["forced"]),
        was_dark=bool(record["was_dark"]),
        plates=tuple(plate_of(plate) for plate in record["plates"]),
        plate=None if plate is None else plate_of(plate),
        holds=frozenset(Hold(hold) for hold in record["holds"]),
        unsafe=_unsafe(record),
        safe_for_s=None if (safe_for_s := record.get("safe_for_s")) is None else float(safe_for_s),
        field=str(record["field"]),
        segment=str(record["segment"]),
        applied=applied,
        under_way=record["under_way"],
        used=tuple(record["used"]),
        corrections=tuple(datetime.fromisoformat(utc) for utc in record["corrections"]),
        corrected=int(record["corrected"]),
        not_before=None if not_before is None else datetime.fromisoformat(not_before),
        frames=int(record["frames"]),
        placed=int(record["placed"]),
        unsolved=int(record["unsolved"]),
    )


def _unsafe(record: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    if "unsafe" in record:
        return tuple((str(by), str(why)) for by, why in record["unsafe"])
    # until 2026-11 it was not written down who reported it
    return (("", str(record["unsafe_why"])),) if str(Hold.UNSAFE) in record["holds"] else ()


def _plate_record(plate: PlateSeen) -> dict[str, Any]:
    return {
        "scale_arcsec_px": plate.scale_arcsec_px,
        "rotation_deg": plate.rotation_deg,
        "parity": plate.parity,
        "size": list(plate.size),
    }


def plate_of(record: Mapping[str, Any]) -> PlateSeen:
    """A plate that was seen."""
    width, height = record["size"]
    return PlateSeen(
        float(record["scale_arcsec_px"]),
        float(record["rotation_deg"]),
        int(record["parity"]),
        (int(width), int(height)),
    )


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


STATE_EVERY = 200
"""So many events from one state to the next: after a line that was lost a replay goes on with the next state
(at a tick every 5 s a quarter of an hour); a night of ticks alone gets some 50 of them."""


class EventsKept:
    """Numbers the events of one session, and keeps the state before the first and then now and again.

    Parameters
    ----------
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
