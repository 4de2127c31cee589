"""An archive's folder: where each thing lies in it, and how a folder comes to be there whole or not at all.

::

    archive.json                         what this is: format, frames a chunk
    list/batch-000000/                   a part of the work list; `init` and `add` make one each
        batch.json                       frames and hash of each of its chunks, and their priority
        0000000.parquet ...              the frames of a chunk
    runs/RUN/                            RUN: the first letters of the recipe's hash
        recipe.json                      what decides the results: version, catalogs, settings
        chunks/chunk=0000000/            there as a whole or not at all, and never changed
            frames.parquet solutions.parquet refusals.parquet [pairs.parquet]
            chunk.json                   counts, and the hash of each file
        costs/0000000.parquet            times, host, libraries: what differs from run to run
        making/                          what is being written; nobody reads it

Nothing else is ever written, least of all a frame.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mountnav.errors import BadRequest, NotFound
from mountnav.files import read_text, replace_bytes

FORMAT = "mountnav-archive"
VERSION = 1
"""Of the folder and of its tables; a newer one is refused."""

MOST_JSON_BYTES = 200_000_000
"""Longest JSON file of an archive: that of a batch of 2.5 million chunks. Doubled, a damaged one costs twice
as much memory."""

_CHUNK = re.compile(r"chunk=(\d{7,})")


@dataclass(frozen=True, slots=True)
class Folder:
    """An archive that is there.

    Attributes
    ----------
    chunk_frames : int
        How many frames a chunk has at most.
    """

    path: Path
    chunk_frames: int

    @classmethod
    def open(cls, path: Path) -> Folder:
        """Open an archive.

        Raises
        ------
        NotFound
            There is none.
        BadRequest
            It is of a newer mountnav, or damaged.
        """
        told = read_json(
            path / "archive.json", missing=f"{path} is not an archive: `mountnav archive init` makes one"
        )
        if told.get("format") != FORMAT or not isinstance(told.get("chunk_frames"), int):
            raise BadRequest(
                f"{path}/archive.json does not belong to an archive", advice="name another folder"
            )
        if told.get("version") != VERSION:
            raise BadRequest(
                f"{path} has version {told.get('version')} of the format, this mountnav knows {VERSION}",
                advice="use the mountnav that it was made with, or a newer one",
            )
        return cls(path, told["chunk_frames"])

    @classmethod
    def make(cls, path: Path, chunk_frames: int) -> Folder:
        """Make an archive in a folder that is empty or not there.

        Raises
        ------
        BadRequest
            The folder holds something.
        OSError
        """
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise BadRequest(
                f"{path} is not empty",
                advice="name a new folder; `mountnav archive add` adds frames to an archive",
            )
        path.mkdir(parents=True, exist_ok=True)
        for name in ("list", "runs"):
            (path / name).mkdir()
        write_json(
            path / "archive.json", {"format": FORMAT, "version": VERSION, "chunk_frames": chunk_frames}
        )
        return cls(path, chunk_frames)

    @property
    def batches(self) -> Path:
        """Where the work list lies."""
        return self.path / "list"

    def runs(self) -> list[str]:
        """Names of the runs, in the order in which they were begun. Raises `BadRequest`."""
        found = []
        for path in self.path.glob("runs/*/recipe.json"):
            order = read_json(path).get("order")
            found.append((order if isinstance(order, int) else 0, path.parent.name))
        return [name for _, name in sorted(found)]

    def run(self, name: str | None) -> RunFolder:
        """A run by its name or the beginning of it; the newest without one.

        Raises
        ------
        NotFound
            There is none, or several begin so.
        """
        names = self.runs()
        fitting = names[-1:] if name is None else [one for one in names if one.startswith(name)]
        if len(fitting) != 1:
            there = f"there are: {', '.join(names)}" if names else "there is none"
            raise NotFound(
                f"{self.path} has no run {name!r}" if name else f"{self.path} has no run", advice=there
            )
        return RunFolder(self.path / "runs" / fitting[0])


@dataclass(frozen=True, slots=True)
class RunFolder:
    """A run of an archive: results under one recipe."""

    path: Path

    @property
    def name(self) -> str:
        """How it is called."""
        return self.path.name

    @property
    def chunks(self) -> Path:
        """Where finished chunks lie."""
        return self.path / "chunks"

    @property
    def making(self) -> Path:
        """Where unfinished ones lie."""
        return self.path / "making"

    def chunk(self, number: int) -> Path:
        """Where a finished chunk lies or will lie."""
        return self.chunks / f"chunk={number:07d}"

    def cost(self, number: int) -> Path:
        """Where it is told what a chunk took."""
        return self.path / "costs" / f"{number:07d}.parquet"

    def done(self) -> set[int]:
        """The chunks that are finished. Raises `OSError`."""
        with suppress(FileNotFoundError):
            return {int(match[1]) for one in os.scandir(self.chunks) if (match := _CHUNK.fullmatch(one.name))}
        return set()

    def make(self) -> None:
        """Make its folders. Raises `OSError`."""
        for folder in (self.chunks, self.making, self.path / "costs"):
            folder.mkdir(parents=True, exist_ok=True)


@contextmanager
def whole(target: Path, making: Path, prefix: str) -> Iterator[Path]:
    """Fill a folder that is put in its place as a whole, when all that was written is on the disk.

    Parameters
    ----------
    target : Path
        Where it goes. Files in it have to be on the disk when the block ends; the folder is seen to here.
    making : Path
        A folder of the same file system.
    prefix : str
        How the folder is called meanwhile.

    Raises
    ------
    FileExistsError
        There is one already; what was written now is gone.
    OSError
        It can't be written; nothing of it is left.
    """
    fresh = Path(tempfile.mkdtemp(prefix=prefix, dir=making))
    try:
        fresh.chmod(0o777 & ~_umask())
        yield fresh
        sync_folder(fresh)
        try:
            # a folder replaces none that holds something
            os.rename(fresh, target)
        except OSError as fault:
            if target.is_dir():
                raise FileExistsError(17, "it is there already", str(target)) from fault
            raise
        sync_folder(target.parent)
    except BaseException:
        shutil.rmtree(fresh, ignore_errors=True)
        raise


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def sync_folder(path: Path) -> None:
    """Have the names in a folder on the disk. Raises `OSError`."""
    number = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def read_json(path: Path, *, missing: str = "") -> dict[str, Any]:
    """Read a JSON object of an archive.

    Raises
    ------
    NotFound
        It isn't there.
    BadRequest
        It is no JSON object.
    """
    try:
        found = json.loads(read_text(path, MOST_JSON_BYTES))
    except FileNotFoundError:
        raise NotFound(missing or f"{path} is not there") from None
    except (OSError, ValueError, RecursionError) as fault:
        raise BadRequest(f"{path} can't be read: {fault}", advice="restore it") from fault
    if not isinstance(found, dict):
        raise BadRequest(f"{path} is not a JSON object", advice="restore it")
    return found


def write_json(path: Path, value: dict[str, Any]) -> None:
    """Write a JSON object, whole or not at all. Raises `OSError`."""
    replace_bytes(path, as_json(value))


def as_json(value: dict[str, Any]) -> bytes:
    """A JSON object as an archive writes it: the same bytes for the same values."""
    return (json.dumps(value, indent=1, sort_keys=True, ensure_ascii=False) + "\n").encode()
