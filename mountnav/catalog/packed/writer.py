"""The writer of version 2: sorted stars in, block after block, one file out, complete or not at all."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import (
    CLASS,
    COARSE_NSIDE,
    COLOR,
    FAST_2,
    FLAG,
    HEADER_BYTES,
    LARGEST_PM_RAW,
    MAG_STEP,
    MAG_ZERO,
    NO_STAR,
    OFFSET,
    PM_IN_SIDECAR,
    PM_UNKNOWN,
    STAR,
    TOP,
    Header,
)
from mountnav.catalog.packed.header import encode_header, named_by_content
from mountnav.catalog.packed.raw_stars import RAW_PM_UNKNOWN, Raw, pixels_of, speeds_mas_yr
from mountnav.errors import BadSettings

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
    facts : PackedFacts
    shape : PackedShape

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
            In the order of `mountnav.catalog.packed.raw_stars.sorted_order`.
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

        Parameters
        ----------
        classes : ndarray of float32, shape (class_count, 3)

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
            raise ValueError(f"section {section} is larger than was said")
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

    Parameters
    ----------
    folder : Path

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
