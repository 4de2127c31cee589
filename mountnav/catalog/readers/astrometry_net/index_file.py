"""One index file of astrometry.net: its star tree, the columns beside it, and stand-in magnitudes.

The file is FITS; each array of the tree is a table of one column of bytes, in the byte order of the machine
that wrote it (card ENDIAN). The star tree holds unit vectors as u32 steps from a lower bound; tag-along
tables are ordinary FITS tables, row i for star i [CATALOGS, Formats §2; libkd/kdtree_fits_io.c and
util/starkd.c of astrometry.net].

Magnitudes for stars of which an index file has only the order of brightness.

An index file has the brightest star of each cell of a fine grid (first sweep), then the second brightest of
each (second sweep) and so on, ten as a rule; within a sweep the stars are in order of brightness. Its table
`sweep` has one byte a star, 256 × its number in that order / count [solver/unpermute-stars.c of
astrometry.net]. From the cell's size and the sweep follows how many stars of a square degree are brighter,
and from them the magnitude.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.readers.fits_tables import (
    FitsColumn,
    FitsTable,
    column_named,
    fits_tables,
    numbers,
    texts,
)
from mountnav.errors import BadCatalog
from mountnav.units import SKY_DEG2

Array = NDArray[np.float64]

_AT_MAG, _AT_PER_DEG2 = 11.5, 62.0
"""Averaged over the sky, Tycho-2's 2.55 million stars brighter than V = 11.5."""
_DEX_PER_MAG = 0.34
"""Growth of counts to 17, of which Gaia has about 4600 in a square degree."""
_FAINTEST_MAG = 21.0
"""Stand-in magnitudes go no fainter: Gaia's limit, from which the 5200 series is made."""


def stand_in_mags(count: int, sweeps: Sequence[int], cells_nside: int) -> Array:
    """Estimate the magnitude for each value of the byte.

    On Debian's Tycho-2 index of the finest scale: off by 0.6 mag in the median.

    Parameters
    ----------
    count : int
        Stars in the file.
    sweeps : sequence of int
        How many of them each sweep has; empty if it isn't told: all are taken for one sweep's.
    cells_nside : int
        HEALPix resolution of the cells.

    Returns
    -------
    ndarray, shape (256,)
        Rising within each sweep.
    """
    ends = np.cumsum(sweeps if sum(sweeps) == count and count else [max(count, 1)])
    rank = (np.arange(256) + 0.5) / 256.0 * ends[-1]
    sweep = np.searchsorted(ends, rank, side="right")
    starts = np.concatenate([[0], ends[:-1]])
    share = (rank - starts[sweep]) / (ends[sweep] - starts[sweep])
    deviate = np.array([NormalDist().inv_cdf(float(min(max(s, 0.005), 0.995))) for s in share])
    per_deg2 = (sweep + 1.0) * 12.0 * cells_nside**2 / SKY_DEG2
    middle = _AT_MAG + np.log10(per_deg2 / _AT_PER_DEG2) / _DEX_PER_MAG
    # the place of the n-th star in a count scatters by 1/sqrt(n) of the logarithm
    scatter = 1.0 / np.sqrt(sweep + 1.0) / np.log(10.0) / _DEX_PER_MAG
    mags: Array = np.clip(middle + scatter * deviate, 0.0, _FAINTEST_MAG)
    return mags


_BYTE_ORDERS = {"04:03:02:01": "<", "01:02:03:04": ">"}
_OFF_SPHERE = 1e-6
"""Vectors are of length 1 to within 1e-9; what is further off was read wrongly."""
_AT_ZERO_RAD = 1e-9
"""Within so much of RA 0, Dec 0 a star is taken as one without a position: a zero vector that was brought to
length 1. 0.2 mas, so that no real star is lost."""
_LARGEST_NSIDE = 64
"""Finest division of the sky into index files that is believed; more is a damaged header. Chosen by hand."""


class IndexFile:
    """An index file, opened.

    Raises
    ------
    BadCatalog
        It is no index file, is cut short, or contradicts itself.

    Attributes
    ----------
    count : int
        Stars in the tree.
    index_id : int
        INDEXID: series and scale.
    scale_arcmin : float
        Upper limit of the quads' size: the smaller, the deeper the stars go.
    healpix, nside : int
        Which part of the sky it is for, in astrometry.net's numbering (base pixel, x, y); -1 for all.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        primary, tables = fits_tables(path)
        by_name = {table.columns[0].name: table for table in tables if len(table.columns) == 1}
        head = by_name.get("kdtree_header_stars")
        if head is None:
            raise NotAnIndex(
                "has no star tree (kdtree_header_stars): it is not an index file",
                device=path.name,
                advice="give the index-*.fits files themselves",
            )
        cards, at = head.cards, head.data_at - head.cards.length
        order = _BYTE_ORDERS.get(str(cards.values.get("ENDIAN", primary.values.get("ENDIAN"))))
        if order is None:
            raise malformed_at(
                path.name, at, f"ENDIAN, one of {', '.join(_BYTE_ORDERS)}", repr(cards.values.get("ENDIAN"))
            )
        self._order = order
        self.count = cards.integer("KDT_NDAT", -1)
        shape = (cards.integer("KDT_NDIM", -1), cards.values.get("KDT_DATA"))
        if shape != (3, "u32"):
            raise malformed_at(
                path.name, at, "a star tree of 3 dimensions in u32", f"{shape[0]} in {shape[1]}"
            )
        self._data = self._table(by_name, "kdtree_data_stars", 12 * self.count, at)
        self._low, self._scale = self._range(self._table(by_name, "kdtree_range_stars", 56, at))
        self._sweep = by_name.get("sweep")
        if self._sweep is not None and self._sweep.rows * self._sweep.row_bytes != self.count:
            raise malformed_at(
                path.name, self._sweep.data_at, f"{self.count} sweeps", f"{self._sweep.rows} of them"
            )
        self._along = next((t for t in tables if t.cards.values.get("AN_FILE") == "TAGALONG"), None)
        if self._along is not None and self._along.rows != self.count:
            raise malformed_at(
                path.name, self._along.data_at, f"{self.count} rows beside the stars", f"{self._along.rows}"
            )
        self.index_id = primary.integer("INDEXID", 0)
        self.scale_arcmin = float(np.degrees(primary.real("SCALE_U", np.pi))) * 60.0
        self.healpix = cards.integer("HEALPIX", primary.integer("HEALPIX", -1))
        self.nside = max(1, cards.integer("HPNSIDE", primary.integer("HPNSIDE", 1)))
        if self.healpix >= 12 * self.nside**2 or self.nside & (self.nside - 1) or self.nside > _LARGEST_NSIDE:
            raise malformed_at(
                path.name,
                at,
                "a HEALPix pixel (HPNSIDE a power of 2)",
                f"{self.healpix} of nside {self.nside}",
            )
        self._cells_nside = max(1, cards.integer("CUTNSIDE", 1))
        self._sweeps = [cards.integer(f"SWEEP{n}") for n in range(1, cards.integer("CUTNSWEP") + 1)]

    @property
    def columns(self) -> dict[str, FitsColumn]:
        """The columns that came along, by their names in lower case; those with one number a row."""
        if self._along is None:
            return {}
        return {
            c.name.lower(): c
            for c in self._along.columns
            if c.is_number and column_named(self._along, c.name)
        }

    def places_deg(self, first: int, end: int) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Positions of some stars.

        Returns
        -------
        ra_deg, dec_deg : ndarray, shape (end - first,)
            In the file's order.
        bogus : ndarray of bool, shape (end - first,)
            At RA = Dec = 0 to within the step of the tree: a row without position got there.

        Raises
        ------
        BadCatalog
            A vector isn't of length one; the message tells its byte.
        """
        at = self._data.data_at + 12 * first
        steps = np.fromfile(self.path, dtype=f"{self._order}u4", count=3 * (end - first), offset=at)
        if steps.size < 3 * (end - first):
            raise malformed_at(self.path.name, at + 4 * steps.size, f"{self.count} stars", "the end")
        x, y, z = (self._low + steps.reshape(-1, 3) / self._scale).T
        length = np.sqrt(x * x + y * y + z * z)
        off = np.flatnonzero(~(np.abs(length - 1.0) < _OFF_SPHERE))
        if off.size:
            raise malformed_at(
                self.path.name, at + 12 * int(off[0]), "a unit vector", f"one of length {length[off[0]]:.6f}"
            )
        ra_deg = np.degrees(np.arctan2(y, x)) % 360.0
        ra_deg[ra_deg >= 360.0] = 0.0
        return ra_deg, np.degrees(np.arctan2(z, np.hypot(x, y))), (x > 0) & (np.hypot(y, z) < _AT_ZERO_RAD)

    def column(self, name: str, first: int, end: int) -> Array:
        """Values of a column that came along, NaN where there is none.

        Parameters
        ----------
        name : str
            Lower case.
        """
        column = self.columns[name]
        assert self._along is not None
        return numbers(self._along.read({name: column}, first, end)[name], column)

    def text(self, name: str, first: int, end: int) -> NDArray[np.str_] | None:
        """Values of a column of characters that came along; None if there is no such column.

        Parameters
        ----------
        name : str
            Lower case.
        """
        column = None if self._along is None else column_named(self._along, name)
        if self._along is None or column is None or not column.is_text:
            return None
        return texts(self._along.read({name: column}, first, end)[name])

    def stand_in_mags(self, first: int, end: int) -> Array:
        """Magnitudes estimated from the order of brightness alone."""
        by_byte = stand_in_mags(self.count, self._sweeps, self._cells_nside)
        if self._sweep is None:
            return np.full(end - first, by_byte[-1])
        order = np.fromfile(self.path, dtype=np.uint8, count=end - first, offset=self._sweep.data_at + first)
        if order.size < end - first:
            at = self._sweep.data_at + first + order.size
            raise malformed_at(self.path.name, at, f"{self.count} bytes of sweep", "the end")
        return by_byte[order]

    def _table(self, by_name: dict[str, FitsTable], name: str, length: int, at: int) -> FitsTable:
        table = by_name.get(name)
        found = -1 if table is None else table.rows * table.row_bytes
        if table is None or found != length:
            raise malformed_at(
                self.path.name,
                at if table is None else table.data_at,
                f"{length} bytes of {name}",
                "no such table" if table is None else f"{found}",
            )
        return table

    def _range(self, table: FitsTable) -> tuple[Array, float]:
        """Lower bounds of the three coordinates, and tree units per unit."""
        bounds = np.fromfile(self.path, dtype=f"{self._order}f8", count=7, offset=table.data_at)
        low, high, scale = bounds[:3], bounds[3:6], float(bounds[6])
        if (
            not np.all(np.isfinite(bounds))
            or np.any(np.abs(bounds[:6]) > 2.0)
            or np.any(low >= high)
            or not 0.0 < scale * float(np.max(high - low)) < 2.0**32 * (1.0 + 1e-6)
        ):
            raise malformed_at(
                self.path.name, table.data_at, "bounds of unit vectors and their scale", f"{bounds.tolist()}"
            )
        return low.astype(np.float64), scale


class NotAnIndex(BadCatalog):
    """A FITS file without a star tree."""
