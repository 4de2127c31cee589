"""A star database of ASTAP as a catalog: its area files as parts, without proper motions and identifiers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.error_classes import error_curve, unknown_motion_mas_yr
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.astap.layout import (
    DEC_STEP_DEG,
    HEAD_BYTES,
    RA_STEP_DEG,
    UNTOLD_EPOCH_YR,
    Area,
    Decoded,
    Head,
    all_labels,
    area_of,
    decode,
    parse_head,
)
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.files import MOST_RECORD_BYTES, open_buffered, read_bytes

Array = NDArray[np.float64]

_CHUNK = 500_000
"""Stars in a chunk at most: what `Reader.read` promises."""
_SLACK_DEG = 60.0 / 3600.0
"""Rounding is 0.04"; a star that crosses right ascension 0 on its way to the database's epoch stays in the
area where it was, and no star moves faster than 10"/yr."""
_MAS_PER_DEG = 3.6e6
"""Milliarcseconds in a degree."""
_COLOR_STEP = {"B-V": 0.02, "BP-RP": 0.1, "": 1.0}
"""Magnitudes in a step of the color byte, by kind of color."""
_LABELS_TOLD = 5
"""Missing area files that a note names at most; the rest are counted."""
_WIDE_FIELD_SUFFIX = ".001"


class AstapReader:
    """Reader of one database.

    Its places are Gaia's, moved to the epoch that the head tells, in steps of 0.077" x 0.039". There are no
    proper motions: away from that epoch each star's sigma grows by what stars of its magnitude typically
    move.

    Parameters
    ----------
    files : dict
        Area files of one database, with what their names tell.
    """

    def __init__(self, files: dict[Path, Area]) -> None:
        self._files = dict(sorted(files.items(), key=lambda item: (item[1].ring, item[1].cell)))
        self._heads = {path: _head(path, area) for path, area in self._files.items()}
        first_path, area = next(iter(self._files.items()))
        self._head = self._heads[first_path]
        for path, head in self._heads.items():
            if head != self._head:
                raise BadCatalog(
                    f"its header says {head.text!r}, records of {head.layout.size} bytes, but that of "
                    f"{first_path.name} says {self._head.text!r}, {self._head.layout.size} bytes",
                    device=path.name,
                    advice="the folder mixes two editions of a database: copy one of them again",
                )
        self.name = f"ASTAP {area.database.upper()}"
        self.band = self._head.band
        self.color_name = self._head.color_name
        self.epoch_yr = self._head.epoch_yr
        self.made_from = self._told(area)

    def parts(self) -> Sequence[Part]:
        """One for each area file, south to north."""
        return [Part(path.name, path, path.stat().st_size) for path in self._files]

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Lowest and highest declination of the part's stars."""
        south, north = self._files[part.path].dec_range_deg
        return south - _SLACK_DEG, north + _SLACK_DEG

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of an area.

        Raises
        ------
        BadCatalog
            The file is malformed, or a star doesn't lie in its area.
        """
        area = self._files[part.path]
        content = read_bytes(part.path, MOST_RECORD_BYTES)
        file = part.path.name
        if parse_head(content[:HEAD_BYTES], file, area.database) != self._head:
            raise BadCatalog("it changed while it was read", device=file, advice="start the import again")
        stars = decode(content[HEAD_BYTES:], self._head.layout, file, HEAD_BYTES)
        outside = np.flatnonzero(area.outside(stars.ra_deg, stars.dec_deg, _SLACK_DEG))
        if outside.size:
            worst = int(outside[0])
            (south, north), (west, east) = area.dec_range_deg, area.ra_range_deg
            raise malformed_at(
                file,
                int(stars.offset[worst]),
                f"a star of area {area.label}: RA {west:.4f} to {east:.4f}, Dec {south:.4f} to {north:.4f}",
                f"RA {stars.ra_deg[worst]:.4f}, Dec {stars.dec_deg[worst]:.4f}",
            )
        for start in range(0, stars.mag.size, _CHUNK):
            yield self._columns(stars, slice(start, start + _CHUNK))

    def _columns(self, stars: Decoded, chosen: slice) -> CatalogColumns:
        dec, mag = stars.dec_deg[chosen], stars.mag[chosen]
        motion = unknown_motion_mas_yr(mag)
        by_epoch = motion * self._head.epoch_sigma_yr
        rounding_mas = _MAS_PER_DEG / np.sqrt(12.0)
        sigma = (
            np.hypot(RA_STEP_DEG * rounding_mas * np.cos(np.radians(dec)), by_epoch),
            np.hypot(np.full(mag.size, DEC_STEP_DEG * rounding_mas), by_epoch),
        )
        epoch = np.full(mag.size, self.epoch_yr)
        unknown = np.full(mag.size, np.nan)
        has_color = self.color_name != ""
        return CatalogColumns(
            ra_deg=stars.ra_deg[chosen],
            dec_deg=dec,
            pm_ra_cosdec_mas_yr=unknown,
            pm_dec_mas_yr=unknown.copy(),
            mag=mag,
            error_curve=error_curve(sigma, (motion, motion), (epoch, epoch)),
            color_mag=stars.color_raw[chosen] * _COLOR_STEP[self.color_name] if has_color else None,
            flags=np.full(mag.size, StarFlag.NO_PROPER_MOTION, dtype=np.uint8),
        )

    def _told(self, area: Area) -> str:
        there = {each.label for each in self._files.values()}
        missing = [label for label in all_labels(area.areas) if label not in there]
        told = f"{self.name} ({self._head.text}), {len(there)} of {area.areas} areas"
        if missing:
            shown = ", ".join(missing[:_LABELS_TOLD]) + (", ..." if len(missing) > _LABELS_TOLD else "")
            told += f" (missing: {shown})"
        if self._head.epoch_sigma_yr:
            told += f"; its header gives no epoch: {UNTOLD_EPOCH_YR} taken, with sigmas to match"
        return told


def open_catalog(path: Path) -> AstapReader:
    """Open a database of ASTAP or HNSKY.

    Parameters
    ----------
    path : Path
        A folder with the area files of one database, or one area file: then only that area is read.

    Raises
    ------
    BadCatalog
        No such files, those of several databases, or a head that can't be read.
    """
    candidates = sorted(path.iterdir()) if path.is_dir() else [path]
    files = {each: area for each in candidates if (area := area_of(each)) is not None}
    if not files:
        raise _none_found(path, candidates)
    databases = sorted({(area.database, area.areas) for area in files.values()})
    if len(databases) > 1:
        names = ", ".join(f"{name} (.{areas})" for name, areas in databases)
        raise BadCatalog(
            f"the folder holds several star databases: {names}",
            device=str(path),
            advice="put the files of the one you want into a folder of its own (links do), and name that",
        )
    return AstapReader(files)


def _none_found(path: Path, candidates: Sequence[Path]) -> BadCatalog:
    if any(each.suffix == _WIDE_FIELD_SUFFIX for each in candidates):
        return BadCatalog(
            "a wide-field database (.001) is not read: it ends at magnitude 8",
            device=str(path),
            advice="the embedded catalog is deeper; for narrow fields install ASTAP's D50 or D80",
        )
    return BadCatalog(
        "no area files of a star database, such as d50_0101.1476 or g05_0101.290",
        device=str(path),
        advice="name the folder where ASTAP's star database was installed, such as /opt/astap",
    )


def _head(path: Path, area: Area) -> Head:
    with open_buffered(path) as file:
        return parse_head(file.read(HEAD_BYTES), path.name, area.database)
