"""Reading a recorded night back: lines become the values that they were written from."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from mountnav.devices import MountReading, PierSide
from mountnav.errors import BadRequest
from mountnav.files import MOST_RECORD_BYTES, read_text
from mountnav.frames import Frame, Hint
from mountnav.night.events import Act, Decision, Why
from mountnav.night.recording import VERSION
from mountnav.parsing import json_of
from mountnav.sky.coordinates import Apparent, Icrs
from mountnav.sky.sphere import Offset, half_turn_deg
from mountnav.solution import IdentifiedPairs, Reason, Solution, Times, Verdict

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
    other = next((one for one in lines if one.kind == "header" and one.facts.get("version") != VERSION), None)
    if other is not None:
        raise BadRequest(
            f"line {other.number}: a recording of version {other.facts.get('version')}, not {VERSION}",
            device=str(path),
            advice="what its decisions hang on is not all in it: only the mountnav that wrote it can play it",
        )
    return Recording(path, lines[0].facts, tuple(_timed(lines)))


class _Facts(dict[str, Any]):
    """What a line tells; a field that it doesn't have is told with its place."""

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
        return [_with_place(one, where, file) for one in value]
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
    solution = None if told is None else _solution(told)
    return Verdict(solution, reason, str(record["detail"]), int(record["measured"]), Times())


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
