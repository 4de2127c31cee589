"""Small archives with results that were made up: what can be asked of lists, stores and accounts."""

from __future__ import annotations

from pathlib import Path

from mountnav.archive.folder import Folder, RunFolder
from mountnav.archive.recipe import Recipe, begin_run
from mountnav.archive.store import HUNG, UNREAD, Result, chunk_written
from mountnav.archive.work_list import Chunk, Entry, WorkList, add_batch
from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs
from mountnav.solution import Contradiction, Origin, Reason, Times, Verdict

RECIPE = Recipe(
    {
        "mountnav": "0",
        "usable": ["Tycho-2"],
        "settings": {"budget_s": 30.0},
        "pairs": False,
        "deadline_s": 9.0,
    },
    {},
)


def archive(path: Path, frames: int = 7, chunk_frames: int = 3) -> tuple[Folder, RunFolder]:
    """An archive of frames that nobody has, without results."""
    folder = Folder.make(path, chunk_frames)
    add_batch(
        folder, (Entry(f"/frames/{number}.fits", None, 1000, _hint(number)) for number in range(frames))
    )
    run, new = begin_run(folder, RECIPE)
    assert new
    return folder, run


def _hint(number: int) -> Hint | None:
    return Hint(center=Icrs(float(number), 1.0), radius_deg=2.0) if number % 2 else None


def finished(folder: Folder, run: RunFolder, recipe: Recipe = RECIPE, only: int | None = None) -> None:
    """Write results of all chunks, or of one."""
    for chunk in WorkList.open(folder).chunks:
        if only in (None, chunk.number):
            written(run, chunk, recipe)


def written(run: RunFolder, chunk: Chunk, recipe: Recipe = RECIPE, reason: Reason = Reason.NO_MATCH) -> None:
    """Write results of a chunk: refused, unread, and one that hung."""
    with chunk_written(run, chunk, recipe) as writer:
        for entry in chunk.entries():
            writer.add(result_of(entry, reason))


def result_of(entry: Entry, reason: Reason = Reason.NO_MATCH) -> Result:
    """What became of a frame, by its number."""
    if entry.number % 5 == 3:
        return Result(entry, code=UNREAD, why="the file can't be read: gone")
    if entry.number % 5 == 4:
        return Result(entry, "b" * 64, 7, code=HUNG, why="no answer within 9 s, in each of 2 tries", tries=2)
    origin = Origin("a <b>camera</b>", "", f"field {entry.number % 2}", None)
    wrong = Contradiction("center", "OBJCTRA", "here", "there")
    verdict = Verdict(
        None, reason, "drawn", 9, Times(0.1, 0.2, 0.3, 0.6), contradictions=(wrong,), origin=origin
    )
    return Result(entry, f"{entry.number:064x}", 1000, verdict, total_s=0.7)
