"""From a folder of zone files to columns of stars; each checked against what the catalog says it holds."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers import Part
from mountnav.catalog.readers.record_files import Zone, record_count, records_in_order
from mountnav.catalog.readers.ucac4.fast_stars import with_fast_stars
from mountnav.catalog.readers.ucac4.mapping import columns_of
from mountnav.catalog.readers.ucac4.record import RECORD, decoded
from mountnav.catalog.readers.ucac4.zone_counts import STARS_IN_ZONE, ZONES
from mountnav.catalog.readers.zone_folder import files_by_zone, zone_list
from mountnav.errors import BadCatalog

TURN_MAS = 360 * 3_600_000
ZONE_MAS = 720_000
MARGIN_MAS = 60_000
"""So far outside its zone a star is let pass: enough to tell a file of another zone, or of other bytes."""
_NAME = re.compile(r"z(\d{3})", re.IGNORECASE)


class Ucac4Reader:
    """Reader of UCAC4; see `mountnav.catalog.readers.Reader`.

    Parameters
    ----------
    zones : dict
        Zone number, 1 to 900, to its file.
    counts : sequence of int, optional
        Stars in each zone; those of the catalog if left out.
    """

    name = "UCAC4"
    band = "UCAC"
    color_name = "B-V"
    epoch_yr = 2000.0

    def __init__(self, zones: dict[int, Path], *, counts: Sequence[int] = STARS_IN_ZONE) -> None:
        self._zones = zones
        self._counts = counts
        self.made_from = f"UCAC4 (U.S. Naval Observatory, Zacharias et al. 2013): {_extent(zones)}"

    def parts(self) -> Sequence[Part]:
        """One for each zone file, from the south pole on."""
        return [Part(f"z{zone:03d}", path, path.stat().st_size) for zone, path in sorted(self._zones.items())]

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Declinations of a zone's stars at the catalog's epoch."""
        zone = int(part.name[1:])
        return -90.0 + 0.2 * (zone - 1), -90.0 + 0.2 * zone

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a zone.

        Raises
        ------
        BadCatalog
            The file isn't that zone of UCAC4, whole and in its order; tells the offset.
        """
        zone = int(part.name[1:])
        wanted, count = self._counts[zone - 1], record_count(part.path, RECORD)
        if count != wanted:
            raise malformed_at(
                part.path.name,
                min(count, wanted) * RECORD.itemsize,
                f"{wanted} stars in zone {zone}",
                f"{count}",
            )
        band = Zone(
            TURN_MAS,
            max((zone - 1) * ZONE_MAS - MARGIN_MAS, 0),
            min(zone * ZONE_MAS + MARGIN_MAS, TURN_MAS // 2),
            "mas",
        )
        for _, records in records_in_order(part.path, RECORD, band):
            yield columns_of(with_fast_stars(decoded(records)))


def open_catalog(path: Path) -> Ucac4Reader:
    """Find the zone files.

    Parameters
    ----------
    path : Path
        The folder that holds z001 to z900, or one above it (u4b), or a single zone file.

    Returns
    -------
    Ucac4Reader
        Of the zones that are there.

    Raises
    ------
    BadCatalog
        There is none, or one is there twice.
    """
    found = files_by_zone(path, _NAME, "zone files z001 to z900", range(1, ZONES + 1))
    if not found:
        raise BadCatalog(
            "no zone files of UCAC4 (z001 to z900) here",
            device=str(path),
            advice="give the folder u4b, or the folder above it",
        )
    return Ucac4Reader(found)


def _extent(zones: dict[int, Path]) -> str:
    missing = sorted(set(range(1, ZONES + 1)) - set(zones))
    if not missing:
        return f"all {ZONES} zone files"
    if len(zones) <= len(missing):
        return f"{len(zones)} of {ZONES} zone files ({zone_list(sorted(zones))})"
    return f"{len(zones)} of {ZONES} zone files (missing: {zone_list(missing)})"
