"""USNO-B1.0's zone files: a billion stars to V = 21 from photographic plates [CATALOGS, Formats §4]."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.usno_b1.reader import open_catalog

    return open_catalog(path)


CATALOG = CatalogKind(
    name="usno-b1",
    files="USNO-B1.0 zone files (bNNNN.cat)",
    credit=Credit(
        "free for personal and institutional science; plate archives keep rights: redistribution needs leave",
        "USNO-B1.0: Monet et al., AJ 125, 984 (2003), from plates of Palomar, ESO and UK Schmidt.",
    ),
    open=_open,
    editions=(
        Edition(
            name="USNO-B1.0",
            stars=1_045_913_669,
            faintest_mag=21.0,
            sigma_arcsec=0.3,
            download_gb=83.7,
            obtained=(
                "the Naval Observatory's Flagstaff Station, on request; not the packed form that CDS serves"
            ),
        ),
    ),
    is_one_catalog=True,
    source_bytes_per_star=80,  # `record.RECORD`: 20 words of 4 bytes
)
