"""What two runs made of the same frames: gained, lost, moved, refused otherwise."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mountnav.archive.columns import Row
from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.tables import read_rows
from mountnav.archive.work_list import WorkList
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec

SAME_PX = 0.1
"""Centers that are nearer than this part of a pixel are the same. Doubled, a shift that other catalogs bring
goes unseen."""
FALSE_PX = 5.0
"""Centers farther apart than so many pixels are two places: one of the two solutions is false. Doubled, a
wrong solution that shares half of its stars passes for a better one."""

KINDS = ("gained", "lost", "contradicting", "moved", "other_reason", "changed_frame")
"""How a frame may differ; the names are explained in `Differences.words`."""

_WORDS = {
    "gained": "solved by the newer run alone",
    "lost": "solved by the older run alone",
    "contradicting": f"solved by both at places more than {FALSE_PX:g} px apart: one is false",
    "moved": f"solved by both, {SAME_PX:g} to {FALSE_PX:g} px apart",
    "other_reason": "refused by both for different reasons",
    "changed_frame": "the file itself was changed between the runs",
}


@dataclass(slots=True)
class Differences:
    """What differs between two runs.

    Attributes
    ----------
    compared, same_solved, same_refused : int
        Frames that both have; of these those with the same answer.
    not_both : int
        Frames of chunks that only one of the runs has finished.
    counts : dict
        By kind (`KINDS`).
    listed : dict
        The first of each kind: number, file, and what each run said.
    """

    compared: int = 0
    same_solved: int = 0
    same_refused: int = 0
    not_both: int = 0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    listed: dict[str, list[dict[str, Any]]] = field(default_factory=lambda: {kind: [] for kind in KINDS})

    @property
    def same(self) -> bool:
        """Whether both runs say the same of all frames."""
        return not any(self.counts.values()) and not self.not_both

    def plain(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {
            "compared": self.compared,
            "same_solved": self.same_solved,
            "same_refused": self.same_refused,
            "not_in_both": self.not_both,
            **self.counts,
            "listed": self.listed,
        }

    def words(self) -> str:
        """For people."""
        lines = [
            f"{self.compared} frames in both runs: {self.same_solved} solved the same, "
            f"{self.same_refused} refused the same"
        ]
        if self.not_both:
            lines.append(f"{self.not_both} frames are finished in one of the runs only")
        for kind in KINDS:
            if self.counts[kind]:
                lines.append(f"{self.counts[kind]} {_WORDS[kind]}")
                lines += [
                    f"  {one['number']} {one['file']}: {one['older']} -> {one['newer']}"
                    for one in self.listed[kind]
                ]
        return "\n".join(lines) + "\n"


def differences(folder: Folder, older: RunFolder, newer: RunFolder, *, most: int = 20) -> Differences:
    """Compare two runs of an archive, chunk by chunk.

    Parameters
    ----------
    most : int
        Frames of each kind that are listed.

    Raises
    ------
    NotFound, BadRequest
        A chunk is damaged.
    """
    found = Differences()
    one_done, other_done = older.done(), newer.done()
    for chunk in WorkList.open(folder).chunks:
        if (chunk.number in one_done) != (chunk.number in other_done):
            found.not_both += chunk.frames
        if chunk.number not in one_done or chunk.number not in other_done:
            continue
        rows = zip(_answers(older, chunk.number), _answers(newer, chunk.number), strict=True)
        for one, other in rows:
            _compare(one, other, found, most)
    return found


def _answers(run: RunFolder, chunk: int) -> list[Row]:
    """What a run says of each frame of a chunk, in the order of the list."""
    path = run.chunk(chunk)
    more: dict[Any, Row] = {}
    names = ["number", "ra_deg", "dec_deg", "scale_arcsec_px"]
    for row in read_rows(path / "solutions.parquet", names):
        more[row["number"]] = row
    for row in read_rows(path / "refusals.parquet", ["number", "reason_code"]):
        more[row["number"]] = row
    rows = read_rows(path / "frames.parquet", ["number", "file", "sha256", "solved"])
    return [row | more[row["number"]] for row in rows]


def _compare(one: Row, other: Row, found: Differences, most: int) -> None:
    found.compared += 1
    kind = _kind(one, other)
    if kind is None:
        if one["solved"]:
            found.same_solved += 1
        else:
            found.same_refused += 1
        return
    found.counts[kind] += 1
    if len(found.listed[kind]) < most:
        listed = {"number": one["number"], "file": one["file"], "older": _said(one), "newer": _said(other)}
        found.listed[kind].append(listed)


def _kind(one: Row, other: Row) -> str | None:
    if one["sha256"] != other["sha256"]:
        return "changed_frame"
    if one["solved"] != other["solved"]:
        return "gained" if other["solved"] else "lost"
    if not one["solved"]:
        return None if one["reason_code"] == other["reason_code"] else "other_reason"
    apart = separation_arcsec(_center(one), _center(other)) / float(one["scale_arcsec_px"] or 1.0)
    if apart <= SAME_PX:
        return None
    return "moved" if apart <= FALSE_PX else "contradicting"


def _center(row: Row) -> Icrs:
    return Icrs(float(row["ra_deg"] or 0.0), float(row["dec_deg"] or 0.0))


def _said(row: Row) -> str:
    if row["solved"]:
        return f"RA {row['ra_deg']:.5f}° Dec {row['dec_deg']:+.5f}°"
    return str(row["reason_code"])
