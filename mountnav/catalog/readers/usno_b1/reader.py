"""From a folder of zone files to columns of stars; Tycho-2's records and rejects are left out and counted."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.readers.usno_b1.record import (
    NO_STAR_GALAXY,
    RECORD,
    UsnoB1Stars,
    decoded,
    detections,
    impossible,
)
from mountnav.catalog.readers.zone_files import Zone, files_by_zone, record_count, records_in_order, zone_list
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadCatalog
from mountnav.files import read_bytes

Array = NDArray[np.float64]

B1, R1, B2, R2, INFRARED = range(5)
"""Columns of the five surveys in a record."""
FLOOR_MAS = 200.0
"""The catalog's accuracy at J2000 [Monet et al. 2003, AJ 125, 984]; the stated sigma is the plates' scatter.
At the south pole its declinations differ from UCAC4's by 0.26", robust sigma, at magnitude 12 to 16."""
FLOOR_PM_MAS_YR = 4.0
"""Smaller stated errors "should not be taken at face value" [Gould 2003, AJ 126, 472]."""
UNKNOWN_MOTION_MAG = (8.5, 10.5, 11.5, 12.5, 13.5, 14.5, 15.5, 16.5)
"""Magnitudes of the table below."""
UNKNOWN_MOTION_MAS_YR = (43.0, 25.5, 23.4, 18.9, 14.3, 13.7, 11.9, 11.0)
"""How far a star without a proper motion may move, per coordinate: 68.3 % of the UCAC4 stars of its magnitude
move less (CDS's sample of 1000, less their errors)."""
R_MINUS_BLUE_MAG = -0.9
"""Red less blue magnitude of an ordinary star: brings a star that only a blue plate has to R. The origin
isn't recorded."""
R_MINUS_INFRARED_MAG = 0.5
"""Red less infrared magnitude of an ordinary star, likewise."""
NO_MAGNITUDE_MAG = 21.0
"""The catalog's limit."""
EXTENDED_AT_MOST = 2
"""Star/galaxy estimates of extended objects. 3 is too high: one in five UCAC4 stars near the pole has it."""


def columns_of(stars: UsnoB1Stars) -> CatalogColumns:
    """Choose what the packed form holds.

    Parameters
    ----------
    stars : UsnoB1Stars
        Of the catalog's own records.

    Returns
    -------
    CatalogColumns
        Band "R" (photographic), color B-R.
    """
    mag, color, mag_flags = magnitudes(stars)
    unknown = np.isnan(stars.pm_dec_mas_yr)
    typical = np.interp(mag, UNKNOWN_MOTION_MAG, UNKNOWN_MOTION_MAS_YR)
    stated = (stars.sigma_pm_ra_mas_yr, stars.sigma_pm_dec_mas_yr)
    flags = mag_flags.copy()
    flags[unknown] |= int(StarFlag.NO_PROPER_MOTION)
    flags[stars.diffraction_spike] |= int(StarFlag.DOUBTFUL)
    flags[is_extended(stars)] |= int(StarFlag.EXTENDED)
    return CatalogColumns(
        ra_deg=stars.ra_deg,
        dec_deg=stars.dec_deg,
        pm_ra_cosdec_mas_yr=stars.pm_ra_cosdec_mas_yr,
        pm_dec_mas_yr=stars.pm_dec_mas_yr,
        mag=mag,
        error_curve=error_curve(
            (np.hypot(stars.sigma_ra_mas, FLOOR_MAS), np.hypot(stars.sigma_dec_mas, FLOOR_MAS)),
            (
                np.where(unknown, typical, np.maximum(stated[0], FLOOR_PM_MAS_YR)),
                np.where(unknown, typical, np.maximum(stated[1], FLOOR_PM_MAS_YR)),
            ),
            (stars.epoch_yr, stars.epoch_yr),
        ),
        color_mag=color,
        flags=flags,
    )


def magnitudes(stars: UsnoB1Stars) -> tuple[Array, Array, NDArray[np.uint8]]:
    """R and B-R: R2, or R1; B of the same epoch if there is one.

    Returns
    -------
    mag : ndarray, shape (n,)
        Finite.
    color : ndarray, shape (n,)
        NaN where unknown.
    flags : ndarray of uint8, shape (n,)
        NO_MAGNITUDE, OTHER_BAND.
    """
    m = stars.mag
    second = np.isfinite(m[:, R2])
    red = np.where(second, m[:, R2], m[:, R1])
    near, far = np.where(second, m[:, B2], m[:, B1]), np.where(second, m[:, B1], m[:, B2])
    blue = np.where(np.isnan(near), far, near)
    other = np.where(np.isnan(blue), m[:, INFRARED] + R_MINUS_INFRARED_MAG, blue + R_MINUS_BLUE_MAG)
    mag = np.where(np.isnan(red), other, red)
    nothing = np.isnan(mag)
    flags = np.where(
        nothing, int(StarFlag.NO_MAGNITUDE), np.where(np.isnan(red), int(StarFlag.OTHER_BAND), 0)
    )
    return np.where(nothing, NO_MAGNITUDE_MAG, mag), blue - red, flags.astype(np.uint8)


def is_extended(stars: UsnoB1Stars) -> NDArray[np.bool_]:
    """Whether two surveys or more take it for a galaxy, and none for a star.

    A 0 says nothing by itself: whole plates have it.

    Returns
    -------
    ndarray of bool, shape (n,)
        True: taken for a galaxy.
    """
    told = np.isfinite(stars.mag) & (stars.star_galaxy > 0) & (stars.star_galaxy < NO_STAR_GALAXY)
    largest = np.where(told, stars.star_galaxy, 0).max(axis=1)
    return np.asarray((told.sum(axis=1) >= 2) & (largest <= EXTENDED_AT_MOST))


ZONES = 1800
"""Zone files of the whole catalog, each 0.1° from the south pole on."""
TURN_CAS = 360 * 360_000
"""In the unit of the files, 0.01 arcsec."""
ZONE_CAS = 36_000
"""Height of a zone, 0.1°."""
MARGIN_CAS = 6_000
"""As `MARGIN_MAS` of UCAC4: 60″."""
_NAME = re.compile(r"(?:usno[-_]?b?1?[-_.]?)?b(\d{4})\.cat", re.IGNORECASE)
"""b0000.cat, also usnob_b0000.cat and usno-b1_b0000.cat, as copies are called."""
_ACCELERATOR_LINES = 96
"""Lines of an .acc file: one for each quarter of an hour of right ascension."""
_ACCELERATOR_LINE = re.compile(rb"\s*[\d.]+\s+(\d+)\s+(\d+)\s*")


class UsnoB1Reader:
    """Reader of USNO-B1.0; see `mountnav.catalog.readers.kind.Reader`.

    Parameters
    ----------
    zones : dict
        Zone number, 0 to 1799, to its file.

    Attributes
    ----------
    tycho_records, rejects : int
        How many records of the parts read so far were left out: those taken from Tycho-2, whose layout is
        another, and those that the catalog itself rejects.
    """

    name = "USNO-B1.0"
    band = "R"
    color_name = "B-R"
    epoch_yr = 2000.0

    def __init__(self, zones: dict[int, Path]) -> None:
        self._zones = zones
        self.tycho_records = 0
        self.rejects = 0
        missing = sorted(set(range(ZONES)) - set(zones))
        some = f"missing: {zone_list(missing)}" if len(missing) < len(zones) else zone_list(sorted(zones))
        extent = f"all {ZONES} zone files" if not missing else f"{len(zones)} of {ZONES} zone files ({some})"
        self.made_from = (
            f"USNO-B1.0 (U.S. Naval Observatory, Monet et al. 2003): {extent}; without its Tycho-2 stars"
        )

    def parts(self) -> Sequence[Part]:
        """One for each zone file, from the south pole on."""
        return [Part(f"b{zone:04d}", path, path.stat().st_size) for zone, path in sorted(self._zones.items())]

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Declinations of a zone's stars at the catalog's epoch."""
        zone = int(part.name[1:])
        return -90.0 + 0.1 * zone, -90.0 + 0.1 * (zone + 1)

    def notes(self) -> tuple[str, ...]:
        """What was left out of the parts read so far, for people."""
        return tuple(
            text
            for count, text in (
                (
                    self.tycho_records,
                    f"{self.tycho_records} Tycho-2 stars left out: take them from Tycho-2 itself",
                ),
                (self.rejects, f"{self.rejects} objects left out that the catalog rejects"),
            )
            if count
        )

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a zone.

        Raises
        ------
        BadCatalog
            The file isn't that zone of USNO-B1.0, whole and in its order; tells the offset.
        """
        zone = int(part.name[1:])
        band = Zone(
            TURN_CAS,
            max(zone * ZONE_CAS - MARGIN_CAS, 0),
            min((zone + 1) * ZONE_CAS + MARGIN_CAS, TURN_CAS // 2),
            "x 0.01 arcsec",
        )
        _require_count(part.path, record_count(part.path, RECORD))
        own_records = records_in_order(part.path, RECORD, band, bound=lambda some: detections(some) > 0)
        for first, records in own_records:
            wrong = impossible(records)
            if wrong.any():
                bad = first + int(np.argmax(wrong))
                raise malformed_at(
                    part.path.name,
                    bad * RECORD.itemsize,
                    "a record of USNO-B1.0: flags of 0 or 1, at most 5 detections, fields to 937",
                    "other digits",
                )
            found = detections(records)
            self.tycho_records += int((found == 0).sum())
            self.rejects += int((found == 1).sum())
            own = records[found > 1]
            if own.size:
                yield columns_of(decoded(own))


def open_catalog(path: Path) -> UsnoB1Reader:
    """Find the zone files.

    Parameters
    ----------
    path : Path
        The folder that holds b0000.cat to b1799.cat, or 000 to 179 with these, or a single zone file.

    Returns
    -------
    UsnoB1Reader
        Of the zones that are there.

    Raises
    ------
    BadCatalog
        There is none, or one is there twice.
    """
    found = files_by_zone(path, _NAME, "zone files b0000.cat to b1799.cat", range(ZONES))
    if not found:
        raise BadCatalog(
            "no zone files of USNO-B1.0 (b0000.cat to b1799.cat) here",
            device=str(path),
            advice="give the folder that holds 000 to 179, or one of these",
        )
    return UsnoB1Reader(found)


def _require_count(path: Path, count: int) -> None:
    """Compare with the accelerator file beside, if any: a file cut where a record ends shows nowhere else."""
    beside = {file.name.lower(): file for file in path.parent.iterdir()}
    accelerator = beside.get(f"{path.stem.lower()}.acc")
    if accelerator is None:
        return
    lines = [_ACCELERATOR_LINE.fullmatch(line) for line in read_bytes(accelerator).splitlines()]
    if len(lines) != _ACCELERATOR_LINES or None in lines:
        raise BadCatalog(
            f"an accelerator file has {_ACCELERATOR_LINES} lines of right ascension, first record and count",
            device=accelerator.name,
            advice="copy it again, or take it away: it is only used to check the length of the zone file",
        )
    told = sum(int(line[2]) for line in lines if line is not None)
    if told != count:
        raise malformed_at(
            path.name,
            min(told, count) * RECORD.itemsize,
            f"{told} records by {accelerator.name}",
            f"{count}",
        )
