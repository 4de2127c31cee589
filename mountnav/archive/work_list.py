"""The work list: which frames are to be solved, in chunks, in batches that are added as a whole."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mountnav.archive.folder import Folder, read_json, whole, write_json
from mountnav.archive.tables import LIST_COLUMNS, read_rows, sha256_of, write_table
from mountnav.errors import BadRequest
from mountnav.frames import Hint
from mountnav.sky.coordinates import Icrs


@dataclass(frozen=True, slots=True)
class Entry:
    """A frame that is to be solved.

    Attributes
    ----------
    file : str
        A path, or a URL.
    extension : str or None
        Of a FITS file, by number or name; None: chosen by the reader.
    size_bytes : int or None
        None: not known before it is fetched.
    hint : Hint or None
        What the list says of it.
    number : int
        Its place in the list; given by the list.
    """

    file: str
    extension: str | None = None
    size_bytes: int | None = None
    hint: Hint | None = None
    number: int = -1

    @property
    def hdu(self) -> int | str | None:
        """The extension as readers take it."""
        if self.extension is not None and self.extension.isdecimal():
            return int(self.extension)
        return self.extension


@dataclass(frozen=True, slots=True)
class Chunk:
    """A chunk of the list: where it lies, how many frames it has, what goes first, and the hash of its file.

    Lists of older versions have no hashes.
    """

    number: int
    path: Path
    frames: int
    priority: int
    sha256: str | None = None

    def entries(self) -> list[Entry]:
        """Its frames.

        Raises
        ------
        BadRequest
            The list is damaged.
        """
        try:
            damaged = self.sha256 is not None and sha256_of(self.path) != self.sha256
        except OSError as fault:
            raise BadRequest(
                f"{self.path} can't be read: {fault.strerror or fault}", advice="restore it"
            ) from fault
        if damaged:
            raise BadRequest(f"{self.path} is damaged: its SHA-256 is another", advice="restore it")
        found = [_entry(row) for row in read_rows(self.path)]
        if len(found) != self.frames:
            raise BadRequest(f"{self.path} has {len(found)} frames, not {self.frames}", advice="restore it")
        return found


@dataclass(frozen=True, slots=True)
class WorkList:
    """All chunks of an archive, in the order of the list."""

    chunks: tuple[Chunk, ...]

    @classmethod
    def open(cls, folder: Folder) -> WorkList:
        """Read which chunks there are.

        Raises
        ------
        BadRequest
            A part of the list is damaged or missing.
        """
        chunks: list[Chunk] = []
        for path in _batches(folder):
            told = read_json(path / "batch.json")
            try:
                if told["first_chunk"] != len(chunks):
                    raise ValueError("a batch before it is missing")
                counts = [int(count) for count in told["frames"]]
                priority = int(told["priority"])
                hashes = told.get("sha256", [None] * len(counts))
                if len(hashes) != len(counts):
                    raise ValueError("it has another number of hashes than of chunks")
            except (KeyError, TypeError, ValueError) as fault:
                raise BadRequest(f"{path}/batch.json is damaged: {fault}", advice="restore it") from fault
            for count, sha256 in zip(counts, hashes, strict=True):
                number = len(chunks)
                chunks.append(Chunk(number, path / _name(number), count, priority, sha256))
        return cls(tuple(chunks))

    @property
    def frames(self) -> int:
        """How many frames all chunks have."""
        return sum(chunk.frames for chunk in self.chunks)

    def in_order(self) -> list[Chunk]:
        """The chunks as they are worked on: what has the higher priority first, else by number."""
        return sorted(self.chunks, key=lambda chunk: (-chunk.priority, chunk.number))

    def part(self, which: int, of: int) -> list[Chunk]:
        """The chunks of one of so many workers, counted from 0 or from 1; each chunk has one worker.

        Parameters
        ----------
        which : int
            0 and `of` are the same worker.
        """
        return [chunk for at, chunk in enumerate(self.in_order()) if at % of == which % of]


def add_batch(folder: Folder, entries: Iterable[Entry], priority: int = 0) -> int:
    """Add frames to the list, all or none of them.

    Parameters
    ----------
    entries : iterable of Entry
        Without numbers. Gone through once, a chunk at a time.
    priority : int
        The higher goes first.

    Returns
    -------
    int
        How many frames were added.

    Raises
    ------
    BadRequest
        There is none.
    OSError
    """
    known = WorkList.open(folder)
    first_chunk, number = len(known.chunks), known.frames
    counts: list[int] = []
    hashes: list[str] = []
    at = len(_batches(folder))
    with whole(folder.batches / f"batch-{at:06d}", folder.batches, ".making-") as fresh:
        waiting = iter(entries)
        while part := list(itertools.islice(waiting, folder.chunk_frames)):
            rows = (_row(entry, number + place) for place, entry in enumerate(part))
            path = fresh / _name(first_chunk + len(counts))
            write_table(path, LIST_COLUMNS, rows)
            hashes.append(sha256_of(path))
            number += len(part)
            counts.append(len(part))
        if not counts:
            raise BadRequest(
                "there is no frame to add", advice="name files, folders, patterns, a list or a table"
            )
        told = {"first_chunk": first_chunk, "frames": counts, "priority": priority, "sha256": hashes}
        write_json(fresh / "batch.json", told)
    return sum(counts)


def _batches(folder: Folder) -> list[Path]:
    found = sorted(folder.batches.glob("batch-*"))
    if [path.name for path in found] != [f"batch-{at:06d}" for at in range(len(found))]:
        raise BadRequest(f"{folder.batches}: a batch is missing", advice="restore it")
    return found


def _name(chunk: int) -> str:
    return f"{chunk:07d}.parquet"


def _row(entry: Entry, number: int) -> dict[str, Any]:
    row: dict[str, Any] = {
        "number": number,
        "file": entry.file,
        "extension": entry.extension,
        "bytes": entry.size_bytes,
    }
    hint = entry.hint
    if hint is not None:
        row |= {
            "scale_low_arcsec_px": hint.scale_low_arcsec_px,
            "scale_high_arcsec_px": hint.scale_high_arcsec_px,
        }
        if hint.center is not None:
            row |= {
                "ra_deg": hint.center.ra_deg,
                "dec_deg": hint.center.dec_deg,
                "radius_deg": hint.radius_deg,
            }
    return row


def _entry(row: dict[str, Any]) -> Entry:
    center = None if row["ra_deg"] is None else Icrs(row["ra_deg"], row["dec_deg"])
    low, high = row["scale_low_arcsec_px"], row["scale_high_arcsec_px"]
    hint = None
    if center is not None or low is not None or high is not None:
        hint = Hint(
            center=center,
            radius_deg=1.0 if row["radius_deg"] is None else row["radius_deg"],
            scale_low_arcsec_px=low,
            scale_high_arcsec_px=high,
            center_source="the work list",
            scale_source="the work list",
        )
    return Entry(row["file"], row["extension"], row["bytes"], hint, row["number"])


def numbered(chunks: Iterable[Chunk]) -> Iterator[Entry]:
    """The frames of several chunks."""
    for chunk in chunks:
        yield from chunk.entries()
