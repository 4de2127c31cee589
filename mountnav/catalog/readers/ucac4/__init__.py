"""UCAC4's zone files: 113,780,093 stars to magnitude 16, with motions and errors [CATALOGS, Formats §3]."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.ucac4.reader import open_catalog

    return open_catalog(path)


CATALOG = CatalogKind(
    name="ucac4",
    files="UCAC4 zone files (z001 to z900)",
    credit=Credit(
        "a work of the US Naval Observatory, available free of charge; 2MASS and APASS magnitudes are in it",
        "UCAC4: Zacharias et al., AJ 145, 44 (2013); APASS, funded by the Robert Martin Ayers Sciences Fund.",
    ),
    open=_open,
    editions=(
        Edition(
            name="UCAC4",
            stars=113_780_093,
            faintest_mag=16.3,
            sigma_arcsec=0.11,
            download_gb=8.9,
            obtained="CDS I/322A (folder UCAC4/u4b of its file server), or the Naval Observatory's DVD",
        ),
    ),
    is_one_catalog=True,
    source_bytes_per_star=78,  # `record.RECORD` [readme_u4 §5a]
)
