"""A model run as a file: its plan and each point's outcome as comments between the observations.

So that it is a file of observations for everything else, and a run that was interrupted goes on where it was.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from mountnav.devices import PierSide
from mountnav.errors import BadRequest
from mountnav.parsing import json_of
from mountnav.plain_files import MOST_RECORD_BYTES, read_bytes, read_text
from mountnav.pointing.model.planning import RunPoint
from mountnav.pointing.observation import PointingObservation
from mountnav.pointing.observation_file import observation_record, read_observations

PLAN, POINT = "# mountnav model run ", "# point "

Part = Literal["fit", "held-out", "fresh"]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one point.

    Attributes
    ----------
    number : int
        Of the plan.
    look_id : str or None
        Of its observation, if it was solved.
    problem : str or None
        Why not.
    """

    number: int
    look_id: str | None
    problem: str | None = None


@dataclass(frozen=True, slots=True)
class RunFile:
    """A run as far as it has come.

    Attributes
    ----------
    telescope : str
    points : tuple of RunPoint
    fresh : frozenset of int
        Numbers of the points for the last check.
    outcomes : tuple of Outcome
    observations : tuple of PointingObservation
    """

    telescope: str
    points: tuple[RunPoint, ...]
    fresh: frozenset[int]
    outcomes: tuple[Outcome, ...]
    observations: tuple[PointingObservation, ...]

    @property
    def left(self) -> tuple[RunPoint, ...]:
        """Points that nothing has come of yet."""
        done = {one.number for one in self.outcomes}
        return tuple(one for one in self.points if one.number not in done)

    def part(self, observation: PointingObservation) -> Part | None:
        """What an observation is for; None if its point was not ended."""
        for one in self.outcomes:
            if one.look_id is not None and one.look_id == observation.look_id:
                if one.number in self.fresh:
                    return "fresh"
                held_out = any(point.number == one.number and point.held_out for point in self.points)
                return "held-out" if held_out else "fit"
        return None

    def of_part(self, part: Part) -> list[PointingObservation]:
        """The observations for one purpose."""
        return [one for one in self.observations if self.part(one) == part]


def begin(path: Path, telescope: str, points: Sequence[RunPoint], fresh: Iterable[int]) -> None:
    """Write the plan into a new file.

    Raises
    ------
    BadRequest
        There is such a file.
    """
    plan = {
        "telescope": telescope,
        "points": [asdict(one) for one in points],
        "fresh": sorted(fresh),
    }
    try:
        with path.open("x", encoding="utf-8") as out:
            out.write(PLAN + json.dumps(plan, allow_nan=False) + "\n")
    except FileExistsError as cause:
        raise BadRequest(f"{path} is there already") from cause
    except OSError as cause:
        raise BadRequest(f"{path} can't be written: {cause.strerror}") from cause


def add(path: Path, outcome: Outcome, observation: PointingObservation | None) -> None:
    """Write what came of a point; its outcome last, so that it counts only if all of it was written."""
    lines = ""
    if observation is not None:
        lines = json.dumps(observation_record(observation), allow_nan=False) + "\n"
    lines += POINT + json.dumps(asdict(outcome), allow_nan=False) + "\n"
    with path.open("a", encoding="utf-8") as out:
        out.write(lines)
        out.flush()
        os.fsync(out.fileno())


def mend(path: Path) -> None:
    """Cut off a last line that was not written whole, as after a kill; the point is taken again."""
    content = read_bytes(path, MOST_RECORD_BYTES)
    whole = content.rfind(b"\n") + 1
    if whole != len(content):
        with path.open("r+b") as out:
            out.truncate(whole)


def read_run(path: Path) -> RunFile | None:
    """Read a run; None if the file is no run but plain observations.

    Raises
    ------
    BadRequest
        The file can't be read, or is damaged.
    """
    try:
        lines = read_text(path, MOST_RECORD_BYTES).splitlines()
    except (OSError, UnicodeDecodeError) as cause:
        raise BadRequest(f"{path} can't be read: {cause}") from cause
    plan: dict[str, Any] | None = None
    outcomes: list[Outcome] = []
    for number, line in enumerate(lines, start=1):
        try:
            if line.startswith(PLAN):
                plan = json_of(line.removeprefix(PLAN))
            elif line.startswith(POINT):
                outcomes.append(Outcome(**json_of(line.removeprefix(POINT))))
        except (ValueError, TypeError) as cause:
            raise BadRequest(f"{path}, line {number}: a damaged line of a model run") from cause
    if plan is None:
        return None
    try:
        points = tuple(RunPoint(**{**one, "side": PierSide(one["side"])}) for one in plan["points"])
        fresh = frozenset(int(one) for one in plan["fresh"])
        telescope = str(plan["telescope"])
    except (KeyError, TypeError, ValueError) as cause:
        raise BadRequest(f"{path} holds a damaged plan of a model run: {cause}") from cause
    written = tuple(read_observations(path)) if any(one.look_id for one in outcomes) else ()
    return RunFile(telescope, points, fresh, tuple(outcomes), written)
