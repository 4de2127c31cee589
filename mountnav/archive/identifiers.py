"""Names of stars: whose Gaia or Tycho-2 number a star of an archive is, found by its place.

The catalogs that frames are solved with hold no names: they would double their size, and no plate needs them.
So the stars' own catalog is read beside, moved to each frame's epoch, and joined by position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.space_motion import motion_vectors, unit_vectors
from mountnav.errors import BadRequest
from mountnav.extras import extra
from mountnav.units import ARCSEC_PER_RAD, RAD_PER_MAS

if TYPE_CHECKING:
    import pyarrow as pa

Array = NDArray[np.float64]
Ids = NDArray[np.int64]
Kind = Literal["tycho2", "gaia"]

WITHIN_ARCSEC = 1.0
"""How far from its place a star is still the same: two catalogs' errors, and what is unknown of its motion.
Doubled, faint neighbors of Gaia are in each other's way; halved, Tycho-2's faintest lose their names."""
FAST_MAS_YR = 200.0
"""Stars that move faster are looked for in a wider circle; some thousands of all."""
NEAREST = 8
"""Stars of the catalog that are compared with one of the archive. Doubled, it takes twice as long."""
MOST_ROWS = 50_000_000
"""Stars of a file of names: 4 GB of memory. Doubled, twice that."""

_TYCHO_EPOCH_YR, _SUPPLEMENT_EPOCH_YR = 2000.0, 1991.25
"""Epochs of the places in tyc2.dat and in suppl_1.dat, Julian years [Tycho-2, ReadMe of CDS I/259]."""
_TYCHO_FIELDS, _SUPPLEMENT_FIELDS = 32, 18
"""Fields of a line of tyc2.dat and of suppl_1.dat, [Tycho-2, ReadMe of CDS I/259]."""
_RELEASES = {2016.0: "Gaia DR3", 2015.5: "Gaia DR2", 2015.0: "Gaia DR1"}
"""By the epoch of their places: numbers of other releases are other stars'."""


@dataclass(frozen=True, slots=True)
class NamedStars:
    """Stars with names, from a file.

    Attributes
    ----------
    ids : ndarray of int64, shape (n,)
        Gaia's source_id; of Tycho-2 TYC1, TYC2 and TYC3 in one number.
    vectors, motion : ndarray, shape (3, n)
        Directions at `epoch_yr`, and rad/yr.
    prefix : str
        "TYC", "Gaia DR3", ...
    """

    ids: Ids
    vectors: Array
    motion: Array
    epoch_yr: float
    prefix: str
    _slow: cKDTree
    _fast: cKDTree
    _fast_at: Ids
    _fastest_rad_yr: float

    @classmethod
    def of(
        cls,
        ids: Ids,
        ra_deg: Array,
        dec_deg: Array,
        pm_ra_cosdec_mas_yr: Array,
        pm_dec_mas_yr: Array,
        *,
        epoch_yr: float,
        prefix: str,
    ) -> NamedStars:
        """Index stars by their places; a motion that is unknown is none."""
        pm_ra, pm_dec = np.nan_to_num(pm_ra_cosdec_mas_yr), np.nan_to_num(pm_dec_mas_yr)
        vectors = np.asarray(unit_vectors(ra_deg, dec_deg))
        total = np.hypot(pm_ra, pm_dec)
        fast = np.flatnonzero(total > FAST_MAS_YR)
        return cls(
            ids,
            vectors,
            motion_vectors(ra_deg, dec_deg, pm_ra, pm_dec),
            epoch_yr,
            prefix,
            cKDTree(vectors.T),
            cKDTree(vectors[:, fast].T),
            fast,
            float(total.max(initial=0.0)) * RAD_PER_MAS,
        )

    def __len__(self) -> int:
        return int(self.ids.size)

    def named(
        self, ra_deg: Array, dec_deg: Array, epoch_yr: float, within_arcsec: float = WITHIN_ARCSEC
    ) -> tuple[list[str | None], Array]:
        """Names of stars at their places of an epoch, and how far off these are; None and NaN where unsure.

        A star that two of the catalog lie near enough to gets the name of neither: so do two that would get
        the same name.
        """
        places = np.asarray(unit_vectors(ra_deg, dec_deg)).T
        years, within = epoch_yr - self.epoch_yr, within_arcsec / ARCSEC_PER_RAD
        best = np.full(len(places), -1, dtype=np.int64)
        away = np.full(len(places), np.inf)
        second = np.full(len(places), np.inf)
        searches = (
            (self._slow, None, FAST_MAS_YR * RAD_PER_MAS),
            (self._fast, self._fast_at, self._fastest_rad_yr),
        )
        for tree, numbers, speed_rad_yr in searches:
            if tree.n == 0 or not len(places):
                continue
            count = min(NEAREST, tree.n)
            _, found = tree.query(
                places, k=[*range(1, count + 1)], distance_upper_bound=within + speed_rad_yr * abs(years)
            )
            there = found < tree.n
            which = np.where(there, found, 0)
            which = which if numbers is None else numbers[which]
            moved = self.vectors[:, which] + self.motion[:, which] * years
            moved /= np.sqrt((moved**2).sum(axis=0))
            apart = np.sqrt(((moved - places.T[:, :, None]) ** 2).sum(axis=0))
            apart[~there] = np.inf
            for column in range(count):
                other = which[:, column]
                new = (other != best) & np.isfinite(apart[:, column])
                nearer = new & (apart[:, column] < away)
                second = np.where(nearer, away, np.where(new, np.minimum(second, apart[:, column]), second))
                best = np.where(nearer, other, best)
                away = np.where(nearer, apart[:, column], away)
        sure = (away <= within) & (second > within)
        taken, counts = np.unique(best[sure], return_counts=True)
        sure &= ~np.isin(best, taken[counts > 1])
        separation = np.where(sure, away * ARCSEC_PER_RAD, np.nan)
        return [
            self._name(int(self.ids[at])) if ok else None for at, ok in zip(best, sure, strict=True)
        ], separation

    def _name(self, number: int) -> str:
        if self.prefix != "TYC":
            return f"{self.prefix} {number}"
        return f"TYC {number // 1_000_000}-{number // 10 % 100_000}-{number % 10}"


def tycho_id(tyc1: Any, tyc2: Any, tyc3: Any) -> Any:
    """TYC1, TYC2 and TYC3 in one number."""
    return (tyc1 * 100_000 + tyc2) * 10 + tyc3


def named_stars(path: Path) -> NamedStars:
    """Read a file of stars with names.

    Parameters
    ----------
    path : Path
        ``tyc2.dat`` or a part of it, or ``suppl_1.dat``, as CDS (I/259) has them; else a table (.parquet,
        .csv, .csv.gz) with the columns of the Gaia archive (``source_id``, ``ra``, ``dec``, ``ref_epoch``,
        and where known ``pmra``, ``pmdec``) or VizieR's of Tycho-2 (``TYC1``, ``TYC2``, ``TYC3``, ``RAmdeg``,
        ``DEmdeg``, ``pmRA``, ``pmDE``).

    Raises
    ------
    BadRequest
        It can't be read, or is none of these.
    """
    with extra("parquet", "files of stars' names"):
        import pyarrow as pa
    try:
        if ".dat" in path.suffixes or path.name.startswith(("tyc2", "suppl_1")):
            return _of_dat(path)
        table = _table(path)
        if table.num_rows > MOST_ROWS:
            raise BadRequest(f"{path} has {table.num_rows} stars; {MOST_ROWS} are the most", advice="cut it")
        if "source_id" in table.column_names:
            return _of_gaia(table, path)
        if "TYC1" in table.column_names:
            return _of_vizier(table)
    except (OSError, pa.ArrowException, KeyError, ValueError) as fault:
        raise BadRequest(
            f"{path} can't be read: {fault}", advice="name a table of Gaia's or Tycho-2"
        ) from fault
    raise BadRequest(
        f"{path} has neither source_id nor TYC1", advice="name a table of Gaia's or of Tycho-2 (CDS I/259)"
    )


def _table(path: Path) -> pa.Table:
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    return pq.read_table(path) if path.suffix == ".parquet" else pc.read_csv(path)


def _floats(table: pa.Table, name: str, *, needed: bool = False) -> Array:
    if name not in table.column_names and not needed:
        return np.zeros(table.num_rows)
    column = table.column(name).cast("float64")
    return np.asarray(column.to_numpy(), dtype=np.float64)


def _of_gaia(table: pa.Table, path: Path) -> NamedStars:
    epochs = np.unique(_floats(table, "ref_epoch", needed=True)) if table.num_rows else np.array([2016.0])
    if epochs.size != 1 or float(epochs[0]) not in _RELEASES:
        raise BadRequest(
            f"{path}: ref_epoch is {', '.join(f'{one:g}' for one in epochs[:3])}",
            advice=f"one release of Gaia has one: {', '.join(f'{one:g}' for one in _RELEASES)}",
        )
    return NamedStars.of(
        np.asarray(table.column("source_id").cast("int64").to_numpy()),
        _floats(table, "ra", needed=True),
        _floats(table, "dec", needed=True),
        _floats(table, "pmra"),
        _floats(table, "pmdec"),
        epoch_yr=float(epochs[0]),
        prefix=_RELEASES[float(epochs[0])],
    )


def _of_vizier(table: pa.Table) -> NamedStars:
    ids = tycho_id(*(np.asarray(table.column(f"TYC{at}").cast("int64").to_numpy()) for at in (1, 2, 3)))
    ra, dec = _floats(table, "RAmdeg", needed=True), _floats(table, "DEmdeg", needed=True)
    return _of_tycho(ids, ra, dec, _floats(table, "pmRA"), _floats(table, "pmDE"), _TYCHO_EPOCH_YR)


def _of_dat(path: Path) -> NamedStars:
    import pyarrow as pa
    import pyarrow.compute as pcc
    import pyarrow.csv as pc

    names = [f"f{at}" for at in range(_fields(path))]
    main = len(names) == _TYCHO_FIELDS
    observed = ("f24", "f25") if main else ("f2", "f3")
    table = pc.read_csv(
        path,
        read_options=pc.ReadOptions(column_names=names),
        parse_options=pc.ParseOptions(delimiter="|", quote_char=False),
        convert_options=pc.ConvertOptions(
            include_columns=list(dict.fromkeys(["f0", "f2", "f3", "f4", "f5", *observed])),
            column_types=dict.fromkeys(names, pa.string()),
        ),
    )

    def numbers(name: str) -> Array:
        text = pcc.utf8_trim_whitespace(table.column(name))
        return np.asarray(
            pcc.if_else(pcc.equal(text, ""), None, text).cast("float64").to_numpy(), dtype=float
        )

    tyc = pcc.utf8_trim_whitespace(table.column("f0"))
    parts = [
        np.asarray(pcc.utf8_slice_codeunits(tyc, *part).cast("int64").to_numpy())
        for part in ((0, 4), (5, 10), (11, 12))
    ]
    ra, dec = numbers("f2"), numbers("f3")
    # a star without a mean place stands where it was observed
    ra, dec = (
        np.where(np.isnan(mean), numbers(name), mean) for mean, name in zip((ra, dec), observed, strict=True)
    )
    epoch = _TYCHO_EPOCH_YR if main else _SUPPLEMENT_EPOCH_YR
    return _of_tycho(tycho_id(*parts), ra, dec, numbers("f4"), numbers("f5"), epoch)


def _of_tycho(ids: Ids, ra: Array, dec: Array, pm_ra: Array, pm_dec: Array, epoch_yr: float) -> NamedStars:
    """Stars with a place; of two that share one, as parts of a double star do, the first."""
    there = np.flatnonzero(np.isfinite(ra) & np.isfinite(dec))
    order = there[np.argsort(ids[there], kind="stable")]
    _, first = np.unique(np.column_stack((ra[order], dec[order])), axis=0, return_index=True)
    kept = order[np.sort(first)]
    return NamedStars.of(
        ids[kept], ra[kept], dec[kept], pm_ra[kept], pm_dec[kept], epoch_yr=epoch_yr, prefix="TYC"
    )


def _fields(path: Path) -> int:
    """How many fields a line has: that tells the catalog from its supplement."""
    import pyarrow as pa

    with pa.input_stream(str(path), compression="detect") as file:
        count = bytes(file.read(1000)).split(b"\n")[0].count(b"|") + 1
    if count not in (_TYCHO_FIELDS, _SUPPLEMENT_FIELDS):
        raise BadRequest(
            f"{path} has {count} fields a line", advice="name tyc2.dat or suppl_1.dat of CDS I/259"
        )
    return count


def first_named(
    catalogs: Sequence[NamedStars], ra_deg: Array, dec_deg: Array, epoch_yr: float, within_arcsec: float
) -> tuple[list[str | None], Array]:
    """Names by the first catalog that knows each star."""
    names: list[str | None] = [None] * ra_deg.size
    away = np.full(ra_deg.size, np.nan)
    for catalog in catalogs:
        found, apart = catalog.named(ra_deg, dec_deg, epoch_yr, within_arcsec)
        for at, name in enumerate(found):
            if names[at] is None and name is not None:
                names[at], away[at] = name, apart[at]
    return names, away
