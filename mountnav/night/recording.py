"""A night kept in a file, as JSON lines, in the order it happened; and read back into the same values."""

from __future__ import annotations

import json
import logging
import math
import os
import queue
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from datetime import datetime, timedelta
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from mountnav.devices import MountReading, PierSide
from mountnav.errors import BadRequest
from mountnav.files import MOST_RECORD_BYTES, read_text
from mountnav.frames import Frame, Hint
from mountnav.journal.records import CommandEnd, CommandRecord, Entry, Journal, LookRecord
from mountnav.measuring.measurements import SkyQuality, StarImages
from mountnav.night.events import Act, Decision, Why
from mountnav.night.frames_in import Arrived
from mountnav.night.placing import Placed
from mountnav.parsing import json_of
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import Offset, half_turn_deg
from mountnav.solution import MOVED_KEY, IdentifiedPairs, Reason, Solution, Times, Verdict

_log = logging.getLogger(__name__)

VERSION = 3
"""1 and 2 did not hold what decisions hang on: played again, they differed."""
_DATE_LETTERS = 10
"""Of 2026-11-25, at the end of a night's name."""
MOST_WAITING = 100_000
"""So many lines may wait for a disk that is slow or full; more are dropped, and that is reported. Chosen by
hand. Doubled, so is the memory that a full disk may cost."""


class NightRecording:
    """Writes one file a night into a folder, in a thread of its own. A full disk never stops a night.

    Parameters
    ----------
    folder : Path
        Is made if it isn't there.
    header : mapping
        Who and where: JSON values, or values of ours.
    name_of : callable
        Names the night of an instant; the file's name: what it is of, a dash, and the evening's date.
    keep_days : float
        Nights of the same that are older are removed when another begins; 0 keeps all.
    max_mb : float
        The oldest of them are removed while all together have more; 0 for no bound.
    """

    def __init__(
        self,
        folder: Path,
        header: Mapping[str, object],
        name_of: Callable[[datetime], str],
        *,
        keep_days: float = 0.0,
        max_mb: float = 0.0,
    ) -> None:
        self._keep_days, self._max_mb = keep_days, max_mb
        self._folder = folder
        self._header = dict(header)
        self._name_of = name_of
        self._lines: queue.Queue[tuple[str, str] | None] = queue.Queue(MOST_WAITING)
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self._closed = False
        self.problem = ""

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
                        self._thin(path)
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

    def _thin(self, present: Path) -> None:
        """Remove nights that are too old or too many; the present one, and what isn't ours, stays."""
        date = present.stem[-_DATE_LETTERS:]
        try:
            evening = datetime.fromisoformat(date)
        except ValueError:  # it is named otherwise: nothing of it can be told apart
            return
        beside = self._folder.glob(f"{present.stem[:-_DATE_LETTERS]}????-??-??.jsonl")
        others = sorted(path for path in beside if path != present)
        if self._keep_days > 0:
            first = (evening - timedelta(days=self._keep_days)).date().isoformat()
            for path in others:
                if path.stem[-_DATE_LETTERS:] < first:
                    path.unlink(missing_ok=True)
        if self._max_mb > 0:
            left = [path for path in others if path.exists()]
            size = sum(path.stat().st_size for path in left)
            for path in left:
                if size <= self._max_mb * 1e6:
                    break
                size -= path.stat().st_size
                path.unlink(missing_ok=True)

    def _trouble(self, told: str) -> None:
        if not self.problem:
            _log.error("%s", told)
        self.problem = told


class RecordedJournal:
    """A journal whose commands and looks are recorded as well.

    Parameters
    ----------
    keep : callable
        As `NightRecording.keep`.
    """

    def __init__(self, journal: Journal, keep: Callable[[str, datetime, Mapping[str, object]], None]) -> None:
        self._journal = journal
        self._keep = keep

    @property
    def problem(self) -> str | None:
        """Why the journal can't be written just now; None when all is well, or where it doesn't say."""
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
    """Values of ours as JSON values: a dataclass becomes an object with its class as `is`.

    So the names of such classes are part of the file's format: one that is renamed makes other files.
    """
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
                "target": as_json(value.target if isinstance(value.target, Icrs) else None),
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
                "moved_px": as_json(value.numbers.get(MOVED_KEY)),
                "quality": as_json(value.quality),
                "solution": None if value.solution is None else _solution(value.solution),
            }
        case Mapping():
            return {str(key): as_json(one) for key, one in value.items()}
        case list() | tuple():
            return [as_json(item) for item in value]
        case set() | frozenset():
            return sorted(as_json(item) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        plain = {field.name: as_json(getattr(value, field.name)) for field in fields(value)}
        return {"is": type(value).__name__, **plain}
    raise TypeError(f"{type(value).__name__} is not a JSON value")


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


Json = dict[str, Any]

_HEADER = '{"kind": "header"'
"""How the first line of a run begins."""

OF_NIGHT = "night: "
"""How the cause of a correction by a night begins."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a recording.

    Attributes
    ----------
    number : int
        From 1.
    utc : datetime or None
        Of a header that of the first line of its run.
    """

    number: int
    kind: str
    utc: datetime | None
    facts: Json


@dataclass(frozen=True, slots=True)
class Recording:
    """A recorded night.

    Attributes
    ----------
    header : dict
        Of the first run.
    lines : tuple of Line
        In the order they were written: that of the events, also where a clock was set back.
    """

    path: Path
    header: Json
    lines: tuple[Line, ...]

    def of(self, *kinds: str) -> Iterator[Line]:
        """Lines of these kinds."""
        return (line for line in self.lines if line.kind in kinds)

    @property
    def has_wire(self) -> bool:
        """Whether what went over the mount's line was recorded."""
        return any(True for _ in self.of("wire"))


@dataclass(frozen=True, slots=True)
class RecordedSync:
    """What a sync changed of a mount's belief.

    Attributes
    ----------
    utc : datetime
        From then on its readings show it.
    ra_deg, dec_deg : float
        Belief after minus before, in the mount's own coordinates.
    """

    utc: datetime
    ra_deg: float
    dec_deg: float


_CHANGED = ("done", "late", "elsewhere")
"""Outcomes of a sync that changed its belief; another place taken did as well."""


def read_recording(path: Path) -> Recording:
    """Read a recording; a last line that was cut off by a crash is left out.

    Raises
    ------
    BadRequest
        It is none, with the line; or of another version.
    """
    try:
        texts = read_text(path, MOST_RECORD_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as trouble:
        raise BadRequest(f"the recording can't be read: {trouble}", device=str(path)) from trouble
    lines: list[Line] = []
    for number, text in enumerate(texts, 1):
        try:
            facts = _with_place(json_of(text), f"line {number}", str(path))
            utc = None if facts["kind"] == "header" else datetime.fromisoformat(facts["utc"])
            lines.append(Line(number, str(facts["kind"]), utc, facts))
        except (ValueError, KeyError, TypeError) as trouble:
            if number == len(texts) or texts[number].startswith(_HEADER):
                # a run of the service that was killed while it wrote
                continue
            raise BadRequest(
                f"line {number} is not a line of a recording: {trouble}",
                device=str(path),
                advice="give a file that night.record has written",
            ) from trouble
    if not lines or lines[0].kind != "header":
        raise BadRequest(
            "this is not a recording of a night: it has no header",
            device=str(path),
            advice="give a file that night.record has written",
        )
    other = next(
        (line for line in lines if line.kind == "header" and line.facts.get("version") != VERSION), None
    )
    if other is not None:
        raise BadRequest(
            f"line {other.number}: a recording of version {other.facts.get('version')}, not {VERSION}",
            device=str(path),
            advice="not everything that its decisions depend on is in it: only the "
            "mountnav that wrote it can play it",
        )
    return Recording(path, lines[0].facts, tuple(_timed(lines)))


class _Facts(dict[str, Any]):
    """The facts of a line; a missing field is reported with its place."""

    where = file = ""

    def __missing__(self, key: str) -> Any:
        raise BadRequest(
            f"{self.where} has no {key!r}",
            device=self.file,
            advice="the recording is damaged: give a file that night.record has written",
        )


def _with_place(value: Any, where: str, file: str) -> Any:
    """The same value, whose objects know which line they come from."""
    if isinstance(value, list):
        return [_with_place(item, where, file) for item in value]
    if not isinstance(value, dict):
        return value
    facts = _Facts((key, _with_place(one, f"{where}, {key}", file)) for key, one in value.items())
    facts.where, facts.file = where, file
    return facts


def _timed(lines: list[Line]) -> list[Line]:
    """The lines, headers with the time of what they head; one that heads nothing is left out."""
    timed: list[Line] = []
    headed: datetime | None = None
    for line in reversed(lines):
        # what the wire's ring held from before the start is older than the run
        if line.kind != "wire" and line.utc is not None:
            headed = line.utc
        utc = line.utc or headed
        if utc is not None:
            timed.append(replace(line, utc=utc))
    return timed[::-1]


def reading_of(record: Json) -> MountReading:
    """A reading of the mount."""
    side = record["pier_side"]
    return MountReading(
        place=place_of(record["place"]),
        utc=datetime.fromisoformat(record["utc"]),
        slewing=record["slewing"],
        tracking=record["tracking"],
        parked=record["parked"],
        at_home=record["at_home"],
        pier_side=None if side is None else PierSide(side),
    )


def place_of(record: Json) -> Apparent | Icrs:
    """A place of the kind that it says."""
    if record["is"] == "Icrs":
        return Icrs(float(record["ra_deg"]), float(record["dec_deg"]))
    return Apparent(float(record["ra_deg"]), float(record["dec_deg"]), datetime.fromisoformat(record["utc"]))


def icrs_or_none(record: Json | None) -> Icrs | None:
    """An ICRS place, where there is one."""
    if record is None:
        return None
    place = place_of(record)
    return place if isinstance(place, Icrs) else None


def decision_of(record: Json) -> Decision:
    """A decision."""
    return Decision(
        Act(record["act"]),
        Why(record["why"]),
        str(record["text"]),
        str(record["frame_id"]),
        offset_of(record["error"]),
        record["facts"],
    )


def frame_of(record: Json, source: str) -> Frame:
    """A frame without its pixels, of its size."""
    shape = (int(record["height_px"]), int(record["width_px"]))
    middle = record["mid_exposure_utc"]
    return Frame(
        pixels=np.broadcast_to(np.zeros((1, 1), np.uint8), shape),
        mid_exposure_utc=None if middle is None else datetime.fromisoformat(middle),
        exposure_s=record["exposure_s"],
        hint=Hint(center=icrs_or_none(record["center"])),
        source=source,
    )


def verdict_of(record: Json) -> Verdict:
    """A verdict; its solution has no pairs."""
    told = record["solution"]
    reason = None if record["reason"] is None else Reason(record["reason"])
    solution = None if told is None else _solution_read(told)
    moved_px = record["moved_px"]
    numbers = {} if moved_px is None else {MOVED_KEY: float(moved_px)}
    return Verdict(
        solution,
        reason,
        str(record["detail"]),
        int(record["measured"]),
        Times(),
        numbers,
        quality=_quality_read(record["quality"]),
    )


def _quality_read(record: Json | None) -> SkyQuality | None:
    if record is None:
        return None
    told = {one.name: record[one.name] for one in fields(SkyQuality)}
    return SkyQuality(**told | {"images": StarImages(told["images"])})


def sync_of(command: Json, end: Json) -> RecordedSync | None:
    """What a recorded sync of the night's own changed of the mount's belief; None if it is no such sync."""
    if not is_own_sync(command) or command["before"] is None or end["outcome"] not in _CHANGED:
        return None
    before = place_of(command["before"]["place"])
    after = place_of(command["place"])
    if end["after"] is not None:
        after = place_of(end["after"]["place"])
    return RecordedSync(
        datetime.fromisoformat(end["utc"]),
        half_turn_deg(after.ra_deg - before.ra_deg),
        after.dec_deg - before.dec_deg,
    )


def is_own_sync(command: Mapping[str, Any]) -> bool:
    """Whether a recorded command is a sync by a night's correction."""
    return command.get("order") == "sync" and is_own(command)


def is_own(command: Mapping[str, Any]) -> bool:
    """Whether a recorded command is part of a night's correction, or of its end."""
    return str((command.get("cause") or {}).get("why", "")).startswith(OF_NIGHT)


def offset_of(record: Json | None) -> Offset | None:
    """An offset, where there is one."""
    if record is None:
        return None
    return Offset(float(record["east_arcsec"]), float(record["north_arcsec"]))


def _solution_read(record: Json) -> Solution:
    ee, en, nn = (math.nan if term is None else float(term) for term in record["covariance_arcsec2"])
    nothing = np.zeros(0)
    pairs = IdentifiedPairs(
        x_px=nothing,
        y_px=nothing,
        ra_deg=nothing,
        dec_deg=nothing,
        dx_arcsec=nothing,
        dy_arcsec=nothing,
        flux=nothing,
        flux_sigma=nothing,
        mag=nothing,
        centroid_sigma_arcsec=nothing,
        catalog_sigma_arcsec=nothing,
        flags=np.zeros(0, dtype=np.int64),
        used=np.zeros(0, dtype=np.bool_),
        leverage=nothing,
    )
    return Solution(
        center=Icrs(float(record["ra_deg"]), float(record["dec_deg"])),
        center_sigma_arcsec=_number(record["center_sigma_arcsec"]),
        scale_arcsec_px=float(record["scale_arcsec_px"]),
        rotation_deg=float(record["rotation_deg"]),
        parity=int(record["parity"]),
        rms_arcsec=_number(record["rms_arcsec"]),
        pairs=int(record["pairs"]),
        rejected=int(record["rejected"]),
        false_probability=float(record["false_probability"]),
        mode=str(record["mode"]),
        wcs=dict(record["wcs"]),
        center_covariance_arcsec2=np.array([[ee, en], [en, nn]]),
        identified=pairs,
        catalog=str(record["catalog"]),
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
