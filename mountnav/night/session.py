"""The running night of one telescope: frames in, looks out, corrections, drift; `rules` decides."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import cast

import numpy as np

from mountnav.clock import Clock, SystemClock
from mountnav.ephemeris import Ephemeris
from mountnav.errors import (
    BadFrame,
    BadRequest,
    Cancelled,
    DeviceError,
    JournalFailed,
    MountnavError,
    SyncRefused,
)
from mountnav.frames import Frame
from mountnav.journal.records import EntryKind, Journal, Unwritten, because
from mountnav.navigation.reports import Look
from mountnav.night.events import (
    Act,
    CorrectionEnded,
    Decision,
    Event,
    FrameSeen,
    NightState,
    Phase,
    Said,
    Tick,
    Word,
)
from mountnav.night.frames_in import Arrived, FrameAnswer, FramesIn, facts_of
from mountnav.night.memory import (
    FRAME,
    STATE,
    EventsKept,
    Listen,
    NightNotes,
    Recorder,
    Remembered,
    Unrecorded,
    state_record,
)
from mountnav.night.parking import By, NightParking, NightTelescope, Preempt
from mountnav.night.placing import Placing, Seen, placed_by
from mountnav.night.rules import NightRules, decide
from mountnav.series.drift import Drift, Track, fit_drift, jumps
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import Offset, displaced
from mountnav.tasks import waited_for

__all__ = ["Listen", "NightReport", "NightSession", "Recorder", "Unrecorded"]


POINTS_KEPT = 500
"""So many frames of the present field are kept for its drift. Chosen by hand: eight hours of a frame a
minute; older ones are dropped. Doubled, so is the memory that they take."""
LEAST_JUMP_ARCSEC = 5.0
"""A smaller step between two frames is no jump but noise and the worm, ″. Chosen by hand. Doubled, a dither
of 8″ counts as drift."""


@dataclass(frozen=True, slots=True)
class DriftPoint:
    """What the mount was off at one instant: seen minus believed."""

    utc: datetime
    offset: Offset
    sigma_arcsec: float


@dataclass(frozen=True, slots=True)
class DriftSoFar:
    """Of one field and segment.

    Attributes
    ----------
    drift : Drift or None
        How fast seen minus believed changes since the last jump; None with less than three frames.
    jumps_utc : tuple of datetime
        Frames that a jump led to.
    last : Offset
        Seen minus believed of the last frame.
    """

    field: str
    segment: str
    since_utc: datetime
    until_utc: datetime
    frames: int
    drift: Drift | None
    jumps_utc: tuple[datetime, ...]
    last: Offset


class Drifting:
    """Gathers the points of the present field and segment."""

    def __init__(self) -> None:
        self._field = self._segment = ""
        self._points: deque[DriftPoint] = deque(maxlen=POINTS_KEPT)

    def add(self, field: str, segment: str, point: DriftPoint) -> None:
        """Take a frame's point; those of another field or segment are let go."""
        if (field, segment) != (self._field, self._segment):
            self._field, self._segment = field, segment
            self._points.clear()
        self._points.append(point)

    def so_far(self) -> DriftSoFar | None:
        """Tell the drift of the present field."""
        points = sorted(self._points, key=lambda one: one.utc)
        if not points:
            return None
        track = _track(points)
        found = jumps(track, LEAST_JUMP_ARCSEC)
        start = found[-1] if found else 0
        return DriftSoFar(
            field=self._field,
            segment=self._segment,
            since_utc=points[start].utc,
            until_utc=points[-1].utc,
            frames=len(points) - start,
            drift=fit_drift(track.part(start, len(points))),
            jumps_utc=tuple(points[index].utc for index in found),
            last=points[-1].offset,
        )


def _track(points: list[DriftPoint]) -> Track:
    """Offsets as places about the origin of the sky, where east and north are what they are."""
    origin = Icrs(0.0, 0.0)
    places = [displaced(origin, point.offset.east_arcsec, point.offset.north_arcsec) for point in points]
    minutes = [(point.utc - points[0].utc).total_seconds() / 60.0 for point in points]
    sigma = np.array([max(point.sigma_arcsec, 1e-3) for point in points])
    return Track(
        minutes=np.array(minutes),
        ra_deg=np.array([place.ra_deg for place in places]),
        dec_deg=np.array([place.dec_deg for place in places]),
        sigma_arcsec=sigma,
        anchor=np.zeros(len(points), dtype=np.int64),
        anchor_sigma_arcsec=np.zeros(len(points)),
    )


READINGS_MISSED = 3
"""So many readings in a row that fail, and the mount counts as lost. Chosen by hand. Doubled, a lost mount is
noticed twice as late."""
HALT_S = 60.0
"""A correction that is cancelled has so long to stop its mount, s: three times as long as a driver waits for
it to rest (`Timing.stop_timeout_s`). Below that a night could end while its mount still turns."""


@dataclass(frozen=True, slots=True)
class NightReport:
    """What is known of a night.

    Attributes
    ----------
    waiting : int
        Frames that wait.
    sun_altitude_deg : float or None
        At the last tick.
    """

    state: NightState
    waiting: int
    drift: DriftSoFar | None
    last: Decision | None
    sun_altitude_deg: float | None


class NightSession:
    """A telescope's nights, one after the other.

    Parameters
    ----------
    name : str
        Of the telescope, in the journal.
    sun_altitude_deg : callable
        Of an instant.
    night_name : callable
        Names the night of an instant.
    listen : callable, optional
        Told of each decision; it never steers.
    remembered : Remembered, optional
        From the journal: the night goes on where it was.
    make_way : callable, optional
        Ends what others do with the telescope, where it must be parked because it isn't safe.
    """

    def __init__(
        self,
        telescope: NightTelescope,
        rules: NightRules,
        frames: FramesIn,
        placing: Placing,
        *,
        name: str,
        sun_altitude_deg: Callable[[datetime], float],
        night_name: Callable[[datetime], str],
        journal: Journal | None = None,
        clock: Clock | None = None,
        listen: Listen | None = None,
        remembered: Remembered | None = None,
        recorder: Recorder | None = None,
        make_way: Preempt | None = None,
    ) -> None:
        self.frames = frames
        self.rules = rules
        self._telescope = telescope
        self._name = name
        self._placing = placing
        self._sun_altitude_deg = sun_altitude_deg
        self._night_name = night_name
        self._clock = clock or SystemClock()
        self._listen = listen or (lambda kind, data: None)
        self._notes = NightNotes(name, journal or Unwritten(), self._clock, self._listen)
        self._parking = NightParking(telescope, name, self._notes, self._listen, self._clock, make_way)
        self._recorder = recorder or Unrecorded()
        self._events = EventsKept(self._recorder, night_name)
        self._state = NightState()
        self._remembered = remembered
        self._drifting = Drifting()
        self._last: Decision | None = None
        self._sun: float | None = None
        self._missed = 0
        self._correcting: asyncio.Task[object] | None = None

    @property
    def state(self) -> NightState:
        """As of now."""
        return self._state

    def report(self) -> NightReport:
        """Tell what is known."""
        return NightReport(self._state, self.frames.waiting, self._drifting.so_far(), self._last, self._sun)

    # -- what comes in ------------------------------------------------------------------------------------

    async def begin(self) -> None:
        """Go on with the night that the journal remembers, if there is one. Once, before all else."""
        known, self._remembered = self._remembered, None
        if known is None:
            return
        for frame_id in known.frame_ids:
            self.frames.remember(frame_id)
        if known.state is None:
            return
        in_flight = known.state.under_way
        self._state = known.state
        now = self._clock.utc()
        if known.state.night_id != self._night_name(now) and known.state.running:
            # it slept through the morning: that night is over, whatever it was about to do
            self._state = replace(known.state, phase=Phase.WAITING, under_way=None, evidence=None)
        told = "went on after a restart"
        if in_flight is not None:
            told += f"; what came of the correction by frame {in_flight} is not known, it counts as made"
        await self._happened(Said(now, Word.RESTARTED, told))
        if known.owed is not None and known.owed.night_id == self._night_name(now):
            # of tonight; one of long ago moves nothing any more
            self._parking.owe(known.owed)

    async def tick(self) -> None:
        """Let the night see what time it is."""
        now = self._clock.utc()
        self._sun = self._sun_altitude_deg(now)
        await self._happened(Tick(now, self._sun, self._night_name(now)))
        await self._parking.again()

    async def say(self, word: Word, why: str = "", *, for_s: float | None = None, by: str = "") -> None:
        """Say something to the night.

        Parameters
        ----------
        for_s : float, optional
            Of `BUSY`: how long the exposure takes from now on. Of `SAFE`: how long that holds.
        by : str
            Of `SAFE` and `UNSAFE`: who says so; what one says takes back nothing of another.
        """
        now = self._clock.utc()
        until = None if for_s is None else now + timedelta(seconds=for_s)
        safe_for_s = self._state.safe_for_s
        await self._happened(Said(now, word, why, until, self._night_name(now), by))
        if self._state.safe_for_s is not None and self._state.safe_for_s != safe_for_s:
            # no decision, and yet to be known after a restart
            told = f"a monitor says for {self._state.safe_for_s:.0f} s at a time that it is safe"
            await self._notes.note(EntryKind.NIGHT, told, {STATE: state_record(self._state)})

    async def read_mount(self) -> None:
        """Read the mount, so that frames that come later can be compared; notice when it is gone."""
        try:
            reading = await self._telescope.read_mount()
        except DeviceError as error:
            self._missed += 1
            if self._missed == READINGS_MISSED:
                await self.say(Word.MOUNT_LOST, str(error))
            return
        if self._missed >= READINGS_MISSED:
            await self.say(Word.MOUNT_BACK)
        self._missed = 0
        self._recorder.keep("reading", reading.utc, {"reading": reading})

    async def take(self, arrived: Arrived) -> FrameAnswer:
        """Look at a frame, decide, and correct if that was decided. Raises for faults of our own alone."""
        answer = FrameAnswer(arrived.frame_id, arrived.source, arrived.digest, arrived.arrived_utc)
        try:
            with because(night_id=self._state.night_id or None, why="a frame of the night"):
                answer = await self._taken(arrived, answer)
        finally:
            self.frames.answer(replace(answer, done=True))
        answer = replace(answer, done=True)
        self._listen("night-frame", dict(facts_of(answer)))
        return answer

    # -- a frame ------------------------------------------------------------------------------------------

    async def _taken(self, arrived: Arrived, answer: FrameAnswer) -> FrameAnswer:
        if not self._state.running:
            return await self._left(arrived, answer, "no night is running")
        try:
            frame = await asyncio.to_thread(arrived.read)
        except BadFrame as fault:
            return await self._left(arrived, answer, str(fault))
        frame = replace(frame, source=arrived.source)
        answer = replace(answer, mid_utc=frame.mid_exposure_utc)
        moving = None if arrived.target is None or isinstance(arrived.target, Icrs) else arrived.target
        if moving is not None:
            # judged by where it was in the middle of the exposure
            try:
                middle = frame.mid_exposure_utc or arrived.arrived_utc
                arrived = replace(arrived, target=moving.icrs(middle, self._telescope.mount.site))
            except BadRequest as trouble:
                return await self._left(arrived, answer, str(trouble))
        if not arrived.pixels:
            return await self._header_alone(arrived, frame, answer)
        # one reading at least must come after the exposure
        await self.read_mount()
        inputs: dict[str, object] = {"arrived": arrived, "frame": frame}
        try:
            seen = await self._seen(frame, inputs)
        except (BadFrame, DeviceError, JournalFailed) as trouble:
            return await self._left(arrived, answer, str(trouble), inputs)
        solution = seen.placed.verdict.solution
        look = seen.looked.look
        event = seen.event(
            arrived,
            self._clock.utc(),
            moving=self._telescope.activity != "idle",
            segment=self._telescope.mount.segment_id,
        )
        inputs |= {"moving": event.moving, "segment": event.segment}
        self._recorder.keep("frame", event.utc, inputs)
        if look is not None and frame.mid_exposure_utc is not None and not seen.looked.doubts:
            point = DriftPoint(frame.mid_exposure_utc, look.offset, event.sigma_arcsec)
            self._drifting.add(seen.placed.field, event.segment, point)
        decision = _of_frame(await self._happened(event))
        answer = replace(
            answer,
            placed=solution is not None,
            fully=seen.placed.fully,
            seen=None if solution is None else solution.center,
            sigma_arcsec=None if solution is None else solution.center_sigma_arcsec,
            offset=None if look is None else look.offset,
            field=seen.placed.field,
            look_id="" if look is None else look.look_id,
            decision=decision,
            detail=event.detail,
        )
        if decision is not None and decision.act is Act.CORRECT and look is not None:
            # and corrected to where it is now
            wanted = self._now(moving) if moving is not None else arrived.target
            assert wanted is None or isinstance(wanted, Icrs)
            outcome = await self._correct(look, decision, wanted, seen.placed.field)
            answer = replace(answer, outcome=outcome)
        return answer

    async def _seen(self, frame: Frame, inputs: dict[str, object]) -> Seen:
        """Identify and compare; `inputs` gets all that this goes by, as far as it came."""
        fully = self._state.phase is Phase.CALIBRATING
        middle = frame.mid_exposure_utc
        near = None if middle is None else self._telescope.believed(middle)
        inputs |= {"near": near, "fully": fully}
        placed = await placed_by(self._placing, frame, near, fully=fully)
        inputs["placed"] = placed
        looked = await self._telescope.frame(frame, placed.verdict, used="night")
        inputs["meanwhile"] = looked.meanwhile
        return Seen(frame, placed, looked)

    async def _left(
        self,
        arrived: Arrived,
        answer: FrameAnswer,
        detail: str,
        inputs: Mapping[str, object] | None = None,
    ) -> FrameAnswer:
        """Answer for a frame that was not looked at."""
        now = self._clock.utc()
        self._recorder.keep("frame", now, {"arrived": arrived, **(inputs or {}), "detail": detail})
        event = FrameSeen(now, arrived.frame_id, arrived.arrived_utc, detail=detail)
        return replace(answer, decision=_of_frame(await self._happened(event)), detail=detail)

    async def _header_alone(self, arrived: Arrived, frame: Frame, answer: FrameAnswer) -> FrameAnswer:
        """A header without pixels: its place is another program's word, and nothing is corrected by it."""
        told = "a header alone: noted, never corrected by"
        facts = {FRAME: arrived.frame_id, "act": str(Act.LEAVE), "why": told, "source": arrived.source}
        await self._notes.note(EntryKind.NIGHT, told, facts)
        return replace(answer, seen=frame.hint.center, detail=told)

    def _now(self, target: Ephemeris) -> Icrs:
        """Where a target that moves is now; at the end of its ephemeris, if that is over."""
        now = self._clock.utc()
        utc = now if target.ends_utc is None else min(now, target.ends_utc)
        return target.icrs(utc, self._telescope.mount.site)

    # -- corrections --------------------------------------------------------------------------------------

    async def _correct(self, look: Look, decision: Decision, told_target: Icrs | None, field: str) -> str:
        """Carry a correction out; whatever happens, its end goes to the rules."""
        by = cast("By", self.rules.correct_by)  # "nothing" is never decided
        wanted = told_target
        if by != "sync" and wanted is None and decision.error is not None:
            wanted = displaced(look.seen, -decision.error.east_arcsec, -decision.error.north_arcsec)
        outcome, meant, told = "unknown", None, ""
        doubts: tuple[str, ...] = ()

        def heard(judged: object) -> None:
            self._recorder.keep(
                "judged", self._clock.utc(), {"frame_id": decision.frame_id, "judged": judged}
            )

        with because(look_id=look.look_id, why=f"night: {decision.text}"):
            task = waited_for(self._telescope.correct(look, by=by, target=wanted, key=field, heard=heard))
            self._correcting = task
            try:
                done = await task
                outcome, told = "done", done.outcome
                meant = look.offset if done.moved_arcsec > 0.0 else None
            except asyncio.CancelledError:
                outcome, told = "cancelled", "ended before its time"
                if not task.cancelled():
                    # it is we who are cancelled: the correction must not go on alone
                    task.cancel()
                    await asyncio.wait({task}, timeout=HALT_S)
                    self._forget_correction(look, decision, outcome)
                    raise
            except SyncRefused as error:
                outcome, told, doubts = "refused", str(error), tuple(str(doubt) for doubt in error.doubts)
            except Cancelled as error:
                outcome, told = "cancelled", str(error)
            except MountnavError as error:
                outcome, told = "failed", str(error)
            finally:
                self._correcting = None
        # so that a frame that is begun right now has a reading before it
        await self.read_mount()
        await self._happened(CorrectionEnded(self._clock.utc(), decision.frame_id, outcome, meant, doubts))
        text = f"correction {outcome}: {told}"
        await self._notes.decided(
            Decision(Act.CORRECT, decision.why, text, decision.frame_id), self._state, ended=outcome
        )
        return text

    def _forget_correction(self, look: Look, decision: Decision, outcome: str) -> None:
        """On the way out: leave a row, without waiting."""
        self._decide(CorrectionEnded(self._clock.utc(), decision.frame_id, outcome))
        self._notes.decided_now(decision, self._state, ended=outcome)

    async def _halt(self) -> None:
        """End the correction under way; what it moved is stopped by the order that moves it."""
        task = self._correcting
        if task is None:
            return
        task.cancel()
        await asyncio.wait({task}, timeout=HALT_S)

    # -- decisions ----------------------------------------------------------------------------------------

    async def _happened(self, event: Event) -> tuple[Decision, ...]:
        """Let the rules decide, write it down, and do what is to be done at once."""
        decisions = self._decide(event)
        state = self._state
        writing: list[asyncio.Task[bool]] = []
        try:
            for decision in decisions:
                self._last = decision
                self._parking.decided(decision)
                # reported and begun to be written in their order; only a correction waits until that is
                # done: a journal that hangs must not leave the telescope in the rain
                writing.append(waited_for(self._notes.decided(decision, state)))
                await asyncio.sleep(0)
                if decision.act is Act.CORRECT and not await writing[-1]:
                    # what leaves no trace isn't done
                    self._decide(CorrectionEnded(self._clock.utc(), decision.frame_id, "failed"))
                    return tuple(_unwritten(each) if each is decision else each for each in decisions)
                if decision.act is Act.HALT:
                    await self._halt()
                elif decision.act is Act.PARK:
                    await self._parking.park(decision, self._state.night_id)
        finally:
            await asyncio.gather(*writing)
        return decisions

    def _decide(self, event: Event) -> tuple[Decision, ...]:
        """Let the rules decide, and keep what they decided by: no event passes them but here."""
        before = self._state
        self._state, decisions = decide(before, event, self.rules)
        self._events.keep(before, event, decisions)
        return decisions


def _of_frame(decisions: tuple[Decision, ...]) -> Decision | None:
    return next(
        (decision for decision in reversed(decisions) if decision.act in (Act.CORRECT, Act.LEAVE)), None
    )


def _unwritten(decision: Decision) -> Decision:
    return replace(decision, act=Act.LEAVE, text=f"{decision.text}; the journal can't be written")
