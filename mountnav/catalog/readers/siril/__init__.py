"""Siril's local Gaia catalog: the astrometric extract of DR3, one file for the whole sky or chunks of it."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers import gaia
from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.siril.reader import open_catalog

    return open_catalog(path)


CATALOG = CatalogKind(
    name="siril",
    files="Siril's local Gaia catalog files",
    credit=Credit("made from Gaia DR3 (" + gaia.TERMS + "); see its Zenodo record", gaia.CREDIT),
    open=_open,
    editions=(
        Edition(
            name="Siril's Gaia catalog",
            stars=94_870_000,
            faintest_mag=20.0,
            sigma_arcsec=0.01,
            download_gb=1.52,
            obtained="Zenodo record 14692304 (siril_cat_healpix8_astro.dat), unpacked",
            densest_deg2=2400.0,
            is_one_file=True,
        ),
    ),
    source_bytes_per_star=16,  # `layout.STAR`
)
