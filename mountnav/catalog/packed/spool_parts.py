"""A part of a spool: one file of sorted runs of stars, complete or not there.

::

    runs      one after the other: n keys (u32), then n stars (`RAW`), both in the order of the keys
    trailer   JSON, UTF-8: name, runs (n of each), fast (stars above each of `FAST_LIMITS_MAS_YR`), has_flags
    end       u32 length of the trailer, magic "MNAVPART" (8 bytes)

The file is written under another name, made durable, and then gets its own: a name is a promise.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.fast_stars import FAST_LIMITS_MAS_YR
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.packed.raw_stars import RAW, Raw, raw_stars, speeds_mas_yr
from mountnav.catalog.packed.writer import sync_folder
from mountnav.parsing import json_of

SUFFIX = ".stars"
UNFINISHED = ".unfinished"
KEY = np.dtype("<u4")
RUN_STARS = 1_000_000
"""At most so many are sorted at once; 37 bytes each, and some copies."""
_MAGIC = b"MNAVPART"
_END_BYTES = 12


@dataclass(frozen=True, slots=True)
class SpooledPart:
    """A part that is safely in.

    Attributes
    ----------
    path : Path
    name : str
        Of the part.
    runs : tuple of int
        Stars in each run.
    fast : tuple of int
        Stars faster than each of `FAST_LIMITS_MAS_YR`.
    has_flags : bool
        Whether the catalog has flags.
    """

    path: Path
    name: str
    runs: tuple[int, ...]
    fast: tuple[int, ...]
    has_flags: bool

    @property
    def count(self) -> int:
        """Stars in it."""
        return sum(self.runs)

    @classmethod
    def at(cls, path: Path) -> SpooledPart | None:
        """Look at a part's file.

        Parameters
        ----------
        path : Path

        Returns
        -------
        SpooledPart or None
            None if it isn't whole: a disk may lose what it promised to have kept.
        """
        try:
            with path.open("rb") as file:
                size = file.seek(0, os.SEEK_END)
                if size < _END_BYTES:
                    return None
                file.seek(size - _END_BYTES)
                end = file.read(_END_BYTES)
                length = int.from_bytes(end[:4], "little")
                if end[4:] != _MAGIC or length > size - _END_BYTES:
                    return None
                file.seek(size - _END_BYTES - length)
                told = json_of(file.read(length))
            found = cls(path, told["name"], tuple(told["runs"]), tuple(told["fast"]), told["has_flags"])
            whole = size == found.count * (KEY.itemsize + RAW.itemsize) + length + _END_BYTES
            return found if whole and path == part_path(path.parent, found.name) else None
        except (ValueError, KeyError, TypeError, RecursionError):
            return None

    def boundaries(self, keys: NDArray[np.int64]) -> NDArray[np.int64]:
        """How many stars of each run lie before some keys.

        Parameters
        ----------
        keys : ndarray, shape (m,)

        Returns
        -------
        ndarray, shape (runs, m)
        """
        result = np.zeros((len(self.runs), keys.size), dtype=np.int64)
        if not self.runs:
            return result
        mapped = np.memmap(self.path, dtype=np.uint8, mode="r")
        for row, (at, count) in zip(result, self._places(), strict=True):
            own = np.frombuffer(mapped, dtype=KEY, count=count, offset=at)
            # the key after the last needs 33 bits nowhere: 12 × 4**14 < 2**32
            row[:] = np.searchsorted(own, keys.astype(KEY))
        return result

    def stars(self, first: NDArray[np.int64], end: NDArray[np.int64]) -> list[Raw]:
        """Read a piece of each run.

        Parameters
        ----------
        first, end : ndarray, shape (runs,)
            Stars first[k] to end[k] - 1 of run k.

        Returns
        -------
        list of ndarray of RAW

        Raises
        ------
        OSError
            It can't be read.
        """
        if not np.any(end > first):
            return []
        pieces = []
        with self.path.open("rb") as file:
            for (at, count), begin, stop in zip(self._places(), first.tolist(), end.tolist(), strict=True):
                if stop > begin:
                    file.seek(at + count * KEY.itemsize + begin * RAW.itemsize)
                    pieces.append(np.frombuffer(file.read((stop - begin) * RAW.itemsize), dtype=RAW))
        return pieces

    def pieces(self, most: int) -> Iterator[Raw]:
        """Read all stars, at most so many at once."""
        for number, count in enumerate(self.runs):
            for begin in range(0, count, most):
                first, end = np.zeros((2, len(self.runs)), dtype=np.int64)
                first[number], end[number] = begin, min(begin + most, count)
                yield from self.stars(first, end)

    def _places(self) -> Iterator[tuple[int, int]]:
        at = 0
        for count in self.runs:
            yield at, count
            at += count * (KEY.itemsize + RAW.itemsize)


def part_path(folder: Path, name: str) -> Path:
    """Where a part of a name lies: names may hold anything, so the file is called by their hash."""
    return folder / (hashlib.sha256(name.encode()).hexdigest()[:24] + SUFFIX)


def write_part(folder: Path, name: str, chunks: Iterable[CatalogColumns]) -> SpooledPart:
    """Write a part; it is durable when this returns, and leaves nothing when it doesn't.

    Parameters
    ----------
    folder : Path
    name : str
    chunks : iterable of CatalogColumns

    Returns
    -------
    SpooledPart

    Raises
    ------
    NotWritable
        A value cannot be written.
    OSError
        The disk refuses.
    """
    path = part_path(folder, name)
    unfinished = path.with_suffix(UNFINISHED)
    try:
        with unfinished.open("wb") as out:
            written = _Written(out)
            for raw in _joined(chunks, written):
                written.run(raw)
            part = SpooledPart(path, name, tuple(written.runs), tuple(written.fast), written.has_flags)
            told = asdict(part)
            del told["path"]
            trailer = json.dumps(told, sort_keys=True).encode()
            out.write(trailer + len(trailer).to_bytes(4, "little") + _MAGIC)
            out.flush()
            os.fsync(out.fileno())
        unfinished.replace(path)
        sync_folder(folder)
    except BaseException:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)
        raise
    return part


class _Written:
    """What of a part has been written so far."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self.runs: list[int] = []
        self.fast = [0] * len(FAST_LIMITS_MAS_YR)
        self.has_flags = False

    def run(self, raw: Raw) -> None:
        if not raw.size:
            return
        # ties fall as they like: the order of the packed form is made at the end
        ordered = raw[np.argsort(raw["key"])]
        self._out.write(np.ascontiguousarray(ordered["key"]).tobytes())
        self._out.write(ordered.tobytes())
        self.runs.append(int(raw.size))
        speed = speeds_mas_yr(raw)
        for at, limit in enumerate(FAST_LIMITS_MAS_YR):
            self.fast[at] += int(np.sum(speed > limit))


def _joined(chunks: Iterable[CatalogColumns], written: _Written) -> Iterator[Raw]:
    """Small chunks together, large ones cut: runs of `RUN_STARS`, and a last one of what is left."""
    waiting: list[Raw] = []
    for chunk in chunks:
        written.has_flags |= chunk.flags is not None
        cuts = [*range(0, chunk.ra_deg.size, RUN_STARS), chunk.ra_deg.size]
        for begin, end in pairwise(cuts):
            waiting.append(raw_stars(_cut(chunk, begin, end)))
            if sum(raw.size for raw in waiting) >= RUN_STARS:
                yield np.concatenate(waiting)
                waiting.clear()
    if waiting:
        yield np.concatenate(waiting)


def _cut(columns: CatalogColumns, begin: int, end: int) -> CatalogColumns:
    if end - begin == columns.ra_deg.size:
        return columns
    piece = slice(begin, end)
    return CatalogColumns(
        columns.ra_deg[piece],
        columns.dec_deg[piece],
        columns.pm_ra_cosdec_mas_yr[piece],
        columns.pm_dec_mas_yr[piece],
        columns.mag[piece],
        columns.error_curve[piece],
        None if columns.color_mag is None else columns.color_mag[piece],
        None if columns.flags is None else columns.flags[piece],
    )
