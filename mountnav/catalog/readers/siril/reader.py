"""Siril's astrometric catalog as parts: runs of pixels of its files, their stars checked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from astropy import units
from astropy_healpix import healpix_to_lonlat, lonlat_to_healpix
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.error_classes import error_curve, unknown_motion_mas_yr
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.readers.siril.layout import (
    HEAD,
    RELEASE_EPOCHS_YR,
    RELEASES,
    STAR,
    STEP_DEG,
    Head,
    checked_counts,
    parse_head,
)
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.files import open_buffered

Array = NDArray[np.float64]

_LARGEST_RAW = 2**31 - 1
"""A right ascension of 360° in steps; larger ones don't fit the field."""
_POLE_RAW = int(90.0 / STEP_DEG)
"""A declination of 90° in steps."""
_FASTEST_MAS_YR = 12_000
"""Barnard's star moves 10,393."""
_BRIGHTEST_MMAG, _FAINTEST_MMAG = -2_000, 25_000
"""Magnitudes that are believed, in mmag: Gaia's sources have G 1.7 to about 22. Others are damaged
records."""
_RADIUS_RAD = 1.08
"""From a pixel's center to its farthest corner, times 2^level: measured on all pixels of levels 1 to 6."""
_SLACK_DEG = 120.0 / 3600.0
"""A source of Gaia's is numbered by the pixel where it was first seen: a fast star has left it since."""
_NO_MAGNITUDE_STANDS_FOR = 21.0
"""Stands in for a magnitude that isn't there, as in `readers.gaia.stars.FAINT_MAG`."""
_MAS_PER_DEG = 3.6e6
"""Milliarcseconds in a degree."""
_G = (13.0, 15.0, 17.0, 18.0, 20.0, 21.0)
"""G magnitudes of the two tables below."""
_SIGMA_MAS = (0.02, 0.03, 0.06, 0.12, 0.45, 1.1)
"""Position error per coordinate, mas; source below."""
_SIGMA_PM_MAS_YR = (0.02, 0.03, 0.07, 0.14, 0.5, 1.4)
"""Of Gaia DR3 itself, rounded up from Lindegren et al. 2021 (A&A 649, A2); the file has no errors."""
_CUT_OFF_MAS_YR = 1.0 / np.sqrt(3.0)
"""Root mean square of what is lost by cutting off a proper motion's decimals."""


def require_sound(stars: NDArray[np.void], pixel: NDArray[np.int64], level: int, file: str, at: int) -> None:
    """Refuse numbers out of range, and stars that lie in another pixel than the index says.

    Parameters
    ----------
    stars : ndarray of `STAR`, shape (n,)
        As the file has them.
    pixel : ndarray, shape (n,)
        By the index.
    level : int
        HEALPix level of the pixels.
    at : int
        Where in the file the first star begins.

    Raises
    ------
    BadCatalog
    """
    mag = stars["mag"].astype(np.int64)
    for field, expected, sound in (
        ("ra", f"a right ascension (0 to {_LARGEST_RAW})", stars["ra"] >= 0),
        (
            "dec",
            f"a declination (-{_POLE_RAW} to {_POLE_RAW})",
            np.abs(stars["dec"].astype(np.int64)) <= _POLE_RAW,
        ),
        *(
            (
                field,
                f"a proper motion of at most {_FASTEST_MAS_YR} mas/yr",
                np.abs(stars[field].astype(np.int64)) <= _FASTEST_MAS_YR,
            )
            for field in ("pm_ra", "pm_dec")
        ),
        (
            "mag",
            f"a magnitude ({_BRIGHTEST_MMAG} to {_FAINTEST_MMAG} mmag)",
            (mag >= _BRIGHTEST_MMAG) & (mag <= _FAINTEST_MMAG),
        ),
    ):
        bad = np.flatnonzero(~sound)
        if bad.size:
            assert STAR.fields is not None
            offset = at + int(bad[0]) * STAR.itemsize + int(STAR.fields[field][1])
            raise malformed_at(file, offset, expected, str(stars[field][bad[0]]))
    ra, dec = _places(stars)
    nside = 2**level
    found = lonlat_to_healpix(ra * units.deg, dec * units.deg, nside, order="nested")
    elsewhere = np.flatnonzero(found != pixel)
    if elsewhere.size == 0:
        return
    lon, lat = healpix_to_lonlat(pixel[elsewhere], nside, order="nested")
    far = _distance_deg(ra[elsewhere], dec[elsewhere], lon.deg, lat.deg) > _reach_deg(level)
    if np.any(far):
        row = int(elsewhere[int(np.flatnonzero(far)[0])])
        raise malformed_at(
            file,
            at + row * STAR.itemsize,
            f"a star of pixel {pixel[row]} (level {level}), as the index says",
            f"RA {ra[row]:.5f}, Dec {dec[row]:.5f}, in pixel {found[row]}",
        )


def pixels_dec_range_deg(first: int, end: int, level: int) -> tuple[float, float]:
    """Between which declinations the stars of pixels `first` to before `end` lie."""
    _, lat = healpix_to_lonlat(np.arange(first, end), 2**level, order="nested")
    return float(lat.deg.min()) - _reach_deg(level), float(lat.deg.max()) + _reach_deg(level)


def columns_of(stars: NDArray[np.void], epoch_yr: float) -> CatalogColumns:
    """Stars in units.

    Parameters
    ----------
    stars : ndarray of `STAR`, shape (n,)
        As the file has them.
    epoch_yr : float
        Gaia's reference epoch.

    Returns
    -------
    CatalogColumns
        A star with both proper motions 0 counts as one without: where Gaia has none, the file has 0 too.
    """
    ra, dec = _places(stars)
    pm_ra, pm_dec = stars["pm_ra"].astype(np.float64), stars["pm_dec"].astype(np.float64)
    still = (pm_ra == 0) & (pm_dec == 0)
    no_magnitude = stars["mag"] == 0
    mag = np.where(no_magnitude, _NO_MAGNITUDE_STANDS_FOR, stars["mag"] * 0.001)
    own, own_pm = np.interp(mag, _G, _SIGMA_MAS), np.interp(mag, _G, _SIGMA_PM_MAS_YR)
    sigma_pm = np.where(still, unknown_motion_mas_yr(mag), np.hypot(own_pm, _CUT_OFF_MAS_YR))
    sigma = (
        np.hypot(own, _rounding_mas(ra) * np.cos(np.radians(dec))),
        np.hypot(own, _rounding_mas(dec)),
    )
    epoch = np.full(mag.size, epoch_yr)
    flags = np.where(still, StarFlag.NO_PROPER_MOTION, 0) | np.where(no_magnitude, StarFlag.NO_MAGNITUDE, 0)
    return CatalogColumns(
        ra_deg=ra,
        dec_deg=dec,
        pm_ra_cosdec_mas_yr=np.where(still, np.nan, pm_ra),
        pm_dec_mas_yr=np.where(still, np.nan, pm_dec),
        mag=mag,
        error_curve=error_curve(sigma, (sigma_pm, sigma_pm), (epoch, epoch)),
        flags=flags.astype(np.uint8),
    )


def _reach_deg(level: int) -> float:
    """How far a star may be from the center of its pixel."""
    return float(np.degrees(_RADIUS_RAD / 2**level)) + _SLACK_DEG


def _places(stars: NDArray[np.void]) -> tuple[Array, Array]:
    return stars["ra"].astype(np.float64) * STEP_DEG, stars["dec"].astype(np.float64) * STEP_DEG


def _rounding_mas(coordinate_deg: Array) -> Array:
    """One sigma of having been a 32-bit float: steps of 110 mas beyond 256 degrees, 55 beyond 128, ..."""
    step_deg = np.abs(np.spacing(coordinate_deg.astype(np.float32))).astype(np.float64) + STEP_DEG
    return np.asarray(step_deg * _MAS_PER_DEG / np.sqrt(12.0), dtype=np.float64)


def _distance_deg(ra_a: Array, dec_a: Array, ra_b: Array, dec_b: Array) -> Array:
    ra_a, dec_a, ra_b, dec_b = (np.radians(each) for each in (ra_a, dec_a, ra_b, dec_b))
    haversine = np.sin(0.5 * (dec_a - dec_b)) ** 2
    haversine += np.cos(dec_a) * np.cos(dec_b) * np.sin(0.5 * (ra_a - ra_b)) ** 2
    return np.asarray(np.degrees(2.0 * np.arcsin(np.sqrt(np.minimum(haversine, 1.0)))), dtype=np.float64)


_LARGEST_PART = 500_000
"""Stars in a part and in a chunk at most: what `Reader.read` promises."""
_BZIP2_SUFFIX = ".bz2"


@dataclass(frozen=True, slots=True)
class _Run:
    """Neighboring pixels of one file: their numbers within the file, from `first` to before `end`."""

    first: int
    end: int


class SirilReader:
    """Reader of one catalog.

    The brightest 127 stars or fewer of each pixel of level 8 (0.05 square degrees), to G 20, with proper
    motions. The places went through 32-bit floats on their way into the file, which makes 32 mas of RA beyond
    256 degrees, 16 mas beyond 128, less elsewhere; sigma tells. Both proper motions 0 may mean "unknown": the
    star counts as one without.

    Parameters
    ----------
    files : dict
        The file, or all chunks, with their heads.
    """

    def __init__(self, files: dict[Path, Head]) -> None:
        self._files = dict(sorted(files.items(), key=lambda item: item[1].first_pixel))
        self._counts = {path: _counts(path, head) for path, head in self._files.items()}
        head = next(iter(self._files.values()))
        release = RELEASES[head.release]
        self.name = f"Siril Gaia {release}"
        self.band = "G"
        self.color_name = ""
        self.epoch_yr = RELEASE_EPOCHS_YR[head.release]
        stars = sum(int(counts[-1]) for counts in self._counts.values())
        self.made_from = f"{head.title} (Gaia {release}), {stars} stars"
        if head.chunk is not None:
            chunks = 12 * 4 ** head.chunk[0]
            self.made_from += f" in {len(self._files)} of {chunks} chunks of the sky"
        self._runs = dict(self._parts())

    def parts(self) -> Sequence[Part]:
        """Runs of pixels with at most some 500,000 stars, in the order of the files' pixels."""
        return [
            Part(name, path, int(self._counts[path][run.end] - self._counts[path][run.first]) * STAR.itemsize)
            for name, (path, run) in self._runs.items()
        ]

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Lowest and highest declination of the part's stars."""
        path, run = self._runs[part.name]
        head = self._files[path]
        return pixels_dec_range_deg(head.first_pixel + run.first, head.first_pixel + run.end, head.level)

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a run of pixels.

        Raises
        ------
        BadCatalog
            A star doesn't lie in its pixel, or a number is out of its range.
        """
        path, run = self._runs[part.name]
        head, counts = self._files[path], self._counts[path]
        first, count = int(counts[run.first]), int(counts[run.end] - counts[run.first])
        offset = head.stars_at + first * STAR.itemsize
        with open_buffered(path) as file:
            file.seek(offset)
            content = file.read(count * STAR.itemsize)
        if len(content) != count * STAR.itemsize:
            raise BadCatalog(
                "it changed while it was read", device=path.name, advice="start the import again"
            )
        stars = np.frombuffer(content, dtype=STAR)
        pixel = np.repeat(
            np.arange(run.first, run.end) + head.first_pixel, np.diff(counts[run.first : run.end + 1])
        )
        for start in range(0, count, _LARGEST_PART):
            chosen = slice(start, start + _LARGEST_PART)
            at = offset + start * STAR.itemsize
            require_sound(stars[chosen], pixel[chosen], head.level, path.name, at)
            yield columns_of(stars[chosen], self.epoch_yr)

    def _parts(self) -> Iterator[tuple[str, tuple[Path, _Run]]]:
        for path, counts in self._counts.items():
            for run in _runs(counts):
                yield f"{path.name}/{run.first}", (path, run)


def open_catalog(path: Path) -> SirilReader:
    """Open a catalog of Siril's.

    Parameters
    ----------
    path : Path
        siril_cat_healpix8_astro.dat, or the folder that holds it or chunks of such a catalog.

    Raises
    ------
    BadCatalog
        No such file, a packed one, one of spectra, or chunks that don't belong together.
    """
    if not path.is_dir():
        return SirilReader({path: _head(path)})
    heads: dict[Path, Head] = {}
    refused: list[BadCatalog] = []
    for each in sorted(path.glob("*.dat")):
        try:
            heads[each] = _head(each)
        except BadCatalog as error:
            refused.append(error)
    if not heads:
        packed = sorted(each for each in path.glob("*.dat*") if each.suffix == _BZIP2_SUFFIX)
        if packed:
            raise BadCatalog(
                f"{packed[0].name} is still packed",
                device=str(path),
                advice=f"unpack it first: bunzip2 --keep {packed[0].name}",
            )
        if refused:
            raise refused[0]
        raise BadCatalog(
            "no file of Siril's Gaia catalog, such as siril_cat_healpix8_astro.dat",
            device=str(path),
            advice="name the file, or the folder it is in (Siril's preferences tell it)",
        )
    _require_one_catalog(heads)
    return SirilReader(heads)


def _require_one_catalog(heads: dict[Path, Head]) -> None:
    by_kind: dict[object, Path] = {}
    seen: dict[int, Path] = {}
    for path, head in heads.items():
        kind = (head.release, head.level, head.chunk[0] if head.chunk else None)
        by_kind.setdefault(kind, path)
        if head.first_pixel in seen or len(by_kind) > 1:
            other = seen.get(head.first_pixel, next(iter(by_kind.values())))
            raise BadCatalog(
                f"{other.name} and {path.name} don't belong to one catalog",
                device=str(path.parent),
                advice="name the file that is to be imported, or leave only its chunks in the folder",
            )
        seen[head.first_pixel] = path


def _head(path: Path) -> Head:
    with open_buffered(path) as file:
        return parse_head(file.read(HEAD.itemsize), path.name)


def _counts(path: Path, head: Head) -> NDArray[np.int64]:
    return checked_counts(np.memmap(path, dtype=np.uint8, mode="r"), head, path.name)


def _runs(counts: NDArray[np.int64]) -> Iterator[_Run]:
    """Runs of whole pixels with at most `_LARGEST_PART` stars; a pixel with more is a run of its own."""
    pixels = counts.size - 1
    first = 0
    while first < pixels:
        end = int(np.searchsorted(counts, counts[first] + _LARGEST_PART, side="right")) - 1
        end = min(max(end, first + 1), pixels)
        if counts[end] > counts[first]:
            yield _Run(first, end)
        first = end
