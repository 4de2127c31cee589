"""Building the index: levels of star density, each star's quads with its neighbors, codes, one file.

A frame shows its brightest stars, and their distances depend on the size of its field alone. So the index has
levels: of each part of the sky its brightest stars, as many as a field of some size needs.

Eleven million quads don't fit into the memory of a small computer beside their keys and their order. They
wait in files without a name, one for each first coordinate of the code raster, and are sorted one file after
the other.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np
from astropy import units
from astropy_healpix import lonlat_to_healpix
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.space_motion import places
from mountnav.identification.blind.file_format import (
    ALIGNMENT_BYTES,
    CELLS,
    RASTER,
    STEPS_PER_CELL,
    STRIDES,
    Header,
    encode_header,
    pack,
    stepped,
)
from mountnav.identification.blind.index import CELL_STARS, FINEST_NSIDE, Grid, densities
from mountnav.identification.blind.indexed_stars import CatalogRows
from mountnav.identification.blind.quads import codes, flattened
from mountnav.identification.selection import rank_in_cell

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BLEND_SHARE = 0.02
"""Of two stars nearer than this share of the mean distance the fainter is left out: they look like one.
Chosen by hand."""


@dataclass(frozen=True, slots=True)
class Level:
    """A level of the index: the brightest stars of each part of the sky, to one density.

    Attributes
    ----------
    density_deg2 : float
        Most stars per square degree.
    rows : ndarray of int, shape (n,)
        Catalog rows in the grid's order.
    whole : ndarray of bool, shape (n,)
        The star's cell holds every star the catalog has there.
    offsets : ndarray of int, shape (cells + 1,)
        First star of each cell of the grid.
    """

    density_deg2: float
    rows: Index
    whole: NDArray[np.bool_]
    offsets: Index


def make_levels(vectors: Array, mag: Array, count: int) -> list[Level]:
    """Thin a catalog to one list of stars for each density.

    Parameters
    ----------
    vectors : ndarray, shape (n, 3)
        Unit vectors, ICRS.
    mag : ndarray, shape (n,)
        Magnitudes, in the catalog's order.
    count : int
        How many levels.

    Returns
    -------
    list of Level
        The finest first.
    """
    pixel = np.concatenate([_pixels(vectors[part]) for part in _chunks(len(vectors), PIECE)])
    counts = np.bincount(pixel, minlength=12 * FINEST_NSIDE**2)
    brightest = np.argsort(mag, kind="stable").astype(np.int32)
    del mag
    made = []
    coarsest, nearer = FINEST_NSIDE, brightest
    for nside, stars, density in densities(count):
        if nside < coarsest:
            # nested pixels: the brightest of a large cell are among the brightest of its four small ones
            brightest, coarsest = nearer, nside
            counts = counts.reshape(-1, 4).sum(axis=1)
        cell = pixel[brightest] // (FINEST_NSIDE // nside) ** 2
        rank = rank_in_cell(cell).astype(np.int32)
        nearer = brightest[rank < max(CELL_STARS)]
        chosen = rank < stars
        rows, whole = brightest[chosen], counts[cell[chosen]] <= stars
        del cell, rank, chosen  # at the finest level each of them is of the whole catalog
        made.append(_level(vectors[rows], rows, whole, density))
    return made


def _level(vectors: Array, rows: NDArray[np.int32], whole: NDArray[np.bool_], density: float) -> Level:
    """A level of stars, brightest first, in its grid's order and without blends."""
    clear = ~_blended(vectors, np.radians(BLEND_SHARE / np.sqrt(density)))
    grid = Grid.of(density)
    ra_deg, dec_deg = places(vectors[clear].T)
    at = grid.cell(ra_deg, dec_deg)
    order = np.lexsort((ra_deg, at))
    offsets = np.searchsorted(at[order], np.arange(grid.cells + 1))
    return Level(density, rows[clear][order].astype(np.int64), whole[clear][order], offsets)


def _pixels(vectors: Array) -> NDArray[np.int32]:
    ra_deg, dec_deg = places(vectors.T)
    pixel = lonlat_to_healpix(ra_deg * units.deg, dec_deg * units.deg, nside=FINEST_NSIDE, order="nested")
    return np.asarray(pixel).astype(np.int32)


def _chunks(count: int, most: int) -> Iterator[slice]:
    """The numbers below `count` in pieces of `most`."""
    for start in range(0, count, most):
        yield slice(start, min(start + most, count))


def _vectors(catalog: CatalogRows, rows: Index) -> Array:
    """Unit vectors of many stars, of which only a chunk's parts are in memory at once."""
    vectors = np.empty((rows.size, 3))
    for part in _chunks(rows.size, CHUNK):
        vectors[part] = catalog.vectors(rows[part], epoch_yr=EPOCH_YR)
    catalog.rest()
    return vectors


def _magnitudes(catalog: CatalogRows, rows: Index) -> Array:
    mag = catalog.magnitudes(rows)
    catalog.rest()
    return mag


def _blended(vectors: Array, reach_rad: float) -> NDArray[np.bool_]:
    """Which of the stars, brightest first, have a brighter one within reach."""
    pairs = cKDTree(vectors).query_pairs(reach_rad, output_type="ndarray")
    fainter = np.zeros(len(vectors), dtype=bool)
    fainter[pairs.max(axis=1)] = True
    return fainter


EPOCH_YR = 2026.0
"""Shapes hold for this year. A star of 0.1″/yr has moved 1″ ten years on, less than a quad's tolerance."""
LEVELS = 13
"""Densities of stars, each half the one before: 48 to 0.012 per square degree, for fields of 0.6° to 40°
(docs/explanation/blind.md)."""
NEIGHBORS = 6
"""Nearest neighbors of which quads are made: the highest rank in `USUAL` and `MORE`."""
USUAL = ((1, 2, 4), (1, 3, 5), (2, 3, 4))
"""Which neighbors, by rank of distance, make quads with a star. Other ranks that were tried, and what they
lose, stand in docs/explanation/blind.md."""
MORE = (*USUAL, (1, 2, 3), (1, 3, 4), (2, 4, 5), (1, 2, 5), (2, 3, 6))
"""The same where a frame has few stars, since the level holds all that the catalog has; and in coarse levels,
where they cost little: wide frames are bent, and lose quads to that."""
COARSE = 130_000
"""Stars of a level that is called coarse. Chosen by hand: so the five further quads a star cost little of the
file."""
CHUNK = 200_000
"""Stars whose neighbors are asked for at once. The order of quads depends on it: of the same four stars,
found from two of them, the first is kept, which may differ in the last place of its code."""
PIECE = 40_000
"""Quads computed at once: some 20 MB for all that is worked out. It changes memory, no result."""
QUAD = np.dtype([("cell", "<u4"), ("mark", "<u4"), ("packed", "<u8"), ("place", "u1", (4,))])
"""A quad that waits: cell and place in it, packed star numbers, mark; 20 bytes."""

Progress = Callable[[float], None]


def build(
    catalog: PackedStore, path: Path, *, levels: int = LEVELS, progress: Progress | None = None
) -> Header:
    """Write the index of a catalog.

    Parameters
    ----------
    path : Path
        Replaced only when the new file is complete.
    progress : callable, optional
        Called with the share that is done, 0 to 1.

    Returns
    -------
    Header
        As written.

    Raises
    ------
    OSError
        The file can't be written.
    """
    report = progress or (lambda share: None)
    report(0.0)
    everything = CatalogRows(catalog.path)
    rows = np.arange(len(everything))
    vectors = _vectors(everything, rows)
    report(0.05)
    made = make_levels(vectors, _magnitudes(everything, rows), levels)
    del vectors, rows
    report(0.3)
    header = Header(
        catalog=catalog.name,
        catalog_sha256=catalog.header.sections_sha256,
        epoch_yr=EPOCH_YR,
        quads=0,
        level_stars=[int(level.rows.size) for level in made],
        grid_lengths=[int(level.offsets.size) for level in made],
    )
    number_of_levels = np.cumsum([0, *header.level_stars])
    total, done = int(number_of_levels[-1]), 0
    with ExitStack() as temporary:
        waiting = _Waiting(path.parent, temporary)
        for level, first in zip(made, number_of_levels, strict=False):
            vectors = _vectors(everything, level.rows)
            for stars, share in _quads(level, vectors):
                for part in _chunks(len(stars), PIECE):
                    waiting.add(_coded(stars[part], int(first), vectors, level.rows))
                report(0.3 + 0.55 * (done + share * level.rows.size) / total)
            done += level.rows.size
            del vectors
        header = _write(path, header, waiting, made, report)
    report(1.0)
    return header


class _Waiting:
    """Quads on the way to the index, by the first coordinate of their code, in the order they come.

    Parameters
    ----------
    folder : Path
        Where the index will lie: there is room for it. The files have no name, and end with the process.
    closed : ExitStack
        Closes them.
    """

    def __init__(self, folder: Path, closed: ExitStack) -> None:
        self._folder, self._closed = folder, closed
        self._files = [self.file() for _ in range(RASTER[0])]
        self.count = 0

    def file(self) -> IO[bytes]:
        """A file for as long as the index is built."""
        return self._closed.enter_context(tempfile.TemporaryFile(dir=self._folder))

    def add(self, quads: NDArray[np.void]) -> None:
        """Let quads wait, of shape (n,) and type `QUAD`."""
        self.count += quads.size
        first = quads["cell"] // np.uint32(STRIDES[0])
        order = np.argsort(first, kind="stable")
        ends = np.searchsorted(first[order], np.arange(RASTER[0] + 1))
        for file, start, end in zip(self._files, ends[:-1], ends[1:], strict=True):
            file.write(quads[order[start:end]].tobytes())

    def take(self) -> Iterator[NDArray[np.void]]:
        """For each first coordinate its quads, sorted by cell and mark; none of four stars twice."""
        for file in self._files:
            file.flush()
            file.seek(0)
            quads = np.fromfile(file, dtype=QUAD)
            file.close()  # its room on the disk is free again
            # the same four stars may be neighbors in two levels: then they share cell and mark
            key = (quads["cell"].astype(np.uint64) << np.uint64(32)) | quads["mark"]
            order = np.argsort(key, kind="stable")  # the finest level keeps it
            key = key[order]
            yield quads[order[np.concatenate(([True], key[1:] != key[:-1]))]] if order.size else quads


def _quads(level: Level, vectors: Array) -> Iterator[tuple[Index, float]]:
    """Each star of a level with three of its neighbors, in chunks of shape (n, 4); and the share done."""
    count = level.rows.size
    if count <= NEIGHBORS:
        return
    tree = cKDTree(vectors, balanced_tree=False, compact_nodes=False)
    for part in _chunks(count, CHUNK):
        near = np.asarray(tree.query(vectors[part], k=NEIGHBORS + 1)[1], dtype=np.int64)
        near[:, 0] = np.arange(part.start, part.stop)  # of two stars at one position either may come first
        poor = level.whole[part] if count > COARSE else np.ones(len(near), dtype=bool)
        for chosen, kinds in ((near[~poor], USUAL), (near[poor], MORE)):
            for kind in kinds:
                yield chosen[:, (0, *kind)], part.stop / count


def _coded(stars: Index, first: int, vectors: Array, rows: Index) -> NDArray[np.void]:
    """Those quads of a level's stars, shape (n, 4), that can be stored."""
    code, order = codes(flattened(vectors[stars]))
    step = np.floor(stepped(code))
    top = np.array(RASTER) * STEPS_PER_CELL
    sound = np.all((step >= 0) & (step < top), axis=1)  # four stars at one position have no shape
    stars = np.take_along_axis(stars, order, axis=1)
    packed, fits = pack(first + stars[sound])
    steps = step[sound][fits].astype(np.int64)
    quads = np.empty(packed.size, dtype=QUAD)
    quads["cell"] = (steps // STEPS_PER_CELL) @ STRIDES
    quads["place"] = steps % STEPS_PER_CELL
    quads["packed"] = packed
    quads["mark"] = _mark(rows[stars[sound][fits]])
    return quads


def _mark(rows: Index) -> NDArray[np.uint32]:
    """A number that four stars share in whatever order they come, and hardly any other four."""
    mixed = rows.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    together: NDArray[np.uint64] = mixed.sum(axis=1, dtype=np.uint64)
    return (together >> np.uint64(32)).astype(np.uint32)


def _write(path: Path, header: Header, waiting: _Waiting, levels: list[Level], report: Progress) -> Header:
    """Write the index; how many quads it has is known only then."""
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as out:
            start = len(encode_header(replace(header, quads=waiting.count)))
            out.seek(start)
            cells = np.zeros(CELLS + 1, dtype="<u4")
            quads, at = 0, 0
            packed = waiting.file()
            for done, some in enumerate(waiting.take(), start=1):
                here = np.bincount(some["cell"] - np.uint32(at), minlength=STRIDES[0])
                cells[at + 1 : at + here.size + 1] = quads + np.cumsum(here)
                out.write(some["place"].tobytes())
                packed.write(some["packed"].tobytes())
                quads += some.size
                at += here.size
                report(0.85 + 0.1 * done / RASTER[0])
            _align(out)
            out.write(cells.data)
            _align(out)
            packed.seek(0)
            shutil.copyfileobj(packed, out, 1 << 20)
            _align(out)
            for level in levels:
                out.write(level.rows.astype("<u4").tobytes())
            _align(out)
            for level in levels:
                out.write(level.offsets.astype("<u4").tobytes())
            _align(out)
            header = replace(header, quads=quads)
            out.seek(0)
            out.write(encode_header(header, least_bytes=start))
            out.flush()
            os.fsync(out.fileno())
            if hasattr(os, "posix_fadvise"):
                # written in large pieces it stays so in memory, and each look would map one
                os.posix_fadvise(out.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return header


def _align(out: IO[bytes]) -> None:
    """Fill up to where the next section starts."""
    out.write(b"\0" * (-out.tell() % ALIGNMENT_BYTES))
