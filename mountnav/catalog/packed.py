"""The packed store: a memory-mapped catalog that answers a cone in well under a millisecond."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed_format import (
    CLASS,
    DEC_STEP_DEG,
    FAST,
    LONGEST_HEADER_BYTES,
    MAG_STEP,
    MAG_ZERO,
    OFFSET,
    PREAMBLE_BYTES,
    RA_STEP_DEG,
    STAR,
    Header,
    decode_header,
    malformed,
    proper_motions,
)
from mountnav.catalog.pixel_centers import pixel_centers
from mountnav.catalog.space_motion import MAS_RAD, motion_vectors, motions_seen, places, unit_vectors
from mountnav.catalog.stars import Stars
from mountnav.errors import BadRequest, BadSettings
from mountnav.sky.coordinates import Icrs

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class PackedStore:
    """A packed catalog file, opened for cone queries. Implements `mountnav.catalog.stars.Catalog`.

    Nothing is changed after opening: one store may be shared by any number of threads.

    Parameters
    ----------
    path : Path
        A file written by `mountnav.catalog.packing.pack`.

    Raises
    ------
    BadSettings
        The file can't be opened, or is truncated or malformed; the message tells the offset and what was
        expected there.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.header, start, mapped = _mapped(path)
        layout = {section: (start + at, length) for section, (at, length) in self.header.layout().items()}
        self._sections_start = start

        def section(name: str, dtype: np.dtype[Any]) -> NDArray[Any]:
            at, length = layout[name]
            return np.frombuffer(mapped, dtype=dtype, count=length // dtype.itemsize, offset=at)

        self._offsets: Indices = section("offsets", OFFSET).astype(np.int64)
        classes = section("classes", CLASS).astype(np.float64).reshape(-1, 3)
        self._sigma_mas, self._mean_epoch_yr, self._sigma_pm_mas_yr = classes.T.copy()
        self._fast = section("fast", FAST)
        self._stars = section("stars", STAR)
        self._mag = self._stars["mag"]
        _require_sound(path, self.header, layout, self._offsets, classes, self._fast)
        self._centers = pixel_centers(self.header.nside)
        self._pixel_radius_rad = _largest_pixel_radius_rad(self.header.nside)

    @property
    def name(self) -> str:
        """Name for provenance."""
        return self.header.name

    def __len__(self) -> int:
        return self.header.count

    def __reduce__(self) -> tuple[type[PackedStore], tuple[Path]]:
        # a worker process maps the same file instead of receiving 38 MB
        return PackedStore, (self.path,)

    def __repr__(self) -> str:
        return f"PackedStore({self.header.name!r}, {self.header.count} stars, {self.path})"

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        """Stars within `radius_deg` of `center`, at `epoch_yr`, to `mag_limit`, brightest first.

        Parameters
        ----------
        center : Icrs
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
        """
        _require_sensible(center, radius_deg, epoch_yr, mag_limit)
        years = epoch_yr - self.header.epoch_yr
        axis = unit_vectors(center.ra_deg, center.dec_deg)
        rows = self._rows(axis, radius_deg, years, mag_limit)
        found = self._stars[rows]
        ra_deg, dec_deg = found["ra"] * RA_STEP_DEG, found["dec"] * DEC_STEP_DEG
        pm_ra, pm_dec, unknown = proper_motions(rows, found, self._fast)
        motion = motion_vectors(ra_deg, dec_deg, pm_ra, pm_dec)
        vectors = unit_vectors(ra_deg, dec_deg) + motion * years
        # the chord keeps its precision where the cosine of a small angle has none
        chord = vectors / np.sqrt((vectors**2).sum(axis=0)) - axis[:, np.newaxis]
        inside = np.flatnonzero((chord**2).sum(axis=0) <= (2.0 * np.sin(np.radians(radius_deg) / 2.0)) ** 2)
        inside = inside[np.argsort(found["mag"][inside], kind="stable")]
        ra_deg, dec_deg = places(vectors[:, inside])
        pm_ra, pm_dec = motions_seen(vectors[:, inside], motion[:, inside])
        pm_ra[unknown[inside]] = np.nan
        pm_dec[unknown[inside]] = np.nan
        return Stars(
            ra_deg=ra_deg,
            dec_deg=dec_deg,
            sigma_arcsec=self._sigma_arcsec(found["error"][inside], epoch_yr),
            mag=found["mag"][inside] * MAG_STEP + MAG_ZERO,
            pm_ra_cosdec_mas_yr=pm_ra,
            pm_dec_mas_yr=pm_dec,
            epoch_yr=epoch_yr,
            band=self.header.band,
            source=self.header.name,
        )

    def verify(self, sha256: str | None = None) -> None:
        """Read the whole file and compare its hashes.

        Parameters
        ----------
        sha256 : str, optional
            What the whole file's hash must be; without it only the header's own hash of the sections counts.

        Raises
        ------
        BadSettings
            A hash differs.
        """
        whole, sections = hashlib.sha256(), hashlib.sha256()
        with self.path.open("rb") as file:
            whole.update(file.read(self._sections_start))
            while block := file.read(1 << 20):
                whole.update(block)
                sections.update(block)
        if sections.hexdigest() != self.header.sections_sha256:
            expected, found = self.header.sections_sha256, sections.hexdigest()
            raise malformed(str(self.path), self._sections_start, f"sections of sha256 {expected}", found)
        if sha256 is not None and whole.hexdigest() != sha256:
            raise malformed(str(self.path), 0, f"a file of sha256 {sha256}", whole.hexdigest())

    def _rows(self, axis: Array, radius_deg: float, years: float, mag_limit: float | None) -> Indices:
        """Rows of all stars that may be in the cone: whole pixels, bright ends only if there is a limit."""
        # astropy_healpix.cone_search_lonlat misses pixels for small cones; a padded disc of centers doesn't
        moved_rad = self.header.fastest_mas_yr * MAS_RAD * abs(years)
        reach_rad = np.radians(radius_deg) + self._pixel_radius_rad + moved_rad
        if reach_rad >= np.pi:
            pixels = np.arange(self._centers.shape[1])
        else:
            pixels = np.flatnonzero(axis @ self._centers >= np.cos(reach_rad))
        first, end = self._offsets[pixels], self._offsets[pixels + 1]
        if mag_limit is not None:
            end = self._bright_ends(first, end, mag_limit)
        counts = end - first
        before = np.cumsum(counts) - counts
        rows: Indices = np.repeat(first - before, counts) + np.arange(int(counts.sum()))
        return rows

    def _bright_ends(self, first: Indices, end: Indices, mag_limit: float) -> Indices:
        """End of the stars to `mag_limit` in each pixel: one binary search in all pixels at once."""
        # + 1e-6: a limit of 11.5 must not lose the stars of magnitude 11.500 to rounding
        limit_raw = np.floor((mag_limit - MAG_ZERO) / MAG_STEP + 1e-6)
        low, high = first.copy(), end.copy()
        while (open_ := np.flatnonzero(low < high)).size:
            middle = (low[open_] + high[open_]) // 2
            bright = self._mag[middle] <= limit_raw
            low[open_[bright]] = middle[bright] + 1
            high[open_[~bright]] = middle[~bright]
        return low

    def _sigma_arcsec(self, error: NDArray[np.uint8], epoch_yr: float) -> Array:
        sigma_mas = np.hypot(self._sigma_mas, (epoch_yr - self._mean_epoch_yr) * self._sigma_pm_mas_yr)
        sigma_arcsec: Array = (sigma_mas / 1000.0)[error]
        return sigma_arcsec


def _mapped(path: Path) -> tuple[Header, int, NDArray[np.uint8]]:
    try:
        with path.open("rb") as file:
            header, start = decode_header(file.read(PREAMBLE_BYTES + LONGEST_HEADER_BYTES), file=str(path))
        size = path.stat().st_size
        expected = start + header.layout()["end"][0]
        if size != expected:
            raise malformed(str(path), min(size, expected), f"{expected} bytes in all", f"{size}")
        return header, start, np.memmap(path, dtype=np.uint8, mode="r")
    except OSError as refused:
        raise BadSettings(
            f"can't be opened: {refused.strerror}",
            device=str(path),
            advice="check the catalog's path and rights",
        ) from refused


def _require_sound(
    path: Path,
    header: Header,
    layout: dict[str, tuple[int, int]],
    offsets: Indices,
    classes: Array,
    fast: NDArray[np.void],
) -> None:
    """Check the small sections; the stars themselves are checked by `PackedStore.verify` on demand."""
    if offsets[0] != 0 or offsets[-1] != header.count or bool(np.any(np.diff(offsets) < 0)):
        raise malformed(
            str(path),
            layout["offsets"][0],
            f"an offset table rising from 0 to {header.count}",
            f"{offsets[0]} to {offsets[-1]}",
        )
    if not np.all(np.isfinite(classes)) or bool(np.any(classes < 0.0)):
        raise malformed(str(path), layout["classes"][0], "finite error classes, none negative", "others")
    if bool(np.any(np.diff(fast["star"].astype(np.int64)) <= 0)) or bool(
        np.any(fast["star"] >= header.count)
    ):
        raise malformed(str(path), layout["fast"][0], "rising star numbers below the count", "others")


def _require_sensible(center: Icrs, radius_deg: float, epoch_yr: float, mag_limit: float | None) -> None:
    values = [center.ra_deg, center.dec_deg, radius_deg, epoch_yr, 0.0 if mag_limit is None else mag_limit]
    if not np.all(np.isfinite(values)) or abs(center.dec_deg) > 90.0 or not 0.0 <= radius_deg <= 180.0:
        raise BadRequest(
            f"no cone of radius {radius_deg}° at RA {center.ra_deg}°, Dec {center.dec_deg}°, "
            f"epoch {epoch_yr}, magnitude limit {mag_limit}",
            advice="all values must be finite, Dec within -90..90 and the radius within 0..180",
        )


def _largest_pixel_radius_rad(nside: int) -> float:
    """Largest distance of a pixel's corner from its center [HEALPix, `max_pixrad`], with 1 % to spare."""
    center_z, corner_z = 2.0 / 3.0, 1.0 - (1.0 - 1.0 / nside) ** 2 / 3.0
    center = unit_vectors(45.0 / nside, float(np.degrees(np.arcsin(center_z))))
    corner = unit_vectors(0.0, float(np.degrees(np.arcsin(corner_z))))
    return 1.01 * float(2.0 * np.arcsin(np.linalg.norm(center - corner) / 2.0))
