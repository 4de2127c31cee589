"""Packing in memory: columns of some million stars in, one file out, the same bytes each time.

What doesn't fit into memory goes through `mountnav.catalog.packed.spool`.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.error_classes import classify
from mountnav.catalog.packed.format import (
    CLASS,
    COARSE_NSIDE,
    COLOR,
    COLOR_STEP,
    COLOR_UNKNOWN,
    DEC_STEP_DEG,
    FAST_2,
    FLAG,
    HEADER_BYTES,
    LARGEST_PM_RAW,
    MAG_STEP,
    MAG_ZERO,
    NO_STAR,
    OFFSET,
    PM_IN_SIDECAR,
    PM_STEP_MAS_YR,
    PM_UNKNOWN,
    RA_STEP_DEG,
    STAR,
    TOP,
    Header,
    encode_header,
    named_by_content,
)
from mountnav.catalog.packed.store import FAST_LIMITS_MAS_YR, fast_limit
from mountnav.errors import BadSettings

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Raw = NDArray[np.void]

KEY_NSIDE = 2**14
"""Resolution of `RAW` keys: 12 × 4**14 pixels are the most that 32 bits can number."""
RAW_PM_UNKNOWN = -(2**31)
"""Raw value in both proper motions of a star that has none: the least of 32 bits."""
FASTEST_RAW = 10_000_000
"""1000 arcsec/yr, a hundred times Barnard's star: more than that is an error in the file."""

LARGEST_CURVE = 1e30
"""Of an error curve's coefficients: what is larger gives no finite variance in 32-bit floats a century on."""

RAW = np.dtype(
    [
        ("key", "<u4"),
        ("ra", "<u4"),
        ("dec", "<i4"),
        ("pm_ra", "<i4"),
        ("pm_dec", "<i4"),
        ("mag", "<u2"),
        ("color", "<i2"),
        ("flags", "u1"),
        ("curve", "<f4", 3),
    ]
)
"""One star, 37 bytes; ``key`` is its NESTED pixel of `KEY_NSIDE`, ``curve`` its error curve."""


class NotWritable(ValueError):
    """The packed form can't hold a value."""


def require_writable(columns: CatalogColumns) -> None:
    """Refuse what the packed form can't hold.

    Raises
    ------
    NotWritable
        A value is not finite or out of range; tells which.
    """
    if not (np.all((columns.ra_deg >= 0) & (columns.ra_deg <= 360)) and np.all(abs(columns.dec_deg) <= 90)):
        raise NotWritable("RA must be within 0..360 and declination within -90..90 degrees")
    if not np.all((columns.mag >= MAG_ZERO) & (columns.mag <= MAG_ZERO + MAG_STEP * 65534)):
        raise NotWritable(f"magnitudes must be within {MAG_ZERO}..{MAG_ZERO + MAG_STEP * 65534:.3f}")
    # written so that NaN is refused too
    held = np.all(np.abs(columns.error_curve) < LARGEST_CURVE)
    if not held or not np.all(columns.error_curve[:, 0] > 0):
        raise NotWritable("error curves must be positive, and small enough for 32-bit floats")
    if not np.array_equal(np.isnan(columns.pm_ra_cosdec_mas_yr), np.isnan(columns.pm_dec_mas_yr)):
        raise NotWritable("a proper motion must be known in both coordinates or in neither")
    for motion in (columns.pm_ra_cosdec_mas_yr, columns.pm_dec_mas_yr):
        if bool(np.any(np.abs(motion) > FASTEST_RAW * PM_STEP_MAS_YR)):
            raise NotWritable(f"proper motions must be within ±{FASTEST_RAW * PM_STEP_MAS_YR:.0f} mas/yr")
    if columns.color_mag is not None and bool(np.any(np.abs(columns.color_mag) > 32.767)):
        raise NotWritable("color indices must be within ±32.767, or NaN")


def raw_stars(columns: CatalogColumns) -> Raw:
    """Round to the steps of the packed form.

    Returns
    -------
    ndarray of RAW, shape (n,)
        In the same order.

    Raises
    ------
    NotWritable
        From `require_writable`.
    """
    from astropy import units
    from astropy_healpix import lonlat_to_healpix

    require_writable(columns)
    raw = np.zeros(columns.ra_deg.size, dtype=RAW)
    raw["key"] = lonlat_to_healpix(
        columns.ra_deg * units.deg, columns.dec_deg * units.deg, nside=KEY_NSIDE, order="nested"
    )
    raw["ra"], raw["dec"], raw["mag"] = raw_places(columns.ra_deg, columns.dec_deg, columns.mag)
    for field, motion in (("pm_ra", columns.pm_ra_cosdec_mas_yr), ("pm_dec", columns.pm_dec_mas_yr)):
        known = ~np.isnan(motion)
        steps = np.rint(np.where(known, motion, 0.0) / PM_STEP_MAS_YR)
        raw[field] = np.where(known, steps, RAW_PM_UNKNOWN)
    raw["color"] = COLOR_UNKNOWN
    if columns.color_mag is not None:
        known = ~np.isnan(columns.color_mag)
        raw["color"][known] = np.rint(columns.color_mag[known] / COLOR_STEP)
    if columns.flags is not None:
        raw["flags"] = columns.flags
    raw["curve"] = columns.error_curve
    return raw


def raw_places(
    ra_deg: Array, dec_deg: Array, mag: Array
) -> tuple[NDArray[np.uint32], NDArray[np.int32], NDArray[np.uint16]]:
    """Right ascension, declination and magnitude in steps.

    Parameters
    ----------
    ra_deg, dec_deg, mag : ndarray, shape (n,)
        Within the ranges that `require_writable` asks for.
    """
    ra = (np.rint(ra_deg / RA_STEP_DEG).astype(np.int64) % 2**32).astype(np.uint32)
    dec = np.rint(dec_deg / DEC_STEP_DEG).astype(np.int32)
    return ra, dec, np.rint((mag - MAG_ZERO) / MAG_STEP).astype(np.uint16)


def pixels_of(raw: Raw, nside: int) -> Indices:
    """NESTED pixel of each star; `nside` a power of two up to `KEY_NSIDE`."""
    return raw["key"].astype(np.int64) >> key_shift(nside)


def key_shift(nside: int) -> int:
    """By how many bits a key is finer than a pixel of `nside`."""
    return 2 * (KEY_NSIDE.bit_length() - nside.bit_length())


def sorted_order(raw: Raw, nside: int) -> Indices:
    """Order of the packed form: pixel, magnitude, then all that a star has, so that it is the same each time.

    Parameters
    ----------
    raw : ndarray of RAW, shape (n,)
        Stars in any order.
    nside : int
        Of the pixels.

    Returns
    -------
    ndarray of int, shape (n,)
        Indices into `raw`.
    """
    first = (pixels_of(raw, nside) << 16) | raw["mag"]
    order: Indices = np.argsort(first)
    same = first[order[1:]] == first[order[:-1]]
    tied = np.flatnonzero(np.concatenate((same, [False])) | np.concatenate(([False], same)))
    if tied.size:
        members = order[tied]
        found = raw[members]
        curve = found["curve"]
        rest = [curve[:, 2], curve[:, 1], curve[:, 0]]
        rest += [found[field] for field in ("flags", "color", "pm_dec", "pm_ra", "dec", "ra")]
        order[tied] = members[np.lexsort((*rest, first[members]))]
    return order


def speeds_mas_yr(raw: Raw) -> Array:
    """Proper motion in the direction it goes; 0 where unknown. Shape (n,)."""
    known = raw["pm_ra"] != RAW_PM_UNKNOWN
    speed: Array = np.where(
        known, np.hypot(raw["pm_ra"].astype(np.float64), raw["pm_dec"].astype(np.float64)), 0.0
    )
    return speed * PM_STEP_MAS_YR


MAG_BIN_RAW = 100
"""Of `Header.commonest_mag`: 0.1 mag."""


@dataclass(frozen=True, slots=True)
class PackedFacts:
    """What a packed file shall say about itself.

    Attributes
    ----------
    name, band
        Catalog and magnitude band.
    epoch_yr
        Julian year of the positions.
    color_name
        "B-V", "BP-RP"; empty: colors aren't kept.
    made_from
        One line for people: what was packed, and where it came from.
    """

    name: str
    band: str
    epoch_yr: float
    color_name: str = ""
    made_from: str = ""


@dataclass(frozen=True, slots=True)
class PackedShape:
    """How large a file will be; known before its first star is written.

    Attributes
    ----------
    nside, count, class_count, fast_count
        See `Header`.
    slow_mas_yr
        Stars faster than this go into the section ``fast``.
    has_flags
        Whether flags are kept.
    """

    nside: int
    count: int
    class_count: int
    fast_count: int
    slow_mas_yr: float
    has_flags: bool


class PackedWriter:
    """Writes beside the final name and takes it when all is there. A context: what isn't finished is removed.

    Parameters
    ----------
    path : Path
        The file to write; replaced only when the new one is complete and safely on the disk.

    Raises
    ------
    BadSettings
        The folder can't be written, or there is no room for the file.
    ValueError
        The facts' texts are too long.
    """

    def __init__(self, path: Path, facts: PackedFacts, shape: PackedShape) -> None:
        self._path, self._part = path, path.with_name(path.name + ".part")
        self._header = Header(
            facts.name,
            facts.band,
            float(facts.epoch_yr),
            shape.nside,
            shape.count,
            shape.class_count,
            shape.fast_count,
            0.0,
            "",
            version=2,
            slow_mas_yr=shape.slow_mas_yr,
            color_name=facts.color_name,
            made_from=facts.made_from,
            has_flags=shape.has_flags,
        )
        encode_header(replace(self._header, section_sha256=dict.fromkeys(self._header.layout(), "0" * 64)))
        self._layout = self._header.layout()
        self._digests = {name: hashlib.sha256() for name in self._layout if name != "end"}
        self._written = dict.fromkeys(self._digests, 0)
        self._coarse = np.zeros(12 * COARSE_NSIDE**2 + 1, dtype=OFFSET)
        self._mags = np.zeros(65536 // MAG_BIN_RAW + 1, dtype=np.int64)
        self._brightest, self._faintest, self._fastest_mas_yr = 65535, 0, 0.0
        self._pixels_done = self._stars_done = 0
        self._file = self._opened()

    def __enter__(self) -> PackedWriter:
        return self

    def __exit__(self, *trouble: object) -> None:
        self._file.close()
        with suppress(OSError):
            self._part.unlink(missing_ok=True)

    def write(self, raw: Raw, code: NDArray[np.uint8], end_pixel: int) -> None:
        """Add the stars of the next pixels.

        Parameters
        ----------
        raw : ndarray of RAW, shape (n,)
            In the order of `mountnav.catalog.packed.packing.sorted_order`.
        code : ndarray of uint8, shape (n,)
            Their error classes.
        end_pixel : int
            One past the last pixel that is now complete; empty ones may be among them.

        Raises
        ------
        BadSettings
            It can't be written: the disk is full.
        """
        nside = self._header.nside
        pixels = pixels_of(raw, nside)
        counts = np.bincount(pixels - self._pixels_done, minlength=end_pixel - self._pixels_done)
        first = np.cumsum(counts) - counts
        tops = np.full(counts.size, NO_STAR, dtype=TOP)
        tops[counts > 0] = raw["mag"][first[counts > 0]]
        self._put("offsets", (first + self._stars_done).astype(OFFSET))
        self._put("tops", tops)
        if "coarse" in self._layout:
            at = np.arange(self._pixels_done, end_pixel)
            children = (nside // COARSE_NSIDE) ** 2
            own = at % children == 0
            self._coarse[at[own] // children] = first[own] + self._stars_done
        self._put_stars(raw, code)
        if "color" in self._layout:
            self._put("color", raw["color"].astype(COLOR))
        if "flags" in self._layout:
            self._put("flags", raw["flags"].astype(FLAG))
        if raw.size:
            self._mags += np.bincount(raw["mag"] // MAG_BIN_RAW, minlength=self._mags.size)
            self._brightest = min(self._brightest, int(raw["mag"].min()))
            self._faintest = max(self._faintest, int(raw["mag"].max()))
        self._pixels_done, self._stars_done = end_pixel, self._stars_done + raw.size

    def finish(self, classes: NDArray[np.float32]) -> Header:
        """Write what is known only now, and give the file its name.

        Returns
        -------
        Header
            As written.

        Raises
        ------
        BadSettings
            It can't be written.
        """
        if (self._pixels_done, self._stars_done) != (self._header.pixels, self._header.count):
            raise ValueError(f"{self._stars_done} stars in {self._pixels_done} pixels are not all")
        self._put("offsets", np.array([self._stars_done], dtype=OFFSET))
        if "coarse" in self._layout:
            self._coarse[-1] = self._stars_done
            self._put("coarse", self._coarse)
        self._put("classes", classes.astype(CLASS))
        for section, written in self._written.items():
            if written != self._layout[section][1]:
                raise ValueError(f"{written} bytes of section {section}, expected {self._layout[section][1]}")
        header = replace(
            self._header,
            fastest_mas_yr=round(self._fastest_mas_yr + 0.1, 1),
            slow_mas_yr=round(min(self._header.slow_mas_yr, self._fastest_mas_yr + 0.1), 1),
            brightest_mag=round(self._brightest * MAG_STEP + MAG_ZERO, 3),
            faintest_mag=round(self._faintest * MAG_STEP + MAG_ZERO, 3),
            commonest_mag=round((int(np.argmax(self._mags)) + 0.5) * MAG_BIN_RAW * MAG_STEP + MAG_ZERO, 3),
            section_sha256={name: digest.hexdigest() for name, digest in self._digests.items()},
        )
        header = named_by_content(header)
        try:
            self._file.seek(0)
            self._file.write(encode_header(header))
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._part.replace(self._path)
            sync_folder(self._path.parent)
        except OSError as refused:
            raise self._cannot(refused) from refused
        return header

    def _put_stars(self, raw: Raw, code: NDArray[np.uint8]) -> None:
        stars = np.zeros(raw.size, dtype=STAR)
        for field in ("ra", "dec", "mag"):
            stars[field] = raw[field]
        stars["error"] = code
        pm_ra, pm_dec = raw["pm_ra"], raw["pm_dec"]
        unknown = pm_ra == RAW_PM_UNKNOWN
        beside = ~unknown & ((np.abs(pm_ra) > LARGEST_PM_RAW) | (np.abs(pm_dec) > LARGEST_PM_RAW))
        for field, values in (("pm_ra", pm_ra), ("pm_dec", pm_dec)):
            small = np.where(unknown | beside, 0, values)
            stars[field] = np.where(unknown, PM_UNKNOWN, np.where(beside, PM_IN_SIDECAR, small))
        self._put("stars", stars)
        speed = speeds_mas_yr(raw)
        quick = np.flatnonzero(speed > self._header.slow_mas_yr)
        fast = np.zeros(quick.size, dtype=FAST_2)
        fast["star"] = quick + self._stars_done
        for field in ("ra", "dec", "pm_ra", "pm_dec"):
            fast[field] = raw[field][quick]
        self._put("fast", fast)
        if raw.size:
            self._fastest_mas_yr = max(self._fastest_mas_yr, float(speed.max()))

    def _put(self, section: str, values: NDArray[np.generic]) -> None:
        content = values.tobytes()
        at, length = self._layout[section]
        if self._written[section] + len(content) > length:
            raise ValueError(f"section {section} is larger than announced")
        try:
            self._file.seek(HEADER_BYTES + at + self._written[section])
            self._file.write(content)
        except OSError as refused:
            raise self._cannot(refused) from refused
        self._digests[section].update(content)
        self._written[section] += len(content)

    def _opened(self) -> BinaryIO:
        try:
            file = self._part.open("wb", buffering=0)
        except OSError as refused:
            raise self._cannot(refused) from refused
        try:
            size = HEADER_BYTES + self._layout["end"][0]
            if hasattr(os, "posix_fallocate"):  # a full disk is known now, not after an hour
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
        except OSError as refused:
            file.close()
            with suppress(OSError):
                self._part.unlink(missing_ok=True)
            raise self._cannot(refused) from refused
        return file

    def _cannot(self, refused: OSError) -> BadSettings:
        megabytes = (HEADER_BYTES + self._layout["end"][0]) / 1e6
        return BadSettings(
            f"the packed catalog can't be written: {refused.strerror or refused}",
            device=str(self._path),
            advice=f"it needs {megabytes:.0f} MB there: free them, or check the folder's rights",
        )


def sync_folder(folder: Path) -> None:
    """Make the names in a folder durable.

    Raises
    ------
    OSError
        The disk refuses.
    """
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


@dataclass(frozen=True, slots=True)
class CatalogColumns:
    """Stars to be packed; each array has shape (n,) unless said.

    Attributes
    ----------
    ra_deg, dec_deg
        ICRS at the epoch of the file.
    pm_ra_cosdec_mas_yr, pm_dec_mas_yr
        NaN in both where unknown.
    mag
        In the band of the file, -5 to 60.
    error_curve
        Shape (n, 3): from `mountnav.catalog.packed.error_classes.error_curve`.
    color_mag
        Color index; NaN where unknown. None if the catalog has no colors.
    flags
        Bits of `mountnav.catalog.stars.StarFlag`, uint8. None if the catalog has no flags.
    """

    ra_deg: Array
    dec_deg: Array
    pm_ra_cosdec_mas_yr: Array
    pm_dec_mas_yr: Array
    mag: Array
    error_curve: Array
    color_mag: Array | None = None
    flags: NDArray[np.uint8] | None = None


def pack(
    columns: CatalogColumns,
    path: Path,
    *,
    name: str,
    band: str,
    epoch_yr: float,
    nside: int = 64,
    color_name: str = "",
    made_from: str = "",
) -> Header:
    """Write a packed catalog.

    Parameters
    ----------
    path : Path
        The file to write; replaced only when the new one is complete.
    epoch_yr : float
        Julian year of the positions.
    nside : int
        HEALPix resolution; 64 (level 6) suits a few million stars. A file has 6 bytes for each of 12 nside²
        pixels: take 1 to 8 for a few thousand stars of a small piece of the sky.
    color_name : str
        "B-V", "BP-RP"; without it the colors are left out.
    made_from : str
        One line for people.

    Returns
    -------
    Header
        As written.

    Raises
    ------
    ValueError
        A value is not finite or cannot be written.
    BadSettings
        The folder can't be written, or there is no room.
    """
    if columns.ra_deg.size == 0:
        raise ValueError("a catalog of no stars can't be packed")
    raw = raw_stars(columns)
    order = sorted_order(raw, nside)
    code, classes = classify(columns.error_curve)
    speed = speeds_mas_yr(raw)
    slow_mas_yr, fast_count = fast_limit([int(np.sum(speed > limit)) for limit in FAST_LIMITS_MAS_YR])
    shape = PackedShape(nside, raw.size, classes.shape[0], fast_count, slow_mas_yr, columns.flags is not None)
    facts = PackedFacts(name, band, epoch_yr, color_name, made_from)
    with PackedWriter(path, facts, shape) as writer:
        writer.write(raw[order], code[order], 12 * nside**2)
        return writer.finish(classes)
