"""A night kept in a file, as JSON lines: what came in and what was decided, in the order it happened.

The first line of each run of the service is a header. Then come, each with its `utc`: `state` (of the night,
now and then), `frame` (source, digest, its solution, what the mount said meanwhile), `event` (numbered: time,
words, frames, ends of corrections; with what was decided), `judged` (what a correction was judged by),
`reading` (the mount), `wire` (what went over the mount's line), and, if the journal goes through
`RecordedJournal`, `command`, `command-end` and `look`.
"""

from __future__ import annotations

import json
import logging
import math
import os
import queue
import threading
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from datetime import datetime
from enum import Enum
from pathlib import Path
from typing import Any

from mountnav.frames import Frame
from mountnav.journal.records import CommandEnd, CommandRecord, Entry, Journal, LookRecord
from mountnav.night.frames_in import Arrived
from mountnav.night.placing import Placed
from mountnav.solution import Solution, Verdict

_log = logging.getLogger(__name__)

VERSION = 2
"""1 did not hold what decisions hang on: played again, they differed."""
MOST_WAITING = 100_000


class NightRecording:
    """Writes one file a night into a folder, in a thread of its own. A full disk never stops a night.

    Parameters
    ----------
    folder : Path
        Is made if it isn't there.
    header : mapping
        Who and where: JSON values, or values of ours.
    name_of : callable
        Names the night of an instant; the file's name.
    """

    def __init__(
        self, folder: Path, header: Mapping[str, object], name_of: Callable[[datetime], str]
    ) -> None:
        self._folder = folder
        self._header = dict(header)
        self._name_of = name_of
        self._lines: queue.Queue[tuple[str, str] | None] = queue.Queue(MOST_WAITING)
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._closed = False
        self.problem = ""

    def path_of(self, utc: datetime) -> Path:
        """The file of the night that an instant belongs to."""
        return self._folder / f"{self._name_of(utc)}.jsonl"

    def keep(self, kind: str, utc: datetime, facts: Mapping[str, object]) -> None:
        """Keep one thing; from any thread, never raises, never waits."""
        try:
            line = json.dumps({"kind": kind, "utc": utc.isoformat(), **as_json(facts)}, allow_nan=False)
            if not self._begin():
                return
            self._lines.put_nowait((self._name_of(utc), line))
        except (queue.Full, TypeError, ValueError) as trouble:
            self._trouble(f"{kind} was not recorded: {trouble}")

    def close(self) -> None:
        """Write what waits, and end; what comes later is dropped. Twice is fine."""
        with self._lock:
            thread, self._thread, self._closed = self._thread, None, True
        if thread is not None:
            self._lines.put(None)
            thread.join()

    def _begin(self) -> bool:
        with self._lock:
            # the mount's line is closed after us, and has its last words
            if self._thread is None and not self._closed:
                self._thread = threading.Thread(target=self._write, name="night recording", daemon=True)
                self._thread.start()
            return not self._closed

    def _write(self) -> None:
        """Write lines as they come; runs in the thread."""
        name, file = "", None
        try:
            while (item := self._lines.get()) is not None:
                try:
                    if item[0] != name or file is None:
                        if file is not None:
                            file.close()
                        self._folder.mkdir(parents=True, exist_ok=True)
                        # whole lines reach the disk, however the program ends
                        path = self._folder / f"{item[0]}.jsonl"
                        torn = _is_torn(path)
                        file = path.open("a", encoding="utf-8", buffering=1)
                        name = item[0]
                        if torn:
                            file.write("\n")
                        file.write(
                            json.dumps({"kind": "header", "version": VERSION, **as_json(self._header)})
                        )
                        file.write("\n")
                    file.write(item[1] + "\n")
                    self.problem = ""
                except OSError as trouble:
                    self._trouble(f"the recording can't be written: {trouble}")
        finally:
            if file is not None:
                file.close()

    def _trouble(self, told: str) -> None:
        if not self.problem:
            _log.error("%s", told)
        self.problem = told


class RecordedJournal:
    """A journal whose commands and looks are recorded as well.

    Parameters
    ----------
    journal : Journal
    keep : callable
        As `NightRecording.keep`.
    """

    def __init__(self, journal: Journal, keep: Callable[[str, datetime, Mapping[str, object]], None]) -> None:
        self._journal = journal
        self._keep = keep

    @property
    def problem(self) -> str | None:
        """Why the journal can't be written just now; None when all is well, or where it doesn't tell."""
        told: str | None = getattr(self._journal, "problem", None)
        return told

    async def look(self, record: LookRecord) -> None:
        """Write a look."""
        self._keep("look", record.utc, {"look": record})
        await self._journal.look(record)

    async def begin(self, command: CommandRecord) -> None:
        """Write a command."""
        self._keep("command", command.utc, {"command": command})
        await self._journal.begin(command)

    def begin_now(self, command: CommandRecord) -> None:
        """Write a command."""
        self._keep("command", command.utc, {"command": command})
        self._journal.begin_now(command)

    async def end(self, command_id: str, end: CommandEnd) -> None:
        """Close a command."""
        self._keep("command-end", end.utc, {"command_id": command_id, "end": end})
        await self._journal.end(command_id, end)

    async def note(self, entry: Entry) -> None:
        """Write anything else."""
        await self._journal.note(entry)

    def note_now(self, entry: Entry) -> None:
        """Write anything else."""
        self._journal.note_now(entry)


def _is_torn(path: Path) -> bool:
    """Whether the last line of a file was cut off, as by a crash: the next one must not be glued to it."""
    try:
        with path.open("rb") as file:
            file.seek(-1, os.SEEK_END)
            return file.read(1) != b"\n"
    except OSError:
        # there is none yet, or nothing in it
        return False


def as_json(value: Any) -> Any:
    """Values of ours as JSON values: a dataclass becomes an object with its class as `is`."""
    match value:
        case None | bool() | int() | str():
            return str(value) if isinstance(value, Enum) else value
        case float():
            return value if math.isfinite(value) else None
        case datetime():
            return value.isoformat()
        case Path():
            return str(value)
        case Arrived():
            return {
                "frame_id": value.frame_id,
                "source": value.source,
                "digest": value.digest,
                "arrived_utc": value.arrived_utc.isoformat(),
                "held": value.held,
                "pixels": value.pixels,
                "target": as_json(value.target),
            }
        case Frame():
            return {
                "mid_exposure_utc": as_json(value.mid_exposure_utc),
                "exposure_s": as_json(value.exposure_s),
                "width_px": value.width_px,
                "height_px": value.height_px,
                "center": as_json(value.hint.center),
            }
        case Placed():
            return {"fully": value.fully, "field": value.field, "verdict": as_json(value.verdict)}
        case Verdict():
            return {
                "reason": as_json(value.reason),
                "detail": value.detail,
                "measured": value.measured,
                "solution": None if value.solution is None else _solution(value.solution),
            }
        case Mapping():
            return {str(key): as_json(one) for key, one in value.items()}
        case list() | tuple():
            return [as_json(one) for one in value]
        case set() | frozenset():
            return sorted(as_json(one) for one in value)
    if is_dataclass(value) and not isinstance(value, type):
        plain = {one.name: as_json(getattr(value, one.name)) for one in fields(value)}
        return {"is": type(value).__name__, **plain}
    raise TypeError(f"{type(value).__name__} is no JSON value")


def _solution(solution: Solution) -> dict[str, Any]:
    covariance = solution.center_covariance_arcsec2
    return {
        "ra_deg": solution.center.ra_deg,
        "dec_deg": solution.center.dec_deg,
        "center_sigma_arcsec": as_json(solution.center_sigma_arcsec),
        "covariance_arcsec2": [as_json(float(covariance[i, j])) for i, j in ((0, 0), (0, 1), (1, 1))],
        "scale_arcsec_px": solution.scale_arcsec_px,
        "rotation_deg": solution.rotation_deg,
        "parity": solution.parity,
        "rms_arcsec": as_json(solution.rms_arcsec),
        "pairs": solution.pairs,
        "rejected": solution.rejected,
        "false_probability": solution.false_probability,
        "mode": solution.mode,
        "wcs": as_json({key: _plain(one) for key, one in solution.wcs.items()}),
        "catalog": solution.catalog,
    }


def _plain(value: Any) -> Any:
    """A number as Python has it: cards may hold numpy's."""
    return value.item() if hasattr(value, "item") else value
