"""Stars on their way into a packed file, kept on disk: an interrupted import goes on where it stopped.

A spool is a folder with a file for each part of the catalog that is in (`spool_parts`) and the facts that
they were taken for. `Spool.finish` cuts the sphere into pieces of so many stars as fit into memory, collects
each piece from all the parts, sorts it, and hands it to the writer. Nothing else grows with the catalog: some
hundred million stars need no more memory than some million.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np

from mountnav.catalog.packed.error_cells import ErrorCells
from mountnav.catalog.packed.fast_stars import fast_limit
from mountnav.catalog.packed.format import Header
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.packed.raw_stars import NotWritable
from mountnav.catalog.packed.spool_cuts import FIRST_CUT_NSIDE, Cut, nside_for, sorted_pieces
from mountnav.catalog.packed.spool_parts import SUFFIX, UNFINISHED, SpooledPart, write_part
from mountnav.catalog.packed.writer import PackedFacts as PackedFacts
from mountnav.catalog.packed.writer import PackedShape, PackedWriter, sync_folder
from mountnav.errors import BadCatalog, BadSettings

STARS_AT_ONCE = 1_500_000
"""How many stars `Spool.finish` sorts at once: 0.3 GB of memory."""
SPOOL_VERSION = 1
_FACTS = "facts.json"
_SHARE_OF_COUNTING = 0.2


class Spool:
    """Stars of finished parts on disk. Made by `open`.

    One process may use a spool at a time; who imports sees to it.
    """

    def __init__(self, folder: Path, facts: PackedFacts, parts: dict[str, SpooledPart]) -> None:
        self._folder, self._facts, self._parts = folder, facts, parts

    @classmethod
    def open(cls, folder: Path, facts: PackedFacts) -> Spool:
        """Go on with a spool of equal facts, or start anew.

        Parameters
        ----------
        folder : Path
            Of the spool alone; made if it isn't there.
        facts : PackedFacts

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
        path : Path
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
        f"the stars on their way can't be kept: {refused.strerror or refused}",
        device=str(folder),
        advice="free room there (41 bytes a star, and 18 for the packed file), or check the folder's rights",
    )
