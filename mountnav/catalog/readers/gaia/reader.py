"""Gaia extracts: what the archive, VizieR or astroquery put on disk, with the archive's column names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.gaia.csv_file import CsvFile
from mountnav.catalog.readers.gaia.fits_file import FitsFile
from mountnav.catalog.readers.gaia.parquet_file import ParquetFile
from mountnav.catalog.readers.gaia.stars import epochs_of, stars_of
from mountnav.catalog.readers.gaia.tables import QUANTITIES, Piece, TableFile
from mountnav.catalog.readers.gaia.votable_file import VoTableFile
from mountnav.catalog.readers.kind import Part
from mountnav.errors import BadCatalog

Ids = NDArray[np.int64]

MOST_REMEMBERED = 40_000_000
"""16 bytes each. Beyond them no more are remembered: downloads so large come from one query, or in the
archive's own files, which don't overlap."""
_MOST_CHUNKS = 2**12
"""Chunks of a part that are told apart: part and chunk are one number, part times 4096 plus chunk. Later
chunks of a part count as its last."""
_MOST_LISTS = 8
"""Sorted lists of identifiers that are searched one after the other before they are merged into one; chosen
by hand, for speed alone."""


class Repeats:
    """Remembers which `source_id` came first in which chunk of which part.

    It can be asked about the chunks in any order, and again: the answer is always the same, as long as the
    parts before have been noted.
    """

    def __init__(self) -> None:
        self._lists: list[tuple[Ids, Ids]] = []
        self._count = 0
        self._noted: set[int] = set()

    def is_noted(self, part: int) -> bool:
        """Whether a part has been noted as a whole."""
        return part in self._noted

    def part_ends(self, part: int) -> None:
        """Take down that a part has been noted as a whole."""
        self._noted.add(part)

    def first_time(self, ids: Ids, part: int, chunk: int) -> NDArray[np.bool_]:
        """Tell which stars of a chunk haven't come in an earlier one, nor earlier in this one; note them.

        Parameters
        ----------
        ids : ndarray of int64, shape (n,)
            0 or less where there is none: such stars always count as new.
        part, chunk : int
            Numbers of the part, and of the chunk in it.

        Returns
        -------
        ndarray of bool, shape (n,)
            True: it has not come before.
        """
        now = part * _MOST_CHUNKS + min(chunk, _MOST_CHUNKS - 1)
        new = np.zeros(ids.size, dtype=np.bool_)
        new[np.unique(ids, return_index=True)[1]] = True
        new |= ids <= 0
        came = self._came(ids)
        known = came <= now
        new &= ~(came < now)
        if part not in self._noted and self._count < MOST_REMEMBERED:
            fresh = np.sort(ids[new & ~known & (ids > 0)])
            self._lists.append((fresh, np.full(fresh.size, now, dtype=np.int64)))
            self._count += fresh.size
            if len(self._lists) > _MOST_LISTS:
                self._merge()
        return new

    def _came(self, ids: Ids) -> Ids:
        """When each came first; a number beyond all others where it never did."""
        came = np.full(ids.size, np.iinfo(np.int64).max)
        for known, when in self._lists:
            if known.size and ids.size and known[0] <= ids.max() and ids.min() <= known[-1]:
                at = np.minimum(np.searchsorted(known, ids), known.size - 1)
                came = np.where(known[at] == ids, np.minimum(came, when[at]), came)
        return came

    def _merge(self) -> None:
        ids = np.concatenate([known for known, _ in self._lists])
        when = np.concatenate([when for _, when in self._lists])
        # of an id that was noted in two chunks asked for out of order, the earlier one counts
        order = np.lexsort((when, ids))
        ids, when = ids[order], when[order]
        first = np.ones(ids.size, dtype=np.bool_)
        first[1:] = ids[1:] != ids[:-1]
        self._lists = [(ids[first], when[first])]


FORMATS: dict[str, Callable[[Path], TableFile]] = {
    ".fits": FitsFile,
    ".fit": FitsFile,
    ".csv": CsvFile,
    ".csv.gz": CsvFile,
    ".ecsv": CsvFile,
    ".ecsv.gz": CsvFile,
    ".tsv": CsvFile,
    ".tsv.gz": CsvFile,
    ".vot": VoTableFile,
    ".vot.gz": VoTableFile,
    ".xml": VoTableFile,
    ".xml.gz": VoTableFile,
    ".votable": VoTableFile,
    ".parquet": ParquetFile,
}

_ARCHIVE_FILE = re.compile(r"GaiaSource_\d+-\d+\.")
"""The archive's own partition of a release: no star is in two of them."""


class GaiaReader:
    """Gaia extracts in a file or a folder. Implements `mountnav.catalog.readers.kind.Reader`.

    Parameters
    ----------
    paths : sequence of Path
        The files, in the order in which they are read.

    Raises
    ------
    BadCatalog
        One of the heads can't be read, lacks a column, or has another unit.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._files = {path.name: _opened(path) for path in paths}
        self._pieces: dict[str, tuple[str, Piece]] = {}
        self._parts: list[Part] = []
        for path in paths:
            pieces = self._files[path.name].pieces()
            for piece in pieces:
                name = path.name if len(pieces) == 1 else f"{path.name} from {piece.first}"
                self._pieces[name] = path.name, piece
                self._parts.append(Part(name, path, piece.size_bytes))
        self.name = "Gaia"
        self.band = "G"
        self.color_name = "BP-RP"
        self.epoch_yr = self._first_epoch_yr()
        listed = (
            paths[0].name if len(paths) == 1 else f"{len(paths)} files, {paths[0].name} to {paths[-1].name}"
        )
        self.made_from = f"Gaia extract, {listed} (ESA/Gaia/DPAC)"
        self._repeats = Repeats()
        self._is_partition = all(_ARCHIVE_FILE.match(path.name) for path in paths)

    def parts(self) -> Sequence[Part]:
        """Files in the order of their names; large ones in pieces."""
        return list(self._parts)

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a part, in chunks. A `source_id` that came before is left out. Raises `BadCatalog`."""
        number = next(at for at, known in enumerate(self._parts) if known.name == part.name)
        if not self._is_partition:
            for before in range(number):
                self._note(before)
        file_name, piece = self._pieces[part.name]
        file = self._files[file_name]
        for chunk, block in enumerate(file.blocks(piece, self._quantities(file))):
            stars = stars_of(
                block, file=file_name, told_epoch_yr=file.layout.epoch_yr, epoch_yr=self.epoch_yr
            )
            if stars.color_mag is None:
                stars = replace(stars, color_mag=np.full(stars.ra_deg.size, np.nan))
            ids = block.values.get("source_id")
            if ids is not None and ids.dtype == np.int64 and not self._is_partition:
                new = self._repeats.first_time(ids, number, chunk)
                stars = stars if new.all() else _chosen(stars, new)
            yield stars
        self._repeats.part_ends(number)

    def _note(self, number: int) -> None:
        """Take down the stars of a part that is in from an earlier run."""
        file_name, piece = self._pieces[self._parts[number].name]
        file = self._files[file_name]
        if self._repeats.is_noted(number) or "source_id" not in file.layout.columns:
            return
        for chunk, block in enumerate(file.blocks(piece, ("source_id",))):
            if block.values["source_id"].dtype == np.int64:
                self._repeats.first_time(block.values["source_id"], number, chunk)
        self._repeats.part_ends(number)

    def _first_epoch_yr(self) -> float:
        """The epoch of the first star: all others are moved to it."""
        for file_name, piece in self._pieces.values():
            file = self._files[file_name]
            for block in file.blocks(piece, self._quantities(file)):
                if block.values["ra"].size:
                    return float(epochs_of(block, file_name, file.layout.epoch_yr)[0])
        raise BadCatalog(
            "holds no stars", device=str(self._parts[0].path.parent), advice="check what the query gave"
        )

    @staticmethod
    def _quantities(file: TableFile) -> list[str]:
        """What is read: the designation only where nothing else states the epoch."""
        known = "ref_epoch" in file.layout.columns
        return [
            key for key in QUANTITIES if key in file.layout.columns and not (known and key == "designation")
        ]


def open_catalog(path: Path) -> GaiaReader:
    """Open a Gaia extract.

    Parameters
    ----------
    path : Path
        A file, or a folder of files; other files in the folder are left alone.

    Raises
    ------
    BadCatalog
        There is no such file, or it isn't Gaia's.
    """
    if path.is_dir():
        paths = sorted(
            (file for file in path.iterdir() if file.is_file() and _suffix(file) in FORMATS),
            key=lambda file: file.name,
        )
        if not paths:
            raise BadCatalog(
                f"holds none of the files that are read ({', '.join(FORMATS)})",
                device=str(path),
                advice="check the path",
            )
        return GaiaReader(paths)
    return GaiaReader([path])


def _suffix(path: Path) -> str:
    suffixes = [suffix.lower() for suffix in path.suffixes]
    return "".join(suffixes[-2:]) if suffixes[-1:] == [".gz"] else "".join(suffixes[-1:])


def _opened(path: Path) -> TableFile:
    opener = FORMATS.get(_suffix(path))
    if opener is None:
        packed = " (unpack it first: gunzip)" if _suffix(path) in (".fits.gz", ".fit.gz") else ""
        raise BadCatalog(
            f"is not of a format that can be read{packed}",
            device=path.name,
            advice=f"the name must end in one of {', '.join(FORMATS)}",
        )
    return opener(path)


def _chosen(stars: CatalogColumns, rows: NDArray[np.bool_]) -> CatalogColumns:
    columns: dict[str, Any] = {}
    for column in fields(stars):
        values = getattr(stars, column.name)
        columns[column.name] = None if values is None else values[rows]
    return CatalogColumns(**columns)
