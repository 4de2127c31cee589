"""A recorded night decided again: each decision from the values it was made of, and what differs."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import cast

from mountnav.errors import SyncDoubt
from mountnav.frames import Frame
from mountnav.navigation.outside_frames import By, Judged, compared, forbids
from mountnav.navigation.reports import Look
from mountnav.navigation.sync_judge import decide as judge
from mountnav.navigation.sync_policy import SyncPolicy
from mountnav.navigation.sync_trigger import SyncTrigger
from mountnav.night.daylight import night_name, sun_altitude_deg
from mountnav.night.events import Act, CorrectionEnded, Decision, Event, FrameSeen, NightState, Tick, Why
from mountnav.night.frames_in import Arrived
from mountnav.night.memory import state_of as remembered_state
from mountnav.night.memory import state_record
from mountnav.night.placing import Placed, Placing, Seen, placed_by
from mountnav.night.recording import (
    Json,
    Line,
    Recording,
    decision_of,
    frame_of,
    icrs_or_none,
    sync_of,
    verdict_of,
)
from mountnav.night.replay_inputs import Beliefs, event_of, judged_of, meanwhile_of, state_of
from mountnav.night.rules import NightRules, decide
from mountnav.sky.coordinates import Site

__all__ = ["Judgement", "Replay", "ReplayReport", "Row", "paired"]


SAME_ARCSEC = 0.01
"""Errors that differ by less are the same: the numbers go through a file, and are added up once more, ″. Far
below what any rule asks for."""
SAME_ANEW_ARCSEC = 1.0
"""The same where the frame was identified again, perhaps by another version, ″. Chosen by hand. Doubled, a
change of the solver by 2″ goes unsaid."""


@dataclass(frozen=True, slots=True)
class Row:
    """One thing that was decided, then and now.

    Attributes
    ----------
    what : str
        The frame's source, or "night".
    recorded, replayed : str
        "-" where nothing was.
    """

    utc: datetime
    what: str
    recorded: str
    replayed: str
    same: bool


@dataclass(slots=True)
class Judgement:
    """One decision of each, with what came of it if it was a correction.

    Attributes
    ----------
    source : str
        Of the frame; empty for decisions about the night itself.
    anew : bool
        Whether the frame was identified again.
    """

    utc: datetime
    source: str
    then: Decision | None
    now: Decision | None
    ended_then: CorrectionEnded | None = None
    ended_now: CorrectionEnded | None = None
    anew: bool = False

    @property
    def row(self) -> Row:
        """For people and programs."""
        return Row(
            self.utc,
            Path(self.source).name or "night",
            _told(self.then, self.ended_then),
            _told(self.now, self.ended_now),
            self._same(),
        )

    def _same(self) -> bool:
        then, now = self.then, self.now
        if then is None or now is None or (then.act, then.why) != (now.act, now.why):
            return False
        if (then.error is None) != (now.error is None):
            return False
        if then.error is not None and now.error is not None:
            east = abs(then.error.east_arcsec - now.error.east_arcsec)
            north = abs(then.error.north_arcsec - now.error.north_arcsec)
            if max(east, north) > (SAME_ANEW_ARCSEC if self.anew else SAME_ARCSEC):
                return False
        if self.ended_then is None or self.ended_now is None:
            # a recording that ends before the correction did doesn't show it
            return self.ended_then is None
        return (self.ended_then.outcome, self.ended_then.doubts) == (
            self.ended_now.outcome,
            self.ended_now.doubts,
        )


def paired(
    then: Sequence[Decision], now: Sequence[Decision]
) -> Iterator[tuple[Decision | None, Decision | None]]:
    """The decisions of one event, like with like: an event has one of each kind at most, in their order."""
    before, after = ({_kind(decision): decision for decision in some} for some in (then, now))
    for kind in {**before, **after}:
        yield before.get(kind), after.get(kind)


def _kind(decision: Decision) -> str:
    return "frame" if decision.act in (Act.CORRECT, Act.LEAVE) else str(decision.act)


def _told(decision: Decision | None, end: CorrectionEnded | None) -> str:
    if decision is None:
        return "-"
    told = f"{decision.act}: {decision.why}"
    if decision.why is Why.DOUBTED:
        told += f": {decision.text}"
    if decision.error is not None:
        told += f" ({decision.error.east_arcsec:+.1f}″, {decision.error.north_arcsec:+.1f}″)"
    if end is not None:
        told += f"; {end.outcome}"
        if end.doubts:
            told += f" ({', '.join(end.doubts)})"
    return told


NEVER_LONGER_S = 3600.0
"""A pause in the recording is played no longer than this (s of the night). Chosen by hand: an hour without a
line is a service that was off."""


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay came to.

    Attributes
    ----------
    rows : tuple of Row
        The decisions that could be judged, in their order.
    not_judged : int
        Recorded decisions whose values are not all in the recording.
    solved_anew : int
        Frames that were identified again from their files.
    missing : tuple of str
        Files that are gone or changed: their recorded solutions were taken.
    after_missing : int
        Frames that were identified together with a missing one: theirs were taken as well.
    """

    rows: tuple[Row, ...]
    not_judged: int
    frames: int
    solved_anew: int
    missing: tuple[str, ...]
    after_missing: int
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether all that could be judged was decided as it was then; not if nothing could."""
        return all(row.same for row in self.rows) and (bool(self.rows) or not self.not_judged)


@dataclass(frozen=True, slots=True)
class _Frame:
    arrived: Arrived
    seen: Seen
    moving: bool
    segment: str
    anew: bool


@dataclass(slots=True)
class Replay:
    """A replay.

    Parameters
    ----------
    rules : NightRules
        The recorded ones, or others.
    sync : SyncPolicy
        By which corrections are judged.
    other_rules : bool
        Whether rules or policy are others than the recorded ones: then what was remembered of the night is
        the replay's own.
    anew : callable or None
        Makes what identifies frames again; one for each run of the service.
    read : callable
        Reads a frame's file if it is still what it was; None if it is not.
    speed : float
        Seconds of the night in one of ours; 0: as fast as it goes.
    """

    recording: Recording
    rules: NightRules
    site: Site
    telescope_id: str
    sync: SyncPolicy
    other_rules: bool = False
    anew: Callable[[], Placing] | None = None
    read: Callable[[Path, str], Frame | None] = lambda path, digest: None
    speed: float = 0.0
    _state: NightState | None = None
    _known: bool = False
    _run: str = ""
    _next: int = 0
    _placing: Placing | None = None
    _now: datetime | None = None
    _frames: dict[str, _Frame] = field(default_factory=dict)
    _judged: dict[str, Judged] = field(default_factory=dict)
    _commands: dict[str, Json] = field(default_factory=dict)
    _correcting_then: str = ""
    _correcting_now: str = ""
    _judgements: list[Judgement] = field(default_factory=list)
    _corrections: dict[str, Judgement] = field(default_factory=dict)
    _beliefs: Beliefs = field(default_factory=Beliefs)
    _sources: dict[str, str] = field(default_factory=dict)
    _not_judged: int = 0
    _count: int = 0
    _solved_anew: int = 0
    _missing: list[str] = field(default_factory=list)
    _after_missing: int = 0
    _gaps: int = 0
    _other_catalogs: int = 0
    _unjudged_corrections: int = 0

    async def run(self) -> ReplayReport:
        """Play it to its end, and compare. Once."""
        for line in self.recording.lines:
            await self._paced(line.utc)
            match line.kind:
                case "header":
                    self._begun(line)
                case "state":
                    self._state_told(line)
                case "frame":
                    await self._frame(line)
                case "event":
                    self._event(line)
                case "judged":
                    self._judged[str(line.facts["frame_id"])] = judged_of(line.facts["judged"])
                case "command":
                    command = line.facts["command"]
                    self._commands[command["command_id"]] = command
                case "command-end":
                    self._command_ended(self._commands.pop(line.facts["command_id"], None), line.facts["end"])
        return ReplayReport(
            tuple(judgement.row for judgement in self._judgements),
            self._not_judged,
            self._count,
            self._solved_anew,
            tuple(self._missing),
            self._after_missing,
            tuple(self._notes()),
        )

    def _begun(self, line: Line) -> None:
        """The service was started (again), or another night's file was begun: nothing is known."""
        run, self._run = self._run, str(line.facts.get("begun_utc", ""))
        if run and run == self._run:
            # it wrote into another night's file meanwhile
            return
        self._known = False
        self._frames.clear()
        self._correcting_then = self._correcting_now = ""
        self._placing = None if self.anew is None else self.anew()

    async def _paced(self, utc: datetime | None) -> None:
        """Let the time of a line come, if a speed is set; what a clock was set back by takes no time."""
        before, self._now = self._now, utc
        if self.speed > 0.0 and before is not None and utc is not None:
            ahead_s = (utc - before).total_seconds()
            await asyncio.sleep(min(max(ahead_s, 0.0), NEVER_LONGER_S) / self.speed)

    def _notes(self) -> list[str]:
        notes = []
        if self._gaps:
            notes.append(f"{self._gaps} gaps in the recording: it is judged again from the next state on")
        if self._unjudged_corrections:
            notes.append(
                f"{self._unjudged_corrections} corrections were not made then: taken as carried out, since "
                "nobody knows what would have come of them"
            )
        if self._other_catalogs:
            notes.append(f"{self._other_catalogs} frames were identified by another catalog than then")
        return notes

    # -- the state ----------------------------------------------------------------------------------------

    def _state_told(self, line: Line) -> None:
        """Begin with the recorded state, where none is known."""
        if self._known:
            return
        told, own = state_of(line.facts["state"]), self._state
        if self.other_rules and own is not None and own.night_id == told.night_id:
            # by other rules another night was remembered, in its own way; what the restart found is the same
            own = remembered_state(state_record(own))
            slept = own.running and not told.running
            told = replace(own, phase=told.phase, under_way=None, evidence=None) if slept else own
        self._state, self._known, self._next = told, True, int(line.facts["number"])

    # -- frames -------------------------------------------------------------------------------------------

    async def _frame(self, line: Line) -> None:
        """What the rules are given of a frame, made again of what was known of it."""
        facts = line.facts
        arrived = _arrived(facts["arrived"])
        self._count += 1
        self._sources[arrived.frame_id] = arrived.source
        if "placed" not in facts:
            return
        told = facts["placed"]
        placed = Placed(verdict_of(told["verdict"]), bool(told["fully"]), str(told["field"]))
        frame = frame_of(facts["frame"], arrived.source)
        again = await self._placed_anew(arrived, facts)
        if again is not None:
            self._other_catalogs += _catalog(again[1]) not in ("", _catalog(placed))
            frame, placed = again
        middle = frame.mid_exposure_utc
        if "meanwhile" not in facts or middle is None:
            return
        meanwhile = self._beliefs.of(meanwhile_of(facts["meanwhile"]))
        looked = compared(frame, placed.verdict, middle, meanwhile, look_id=arrived.frame_id)
        seen = Seen(frame, placed, looked)
        segment = self._beliefs.segment(str(facts["segment"]))
        self._frames[arrived.frame_id] = _Frame(
            arrived, seen, bool(facts["moving"]), segment, again is not None
        )

    async def _placed_anew(
        self, arrived: Arrived, facts: Mapping[str, object]
    ) -> tuple[Frame, Placed] | None:
        """The frame identified from its file; None where it can't be, as one before it was missing."""
        if self.anew is None:
            return None
        frame = await asyncio.to_thread(self.read, Path(arrived.source), arrived.digest)
        if frame is None:
            # what follows is identified by shifts from frames before
            self._missing.append(arrived.source)
            self._placing = None
            return None
        if self._placing is None:
            self._after_missing += 1
            return None
        self._solved_anew += 1
        frame = replace(frame, source=arrived.source)
        near = icrs_or_none(cast("Json | None", facts["near"]))
        return frame, await placed_by(self._placing, frame, near, fully=bool(facts["fully"]))

    # -- events -------------------------------------------------------------------------------------------

    def _event(self, line: Line) -> None:
        number, then = int(line.facts["number"]), [decision_of(record) for record in line.facts["decisions"]]
        if self._known and number != self._next:
            self._known = False
            self._gaps += 1
        self._next = number + 1
        if not self._known:
            self._not_judged += len(then)
            return
        event = self._of_now(event_of(line.facts["event"]))
        if event is None:
            return
        for before, after in paired(then, self._decided(event)):
            self._compare(event, before, after)

    def _of_now(self, event: Event) -> Event | None:
        """An event as the present code and rules know it; None if it doesn't happen."""
        match event:
            case Tick():
                utc = event.utc
                name = night_name(self.telescope_id, utc, self.site)
                return Tick(utc, sun_altitude_deg(utc, self.site), name)
            case FrameSeen():
                known = self._frames.get(event.frame_id)
                if known is None:
                    return event
                return known.seen.event(known.arrived, event.utc, moving=known.moving, segment=known.segment)
            case CorrectionEnded():
                return self._ended(event)
        return event

    def _decided(self, event: Event) -> tuple[Decision, ...]:
        assert self._state is not None
        self._state, decisions = decide(self._state, event, self.rules)
        return decisions

    def _compare(self, event: Event, then: Decision | None, now: Decision | None) -> None:
        frame_id = next(
            (decision.frame_id for decision in (then, now) if decision is not None and decision.frame_id), ""
        )
        known = self._frames.get(frame_id)
        judgement = Judgement(
            event.utc,
            self._sources.get(frame_id, frame_id),
            then,
            now,
            anew=known is not None and known.anew,
        )
        self._judgements.append(judgement)
        corrects_then = then is not None and then.act is Act.CORRECT
        corrects_now = now is not None and now.act is Act.CORRECT
        if corrects_then:
            self._correcting_then = frame_id
        if corrects_now:
            self._correcting_now = frame_id
        if corrects_then or corrects_now:
            self._corrections[frame_id] = judgement
        if corrects_now and not corrects_then:
            self._made_now(event.utc, frame_id, judgement)

    # -- corrections --------------------------------------------------------------------------------------

    def _ended(self, event: CorrectionEnded) -> CorrectionEnded | None:
        """The end of a correction: as recorded, where it was judged as it was then."""
        self._correcting_then = ""
        judgement = self._corrections.get(event.frame_id)
        if judgement is not None:
            judgement.ended_then = event
        if self._state is None or self._state.under_way != event.frame_id:
            return None
        now = self._end_of(event)
        self._correcting_now = ""
        if judgement is not None:
            judgement.ended_now = now
        return now

    def _end_of(self, event: CorrectionEnded) -> CorrectionEnded:
        frame_id, judged = event.frame_id, self._judged.get(event.frame_id)
        if judged is None:
            # it ended before it was judged
            return event
        if self._beliefs.changed:
            # nobody knows what would have been expected
            return self._done(event.utc, frame_id) if event.outcome == "done" else event
        doubts = self._doubts(frame_id, judged)
        if doubts == judged.doubts and self._by == judged.by:
            return event
        if forbids(doubts, self._by):
            told = tuple(str(doubt) for doubt in doubts)
            return CorrectionEnded(event.utc, frame_id, "refused", None, told)
        if self._by == judged.by and not forbids(judged.doubts, judged.by):
            return event
        self._unjudged_corrections += 1
        self._carried_out(event.utc, frame_id)
        return self._done(event.utc, frame_id)

    def _doubts(self, frame_id: str, judged: Judged) -> tuple[SyncDoubt, ...]:
        """What stands against a correction, judged again by the same values."""
        look = self._look(frame_id)
        if look is None:
            return judged.doubts
        return judge(look, SyncTrigger.NIGHT, self.sync, judged.context).doubts

    def _made_now(self, utc: datetime, frame_id: str, judgement: Judgement) -> None:
        """A correction that wasn't made then is taken as carried out: the frames don't show it."""
        self._unjudged_corrections += 1
        self._carried_out(utc, frame_id)
        judgement.ended_now = self._done(utc, frame_id)
        self._correcting_now = ""
        self._decided(judgement.ended_now)

    def _carried_out(self, utc: datetime, frame_id: str) -> None:
        look = self._look(frame_id)
        if self._by == "sync" and look is not None:
            self._beliefs.made(utc, look, recorded=None)

    def _done(self, utc: datetime, frame_id: str) -> CorrectionEnded:
        look = self._look(frame_id)
        meant = look.offset if look is not None and self._by != "sync" else None
        return CorrectionEnded(utc, frame_id, "done", meant)

    def _command_ended(self, command: Json | None, end: Json) -> None:
        """A sync of the recorded night: made now as well, or not, or another one."""
        sync = None if command is None else sync_of(command, end)
        if sync is None or not self._correcting_then:
            return
        frame_id = self._correcting_then
        judged = self._judged.get(frame_id)
        made = self._correcting_now == frame_id and self._by == "sync"
        if made and judged is not None and not self._beliefs.changed:
            made = not forbids(self._doubts(frame_id, judged), self._by)
        if not made:
            self._beliefs.unmade(sync)
        elif self._beliefs.changed:
            look = self._look(frame_id)
            if look is not None:
                self._beliefs.made(sync.utc, look, recorded=sync)

    def _look(self, frame_id: str) -> Look | None:
        known = self._frames.get(frame_id)
        return None if known is None else known.seen.looked.look

    @property
    def _by(self) -> By:
        # "nothing" never decides to correct
        return cast("By", self.rules.correct_by)


def _catalog(placed: Placed) -> str:
    solution = placed.verdict.solution
    return "" if solution is None else solution.catalog


def _arrived(record: Json) -> Arrived:
    def read() -> Frame:
        raise AssertionError("a replay reads frames by itself")

    return Arrived(
        str(record["frame_id"]),
        str(record["source"]),
        str(record["digest"]),
        datetime.fromisoformat(record["arrived_utc"]),
        read,
        held=bool(record["held"]),
        target=icrs_or_none(record["target"]),
        pixels=bool(record["pixels"]),
    )
