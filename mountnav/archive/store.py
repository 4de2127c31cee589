"""The store of results: a chunk is written beside the others, and put among them as a whole.

What a worker that is killed leaves behind is a folder below ``making`` that nobody reads; the next one that
takes the chunk removes it, and begins the chunk anew. Two that work on the same chunk do no harm: the same
frames under the same recipe give the same bytes, and the second one finds its own result there.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
import platform
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from mountnav.archive.columns import Column, Row, plate_cells, star_rows, verdict_cells
from mountnav.archive.folder import RunFolder, read_json, whole, write_json
from mountnav.archive.recipe import Recipe
from mountnav.archive.tables import (
    COST_TABLE,
    EXPOSURE_TABLE,
    FRAME_TABLE,
    PAIR_TABLE,
    REFUSAL_TABLE,
    SOLUTION_TABLE,
    TableFile,
    sha256_of,
    write_table,
)
from mountnav.archive.work_list import Chunk, Entry
from mountnav.errors import ResultsDiffer
from mountnav.solution import Reason, Times, Verdict

HUNG, DIED, FAULT = "HUNG", "DIED", "FAULT"
"""Codes of frames that are set aside; those of refusals are names of `mountnav.solution.Reason`."""

UNREAD = "UNREAD"
"""Code of a frame whose file isn't there or can't be read."""

_LIBRARIES = ("numpy", "scipy", "astropy", "pyerfa", "pyarrow")
_KERNELS_TOLD_BY = ("scipy_openblas_get_corename64_", "scipy_openblas_get_corename", "openblas_get_corename")
"""Names of OpenBLAS's function that tells them: in the builds of numpy and of scipy, and a system's own."""


@dataclass(frozen=True, slots=True)
class Result:
    """What became of a frame.

    Attributes
    ----------
    sha256 : str
        Of the file; empty where it couldn't be read.
    verdict : Verdict or None
        None where there is none: unread, or set aside.
    code, why : str
        In place of a verdict.
    total_s : float
        From the order to the answer.
    fetch_s, waited_s : float
        Until the frame was here; and how long of that nothing could be solved meanwhile.
    """

    entry: Entry
    sha256: str = ""
    size_bytes: int | None = None
    verdict: Verdict | None = None
    code: str = ""
    why: str = ""
    tries: int = 1
    total_s: float = 0.0
    fetch_s: float = 0.0
    waited_s: float = 0.0

    @property
    def outcome(self) -> str:
        """In a word: "solved", "refused" or "set_aside"."""
        if self.verdict is not None:
            return "solved" if self.verdict.solution is not None else "refused"
        return "refused" if self.code == UNREAD else "set_aside"


@dataclass(slots=True)
class Counts:
    """How many frames came to what."""

    frames: int = 0
    solved: int = 0
    refused: int = 0
    set_aside: int = 0

    def add(self, outcome: str) -> None:
        """Count a frame."""
        self.frames += 1
        setattr(self, outcome, getattr(self, outcome) + 1)

    def plus(self, told: Mapping[str, Any]) -> None:
        """Add those of a finished chunk."""
        for name in ("frames", "solved", "refused", "set_aside"):
            setattr(self, name, getattr(self, name) + int(told[name]))


@dataclass(slots=True)
class ChunkWriter:
    """Takes the results of a chunk, in the order of the list."""

    recipe: Recipe
    budget_s: float
    tables: dict[str, TableFile]
    counts: Counts = field(default_factory=Counts)
    costs: list[Row] = field(default_factory=list)

    def add(self, result: Result) -> None:
        """Take a result. Raises `OSError`."""
        entry, verdict = result.entry, result.verdict
        number: Row = {"number": entry.number}
        cells = self._cells(result)
        origin = None if verdict is None else verdict.origin
        said = origin.mid_exposure_utc if origin is not None else None
        self.tables["frames"].add(
            cells
            | number
            | {
                "file": entry.file,
                "extension": entry.extension,
                "address": self.recipe.address(entry, result.sha256),
                "sha256": result.sha256 or None,
                "bytes": result.size_bytes,
                "outcome": result.outcome,
                "solved": result.outcome == "solved",
                "instrument": (origin.instrument or None) if origin else None,
                "telescope": (origin.telescope or None) if origin else None,
                "field": (origin.field or None) if origin else None,
                "mid_exposure_utc": None if said is None else f"{said:%Y-%m-%dT%H:%M:%S.%fZ}",
            }
            | _prior_cells(verdict)
        )
        if verdict is not None and verdict.solution is not None:
            self.tables["solutions"].add(cells | number)
            if (exposures := self.tables.get("exposures")) is not None:
                for at, solution in enumerate((verdict.solution, *verdict.further), 1):
                    exposures.add(plate_cells(solution) | number | {"exposure": at})
            if (pairs := self.tables.get("pairs")) is not None:
                for row in star_rows(verdict.solution):
                    pairs.add(row | number)
        else:
            self.tables["refusals"].add(cells | number | {"set_aside": result.outcome == "set_aside"})
        times = Times() if verdict is None else verdict.times
        self.costs.append(
            number
            | {
                "read_s": times.read_s,
                "measure_s": times.measure_s,
                "identify_s": times.identify_s,
                "total_s": result.total_s,
                "tries": result.tries,
                "fetch_s": result.fetch_s,
                "waited_s": result.waited_s,
            }
        )
        self.counts.add(result.outcome)

    def _cells(self, result: Result) -> Row:
        """What is said of the frame; nothing that another run could say otherwise."""
        verdict = result.verdict
        if verdict is None:
            return {"reason_code": result.code, "reason": result.why}
        if verdict.reason is Reason.TIMED_OUT:
            # how far a search came in its time is chance
            told = f"{Reason.TIMED_OUT}: {self.budget_s:g} s of processor time were not enough"
            return {"reason_code": Reason.TIMED_OUT.name, "reason": told}
        return verdict_cells(verdict)


def _prior_cells(verdict: Verdict | None) -> Row:
    """What was assumed of the frame; not of one whose search ended by its time, which is chance."""
    part = None if verdict is None or verdict.reason is Reason.TIMED_OUT else verdict.prior
    if part is None:
        return {}
    return {
        "prior": "held" if part.held else "failed",
        "prior_frames": part.frames,
        "prior_scale_low_arcsec_px": part.scale_low_arcsec_px,
        "prior_scale_high_arcsec_px": part.scale_high_arcsec_px,
    }


TABLES: dict[str, tuple[Column, ...]] = {
    "frames": FRAME_TABLE,
    "solutions": SOLUTION_TABLE,
    "refusals": REFUSAL_TABLE,
    "pairs": PAIR_TABLE,
    "exposures": EXPOSURE_TABLE,
}
"""By the names of their files."""


def tables_of(recipe: Recipe) -> list[str]:
    """Which tables the chunks of a run have."""
    asked = {
        "pairs": recipe.decides["pairs"],
        "exposures": recipe.decides["settings"].get("exposures", 1) > 1,
    }
    return [name for name in TABLES if asked.get(name, True)]


@contextmanager
def chunk_written(run: RunFolder, chunk: Chunk, recipe: Recipe) -> Iterator[ChunkWriter]:
    """Write a chunk; it is there when the block ends well, and nothing of it is otherwise.

    Raises
    ------
    ResultsDiffer
        Somebody else finished it meanwhile, with other results.
    OSError
        The disk is full, or gone.
    """
    sums: dict[str, dict[str, Any]] = {}
    names = tables_of(recipe)
    try:
        with (
            whole(run.chunk(chunk.number), run.making, f"{chunk.number:07d}-") as fresh,
            ExitStack() as stack,
        ):
            tables = {name: TableFile(fresh / f"{name}.parquet", TABLES[name]) for name in names}
            for table in tables.values():
                stack.callback(table.abandon)
            writer = ChunkWriter(recipe, recipe.decides["settings"]["budget_s"], tables)
            yield writer
            if writer.counts.frames != chunk.frames:
                raise RuntimeError(
                    f"chunk {chunk.number} has {chunk.frames} frames, {writer.counts.frames} came"
                )
            for name, table in tables.items():
                table.close()
                sums[f"{name}.parquet"] = {"rows": table.rows, "sha256": sha256_of(fresh / f"{name}.parquet")}
            counts = writer.counts
            told = {
                "frames": counts.frames,
                "solved": counts.solved,
                "refused": counts.refused,
                "set_aside": counts.set_aside,
                "recipe": recipe.hash,
                "files": sums,
            }
            write_json(fresh / "chunk.json", told)
            _write_costs(run.cost(chunk.number), writer.costs)
    except FileExistsError as there:
        if read_json(run.chunk(chunk.number) / "chunk.json").get("files") != sums:
            raise ResultsDiffer(
                f"chunk {chunk.number} was finished by another process, with other results",
                device=str(run.path),
                advice="do the machines differ? `mountnav archive verify` names them",
            ) from there


def _write_costs(path: Path, costs: list[Row]) -> None:
    """What the chunk took; an older account of it is replaced."""
    beside = path.with_name(f".{path.name}.{platform.node()}.{os.getpid()}")
    beside.unlink(missing_ok=True)
    try:
        write_table(beside, COST_TABLE, costs, machine())
        os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise


def machine() -> dict[str, str]:
    """On what this runs: the host, its processor, the libraries that compute."""
    told = {"host": platform.node(), "machine": platform.machine(), "python": platform.python_version()}
    for name in _LIBRARIES:
        with suppress(PackageNotFoundError):
            told[name] = installed(name)
    with suppress(OSError, IndexError):
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
        told["processor"] = text.split("model name")[1].split("\n")[0].strip("\t :")
    if kernels := _kernels():
        told["kernels"] = ", ".join(kernels)
    return told


def _kernels() -> list[str]:
    """The processor that OpenBLAS computes for: the last digits are its, and the environment may choose it.

    A batch system gives its jobs an environment of their own: without the ``OPENBLAS_CORETYPE`` of the shell
    the same computer computes other last digits.
    """
    found: set[str] = set()
    with suppress(OSError):
        maps = Path("/proc/self/maps").read_text(encoding="utf-8", errors="replace").splitlines()
        for path in {line.split(maxsplit=5)[-1] for line in maps if "openblas" in line}:
            library = ctypes.CDLL(path)  # it is loaded already
            for name in _KERNELS_TOLD_BY:
                if (told := getattr(library, name, None)) is not None:
                    told.restype = ctypes.c_char_p
                    found.add((told() or b"?").decode("ascii", "replace"))
    return sorted(found)


@contextmanager
def claimed(run: RunFolder, chunk: Chunk) -> Iterator[bool]:
    """Take a chunk, so that no other worker here spends time on it; whether it is ours.

    A claim goes with the process that holds it. Where the file system has no locks every worker may take
    every chunk: that costs time, and changes no result.

    Raises
    ------
    OSError
    """
    path = run.making / f"{chunk.number:07d}.lock"
    number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    locks = True
    try:
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            yield False
            return
        except OSError as fault:
            if fault.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL):
                raise
            locks = False
        if run.chunk(chunk.number).exists():  # finished between the look and the claim
            path.unlink(missing_ok=True)
            yield False
            return
        if locks:  # else another one may be writing there
            for left in run.making.glob(f"{chunk.number:07d}-*"):
                shutil.rmtree(left, ignore_errors=True)
        yield True
        if run.chunk(chunk.number).exists():
            path.unlink(missing_ok=True)
    finally:
        os.close(number)


def read_counts(run: RunFolder, chunk: int) -> dict[str, Any]:
    """What `chunk.json` of a finished chunk tells.

    Raises
    ------
    NotFound, BadRequest
    """
    return read_json(run.chunk(chunk) / "chunk.json")
