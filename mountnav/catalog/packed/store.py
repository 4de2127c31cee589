"""The packed store: a memory-mapped catalog of any size that answers a cone in a millisecond or two.

Stars that move far: a few thousand are looked at in each query, so that the rest needs little padding.

Barnard's star moves 4.6′ in 27 years. A query of 0.3° that had to be padded by that would read 40 % more
stars on 113 million (CPU: 5 %), one of a deeper catalog more still. And any single error in a source, a
motion of 1000 arcsec/yr, would make every query a wide one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.companion_colors import CompanionColors
from mountnav.catalog.packed.file import PackedFile
from mountnav.catalog.packed.format import (
    COLOR_STEP,
    COLOR_UNKNOWN,
    DEC_STEP_DEG,
    MAG_STEP,
    MAG_ZERO,
    NO_STAR,
    PM_STEP_MAS_YR,
    RA_STEP_DEG,
    Header,
    proper_motions,
)
from mountnav.catalog.packed.pixels import Coverage, PixelChoice, Runs
from mountnav.catalog.space_motion import motion_vectors, motions_seen, places, unit_vectors
from mountnav.catalog.stars import Flags, StarFlag, Stars
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs
from mountnav.units import RAD_PER_MAS

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FAST_LIMITS_MAS_YR = (500.0, 1000.0, 2000.0, 3276.6)
"""What "fast" may mean; the last is what a record can hold."""
MOST_FAST = 10_000
"""Looking at so many takes 0.04 ms. The sky has about 5000 stars above 0.5 arcsec/yr; a catalog made from old
plates claims more."""


def fast_limit(counts: Sequence[int]) -> tuple[float, int]:
    """Choose what fast means for a catalog.

    Parameters
    ----------
    counts : sequence of int
        How many of its stars are faster than each of `FAST_LIMITS_MAS_YR`.

    Returns
    -------
    (float, int)
        The lowest limit [mas/yr] that leaves no more than `MOST_FAST` stars, else the highest; their number.
    """
    for limit, count in zip(FAST_LIMITS_MAS_YR, counts, strict=True):
        if count <= MOST_FAST:
            return limit, count
    return FAST_LIMITS_MAS_YR[-1], counts[-1]


@dataclass(frozen=True, slots=True)
class FastStars:
    """Place and motion of the fast stars of a packed file.

    Attributes
    ----------
    rows
        Their numbers in the section ``stars``, rising; shape (n,).
    places
        Unit vectors at the file's epoch, shape (3, n).
    motions
        rad/yr, shape (3, n).
    """

    rows: Indices
    places: Array
    motions: Array

    @classmethod
    def of(cls, fast: NDArray[np.void]) -> FastStars:
        """From the section ``fast`` of version 2."""
        ra_deg, dec_deg = fast["ra"] * RA_STEP_DEG, fast["dec"] * DEC_STEP_DEG
        pm_ra, pm_dec = fast["pm_ra"] * PM_STEP_MAS_YR, fast["pm_dec"] * PM_STEP_MAS_YR
        return cls(
            fast["star"].astype(np.int64),
            unit_vectors(ra_deg, dec_deg),
            motion_vectors(ra_deg, dec_deg, pm_ra, pm_dec),
        )

    def near(self, axis: Array, radius_rad: float, years: float) -> Indices:
        """Rows of those that may be in a cone after some years.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit vector of the center.
        """
        fastest_rad = float(np.sqrt((self.motions**2).sum(axis=0).max(initial=0.0))) * abs(years)
        if radius_rad + fastest_rad < np.pi / 2:
            some = np.flatnonzero(axis @ self.places >= np.cos(radius_rad + fastest_rad + 1e-6))
        else:
            some = np.arange(self.rows.size)
        moved = self.places[:, some] + self.motions[:, some] * years
        chord = moved / np.sqrt((moved**2).sum(axis=0)) - axis[:, np.newaxis]
        # a little more than the cone: the last word is spoken where all stars are judged
        reach = 2.0 * np.sin(min(radius_rad + 1e-6, np.pi) / 2.0)
        rows: Indices = self.rows[some[(chord**2).sum(axis=0) <= reach**2 * (1.0 + 1e-12)]]
        return rows


LARGEST_PIECE = 2_000_000
"""Of so few stars all places are looked at to see how far they reach, when that is asked."""
WIDE_DEG = 4.0
"""From this radius on the system is let read ahead."""


class PackedStore:
    """A packed catalog file, opened for cone queries. Implements `mountnav.catalog.stars.Catalog`.

    Nothing is changed after opening: one store may be shared by any number of threads. The file is mapped,
    not read: what stays in memory doesn't grow with the catalog.

    Parameters
    ----------
    path : Path
        A file written by `mountnav.catalog.packed.packing.pack` or by way of
        `mountnav.catalog.packed.spool.Spool`. Colors that lie beside it (`companion_colors`) are found.
    label : str, optional
        What to call it, if the name that the file gives itself isn't the only one of its kind.

    Raises
    ------
    BadSettings
        The file can't be opened, or (`BadCatalog`) is truncated or malformed, or the colors beside it are
        another file's; the message tells the offset and what was expected there.
    """

    def __init__(self, path: Path, label: str | None = None) -> None:
        self.path = path
        self._label = label
        self._file, self._wide_file = PackedFile.open(path)
        self.header: Header = self._file.header
        self._sigma_mas, self._mean_epoch_yr, self._sigma_pm_mas_yr = self._file.classes.T.copy()
        self._pixels = PixelChoice(self.header.nside)
        self._beside = None if self._file.color is not None else CompanionColors.beside(path, self.header)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return self.header.name if self._label is None else self._label

    @property
    def color_name(self) -> str:
        """Which color index the stars have, "B-V" or "BP-RP"; empty if they have none."""
        return self.header.color_name if self._beside is None else self._beside.color_name

    def __len__(self) -> int:
        return self.header.count

    def __reduce__(self) -> tuple[type[PackedStore], tuple[Path, str | None]]:
        # a worker process maps the same file instead of receiving 38 MB
        return PackedStore, (self.path, self._label)

    def __repr__(self) -> str:
        return f"PackedStore({self.header.name!r}, {self.header.count} stars, {self.path})"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first.

        Parameters
        ----------
        radius_deg : float
            0 to 180.
        epoch_yr : float
            Julian year; the stars are moved to it by their proper motions before the cone is cut out.
        mag_limit : float, optional
            Faintest magnitude that is wanted, inclusive.

        Returns
        -------
        Stars
            Possibly none.

        Raises
        ------
        BadRequest
            A value is not finite or out of range.
        BadCatalog
            The file is damaged at a place that opening it doesn't look at.
        """
        _require_sensible(center, radius_deg, epoch_yr, mag_limit)
        years = epoch_yr - self.header.epoch_yr
        axis = unit_vectors(center.ra_deg, center.dec_deg)
        file = self._file if radius_deg < WIDE_DEG else self._wide_file
        rows = self._rows(file, axis, np.radians(radius_deg), years, mag_limit)
        found = file.stars[rows]
        ra_deg, dec_deg = found["ra"] * RA_STEP_DEG, found["dec"] * DEC_STEP_DEG
        pm_ra, pm_dec, unknown = proper_motions(rows, found, file.fast)
        motion = motion_vectors(ra_deg, dec_deg, pm_ra, pm_dec)
        vectors = unit_vectors(ra_deg, dec_deg) + motion * years
        # the chord keeps its precision where the cosine of a small angle has none
        chord = vectors / np.sqrt((vectors**2).sum(axis=0)) - axis[:, np.newaxis]
        inside = np.flatnonzero((chord**2).sum(axis=0) <= (2.0 * np.sin(np.radians(radius_deg) / 2.0)) ** 2)
        inside = inside[np.argsort(found["mag"][inside], kind="stable")]
        ra_deg, dec_deg = places(vectors[:, inside])
        pm_ra, pm_dec = motions_seen(vectors[:, inside], motion[:, inside])
        unknown = unknown[inside]
        pm_ra[unknown] = np.nan
        pm_dec[unknown] = np.nan
        return Stars(
            ra_deg=ra_deg,
            dec_deg=dec_deg,
            sigma_arcsec=self._sigma_arcsec(found["error"][inside], epoch_yr),
            mag=found["mag"][inside] * MAG_STEP + MAG_ZERO,
            pm_ra_cosdec_mas_yr=pm_ra,
            pm_dec_mas_yr=pm_dec,
            epoch_yr=epoch_yr,
            band=self.header.band,
            source=self.name,
            color_mag=self._colors(file, rows[inside]),
            flags=_flags(file, rows[inside], unknown),
            color_name=self.color_name,
        )

    def most_in(self, center: Icrs, radius_deg: float) -> int:
        """How many stars a cone holds at most: those of all pixels that it touches. No star is read for it.

        Parameters
        ----------
        center : Icrs
        radius_deg : float
            0 to 180.

        Raises
        ------
        BadRequest
            A value is not finite or out of range.
        """
        _require_sensible(center, radius_deg, self.header.epoch_yr, None)
        axis = unit_vectors(center.ra_deg, center.dec_deg)
        stars = self._file.stars_of(self._pixels.near(axis, np.radians(radius_deg)))
        return int((stars.end - stars.first).sum())

    def sky_share(self) -> float:
        """Share of the sky that the file covers, 0 to 1: of pixels that are large enough to hold stars."""
        return self._coverage.share()

    def covers(self, center: Icrs, radius_deg: float) -> bool:
        """Whether the file holds stars all over a cone.

        A catalog that was cut out of a larger one has a border. Near it, within two to three pixels of the
        grid that `sky_share` counts, the answer is no; of up to two million stars in one piece the border is
        known better.

        Parameters
        ----------
        radius_deg : float
            0 to 180.

        Raises
        ------
        BadRequest
            A value is not finite or out of range.
        """
        _require_sensible(center, radius_deg, self.header.epoch_yr, None)
        return self._coverage.holds(unit_vectors(center.ra_deg, center.dec_deg), np.radians(radius_deg))

    @cached_property
    def magnitudes(self) -> tuple[float, float, float]:
        """Brightest, faintest and commonest magnitude; a file of version 1 is read for it.

        The commonest is where the number of stars per 0.1 mag is largest: beyond, the catalog thins out.
        """
        header = self.header
        if header.brightest_mag is None or header.faintest_mag is None or header.commonest_mag is None:
            mag = self._wide_file.stars["mag"]
            bins = np.bincount(mag // 100)
            raw = np.array([mag.min(), mag.max(), 100 * bins.argmax() + 50])
            brightest, faintest, commonest = (raw * MAG_STEP + MAG_ZERO).round(3).tolist()
            return brightest, faintest, commonest
        return header.brightest_mag, header.faintest_mag, header.commonest_mag

    def verify(self, sha256: str | None = None, progress: Callable[[float], None] | None = None) -> None:
        """Read the whole file and compare its hashes.

        Parameters
        ----------
        sha256 : str, optional
            What the whole file's hash must be; without it only the hashes in its header count.
        progress : callable, optional
            Told the share that is read, 0 to 1, every MB.

        Raises
        ------
        BadCatalog
            A hash differs; tells the offset, and in version 2 the section.
        BadSettings
            The file can't be read.
        """
        self._file.verify(sha256, progress or (lambda share: None))
        if self._beside is not None:
            self._beside.verify()

    @cached_property
    def _coverage(self) -> Coverage:
        found = Coverage.of(self._file.offsets, self.header.nside, self._file.coarse)
        if self.header.count > LARGEST_PIECE or found.occupied.size == 12 * found.nside**2:
            return found
        stars = self._file.stars
        return found.within(unit_vectors(stars["ra"] * RA_STEP_DEG, stars["dec"] * DEC_STEP_DEG))

    @cached_property
    def _fast(self) -> FastStars:
        return FastStars.of(self._file.fast)

    def _rows(
        self, file: PackedFile, axis: Array, radius_rad: float, years: float, mag_limit: float | None
    ) -> Indices:
        """Rows of all stars that may be in the cone: whole pixels, bright ends only if there is a limit."""
        pixels = self._pixels.near(axis, radius_rad + self.header.slow_mas_yr * RAD_PER_MAS * abs(years))
        if mag_limit is None:
            rows = file.stars_of(pixels).all()
        else:
            # + 1e-6: a limit of 11.5 must not lose the stars of magnitude 11.500 to rounding
            limit_raw = int(np.clip(np.floor((mag_limit - MAG_ZERO) / MAG_STEP + 1e-6), -1, NO_STAR - 1))
            stars = file.stars_of(_with_bright_stars(file, pixels, limit_raw))
            rows = Runs(stars.first, _bright_ends(file, stars, limit_raw)).all()
        if self.header.version == 1 or not self.header.fast_count:
            return rows
        fast = self._fast.near(axis, radius_rad, years)
        if mag_limit is not None:
            fast = fast[file.stars["mag"][fast] <= limit_raw]
        return np.union1d(rows, fast) if fast.size else rows

    def _sigma_arcsec(self, error: NDArray[np.uint8], epoch_yr: float) -> Array:
        if error.size and int(error.max()) >= self._sigma_mas.size:
            raise self._file.malformed_section(
                "stars", f"error classes below {self._sigma_mas.size}", f"{int(error.max())}"
            )
        sigma_mas = np.hypot(self._sigma_mas, (epoch_yr - self._mean_epoch_yr) * self._sigma_pm_mas_yr)
        sigma_arcsec: Array = (sigma_mas / 1000.0)[error]
        return sigma_arcsec

    def _colors(self, file: PackedFile, rows: Indices) -> Array:
        if file.color is not None:
            raw = file.color[rows]
            return np.where(raw == COLOR_UNKNOWN, np.nan, raw * COLOR_STEP)
        return np.full(rows.size, np.nan) if self._beside is None else self._beside.colors(rows)


def _with_bright_stars(file: PackedFile, pixels: Runs, limit_raw: int) -> Runs:
    """Single pixels that hold a star to the limit."""
    tops = file.tops
    if pixels.first.size == 1 and tops is not None:  # the whole sky: no list of all its pixels
        begin, end = int(pixels.first[0]), int(pixels.end[0])
        numbers = begin + np.flatnonzero(tops[begin:end] <= limit_raw)
    else:
        numbers = pixels.all()
        if tops is not None:
            numbers = numbers[tops[numbers] <= limit_raw]
    return Runs(numbers, numbers + 1)


def _bright_ends(file: PackedFile, stars: Runs, limit_raw: int) -> Indices:
    """End of the stars to the limit in each pixel: one binary search in all pixels at once."""
    mag = file.stars["mag"]
    low, high = stars.first.copy(), stars.end.copy()
    while (open_ := np.flatnonzero(low < high)).size:
        middle = (low[open_] + high[open_]) // 2
        bright = mag[middle] <= limit_raw
        low[open_[bright]] = middle[bright] + 1
        high[open_[~bright]] = middle[~bright]
    return low


def _flags(file: PackedFile, rows: Indices, without_motion: NDArray[np.bool_]) -> Flags:
    flags = np.where(without_motion, StarFlag.NO_PROPER_MOTION, 0).astype(np.uint8)
    return flags if file.flags is None else flags | file.flags[rows]


def _require_sensible(center: Icrs, radius_deg: float, epoch_yr: float, mag_limit: float | None) -> None:
    values = [center.ra_deg, center.dec_deg, radius_deg, epoch_yr, 0.0 if mag_limit is None else mag_limit]
    if not np.all(np.isfinite(values)) or abs(center.dec_deg) > 90.0 or not 0.0 <= radius_deg <= 180.0:
        raise BadRequest(
            f"no cone of radius {radius_deg}° at RA {center.ra_deg}°, Dec {center.dec_deg}°, "
            f"epoch {epoch_yr}, magnitude limit {mag_limit}",
            advice="all values must be finite, Dec within -90..90 and the radius within 0..180",
        )
