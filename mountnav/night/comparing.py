"""What was decided then and in a replay, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from mountnav.night.events import Act, CorrectionEnded, Decision, Why
from mountnav.night.recorded import Recording, decision_of, event_of

ARCSEC = 1.0
"""Errors that differ by less are the same."""


@dataclass(frozen=True, slots=True)
class Row:
    """One thing that was decided, then and now.

    Attributes
    ----------
    utc : datetime
    what : str
        The frame's source, or "night".
    recorded, replayed : str
        "-" where nothing was.
    same : bool
    """

    utc: datetime
    what: str
    recorded: str
    replayed: str
    same: bool


@dataclass(slots=True)
class Heard:
    """What a replay decides, as it is recorded."""

    decisions: list[tuple[datetime, Decision]] = field(default_factory=list)
    ends: list[CorrectionEnded] = field(default_factory=list)

    def keep(self, kind: str, utc: datetime, facts: Mapping[str, object]) -> None:
        """Keep decisions and ends of corrections."""
        decision, event = facts.get("decision"), facts.get("event")
        if isinstance(decision, Decision):
            self.decisions.append((utc, decision))
        if isinstance(event, CorrectionEnded):
            self.ends.append(event)


def compared(recording: Recording, heard: Heard, sources: Mapping[str, str]) -> tuple[Row, ...]:
    """Each decision of either, in the order of time.

    Parameters
    ----------
    recording : Recording
    heard : Heard
        Of the replay.
    sources : mapping
        Files of the frames, by their ids.
    """
    then = [(line.utc, decision_of(line.facts["decision"])) for line in recording.of("decision")]
    ends = [
        event
        for event in (event_of(line.facts["event"]) for line in recording.of("event"))
        if isinstance(event, CorrectionEnded)
    ]
    recorded = _keyed([(utc, one) for utc, one in then if utc is not None], ends)
    replayed = _keyed(heard.decisions, heard.ends)
    rows = []
    for key in sorted({**recorded, **replayed}, key=lambda one: _utc(recorded, replayed, one)):
        before, after = recorded.get(key), replayed.get(key)
        same = before is not None and after is not None and before.agrees(after)
        what = sources.get(key[0], key[0]) or "night"
        rows.append(
            Row(
                _utc(recorded, replayed, key),
                Path(what).name,
                "-" if before is None else str(before),
                "-" if after is None else str(after),
                same,
            )
        )
    return tuple(rows)


@dataclass(frozen=True, slots=True)
class _Decided:
    utc: datetime
    decision: Decision
    end: CorrectionEnded | None

    def agrees(self, other: _Decided) -> bool:
        one, two = self.decision, other.decision
        if (one.act, one.why) != (two.act, two.why):
            return False
        if (one.error is None) != (two.error is None):
            return False
        if one.error is not None and two.error is not None:
            east = abs(one.error.east_arcsec - two.error.east_arcsec)
            north = abs(one.error.north_arcsec - two.error.north_arcsec)
            if max(east, north) > ARCSEC:
                return False
        mine, its = self.end, other.end
        if mine is None or its is None:
            # a recording that ends before the correction did can't tell
            return mine is None
        return (mine.outcome, mine.doubts) == (its.outcome, its.doubts)

    def __str__(self) -> str:
        decision = self.decision
        told = f"{decision.act}: {decision.why}"
        if decision.why is Why.DOUBTED:
            told += f": {decision.text}"
        if decision.error is not None:
            told += f" ({decision.error.east_arcsec:+.1f}″, {decision.error.north_arcsec:+.1f}″)"
        if self.end is not None:
            told += f"; {self.end.outcome}"
            if self.end.doubts:
                told += f" ({', '.join(self.end.doubts)})"
        return told


Key = tuple[str, int]


def _keyed(decisions: list[tuple[datetime, Decision]], ends: list[CorrectionEnded]) -> dict[Key, _Decided]:
    """Decisions by frame, and those about the night itself in their order."""
    counts: dict[str, int] = {}
    by_frame = {one.frame_id: one for one in ends}
    keyed: dict[Key, _Decided] = {}
    for utc, one in decisions:
        of_frame = one.act in (Act.CORRECT, Act.LEAVE)
        name = one.frame_id if of_frame else f"night, {one.act}"
        number = counts[name] = counts.get(name, 0) + 1
        end = by_frame.get(one.frame_id) if one.act is Act.CORRECT else None
        keyed[(name, number)] = _Decided(utc, one, end)
    return keyed


def _utc(recorded: dict[Key, _Decided], replayed: dict[Key, _Decided], key: Key) -> datetime:
    return (recorded.get(key) or replayed[key]).utc
