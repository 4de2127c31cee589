"""Index files of astrometry.net as a star catalog: each star once, from the deepest file there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.astrometry_net.index_file import IndexFile, NotAnIndex
from mountnav.catalog.readers.gaia.stars import stars_of
from mountnav.catalog.readers.gaia.tables import EARLIEST_YR, LATEST_YR, Block
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog


@dataclass(frozen=True, slots=True)
class Series:
    """Index files of one making.

    Attributes
    ----------
    epoch_yr : float
        Julian year of the positions in the star tree.
    band : str
        Of the magnitudes.
    sigma_mas : tuple of (magnitude, mas)
        One-sigma position error at the epoch, by magnitude. Empty for Gaia's.
    """

    name: str
    epoch_yr: float
    band: str
    sigma_mas: tuple[tuple[float, float], ...] = ()


SERIES: dict[int, Series] = {
    41: Series(
        "Tycho-2 (index files)",
        2000.0,
        "VT",
        ((7.0, 32.0), (8.5, 33.0), (9.5, 38.0), (10.5, 53.0), (11.5, 86.0), (12.5, 118.0)),
    ),
    42: Series("2MASS (index files)", 1999.5, "J", ((13.0, 80.0), (16.0, 120.0))),
    50: Series("Gaia DR2 (index files)", 2015.5, "G"),
    52: Series("Gaia DR2 and Tycho-2 (index files)", 2015.5, "G"),
}
"""By INDEXID // 100 [data.astrometry.net; the author's 5000-README for the epoch of Gaia's].

The 4100 series (and Debian's index-tycho2 files, which have its numbers) holds Tycho-2's mean positions at
J2000: 100,000 of its stars lie 0.009″ (median) from Tycho-2 there. Sigma: Tycho-2's own at 2000, with 0.03″
for positions that went through 32-bit floating-point degrees. 2MASS was observed from 1997 to 2001 and is
good to 0.08″ [M. F. Skrutskie et al., AJ 131, 1163 (2006)]."""

MAGNITUDE_COLUMNS: dict[str, str] = {
    "phot_g_mean_mag": "G",
    "mag": "G",
    "mag_vt": "VT",
    "vt": "VT",
    "j_mag": "J",
    "jmag": "J",
    "mag_j": "J",
}
"""Band by tag-along column, lower case. "mag" is that of the 5200 series' larger version: G, and VT for the
stars that it has from Tycho-2."""

TYCHO_EPOCH_YR = 1991.5
"""Where the 5200 series has Tycho-2's stars isn't documented: as observed around then, or moved to 2000. They
are taken as doubtful, of unknown motion since then."""


def nested_pixel(healpix: int, nside: int) -> int:
    """Bring astrometry.net's pixel number to the NESTED scheme.

    Theirs is base pixel × nside² + x × nside + y; NESTED interleaves the bits of x (even) and y (odd)
    [util/healpix.c of astrometry.net; K. M. Górski et al., ApJ 622, 759 (2005), section 4.1].

    Parameters
    ----------
    healpix, nside : int
        `nside` a power of 2.
    """
    base, inside = divmod(healpix, nside * nside)
    x, y = divmod(inside, nside)
    interleaved = 0
    for bit in range(nside.bit_length()):
        interleaved |= ((x >> bit) & 1) << (2 * bit) | ((y >> bit) & 1) << (2 * bit + 1)
    return base * nside * nside + interleaved


def owners(files: Sequence[IndexFile], nside: int) -> NDArray[np.str_]:
    """Name the file that each pixel is taken from.

    Parameters
    ----------
    files : sequence of IndexFile
        The one that is preferred first.
    nside : int
        At least that of the files.

    Returns
    -------
    ndarray of str, shape (12 nside²,)
        NESTED; empty where no file is for it.
    """
    longest = max(len(file.path.name) for file in files)
    names = np.full(12 * nside**2, "", dtype=f"<U{longest}")
    for file in reversed(files):
        if file.healpix < 0:
            names[:] = file.path.name
            continue
        children = (nside // file.nside) ** 2
        first = nested_pixel(file.healpix, file.nside) * children
        names[first : first + children] = file.path.name
    return names


def cells_of(ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64], nside: int) -> NDArray[np.int64]:
    """Pixels of some positions, NESTED.

    Parameters
    ----------
    ra_deg, dec_deg : ndarray, shape (n,)
        Positions, ICRS.

    Returns
    -------
    ndarray of int, shape (n,)
        0 to 12 nside² - 1.
    """
    from astropy import units
    from astropy_healpix import lonlat_to_healpix

    pixels: NDArray[np.int64] = lonlat_to_healpix(
        ra_deg * units.deg, dec_deg * units.deg, nside=nside, order="nested"
    )
    return pixels


Array = NDArray[np.float64]

CHUNK = 400_000
"""Stars in a chunk, below what `Reader.read` promises."""
_GAIA_COLUMNS = {
    "pmra": "pmra",
    "pmdec": "pmdec",
    "ra_error": "ra_error",
    "dec_error": "dec_error",
    "pmra_error": "pmra_error",
    "pmdec_error": "pmdec_error",
    "phot_bp_mean_mag": "bp",
    "phot_rp_mean_mag": "rp",
    "ruwe": "ruwe",
    "ref_epoch": "ref_epoch",
}
_INVERSE_VARIANCES = {
    "ra_ivar": ("ra_error", 3.6e6),
    "dec_ivar": ("dec_error", 3.6e6),
    "pmra_ivar": ("pmra_error", 1.0),
    "pmdec_ivar": ("pmdec_error", 1.0),
}
"""The larger 5200 version has 1/degree² and 1/(mas/yr)², as its author's legacypipe writes them."""
_LARGEST_SIGMA_MAS = 1e4
"""Errors of 10″ or more are taken as unknown: an inverse variance near 0 says that there is no error."""
_SAME_PLACE_ARCSEC = 1.0
"""A star's position in the tree and in the columns that came along may differ by so much; more, and the file
is damaged or the columns are of another file."""


class IndexReader:
    """Index files of one series. Implements `mountnav.catalog.readers.kind.Reader`.

    Files of other series are left aside: another catalog, another epoch. Each place on the sky is taken from
    the file with the smallest quads that is for it; stars on the margins of files belong to the file whose
    HEALPix pixel they are in.

    Raises
    ------
    BadCatalog
        It isn't known for which year the positions hold.
    """

    def __init__(self, files: Sequence[IndexFile]) -> None:
        deepest = min(files, key=_depth)
        number = deepest.index_id // 100
        ours = [file for file in files if file.index_id // 100 == number]
        self._series = SERIES.get(number) or _own_series(ours)
        self._nside = max(file.nside for file in ours)
        # a file with columns goes before the same one without
        self._owners = owners(sorted(ours, key=lambda file: (*_depth(file), file.path.name)), self._nside)
        self._files = {file.path.name: file for file in ours if np.any(self._owners == file.path.name)}
        self.name = self._series.name
        self.band = self._series.band
        self.epoch_yr = self._series.epoch_yr
        self._has_colors = any({"phot_bp_mean_mag", "phot_rp_mean_mag"} <= set(f.columns) for f in ours)
        self.color_name = "BP-RP" if self._has_colors else ""
        self.made_from = self._told(len(files) - len(ours))

    def parts(self) -> Sequence[Part]:
        """The files that are the deepest somewhere, in the order of their names."""
        return [Part(name, file.path, 17 * file.count) for name, file in sorted(self._files.items())]

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a file that no other file is for, in chunks. Raises `BadCatalog`."""
        file = self._files[part.name]
        for first in range(0, file.count, CHUNK):
            yield self._stars(file, first, min(first + CHUNK, file.count))

    def _stars(self, file: IndexFile, first: int, end: int) -> CatalogColumns:
        ra_deg, dec_deg, bogus = file.places_deg(first, end)
        mine = ~bogus & (self._owners[cells_of(ra_deg, dec_deg, self._nside)] == file.path.name)
        rows = np.flatnonzero(mine)
        mag, no_mag = self._magnitudes(file, first, end)
        values = {"ra": ra_deg, "dec": dec_deg, "g": mag}
        if self._series.sigma_mas:
            at, sigma = zip(*self._series.sigma_mas, strict=True)
            values["ra_error"] = values["dec_error"] = np.interp(mag, at, sigma)
        columns = file.columns
        for name, key in _GAIA_COLUMNS.items():
            if name in columns:
                values[key] = file.column(name, first, end)
        for name, (key, mas) in _INVERSE_VARIANCES.items():
            if name in columns:
                values[key] = _sigma(file.column(name, first, end), mas)
        if {"ra", "dec"} <= set(columns):
            self._take_places(file, first, values, mine)
        _without_empty(values, self.epoch_yr)
        from_tycho = _tycho_rows(file.text("ref_cat", first, end), values, self.epoch_yr)
        values = {key: column[rows] for key, column in values.items()}

        def error_at(row: int, expected: str, found: str) -> BadCatalog:
            return malformed_at(file.path.name, first + int(rows[row]), expected, found, unit="star")

        stars = stars_of(
            Block(values, error_at), file=file.path.name, told_epoch_yr=self.epoch_yr, epoch_yr=self.epoch_yr
        )
        assert stars.flags is not None
        stars.flags[no_mag[rows]] |= np.uint8(StarFlag.NO_MAGNITUDE)
        stars.flags[from_tycho[rows]] |= np.uint8(StarFlag.DOUBTFUL | StarFlag.OTHER_BAND)
        colors = stars.color_mag if stars.color_mag is not None else np.full(rows.size, np.nan)
        return replace(stars, color_mag=colors if self._has_colors else None)

    def _magnitudes(self, file: IndexFile, first: int, end: int) -> tuple[Array, NDArray[np.bool_]]:
        """Magnitudes, and which of them only stand in: from how many stars of their cell are brighter."""
        stand_in = file.stand_in_mags(first, end)
        for name, band in MAGNITUDE_COLUMNS.items():
            if band == self.band and name in file.columns:
                mag = file.column(name, first, end)
                # a catalog's stars without this magnitude have 0, NaN or 99 there
                unknown = ~((mag > -3.0) & (mag < 30.0)) | (mag == 0.0)
                return np.where(unknown, stand_in, mag), unknown
        return stand_in, np.ones(end - first, dtype=np.bool_)

    def _take_places(
        self, file: IndexFile, first: int, values: dict[str, Array], mine: NDArray[np.bool_]
    ) -> None:
        """Take the positions that came along: they have more digits. They must be those of the tree."""
        end = first + values["ra"].size
        ra_deg, dec_deg = file.column("ra", first, end), file.column("dec", first, end)
        with np.errstate(all="ignore"):  # whatever a damaged file has there, it is far off
            east = (ra_deg - values["ra"] + 180.0) % 360.0 - 180.0
            off = np.hypot(east * np.cos(np.radians(dec_deg)), dec_deg - values["dec"]) * 3600.0
            ra_deg = ra_deg % 360.0
        bad = np.flatnonzero(mine & ~(off < _SAME_PLACE_ARCSEC))
        if bad.size:
            raise malformed_at(
                file.path.name,
                first + int(bad[0]),
                "the same place in the tree and beside it",
                f"places {off[bad[0]]:.1f}″ apart",
                unit="star",
            )
        values["ra"], values["dec"] = ra_deg, dec_deg

    def _told(self, others: int) -> str:
        files = sorted(self._files)
        listed = files[0] if len(files) == 1 else f"{len(files)} files, {files[0]} to {files[-1]}"
        share = float(np.mean(self._owners != ""))
        sky = "the whole sky" if share == 1.0 else f"{share:.0%} of the sky"
        aside = f"; {others} files of other series left aside" if others else ""
        return f"astrometry.net index files, {listed}, for {sky}{aside}"


def open_catalog(path: Path) -> IndexReader:
    """Open index files.

    Parameters
    ----------
    path : Path
        An index file, or the folder that holds them.

    Raises
    ------
    BadCatalog
        There is no index file, or one is damaged.
    """
    if not path.is_dir():
        return IndexReader([IndexFile(path)])
    files = []
    for candidate in sorted(path.iterdir()):
        if candidate.is_file() and candidate.suffix.lower() in (".fits", ".fit"):
            try:
                files.append(IndexFile(candidate))
            except NotAnIndex:
                continue
    if not files:
        raise BadCatalog("holds no index file", device=str(path), advice="give the folder of index-*.fits")
    return IndexReader(files)


def _depth(file: IndexFile) -> tuple[float, bool]:
    return file.scale_arcmin, not file.columns


def _own_series(files: Sequence[IndexFile]) -> Series:
    """Series of somebody's own making: its columns must say what they are."""
    columns = set.intersection(*(set(file.columns) for file in files))
    if not {"ref_epoch", "phot_g_mean_mag"} <= columns:
        raise BadCatalog(
            f"index {files[0].index_id} is of no known series, and has no ref_epoch and phot_g_mean_mag",
            device=files[0].path.name,
            advice=f"known are {', '.join(f'{number}00 ({s.name})' for number, s in SERIES.items())}",
        )
    epochs = files[0].column("ref_epoch", 0, min(files[0].count, CHUNK))
    epochs = epochs[(epochs >= EARLIEST_YR) & (epochs <= LATEST_YR)]
    if epochs.size == 0:
        raise BadCatalog("has no ref_epoch that can be Gaia's", device=files[0].path.name)
    return Series(f"astrometry.net {files[0].index_id // 100}00 series", float(np.median(epochs)), "G")


def _without_empty(values: dict[str, Array], epoch_yr: float) -> None:
    """Make unknown what a table without nulls has as zeros: motions, and the epoch of stars not from Gaia."""
    if {"pmra", "pmdec"} <= set(values):
        still = (values["pmra"] == 0.0) & (values["pmdec"] == 0.0)
        for key in ("pmra", "pmdec"):
            values[key] = np.where(still, np.nan, values[key])
    if "ref_epoch" in values:
        known = (values["ref_epoch"] >= EARLIEST_YR) & (values["ref_epoch"] <= LATEST_YR)
        values["ref_epoch"] = np.where(known, values["ref_epoch"], epoch_yr)
    for key in ("bp", "rp"):
        if key in values:
            values[key] = np.where(values[key] == 0.0, np.nan, values[key])


def _sigma(inverse_variance: Array, mas: float) -> Array:
    """One-sigma errors; NaN where there is none, or an impossible one."""
    known = inverse_variance > 0.0
    sigma = mas / np.sqrt(np.where(known, inverse_variance, 1.0))
    return np.where(known & (sigma < _LARGEST_SIGMA_MAS), sigma, np.nan)


def _tycho_rows(
    ref_cat: NDArray[np.str_] | None, values: dict[str, Array], epoch_yr: float
) -> NDArray[np.bool_]:
    """Find the stars that come from Tycho-2, and make their epoch and motion what is known of them."""
    size = values["ra"].size
    if ref_cat is None:
        return np.zeros(size, dtype=np.bool_)
    rows: NDArray[np.bool_] = ref_cat == "T2"
    values["ref_epoch"] = np.where(rows, TYCHO_EPOCH_YR, values.get("ref_epoch", np.full(size, epoch_yr)))
    for key in ("pmra", "pmdec"):
        if key in values:
            values[key] = np.where(rows, np.nan, values[key])
    return rows
