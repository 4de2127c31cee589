"""A toy kind of catalog: text files of right ascension, declination and V magnitude, a star a line."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from tests.catalog.toy_catalog.reader import open_catalog

    return open_catalog(path)


CATALOG = CatalogKind(
    name="toy",
    files="toy catalog files (*.toy)",
    credit=Credit("public domain", "The Toy Catalog, drawn for docs/how-to/add-a-catalog.md."),
    open=_open,
    editions=(
        Edition(
            name="The Toy Catalog",
            stars=1_000,
            faintest_mag=9.0,
            sigma_arcsec=0.5,
            download_gb=0.00003,
            obtained="nowhere: the test writes it",
        ),
    ),
    source_bytes_per_star=27,
)
