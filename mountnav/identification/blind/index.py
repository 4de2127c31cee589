"""The index in use: a memory-mapped file of quads, opened once and shared by any number of threads."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadSettings
from mountnav.files import open_buffered
from mountnav.identification.blind.file_format import (
    LONGEST_HEADER_BYTES,
    PREAMBLE_BYTES,
    RASTER,
    STEP,
    STEPS_PER_CELL,
    STRIDES,
    damaged,
    decode_header,
    mapped,
    stepped,
    unmap,
    unpack,
)
from mountnav.units import SKY_DEG2

Array = NDArray[np.float64]
Index = NDArray[np.int64]


FINEST_NSIDE = 128
"""Cells of 0.21 square degrees."""
CELL_STARS = (10, 5)
"""Brightest stars of a cell; two levels for each cell size, whose area grows by 4."""
CELL_BANDS = 4
"""A cell of the level's table is one band high and so many wide. Chosen by hand: it changes how many cells a
circle touches, no result."""


@dataclass(frozen=True, slots=True)
class Grid:
    """Where the stars of a level lie in its list.

    Attributes
    ----------
    height_deg : float
        Height of a band; about the mean distance of stars.
    first_cell : ndarray of int, shape (bands + 1,)
        Number of each band's first cell.
    """

    height_deg: float
    first_cell: Index

    @classmethod
    def of(cls, density_deg2: float) -> Grid:
        """The grid of a level with so many stars per square degree."""
        bands = max(3, round(180.0 * np.sqrt(density_deg2)))
        height = 180.0 / bands
        edges = np.radians(np.arange(bands + 1) * height - 90.0)
        widest = np.maximum(np.cos(edges[:-1]), np.cos(edges[1:]))
        widest[(edges[:-1] < 0) & (edges[1:] > 0)] = 1.0
        cells = np.maximum(1, np.round(360.0 * widest / (CELL_BANDS * height))).astype(np.int64)
        return cls(height, np.concatenate(([0], np.cumsum(cells))))

    @property
    def cells(self) -> int:
        """How many cells there are."""
        return int(self.first_cell[-1])

    def cell(self, ra_deg: Array, dec_deg: Array) -> Index:
        """Cell numbers of positions; shape (n,)."""
        bands = self.first_cell.size - 1
        band = np.clip(((dec_deg + 90.0) / self.height_deg).astype(np.int64), 0, bands - 1)
        count = np.diff(self.first_cell)[band]
        within = np.minimum((ra_deg / 360.0 * count).astype(np.int64), count - 1)
        cell: Index = self.first_cell[band] + within
        return cell

    def slices(self, ra_deg: Array, dec_deg: Array, radius_deg: Array) -> tuple[Index, Index, Index]:
        """Runs of cells that cover circles.

        Parameters
        ----------
        ra_deg, dec_deg, radius_deg : ndarray, shape (n,)
            The circles, ICRS.

        Returns
        -------
        circle, first, end : ndarray of int, shape (k,)
            Cells first to end - 1 belong to the circle; a circle over 0 h has two runs in a band.
        """
        bands = self.first_cell.size - 1
        low = np.clip(((dec_deg - radius_deg + 90.0) / self.height_deg).astype(np.int64), 0, bands - 1)
        high = np.clip(((dec_deg + radius_deg + 90.0) / self.height_deg).astype(np.int64), 0, bands - 1)
        counts = high - low + 1
        circle = np.repeat(np.arange(low.size), counts)
        band = low[circle] + np.arange(circle.size) - np.repeat(np.cumsum(counts) - counts, counts)
        # half the width in right ascension of a circle, or all round if it holds the pole
        dec, radius = np.radians(dec_deg), np.radians(radius_deg)
        with np.errstate(invalid="ignore"):
            half = np.degrees(np.arcsin(np.sin(radius) / np.cos(dec)))
        half = np.where(np.abs(dec_deg) + radius_deg >= 90.0, 180.0, half)[circle]
        cells = np.diff(self.first_cell)[band]
        first = np.floor((ra_deg[circle] - half) / 360.0 * cells).astype(np.int64)
        end = np.floor((ra_deg[circle] + half) / 360.0 * cells).astype(np.int64) + 1
        whole = end - first >= cells
        first, end = np.where(whole, 0, first), np.where(whole, cells, end)
        base = self.first_cell[band]
        runs = [(circle, base + np.maximum(first, 0), base + np.minimum(end, cells))]
        before, after = np.flatnonzero(first < 0), np.flatnonzero(end > cells)
        runs.append((circle[before], (base + cells + first)[before], (base + cells)[before]))
        runs.append((circle[after], base[after], (base + end - cells)[after]))
        parts = [np.concatenate([run[k] for run in runs]) for k in range(3)]
        return parts[0], parts[1], parts[2]


def densities(count: int) -> list[tuple[int, int, float]]:
    """Cell size (nside), stars per cell and stars per square degree of each level, the finest first."""
    kinds: list[tuple[int, int, float]] = []
    nside = FINEST_NSIDE
    while nside >= 1 and len(kinds) < count:
        for stars in CELL_STARS:
            kinds.append((nside, stars, stars * 12 * nside**2 / SKY_DEG2))
        nside //= 2
    return kinds[:count]


MOST_TOLERANCE = 0.99 * 0.5 * STEPS_PER_CELL * STEP
"""Half a cell, 0.0103: a wider question would reach three cells of a row."""
ROUNDS_KEPT = 8
"""After so many rounds of questions the pages that they touched are worth releasing: 5 to 10 MB each. A frame
that is found takes one or two. Doubled, a process that solves holds some 50 MB more of the shared file;
halved, a solve of 9 Mpx costs 2 % more."""


class BlindIndex:
    """Quads of the whole sky, found by their shape. Threads may share it.

    Parameters
    ----------
    path : Path
        A file written by `mountnav.identification.blind.building.build`.

    Raises
    ------
    BadSettings
        The file can't be opened, or is no whole index of this version.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            with open_buffered(path) as file:
                self.header, start = decode_header(
                    file.read(PREAMBLE_BYTES + LONGEST_HEADER_BYTES), file=str(path)
                )
            size = path.stat().st_size
            layout = self.header.layout()
            if size != start + layout["end"][0]:
                raise damaged(str(path), f"{size} bytes long, not {start + layout['end'][0]}")
            self._mapped = mapped(path)
        except OSError as refused:
            raise BadSettings(
                f"can't be opened: {refused.strerror}",
                device=str(path),
                advice="check the path and its rights, or build it: mountnav catalog index",
            ) from refused

        def section(name: str, kind: str) -> NDArray[Any]:
            at, length = layout[name]
            dtype = np.dtype(kind)
            return np.frombuffer(self._mapped, dtype, count=length // dtype.itemsize, offset=start + at)

        self._codes = section("codes", "<u4")
        self._cells = section("cells", "<u4")
        self._quads = section("quads", "<u8")
        self._rows = section("rows", "<u4")
        self._grid = section("grid", "<u4")
        self._rounds = 0
        self._grid_starts = np.concatenate(([0], np.cumsum(self.header.grid_lengths)))
        self.first_star: Index = np.concatenate(([0], np.cumsum(self.header.level_stars)))
        self.density_deg2: Array = np.array([kind[2] for kind in densities(len(self.header.level_stars))])
        self._grids = [Grid.of(float(density)) for density in self.density_deg2]
        if self._cells[-1] != self.header.quads or any(
            grid.cells + 1 != length
            for grid, length in zip(self._grids, self.header.grid_lengths, strict=True)
        ):
            raise damaged(str(path), "damaged: its tables don't fit its header")

    @classmethod
    def open(cls, path: Path) -> BlindIndex:
        """Map an index file."""
        return cls(path)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return f"quads of {self.header.catalog}"

    def __len__(self) -> int:
        return self.header.quads

    def __reduce__(self) -> tuple[type[BlindIndex], tuple[Path]]:
        # a worker process maps the same file, and shares its pages
        return BlindIndex, (self.path,)

    def __repr__(self) -> str:
        return f"BlindIndex({self.name!r}, {len(self)} quads, {self.path})"

    def alike(self, code: Array, tolerance: Array) -> tuple[Index, Index]:
        """Quads of the sky shaped like those given.

        Parameters
        ----------
        code : ndarray, shape (n, 4)
            From `patterns.codes`.
        tolerance : ndarray, shape (n,)
            How far each of a code's four numbers may differ; at most `MOST_TOLERANCE`.

        Returns
        -------
        given, quad : ndarray of int, shape (m,)
            Which question, and the number of the quad.
        """
        step, reach = stepped(code), np.minimum(tolerance, MOST_TOLERANCE)[:, None] / STEP
        low, high = np.floor(step - reach).astype(np.int64), np.floor(step + reach).astype(np.int64)
        top = np.array(RASTER) - 1
        low_cell = np.clip(low // STEPS_PER_CELL, 0, top)
        high_cell = np.clip(high // STEPS_PER_CELL, 0, top)
        spans = high_cell > low_cell
        given, cells = [], []
        for corner in product((0, 1), repeat=4):
            there = np.flatnonzero(np.all(spans | (np.array(corner) == 0), axis=1))
            if there.size:
                given.append(there)
                cells.append(low_cell[there] + np.array(corner))
        if not given:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        which, cell = np.concatenate(given), np.concatenate(cells)
        number = cell @ STRIDES
        first, end = self._cells[number].astype(np.int64), self._cells[number + 1].astype(np.int64)
        slot, quad = self._runs(first, end, len(self))
        # in 16 bits: both bounds lie within two cells of the cell they are compared in
        origin = cell * STEPS_PER_CELL
        at_least = np.clip(low[which] - origin, -1, STEPS_PER_CELL).astype(np.int16)
        at_most = np.clip(high[which] - origin, -1, STEPS_PER_CELL).astype(np.int16)
        place = self._codes[quad].view(np.uint8).reshape(-1, 4)
        for k in (3, 1, 2, 0):
            here = place[:, k]
            kept = np.flatnonzero((here >= at_least[slot, k]) & (here <= at_most[slot, k]))
            place, slot, quad = place[kept], slot[kept], quad[kept]
        self._rounds += 1
        return which[slot], quad

    @property
    def worth_releasing(self) -> bool:
        """Whether so many rounds were asked for that much of the file counts as this process' memory."""
        return self._rounds >= ROUNDS_KEPT

    def rest(self) -> None:
        """Release the file's pages: a search leaves 10 to 100 MB of them, and the next finds them again.

        To map them again takes longer than to look at them: not for between the rounds of one search.
        """
        self._rounds = 0
        unmap(self._mapped)

    def stars(self, quad: Index) -> Index:
        """Star numbers of quads in the order A, B, C, D; shape (n, 4)."""
        return unpack(self._quads[quad])

    def rows(self, star: Index) -> Index:
        """Catalog rows of star numbers; shape as given.

        Raises
        ------
        BadSettings
            There are no such stars: the file is damaged.
        """
        if star.size and not 0 <= star.min() <= star.max() < self._rows.size:
            raise damaged(str(self.path), "damaged: its quads are of stars that it doesn't have")
        rows: Index = self._rows[star].astype(np.int64)
        return rows

    def level(self, star: Index) -> Index:
        """The level a star number belongs to; shape as given."""
        return np.searchsorted(self.first_star, star, side="right") - 1

    def around(self, level: int, ra_deg: Array, dec_deg: Array, radius_deg: Array) -> tuple[Index, Index]:
        """Stars of a level round positions, at the index' epoch, and some more.

        Parameters
        ----------
        ra_deg, dec_deg, radius_deg : ndarray, shape (n,)
            The circles, ICRS.

        Returns
        -------
        circle, star : ndarray of int, shape (m,)
            Which circle, and the star's number. Whole cells: those outside are for the caller to drop.
        """
        circle, first, end = self._grids[level].slices(ra_deg, dec_deg, radius_deg)
        at = self._grid_starts[level]
        stars = int(self.first_star[level + 1] - self.first_star[level])
        slot, star = self._runs(
            self._grid[at + first].astype(np.int64), self._grid[at + end].astype(np.int64), stars
        )
        return circle[slot], star + self.first_star[level]

    def _runs(self, first: Index, end: Index, size: int) -> tuple[Index, Index]:
        """Which run each is of, and all numbers first..end-1 of many runs, of which none is above `size`."""
        counts = end - first
        if counts.size and (counts.min() < 0 or end.max() > size):
            raise damaged(str(self.path), "damaged: its tables are out of order")
        run = np.repeat(np.arange(first.size), counts)
        return run, np.arange(run.size) + np.repeat(first - (np.cumsum(counts) - counts), counts)
