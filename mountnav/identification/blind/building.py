"""Building the index: levels of star density, each star's quads with its neighbors, codes, one file.

A frame shows its brightest stars, and their distances depend on the size of its field alone. So the index has
levels: of each part of the sky its brightest stars, as many as a field of some size needs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

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
from mountnav.identification.blind.index import FINEST_NSIDE, Grid, densities
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
    count : int
        How many levels.

    Returns
    -------
    list of Level
        The finest first.
    """
    ra_deg, dec_deg = places(vectors.T)
    pixel = np.asarray(
        lonlat_to_healpix(ra_deg * units.deg, dec_deg * units.deg, nside=FINEST_NSIDE, order="nested")
    )
    brightest = np.argsort(mag, kind="stable")
    made = []
    for nside, stars, density in densities(count):
        cell = pixel[brightest] // (FINEST_NSIDE // nside) ** 2
        chosen = rank_in_cell(cell) < stars
        full = np.bincount(cell, minlength=12 * nside**2) > stars
        rows, whole = brightest[chosen], ~full[cell[chosen]]
        clear = ~_blended(vectors[rows], np.radians(BLEND_SHARE / np.sqrt(density)))
        rows, whole = rows[clear], whole[clear]
        grid = Grid.of(density)
        at = grid.cell(ra_deg[rows], dec_deg[rows])
        order = np.lexsort((ra_deg[rows], at))
        offsets = np.searchsorted(at[order], np.arange(grid.cells + 1))
        made.append(Level(density, rows[order], whole[order], offsets))
    return made


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
"""Quads computed at once: some 20 MB of vectors. It changes memory, no result."""

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
    vectors, mag = everything.vectors(rows, epoch_yr=EPOCH_YR), everything.magnitudes(rows)
    report(0.05)
    made = make_levels(vectors, mag, levels)
    report(0.3)
    number_of_levels = np.cumsum([0, *(level.rows.size for level in made)])
    total, done = int(number_of_levels[-1]), 0
    parts: list[tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint64], NDArray[np.uint32]]] = []
    for level, first in zip(made, number_of_levels, strict=False):
        for stars, share in _quads(level, vectors[level.rows]):
            parts.append(_coded(stars, int(first), vectors, level.rows))
            report(0.3 + 0.55 * (done + share * level.rows.size) / total)
        done += level.rows.size
    cell, place, packed, mark = (np.concatenate([part[k] for part in parts]) for k in range(4))
    parts.clear()
    # the same four stars may be neighbors in two levels: then they share cell and mark
    key = (cell.astype(np.uint64) << np.uint64(32)) | mark
    order = np.argsort(key, kind="stable")  # the finest level keeps it
    key = key[order]
    order = order[np.concatenate(([True], key[1:] != key[:-1]))] if order.size else order
    report(0.95)
    cells = np.concatenate(([0], np.cumsum(np.bincount(cell[order], minlength=CELLS)))).astype("<u4")
    header = Header(
        catalog=catalog.name,
        catalog_sha256=catalog.header.sections_sha256,
        epoch_yr=EPOCH_YR,
        quads=int(order.size),
        level_stars=[int(level.rows.size) for level in made],
        grid_lengths=[int(level.offsets.size) for level in made],
    )
    _write(
        path,
        header,
        {
            "codes": place[order],
            "cells": cells,
            "quads": packed[order].astype("<u8", copy=False),
            "rows": np.concatenate([level.rows for level in made]).astype("<u4"),
            "grid": np.concatenate([level.offsets for level in made]).astype("<u4"),
        },
    )
    report(1.0)
    return header


def _quads(level: Level, vectors: Array) -> Iterator[tuple[Index, float]]:
    """Each star of a level with three of its neighbors, in chunks of shape (n, 4); and the share done."""
    count = level.rows.size
    if count <= NEIGHBORS:
        return
    tree = cKDTree(vectors, balanced_tree=False, compact_nodes=False)
    near = np.array(tree.query(vectors, k=NEIGHBORS + 1)[1], dtype=np.int64)
    near[:, 0] = np.arange(count)  # of two stars at one position either may come first
    poor = level.whole if count > COARSE else np.ones(count, dtype=bool)
    for start in range(0, count, CHUNK):
        part, few = near[start : start + CHUNK], poor[start : start + CHUNK]
        for chosen, kinds in ((part[~few], USUAL), (part[few], MORE)):
            for kind in kinds:
                yield chosen[:, (0, *kind)], (start + len(part)) / count


def _coded(
    stars: Index, first: int, vectors: Array, rows: Index
) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint64], NDArray[np.uint32]]:
    """Cell, place in the cell, packed star numbers and mark of quads."""
    code, order = codes(flattened(vectors[rows[stars]]))
    step = np.floor(stepped(code))
    top = np.array(RASTER) * STEPS_PER_CELL
    sound = np.all((step >= 0) & (step < top), axis=1)  # four stars at one position have no shape
    stars = np.take_along_axis(stars, order, axis=1)
    packed, fits = pack(first + stars[sound])
    steps = step[sound][fits].astype(np.int64)
    cell = ((steps // STEPS_PER_CELL) @ STRIDES).astype(np.int32)
    return cell, (steps % STEPS_PER_CELL).astype(np.uint8), packed, _mark(rows[stars[sound][fits]])


def _mark(rows: Index) -> NDArray[np.uint32]:
    """A number that four stars share in whatever order they come, and hardly any other four."""
    mixed = rows.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    together: NDArray[np.uint64] = mixed.sum(axis=1, dtype=np.uint64)
    return (together >> np.uint64(32)).astype(np.uint32)


def _write(path: Path, header: Header, sections: dict[str, NDArray[np.generic]]) -> None:
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as out:
            out.write(encode_header(header))
            for values in sections.values():
                np.ascontiguousarray(values).tofile(out)
                out.write(b"\0" * (-values.nbytes % ALIGNMENT_BYTES))
            out.flush()
            os.fsync(out.fileno())
            if hasattr(os, "posix_fadvise"):
                # written in large pieces it stays so in memory, and each look would map one
                os.posix_fadvise(out.fileno(), 0, 0, os.POSIX_FADV_DONTNEED)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
