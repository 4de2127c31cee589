"""Levels of star density: of each part of the sky its brightest stars, as many as a field of some size needs.

A frame shows its brightest stars, and how far apart these lie tells nothing but the size of its field. So the
sky is thinned to a dozen densities, each half the one before; a field of any size finds one among them that
has 12 to 24 stars in it. The stars of a level lie in bands of declination, by right ascension within a band:
neighbors on the sky have numbers that differ little, and the stars round a place are a few slices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from astropy import units
from astropy_healpix import lonlat_to_healpix
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import places
from mountnav.identification.blind.grid import FINEST_NSIDE, Grid, densities
from mountnav.identification.selection import rank_in_cell

Array = NDArray[np.float64]
Index = NDArray[np.int64]

BLEND_SHARE = 0.02
"""Of two stars nearer than this share of the mean distance the fainter is left out: they look like one."""


@dataclass(frozen=True, slots=True)
class Level:
    """One density.

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
    """Thin a catalog.

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
