"""Reading a recorded night back: lines become the values that they were written from."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from mountnav.errors import BadRequest
from mountnav.frames import Frame, Hint
from mountnav.navigation.devices import MountReading, PierSide, SyncOutcome
from mountnav.night.events import Act, CorrectionEnded, Decision, Said, Tick, Why, Word
from mountnav.night.recording import VERSION
from mountnav.night.tape import RecordedSync
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import Offset, half_turn_deg
from mountnav.solution import IdentifiedPairs, Reason, Solution, Times, Verdict

Json = dict[str, Any]

OF_NIGHT = "night: "
"""How the cause of a correction by a night begins."""


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a recording.

    Attributes
    ----------
    number : int
        From 1.
    kind : str
    utc : datetime or None
        Of a header that of the first line of its run.
    facts : dict
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
    path : Path
    header : dict
        Of the first run.
    lines : tuple of Line
        In the order of their time.
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


_SYNCS: dict[str, SyncOutcome | None] = {
    "done": SyncOutcome.SEEN,
    "late": SyncOutcome.LATE,
    "ignored": SyncOutcome.IGNORED,
    "refused": None,
}


def read_recording(path: Path) -> Recording:
    """Read a recording; a last line that was cut off by a crash is left out.

    Raises
    ------
    BadRequest
        It is none, with the line; or of another version.
    """
    try:
        texts = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as trouble:
        raise BadRequest(f"the recording can't be read: {trouble}", device=str(path)) from trouble
    lines: list[Line] = []
    for number, text in enumerate(texts, 1):
        try:
            facts = json.loads(text)
            utc = None if facts["kind"] == "header" else datetime.fromisoformat(facts["utc"])
            lines.append(Line(number, str(facts["kind"]), utc, facts))
        except (ValueError, KeyError, TypeError) as trouble:
            if number == len(texts):
                break
            raise BadRequest(
                f"line {number} is no line of a recording: {trouble}",
                device=str(path),
                advice="give a file that night.record has written",
            ) from trouble
    if not lines or lines[0].kind != "header":
        raise BadRequest(
            "this is no recording of a night: it has no header",
            device=str(path),
            advice="give a file that night.record has written",
        )
    if lines[0].facts.get("version") != VERSION:
        raise BadRequest(f"a recording of version {lines[0].facts.get('version')}", device=str(path))
    return Recording(path, lines[0].facts, tuple(_in_time(lines)))


def _in_time(lines: list[Line]) -> list[Line]:
    """Lines in the order of their time; headers stay before what they head."""
    ordered: list[Line] = []
    for at, line in enumerate(lines):
        utc = line.utc
        if utc is None:
            # what the wire's ring held from before the start is older than the run
            later = (one.utc for one in lines[at + 1 :] if one.kind != "wire" and one.utc is not None)
            utc = next(later, None)
        if utc is not None:
            ordered.append(replace(line, utc=utc))
    return sorted(ordered, key=lambda line: (line.utc, line.number))


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


def event_of(record: Json) -> Tick | Said | CorrectionEnded:
    """An event."""
    utc = datetime.fromisoformat(record["utc"])
    match record["is"]:
        case "Tick":
            return Tick(utc, float(record["sun_altitude_deg"]), str(record["night_id"]))
        case "Said":
            until = record["until"]
            return Said(
                utc,
                Word(record["word"]),
                str(record["why"]),
                None if until is None else datetime.fromisoformat(until),
                str(record["night_id"]),
            )
        case _:
            return CorrectionEnded(
                utc,
                str(record["frame_id"]),
                str(record["outcome"]),
                _offset(record["meant"]),
                tuple(record["doubts"]),
            )


def decision_of(record: Json) -> Decision:
    """A decision."""
    return Decision(
        Act(record["act"]),
        Why(record["why"]),
        str(record["text"]),
        str(record["frame_id"]),
        _offset(record["error"]),
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
    solution = None if told is None else _solution(told)
    return Verdict(solution, reason, str(record["detail"]), int(record["measured"]), Times())


def syncs_of_night(recording: Recording) -> list[RecordedSync]:
    """The syncs that the recorded night itself decided on, with what they changed."""
    begun: dict[str, Json] = {}
    found: list[RecordedSync] = []
    for line in recording.of("command", "command-end"):
        if line.kind == "command":
            command = line.facts["command"]
            begun[command["command_id"]] = command
            continue
        command = begun.pop(line.facts["command_id"], {})
        end = line.facts["end"]
        outcome = _SYNCS.get(end["outcome"], "unknown")
        if not is_own_sync(command) or command["before"] is None or outcome == "unknown":
            continue
        before = place_of(command["before"]["place"])
        place = after = place_of(command["place"])
        if end["after"] is not None:
            after = place_of(end["after"]["place"])
        seen = outcome in (SyncOutcome.SEEN, SyncOutcome.LATE)
        found.append(
            RecordedSync(
                datetime.fromisoformat(command["utc"]),
                datetime.fromisoformat(end["utc"]),
                place,
                half_turn_deg(after.ra_deg - before.ra_deg) if seen else 0.0,
                after.dec_deg - before.dec_deg if seen else 0.0,
                None if outcome is None else SyncOutcome(outcome),
            )
        )
    return found


def is_own_sync(command: Mapping[str, Any]) -> bool:
    """Whether a recorded command is a sync by a night's correction."""
    return command.get("order") == "sync" and is_own(command)


def is_own(command: Mapping[str, Any]) -> bool:
    """Whether a recorded command is part of a night's correction, or of its end."""
    return str((command.get("cause") or {}).get("why", "")).startswith(OF_NIGHT)


def _offset(record: Json | None) -> Offset | None:
    if record is None:
        return None
    return Offset(float(record["east_arcsec"]), float(record["north_arcsec"]))


def _solution(record: Json) -> Solution:
    ee, en, nn = (math.nan if one is None else float(one) for one in record["covariance_arcsec2"])
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
