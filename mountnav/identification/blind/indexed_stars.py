"""The index's stars at the frame's epoch: rows of a packed catalog, and stars round a position."""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.format import (
    DEC_STEP_DEG,
    LONGEST_HEADER_BYTES,
    MAG_STEP,
    MAG_ZERO,
    PREAMBLE_BYTES,
    RA_STEP_DEG,
    STAR,
    decode_header,
    proper_motions,
)
from mountnav.catalog.space_motion import motion_vectors, places, unit_vectors
from mountnav.catalog.stars import Catalog
from mountnav.errors import BadSettings
from mountnav.files import open_buffered
from mountnav.identification.blind.file_format import damaged, mapped, unmap
from mountnav.identification.blind.index import BlindIndex
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Index = NDArray[np.int64]


class CatalogRows:
    """The stars of a packed catalog by row number, mapped, not read.

    Parameters
    ----------
    path : Path
        Of a `PackedStore`.

    Raises
    ------
    BadSettings
        The file is gone or no packed catalog any more.
    """

    def __init__(self, path: Path) -> None:
        with open_buffered(path) as file:
            header, start = decode_header(file.read(PREAMBLE_BYTES + LONGEST_HEADER_BYTES), file=str(path))
        layout = header.layout()
        self._mapped = mapped(path)
        self._epoch_yr = header.epoch_yr
        self._stars = np.frombuffer(
            self._mapped, dtype=STAR, count=header.count, offset=start + layout["stars"][0]
        )
        self._fast = np.frombuffer(
            self._mapped, dtype=header.fast_dtype, count=header.fast_count, offset=start + layout["fast"][0]
        )

    def __len__(self) -> int:
        return int(self._stars.size)

    def rest(self) -> None:
        """Release the pages that were read."""
        unmap(self._mapped)

    def vectors(self, rows: Index, *, epoch_yr: float) -> Array:
        """Unit vectors of stars at an epoch.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
            Rows of the index' stars.
        epoch_yr : float
            Julian year.

        Returns
        -------
        ndarray, shape (n, 3)
            ICRS.
        """
        found = self._stars[rows]
        ra_deg, dec_deg = found["ra"] * RA_STEP_DEG, found["dec"] * DEC_STEP_DEG
        pm_ra, pm_dec, _ = proper_motions(rows, found, self._fast)
        moved = unit_vectors(ra_deg, dec_deg) + motion_vectors(ra_deg, dec_deg, pm_ra, pm_dec) * (
            epoch_yr - self._epoch_yr
        )
        moved /= np.sqrt((moved**2).sum(axis=0))
        return np.ascontiguousarray(moved.T)

    def magnitudes(self, rows: Index) -> Array:
        """Magnitudes of stars, shape (n,)."""
        mag: Array = self._stars["mag"][rows] * MAG_STEP + MAG_ZERO
        return mag


class IndexedStars:
    """The sky as the search needs it: quads by code, stars round positions, unit vectors at the epoch.

    Parameters
    ----------
    catalog : Catalog
        The packed catalog that the index was made from.
    epoch_yr : float
        Julian year that stars are moved to.

    Raises
    ------
    BadSettings
        The index is of another catalog.
    """

    def __init__(self, index: BlindIndex, catalog: Catalog, epoch_yr: float) -> None:
        if not isinstance(catalog, PackedStore) or (
            catalog.header.sections_sha256 != index.header.catalog_sha256
        ):
            raise BadSettings(
                f"the index is not of the catalog {catalog.name}",
                device=str(index.path),
                advice="build one of this catalog: mountnav catalog index",
            )
        self.index = index
        self._catalog, self._epoch_yr = catalog, epoch_yr
        self._rows = _rows_of(catalog.path)

    def vectors(self, star: Index) -> Array:
        """Unit vectors of star numbers; one axis more than given, of length 3."""
        rows = self.index.rows(star.ravel())
        if rows.size and rows.max() >= len(self._rows):
            raise damaged(str(self.index.path), "damaged: it names stars that the catalog doesn't have")
        flat = self._rows.vectors(rows, epoch_yr=self._epoch_yr)
        return flat.reshape(*star.shape, 3)

    def around(self, level: int, axis: Array, radius_rad: Array) -> tuple[Index, Index, Array]:
        """Stars of a level within circles.

        Parameters
        ----------
        axis : ndarray, shape (n, 3)
            Unit vectors of the circles' centers.
        radius_rad : ndarray, shape (n,)
            Radius of each circle.

        Returns
        -------
        circle, star : ndarray of int, shape (m,)
            One pair for each star in a circle.
        vectors : ndarray, shape (m, 3)
            Directions of these stars.
        """
        ra_deg, dec_deg = places(axis.T)
        circle, star = self.index.around(level, ra_deg, dec_deg, np.degrees(radius_rad))
        vectors = self.vectors(star)
        inside = np.flatnonzero(np.einsum("nc,nc->n", vectors, axis[circle]) >= np.cos(radius_rad)[circle])
        return circle[inside], star[inside], vectors[inside]

    def rest(self) -> None:
        """Release memory that only a search needs, once there is much of it."""
        if self.index.worth_releasing:
            self.index.rest()
            self._rows.rest()

    def catalog_places(self, star: Index) -> tuple[Array, Array]:
        """Places of a few stars to the last bit as the catalog gives them: confirmation compares them so.

        Parameters
        ----------
        star : ndarray of int, shape (k,)
            Rows of the index' stars.

        Returns
        -------
        ra_deg, dec_deg : ndarray, shape (k,)
            ICRS.
        """
        vectors = self.vectors(star)
        axis = vectors.mean(axis=0)
        axis /= np.sqrt((axis**2).sum())
        (ra_deg,), (dec_deg,) = places(axis[:, None])
        farthest_rad = 2.0 * math.asin(0.5 * float(np.sqrt(((vectors - axis) ** 2).sum(axis=1)).max()))
        found = self._catalog.cone(
            Icrs(float(ra_deg), float(dec_deg)),
            math.degrees(farthest_rad) + 1e-3,
            epoch_yr=self._epoch_yr,
            mag_limit=float(self._rows.magnitudes(self.index.rows(star)).max()) + 1e-3,
        )
        there = unit_vectors(found.ra_deg, found.dec_deg)
        off = ((vectors[:, :, None] - there[None, :, :]) ** 2).sum(axis=1)
        nearest = np.argmin(off, axis=1)
        return found.ra_deg[nearest], found.dec_deg[nearest]


@lru_cache(maxsize=4)
def _rows_of(path: Path) -> CatalogRows:
    return CatalogRows(path)
