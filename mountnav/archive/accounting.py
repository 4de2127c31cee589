"""Is every frame accounted for? How far a run is, and whether what it left is whole."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mountnav.archive.folder import Folder, RunFolder, sync_folder
from mountnav.archive.recipe import Recipe, recipe_in
from mountnav.archive.store import Counts, read_counts, tables_of
from mountnav.archive.tables import read_rows, sha256_of
from mountnav.archive.work_list import Chunk, WorkList
from mountnav.errors import MountnavError
from mountnav.files import open_plain

MOST_TROUBLES = 1000
"""Troubles that are told one by one; the rest is counted."""


@dataclass(frozen=True, slots=True)
class Status:
    """How far a run is.

    Attributes
    ----------
    chunks, frames : int
        In the work list.
    making : tuple of int
        Chunks that somebody works on, or that a killed worker left.
    counts : Counts
        Of finished chunks.
    """

    run: str
    chunks: int
    frames: int
    done_chunks: int
    making: tuple[int, ...]
    counts: Counts

    @property
    def complete(self) -> bool:
        """Whether all is done."""
        return self.done_chunks == self.chunks


def status_of(folder: Folder, run: RunFolder, known: dict[int, dict[str, int]] | None = None) -> Status:
    """How far a run is.

    Parameters
    ----------
    known : dict, optional
        Counts of chunks that were read before: filled here, so that a second look reads the new ones only.

    Raises
    ------
    NotFound, BadRequest, OSError
    """
    work, done = WorkList.open(folder), run.done()
    known = {} if known is None else known
    counts = Counts()
    for number in sorted(done):
        if number not in known:
            known[number] = read_counts(run, number)
        counts.plus(known[number])
    making = {int(one.name[:7]) for one in run.making.glob("*.lock") if one.name[:7].isdecimal()} - done
    return Status(run.name, len(work.chunks), work.frames, len(done), tuple(sorted(making)), counts)


@dataclass(slots=True)
class Audit:
    """What `verify` found.

    Attributes
    ----------
    troubles : list of str
        At most `MOST_TROUBLES`.
    missing_chunks : int
        Not done yet: no trouble.
    machines : Counter of str
        Which processors and libraries chunks were made with.
    copies : int
        Frames whose content an earlier frame of the same chunk has.
    """

    counts: Counts = field(default_factory=Counts)
    troubles: list[str] = field(default_factory=list)
    trouble_count: int = 0
    missing_chunks: int = 0
    without_costs: int = 0
    copies: int = 0
    machines: Counter[str] = field(default_factory=Counter)

    def trouble(self, text: str) -> None:
        """Note a trouble."""
        self.trouble_count += 1
        if len(self.troubles) < MOST_TROUBLES:
            self.troubles.append(text)


def verify(
    folder: Folder,
    run: RunFolder,
    *,
    frames: bool = False,
    tell: Callable[[int, int], object] = lambda done, of: None,
) -> Audit:
    """Check that each frame of the work list is in the store exactly once, and that all hashes are right.

    Parameters
    ----------
    frames : bool
        Read the frames themselves again, too: those that are files here.
    tell : callable
        ``tell(done, of)``, after each chunk.

    Returns
    -------
    Audit
        With every trouble: nothing that is damaged ends it.

    Raises
    ------
    BadRequest
        The work list or the recipe is damaged, so that nothing can be compared with it.
    """
    work, recipe, audit = WorkList.open(folder), recipe_in(run), Audit()
    done = run.done()
    for number in sorted(done - {chunk.number for chunk in work.chunks}):
        audit.trouble(f"chunk {number} is in the store, but not in the work list")
    for at, chunk in enumerate(work.chunks):
        if chunk.number not in done:
            audit.missing_chunks += 1
            continue
        try:
            for trouble in _troubles_of(run, chunk, recipe, audit, frames=frames):
                audit.trouble(f"chunk {chunk.number}: {trouble}")
        except (MountnavError, OSError, KeyError, TypeError, ValueError) as fault:
            audit.trouble(f"chunk {chunk.number}: {fault}")
        tell(at + 1, len(work.chunks))
    return audit


def _troubles_of(
    run: RunFolder, chunk: Chunk, recipe: Recipe, audit: Audit, *, frames: bool
) -> Iterator[str]:
    told, path = read_counts(run, chunk.number), run.chunk(chunk.number)
    if told["recipe"] != recipe.hash:
        yield "it was made by another recipe"
    wanted = {f"{name}.parquet" for name in tables_of(recipe)}
    there = {one.name for one in path.iterdir()} - {"chunk.json"}
    if there != wanted or set(told["files"]) != wanted:
        yield f"it holds {', '.join(sorted(there))}, not {', '.join(sorted(wanted))}"
        return
    for name, said in sorted(told["files"].items()):
        if (found := sha256_of(path / name)) != said["sha256"]:
            yield f"{name} is damaged: its SHA-256 is {found}, not {said['sha256']}"
            return
    counts = Counts()
    solved: set[object] = set()
    refused: set[object] = set()
    seen: set[tuple[str, str | None]] = set()
    rows = read_rows(path / "frames.parquet", ["number", "file", "extension", "address", "sha256", "outcome"])
    entries = chunk.entries()
    for entry, row in zip(entries, rows, strict=True):
        if (row["number"], row["file"], row["extension"]) != (entry.number, entry.file, entry.extension):
            yield f"frame {entry.number} of the list is {row['number']} of the store ({row['file']})"
        if row["address"] != recipe.address(entry, str(row["sha256"] or "")):
            yield f"frame {entry.number} has an address that isn't its own"
        counts.add(str(row["outcome"]))
        (solved if row["outcome"] == "solved" else refused).add(row["number"])
        if row["sha256"]:
            key = str(row["sha256"]), entry.extension
            audit.copies += key in seen
            seen.add(key)
        if frames and row["sha256"] and "://" not in entry.file:
            yield from _changed(entry.file, str(row["sha256"]))
    for name, expected in (("solutions", solved), ("refusals", refused)):
        numbers = [row["number"] for row in read_rows(path / f"{name}.parquet", ["number"])]
        if sorted(numbers) != sorted(expected):  # type: ignore[type-var]
            yield f"{name} are not those of its frames"
    if "exposures.parquet" in wanted:
        rows = read_rows(path / "exposures.parquet", ["number", "exposure"])
        if {row["number"] for row in rows if row["exposure"] == 1} != solved:
            yield "exposures are not those of its frames"
    if any(getattr(counts, name) != told[name] for name in ("frames", "solved", "refused", "set_aside")):
        yield "its counts are not those of its rows"
    audit.counts.plus(told)
    _note_machine(run.cost(chunk.number), audit)


def _note_machine(path: Path, audit: Audit) -> None:
    import pyarrow.parquet as pq

    try:
        metadata = pq.read_schema(path).metadata or {}
    except (OSError, ValueError):
        audit.without_costs += 1
        return
    told = {key.decode(): value.decode() for key, value in metadata.items()}
    libraries = ", ".join(f"{name} {told[name]}" for name in ("python", "numpy", "scipy") if name in told)
    kernels = f", kernels of {told['kernels']}" if "kernels" in told else ""
    audit.machines[f"{told.get('processor', told.get('machine', '?'))}: {libraries}{kernels}"] += 1


def _changed(file: str, sha256: str) -> Iterator[str]:
    try:
        with open_plain(Path(file)) as opened:
            found = hashlib.file_digest(opened, "sha256").hexdigest()
    except OSError as fault:
        yield f"{file} can't be read any more: {fault.strerror}"
        return
    if found != sha256:
        yield f"{file} is not what was solved: it was changed"


@dataclass(slots=True)
class Redone:
    """Chunks that are to be done again."""

    chunks: list[int] = field(default_factory=list)
    frames: int = 0


def chunks_with(folder: Folder, run: RunFolder, codes: set[str]) -> Redone:
    """Find the chunks that hold frames that were not solved for one of these reasons.

    Raises
    ------
    BadRequest
    """
    found = Redone()
    for number in sorted(run.done()):
        codes_here = [
            row["reason_code"] for row in read_rows(run.chunk(number) / "refusals.parquet", ["reason_code"])
        ]
        if codes & set(map(str, codes_here)):
            found.chunks.append(number)
            found.frames += sum(code in codes for code in codes_here)
    return found


def taken_out(run: RunFolder, chunks: list[int]) -> None:
    """Take chunks out of the store, each at once. Raises `OSError`."""
    for number in chunks:
        aside = run.making / f"{number:07d}-redo"
        shutil.rmtree(aside, ignore_errors=True)
        os.rename(run.chunk(number), aside)
        sync_folder(run.chunks)
        shutil.rmtree(aside, ignore_errors=True)
