"""Densities of stars, and how a level's stars lie in its list: in bands of declination, cell by cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SKY_DEG2 = 41252.96
FINEST_NSIDE = 128
"""Cells of 0.21 square degrees."""
CELL_STARS = (10, 5)
"""Brightest stars of a cell; two levels for each cell size, whose area grows by 4."""
CELL_BANDS = 4
"""A cell of the level's table is one band high and so many wide."""


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
        """Cell numbers of places; shape (n,)."""
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
