"""From a folder of zone files to columns of stars; Tycho-2's records and rejects are left out and counted."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import Part
from mountnav.catalog.readers.record_files import Zone, record_count, records_in_order
from mountnav.catalog.readers.usno_b1.mapping import columns_of
from mountnav.catalog.readers.usno_b1.record import RECORD, decoded, detections, impossible
from mountnav.catalog.readers.zone_folder import files_by_zone, zone_list
from mountnav.errors import BadCatalog
from mountnav.files import read_bytes

ZONES = 1800
TURN_CAS = 360 * 360_000
"""In the unit of the files, 0.01 arcsec."""
ZONE_CAS = 36_000
MARGIN_CAS = 6_000
_NAME = re.compile(r"(?:usno[-_]?b?1?[-_.]?)?b(\d{4})\.cat", re.IGNORECASE)
"""b0000.cat, also usnob_b0000.cat and usno-b1_b0000.cat, as copies are called."""
_ACCELERATOR_LINES = 96
_ACCELERATOR_LINE = re.compile(rb"\s*[\d.]+\s+(\d+)\s+(\d+)\s*")


class UsnoB1Reader:
    """Reader of USNO-B1.0; see `mountnav.catalog.readers.Reader`.

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
