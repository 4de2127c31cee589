"""Star databases of ASTAP and HNSKY: a folder of area files (.1476 or .290), or one of them."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers import gaia
from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.astap.reader import open_catalog

    return open_catalog(path)


def _database(name: str, stars: int, faintest_mag: float, densest_deg2: float, download_gb: float) -> Edition:
    return Edition(
        name=f"ASTAP {name}",
        stars=stars,
        faintest_mag=faintest_mag,
        sigma_arcsec=0.15,
        download_gb=download_gb,
        obtained="the ASTAP project's pages (hnsky.org/astap.htm, star databases), unpacked",
        densest_deg2=densest_deg2,
    )


CATALOG = CatalogKind(
    name="astap",
    files="ASTAP / HNSKY star databases (.1476, .290)",
    credit=Credit("made from Gaia (" + gaia.TERMS + "); ASTAP itself is MPL-2.0", gaia.CREDIT),
    open=_open,
    editions=(
        _database("D05", 20_000_000, 17.0, 500.0, 0.1),
        _database("D20", 80_000_000, 18.0, 2000.0, 0.4),
        _database("D50", 180_000_000, 18.0, 5000.0, 0.9),
        _database("D80", 240_000_000, 18.0, 8000.0, 1.2),
    ),
)
