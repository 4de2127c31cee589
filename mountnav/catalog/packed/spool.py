"""Stars on their way into a packed file, kept on disk: an interrupted import goes on where it stopped.

A spool is a folder with a file for each part of the catalog that is in (`SpooledPart`) and the facts that
they were taken for. `Spool.finish` cuts the sphere into pieces of so many stars as fit into memory, collects
each piece from all the parts, sorts it, and hands it to the writer. Nothing else grows with the catalog: some
hundred million stars need no more memory than some million.

A part of a spool: one file of sorted runs of stars, complete or not there.

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
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import ErrorCells
from mountnav.catalog.packed.format import Header
from mountnav.catalog.packed.packing import (
    RAW,
    CatalogColumns,
    NotWritable,
    PackedShape,
    PackedWriter,
    Raw,
    key_shift,
    raw_stars,
    sorted_order,
    speeds_mas_yr,
    sync_folder,
)
from mountnav.catalog.packed.packing import PackedFacts as PackedFacts
from mountnav.catalog.packed.store import FAST_LIMITS_MAS_YR, fast_limit
from mountnav.errors import BadCatalog, BadSettings
from mountnav.parsing import json_of

SUFFIX = ".stars"
UNFINISHED = ".unfinished"
KEY = np.dtype("<u4")
RUN_STARS = 1_000_000
"""At most so many are sorted at once; 37 bytes each, and some copies."""
_MAGIC = b"MNAVPART"
_END_BYTES = 12
"""End of a part's file: length of its description (4 bytes) and the magic (8)."""


@dataclass(frozen=True, slots=True)
class SpooledPart:
    """A part that is safely in.

    Attributes
    ----------
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
            Keys that the runs are sorted by.

        Returns
        -------
        ndarray, shape (runs, m)
            Counts: a row a run, a column a key.
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


Indices = NDArray[np.int64]

FIRST_CUT_NSIDE = 16
"""Division at which stars are counted first, to cut the sphere into pieces that fit into memory: 3,072
pixels. Finer, the counting takes more memory; coarser, dense regions make pieces too large."""
STARS_PER_PIXEL = 64
"""Stars that a pixel of the finished file holds about, half to twice of it on average; measured in
docs/reference/packed-store.md: with fewer, wide cones spend their time on pixels; with more, narrow ones on
stars outside."""
PIXELS_PER_STAR = 0.6
"""At most: so the tables of the pixels, 6 bytes each, stay well below the 15 bytes of each star."""
LARGEST_PACKED_NSIDE = 2048
"""Finest division that is written: 50 million pixels of 1.7′, enough for three billion stars."""


def nside_for(count: int, sky_share: float = 1.0) -> int:
    """HEALPix resolution that suits a catalog: some dozen stars in a pixel.

    Measured in docs/reference/packed-store.md: with fewer, wide cones spend their time on pixels; with more,
    narrow ones on stars outside.

    Parameters
    ----------
    count : int
        Stars.
    sky_share : float
        Which part of the sky they lie in.

    Returns
    -------
    int
        A power of two, 1 to 2048.
    """
    nside = 1
    while nside < LARGEST_PACKED_NSIDE:
        pixels = 12 * (2 * nside) ** 2
        if count < 0.5 * STARS_PER_PIXEL * pixels * sky_share or pixels > PIXELS_PER_STAR * count:
            break
        nside *= 2
    return nside


@dataclass(frozen=True, slots=True)
class Cut:
    """The sphere cut into pieces: keys at the cuts, and how many stars of each run lie before each.

    Attributes
    ----------
    keys
        Shape (m,), from 0 to one past the largest.
    before
        For each part, shape (runs, m).
    """

    keys: Indices
    before: list[Indices]

    @classmethod
    def of(cls, parts: list[SpooledPart], nside: int) -> Cut:
        """At all pixels of a resolution."""
        return cls.at(parts, np.arange(12 * nside**2 + 1) << key_shift(nside))

    @classmethod
    def at(cls, parts: list[SpooledPart], keys: Indices) -> Cut:
        """At some keys."""
        return cls(keys, [part.boundaries(keys) for part in parts])

    @property
    def counts(self) -> Indices:
        """Stars in each piece, shape (m - 1,)."""
        counts: Indices = np.diff(np.sum([own.sum(axis=0) for own in self.before], axis=0))
        return counts

    def only(self, chosen: Indices) -> Cut:
        """Fewer cuts."""
        return Cut(self.keys[chosen], [own[:, chosen] for own in self.before])


def sorted_pieces(
    parts: list[SpooledPart], coarse: Cut, nside: int, stars_at_once: int
) -> Iterator[tuple[int, Raw]]:
    """Collect, sort and give the stars piece by piece.

    Parameters
    ----------
    coarse : Cut
        At the pixels of `FIRST_CUT_NSIDE`.
    nside : int
        Of the packed file; no pixel of it is cut.
    stars_at_once : int
        How many a piece may hold, unless one pixel holds more.

    Yields
    ------
    (int, ndarray of RAW)
        One past the last pixel of the piece, and its stars in the order of the packed form.

    Raises
    ------
    OSError
        A part can't be read.
    """
    shift = key_shift(nside)
    cut = coarse if nside >= FIRST_CUT_NSIDE else Cut.of(parts, nside)
    # pieces with too many stars are cut into four, until they are single pixels
    while True:
        size, counts = np.diff(cut.keys), cut.counts
        crowded = np.flatnonzero((counts > stars_at_once) & (size > 1 << shift))
        if not crowded.size:
            break
        quarters = (cut.keys[crowded, np.newaxis] + size[crowded, np.newaxis] // 4 * np.arange(1, 4)).ravel()
        cut = Cut.at(parts, np.union1d(cut.keys, quarters))
    cut = cut.only(_full_cuts(counts, stars_at_once))
    for at in range(cut.keys.size - 1):
        found = [
            raw
            for part, before in zip(parts, cut.before, strict=True)
            for raw in part.stars(before[:, at], before[:, at + 1])
        ]
        raw = np.concatenate(found) if found else np.zeros(0, dtype=RAW)
        found.clear()
        yield int(cut.keys[at + 1] >> shift), raw[sorted_order(raw, nside)]


def _full_cuts(counts: Indices, most: int) -> Indices:
    """Which cuts to keep so that the pieces are as large as may be."""
    kept, held = [0], 0
    for at, count in enumerate(counts.tolist()):
        if held and held + count > most:
            kept.append(at)
            held = 0
        held += count
    return np.array([*kept, counts.size])


STARS_AT_ONCE = 1_500_000
"""How many stars `Spool.finish` sorts at once: 0.3 GB of memory."""
SPOOL_VERSION = 1
"""Of the form of a spool; one of another version is begun again."""
_FACTS = "facts.json"
_SHARE_OF_COUNTING = 0.2
"""Share of finishing that counting takes on the progress bar; chosen by hand. Another value makes the bar run
unevenly, no more."""


class Spool:
    """Stars of finished parts on disk. Made by `open`.

    One process may use a spool at a time; who imports sees to it.
    """

    def __init__(self, folder: Path, facts: PackedFacts, parts: dict[str, SpooledPart]) -> None:
        self._folder, self._facts, self._parts = folder, facts, parts

    @classmethod
    def open(cls, folder: Path, facts: PackedFacts) -> Spool:
        """Go on with a spool of equal facts, or start again.

        Parameters
        ----------
        folder : Path
            Of the spool alone; made if it isn't there.

        Raises
        ------
        BadSettings
            The folder can't be written.
        """
        told = folder / _FACTS
        text = json.dumps({"version": SPOOL_VERSION} | asdict(facts), sort_keys=True)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for left_behind in folder.glob(f"*{UNFINISHED}"):  # by a process that was killed
                left_behind.unlink()
            if not told.is_file() or told.read_bytes() != text.encode():
                _remove_parts(folder)
                unfinished = told.with_suffix(UNFINISHED)
                with unfinished.open("wb") as out:
                    out.write(text.encode())
                    out.flush()
                    os.fsync(out.fileno())
                unfinished.replace(told)
                sync_folder(folder)
            parts: dict[str, SpooledPart] = {}
            for path in sorted(folder.glob(f"*{SUFFIX}")):
                if (part := SpooledPart.at(path)) is not None:
                    parts[part.name] = part
                else:
                    path.unlink()
        except OSError as refused:
            raise _cannot(refused, folder) from refused
        return cls(folder, facts, parts)

    @property
    def done(self) -> frozenset[str]:
        """Names of the parts that are safely in."""
        return frozenset(self._parts)

    @property
    def count(self) -> int:
        """Stars so far."""
        return sum(part.count for part in self._parts.values())

    def add(self, part: str, chunks: Iterable[CatalogColumns]) -> int:
        """Take the stars of a part.

        All or nothing: when this returns they are safe, whatever happens; before, nothing of them is there.

        Parameters
        ----------
        part : str
            Its name. A part that is in already is left as it is, and `chunks` isn't touched.
        chunks : iterable of CatalogColumns
            Its stars. An error that it raises goes through.

        Returns
        -------
        int
            How many stars it has.

        Raises
        ------
        BadCatalog
            A star has a value that can't be packed.
        BadSettings
            The disk is full, or the folder can't be written.
        """
        if part not in self._parts:
            try:
                self._parts[part] = write_part(self._folder, part, chunks)
            except NotWritable as wrong:
                raise BadCatalog(
                    f"the stars of {part} can't be packed: {wrong}",
                    device=str(self._folder),
                    advice="the source is damaged, or its reader is at fault: tell us",
                ) from wrong
            except OSError as refused:
                raise _cannot(refused, self._folder) from refused
        return self._parts[part].count

    def finish(
        self,
        path: Path,
        *,
        progress: Callable[[float], None] | None = None,
        nside: int | None = None,
        stars_at_once: int = STARS_AT_ONCE,
    ) -> Header:
        """Sort all stars and write the packed file.

        The same stars give the same bytes, in whatever order the parts came. `path` is replaced when the new
        file is complete and durable; if this is interrupted it can be done again: the spool stays until
        `discard`.

        Parameters
        ----------
        progress : callable, optional
            Told the share that is done, 0 to 1.
        nside : int, optional
            HEALPix resolution; `nside_for` the stars' number and the share of the sky they lie in.
        stars_at_once : int
            How many are sorted at once: some 200 bytes of memory each.

        Returns
        -------
        Header
            As written.

        Raises
        ------
        BadCatalog
            There are no stars, or more than 2**32 - 1.
        BadSettings
            The disk is full, or the folder can't be written.
        """
        tell = progress or (lambda share: None)
        tell(0.0)
        if not 0 < self.count < 2**32:
            raise BadCatalog(
                f"{self.count} stars can't be packed",
                device=str(path),
                advice="look whether the path holds the catalog's files, and what the selection leaves",
            )
        try:
            return self._packed(path, tell, nside, stars_at_once)
        except OSError as refused:
            raise _cannot(refused, self._folder) from refused

    def discard(self) -> None:
        """Remove the spool.

        Raises
        ------
        BadSettings
            The folder can't be written.
        """
        try:
            (self._folder / _FACTS).unlink(missing_ok=True)
            _remove_parts(self._folder)
            with suppress(OSError):  # what others put there stays
                self._folder.rmdir()
        except OSError as refused:
            raise _cannot(refused, self._folder) from refused
        self._parts.clear()

    def _packed(
        self, path: Path, tell: Callable[[float], None], nside: int | None, stars_at_once: int
    ) -> Header:
        # by name: what is read in which order is the same each time
        parts = [self._parts[name] for name in sorted(self._parts)]
        cells = ErrorCells.empty()
        counted = 0
        for part in parts:
            for raw in part.pieces(stars_at_once):
                cells.add(raw["curve"])
                counted += raw.size
                tell(_SHARE_OF_COUNTING * counted / self.count)
        classes = cells.classified()
        coarse = Cut.of(parts, FIRST_CUT_NSIDE)
        if nside is None:
            nside = nside_for(self.count, float(np.mean(coarse.counts > 0)))
        slow_mas_yr, fast_count = fast_limit(np.sum([part.fast for part in parts], axis=0).tolist())
        shape = PackedShape(
            nside,
            self.count,
            classes.count,
            fast_count,
            slow_mas_yr,
            any(part.has_flags for part in parts),
        )
        written = 0
        with PackedWriter(path, self._facts, shape) as writer:
            for end_pixel, raw in sorted_pieces(parts, coarse, nside, stars_at_once):
                writer.write(raw, classes.assign(raw["curve"]), end_pixel)
                written += raw.size
                tell(_SHARE_OF_COUNTING + (1.0 - _SHARE_OF_COUNTING) * written / self.count)
            header = writer.finish(classes.parameters())
        tell(1.0)
        return header


def _remove_parts(folder: Path) -> None:
    for pattern in (f"*{SUFFIX}", f"*{UNFINISHED}"):
        for path in folder.glob(pattern):
            path.unlink()


def _cannot(refused: OSError, folder: Path) -> BadSettings:
    return BadSettings(
        f"the stars can't be stored during the import: {refused.strerror or refused}",
        device=str(folder),
        advice="free room there (41 bytes a star, and 18 for the packed file), or check the folder's rights",
    )
