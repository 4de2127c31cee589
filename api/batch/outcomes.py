"""What became of one frame, and the count over all."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from api.batch.inputs import FrameFile
from api.http.file_names import shown

if TYPE_CHECKING:
    from api.solver.solve_answer import Answer
    from mountnav.solution import Solution, Verdict

HASHED_AT_ONCE = 1 << 20
"""Bytes that are read at a time for a hash; for speed alone."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one frame.

    Attributes
    ----------
    verdict : Verdict or None
        None where the file couldn't even be read, or was passed over.
    unread : str
        Why it couldn't.
    sha256 : str
        Of the file's bytes; empty where nobody asked for it.
    held : bool or None
        The file is passed over, for a result file holds it; as solved, or not.
    """

    frame: FrameFile
    verdict: Verdict | None = None
    unread: str = ""
    sha256: str = ""
    held: bool | None = None

    @property
    def solution(self) -> Solution | None:
        """Where it lies, if it was solved now."""
        return None if self.verdict is None else self.verdict.solution

    @property
    def solved(self) -> bool:
        """Whether it is solved, now or before."""
        return self.held is True or self.solution is not None

    def answer(self) -> Answer:
        """The record of `mountnav solve --json`."""
        from api.solver.solve_answer import solve_answer, unread_answer

        name = shown(self.frame.path)
        answer = (
            unread_answer(name, self.unread) if self.verdict is None else solve_answer(name, self.verdict)
        )
        if self.frame.one_of_many or (self.sha256 and self.frame.hdu is not None):
            answer["extension"] = self.frame.hdu
        if self.sha256:
            answer["sha256"] = self.sha256
        return answer


@dataclass(slots=True)
class Summary:
    """The count over all frames.

    Attributes
    ----------
    reasons : Counter of str
        Of those that were not solved.
    faults : list of str
        What couldn't be written of frames that were solved.
    """

    frames: int = 0
    solved: int = 0
    held: int = 0
    held_unsolved: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Count a frame."""
        self.frames += 1
        if outcome.held is not None:
            self.held += 1
            self.held_unsolved += not outcome.held
        elif outcome.solved:
            self.solved += 1
        elif outcome.verdict is None or outcome.verdict.reason is None:
            self.reasons[outcome.unread or "not solved"] += 1
        else:
            self.reasons[str(outcome.verdict.reason)] += 1

    @property
    def all_well(self) -> bool:
        """Whether each frame is solved, and all of it was written that was asked for."""
        return not self.reasons and not self.faults and not self.held_unsolved

    def words(self, wall_s: float, *, interrupted: bool = False) -> str:
        """What is said at the end, in one or two lines."""
        new = self.frames - self.held
        parts = [f"{self.solved} of {new} frames solved in {wall_s:.1f} s"]
        if self.held:
            unsolved = f" ({self.held_unsolved} of them not solved)" if self.held_unsolved else ""
            parts.append(f"{self.held} passed over, for the result file holds them{unsolved}")
        if self.faults:
            parts.append(f"{len(self.faults)} not written")
        lines = [("interrupted: " if interrupted else "") + "; ".join(parts)]
        if self.reasons:
            counted = (f"{count} × {reason}" for reason, count in self.reasons.most_common())
            lines.append(f"not solved: {'; '.join(counted)}")
        return "\n".join(lines)


def sha256_of(path: Path) -> str:
    """Hash a plain file. Raises `OSError`."""
    from mountnav.files import open_plain

    with open_plain(path) as file:
        found = hashlib.sha256()
        while part := file.read(HASHED_AT_ONCE):
            found.update(part)
        return found.hexdigest()
