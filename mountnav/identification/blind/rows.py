"""Any rows of a packed catalog at any epoch: the index names stars by their row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import (
    DEC_STEP_DEG,
    LONGEST_HEADER_BYTES,
    MAG_STEP,
    MAG_ZERO,
    PREAMBLE_BYTES,
    RA_STEP_DEG,
    STAR,
    proper_motions,
)
from mountnav.catalog.packed.header import decode_header
from mountnav.catalog.space_motion import motion_vectors, unit_vectors
from mountnav.files import open_buffered
from mountnav.identification.blind.mapping import let_go, mapped

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
        """Let go of the pages that were looked at."""
        let_go(self._mapped)

    def vectors(self, rows: Index, *, epoch_yr: float) -> Array:
        """Unit vectors of stars at an epoch.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
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
