"""A recorded night once more: the same code, other rules if one likes, and what was decided otherwise.

Time is virtual. The mount is a tape; there is no port at all, so nothing can move.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Protocol

from mountnav.errors import BadFrame, MountnavError
from mountnav.frames import Frame
from mountnav.journal.memory import MemoryJournal
from mountnav.journal.records import Journal
from mountnav.navigation.devices import Mount
from mountnav.night.comparing import Heard, Row, compared
from mountnav.night.daylight import night_name, sun_altitude_deg
from mountnav.night.events import Said, Tick, Word
from mountnav.night.frames_in import FramesIn
from mountnav.night.memory import remembered
from mountnav.night.placing import Placed, Placing
from mountnav.night.recorded import (
    Line,
    Recording,
    event_of,
    frame_of,
    icrs_or_none,
    is_own,
    place_of,
    verdict_of,
)
from mountnav.night.rules import NightRules
from mountnav.night.session import NightSession
from mountnav.night.telescope import NightTelescope
from mountnav.simulation.virtual_time import VirtualClock
from mountnav.sky.coordinates import Icrs, Site

NEVER_LONGER_S = 3600.0


class Opened(NightTelescope, Protocol):
    """A telescope whose devices are opened and released."""

    async def open(self) -> None:
        """Open them."""
        ...

    async def close(self) -> None:
        """Release them."""
        ...


@dataclass(frozen=True, slots=True)
class ReplayReport:
    """What a replay came to.

    Attributes
    ----------
    rows : tuple of Row
        In the order of time.
    frames : int
    solved_anew : int
        Frames that were identified anew from their files.
    missing : tuple of str
        Files that are gone or changed: their recorded solutions were taken.
    notes : tuple of str
    """

    rows: tuple[Row, ...]
    frames: int
    solved_anew: int
    missing: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether everything was decided as it was then."""
        return all(row.same for row in self.rows)


class AsRecorded:
    """A `Placing` that answers with the recorded solutions, or lets a frame be identified anew.

    Parameters
    ----------
    anew : Placing, optional
        Who identifies frames whose files are there.
    """

    def __init__(self, anew: Placing | None = None) -> None:
        self._anew = anew
        self.now: Placed | None = None
        self.there = False
        self.solved_anew = 0

    async def place(self, frame: Frame, near: Icrs | None, *, fully: bool) -> Placed:
        """The recorded place of the present frame; or anew, if its file is there."""
        if self._anew is not None and self.there:
            self.solved_anew += 1
            return await self._anew.place(frame, near, fully=fully)
        assert self.now is not None
        return self.now


@dataclass(slots=True)
class Replay:
    """A replay.

    Parameters
    ----------
    recording : Recording
    rules : NightRules
        The recorded ones, or others.
    site : Site
    telescope_id : str
    mount : Mount
        The tape.
    make_telescope : callable
        ``make_telescope(mount, journal, clock)``: the navigator.
    clock : VirtualClock
        At the recording's beginning; its loop runs this.
    anew : Placing or None
        Identifies frames anew.
    read : callable
        Reads a frame's file if it is still what it was; None if it is not.
    speed : float
        Seconds of the night in one of ours; 0: as fast as it goes.
    """

    recording: Recording
    rules: NightRules
    site: Site
    telescope_id: str
    mount: Mount
    make_telescope: Callable[[Mount, Journal, VirtualClock], Opened]
    clock: VirtualClock
    anew: Placing | None = None
    read: Callable[[Path, str], Frame | None] = lambda path, digest: None
    speed: float = 0.0
    heard: Heard = field(default_factory=Heard)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    sources: dict[str, str] = field(default_factory=dict)

    async def run(self) -> ReplayReport:
        """Play it to its end, and compare."""
        journal = MemoryJournal()
        placing = AsRecorded(self.anew)
        telescope: Opened | None = None
        session: NightSession | None = None
        commands: dict[str, dict[str, object]] = {}
        frames = 0
        try:
            for line in self.recording.lines:
                await self._until(line.utc)
                if line.kind == "header":
                    # the service was started (again): all is new but for the journal
                    if telescope is not None:
                        await telescope.close()
                    telescope = self.make_telescope(self.mount, journal, self.clock)
                    await telescope.open()
                    session = self._session(telescope, placing, journal)
                    await session.begin()
                    continue
                if session is None or telescope is None:
                    continue
                if line.kind == "reading":
                    await session.read_mount()
                elif line.kind == "event":
                    await _said(session, line)
                elif line.kind == "frame":
                    frames += 1
                    await self._frame(session, placing, line)
                elif line.kind == "command":
                    command = line.facts["command"]
                    commands[command["command_id"]] = command
                elif line.kind == "command-end":
                    command = commands.pop(line.facts["command_id"], {})
                    await self._others(telescope, command, line.facts["end"])
        finally:
            if telescope is not None:
                await telescope.close()
        rows = compared(self.recording, self.heard, self.sources)
        return ReplayReport(rows, frames, placing.solved_anew, tuple(self.missing), tuple(self.notes))

    # -- the lines ----------------------------------------------------------------------------------------

    def _session(self, telescope: NightTelescope, placing: Placing, journal: MemoryJournal) -> NightSession:
        return NightSession(
            telescope,
            self.rules,
            FramesIn(1_000_000),
            placing,
            name=self.telescope_id,
            sun_altitude_deg=lambda utc: sun_altitude_deg(utc, self.site),
            night_name=lambda utc: night_name(self.telescope_id, utc, self.site),
            journal=journal,
            clock=self.clock,
            remembered=remembered(journal.entries),
            recorder=self.heard,
        )

    async def _until(self, utc: datetime | None) -> None:
        """Let the time of a line come; at some speed, if one is set."""
        if utc is None:
            return
        ahead_s = (utc - self.clock.utc()).total_seconds()
        if ahead_s <= 0.0:
            return
        if self.speed > 0.0:
            await asyncio.to_thread(time.sleep, min(ahead_s, NEVER_LONGER_S) / self.speed)
        await self.clock.sleep(ahead_s)

    async def _frame(self, session: NightSession, placing: AsRecorded, line: Line) -> None:
        told = line.facts["arrived"]
        source, digest = str(told["source"]), str(told["digest"])
        self.sources[str(told["frame_id"])] = source
        frame: Frame | None = None
        placing.now, placing.there = None, False
        if "placed" in line.facts:
            placed = line.facts["placed"]
            placing.now = Placed(verdict_of(placed["verdict"]), bool(placed["fully"]), str(placed["field"]))
            frame = frame_of(line.facts["frame"], source)
            if self.anew is not None:
                frame = await self._from_file(Path(source), digest, placing) or frame
        detail = str(line.facts.get("detail", ""))

        def read() -> Frame:
            if frame is None:
                raise BadFrame(detail)
            return frame

        session.frames.offer(
            source,
            digest,
            read,
            datetime.fromisoformat(told["arrived_utc"]),
            held=bool(told["held"]),
            target=icrs_or_none(told["target"]),
            pixels=bool(told["pixels"]),
        )
        await session.take(await session.frames.next())

    async def _from_file(self, path: Path, digest: str, placing: AsRecorded) -> Frame | None:
        frame = await asyncio.to_thread(self.read, path, digest)
        if frame is None:
            self.missing.append(str(path))
            return None
        placing.there = True
        return frame

    async def _others(
        self, telescope: NightTelescope, command: Mapping[str, object], end: Mapping[str, object]
    ) -> None:
        """What somebody else ordered through the service: told to the navigator's mount, as it was then."""
        if not command or is_own(command) or end.get("outcome") not in ("done", "late"):
            return
        order, place = command.get("order"), command.get("place")
        mount = telescope.mount
        act = getattr(mount, {"set-park": "set_park"}.get(str(order), str(order)), None)
        try:
            if order in ("slew", "sync") and isinstance(place, dict) and act is not None:
                await act(place_of(place))
            elif order in ("park", "unpark", "home", "stop") and act is not None:
                await act()
        except MountnavError as error:
            self.notes.append(f"{order} of the recording: {error}")


async def _said(session: NightSession, line: Line) -> None:
    event = event_of(line.facts["event"])
    if isinstance(event, Tick):
        await session.tick()
    elif isinstance(event, Said) and event.word is not Word.RESTARTED:
        for_s = None if event.until is None else (event.until - event.utc).total_seconds()
        await session.say(event.word, event.why, for_s=for_s)
