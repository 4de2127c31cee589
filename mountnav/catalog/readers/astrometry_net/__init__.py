"""Index files of astrometry.net as a star catalog."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers import gaia
from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.astrometry_net.reader import open_catalog

    return open_catalog(path)


def _index(scale: int, stars: int, densest_deg2: float, download_gb: float, *, light: bool) -> Edition:
    return Edition(
        name=f"astrometry.net {scale}{' LITE' if light else ''}",
        stars=stars,
        faintest_mag=20.5,
        # without proper motions the stars stand where they were in 2015.5
        sigma_arcsec=0.1 if light else 0.005,
        download_gb=download_gb,
        obtained=f"data.astrometry.net, index-{scale} of the 5200 series{', folder LITE' if light else ''}",
        # from the files' sizes, less a fifth: nobody states it
        densest_deg2=densest_deg2,
        has_magnitudes=not light,
    )


CATALOG = CatalogKind(
    name="astrometry-net",
    files="astrometry.net index files (5200 series, and others with or without stars' columns)",
    credit=Credit(
        "as the catalog that the index was built from (Gaia: " + gaia.TERMS + ")",
        "Astrometry.net index files: Lang et al., AJ 139, 1782 (2010); built from the catalog named above.",
    ),
    open=_open,
    editions=(
        _index(5205, 11_600_000, 225.0, 0.615, light=True),
        _index(5203, 46_700_000, 920.0, 2.45, light=True),
        _index(5201, 167_000_000, 3900.0, 9.49, light=True),
        _index(5200, 275_000_000, 7800.0, 17.2, light=True),
        _index(5205, 11_600_000, 225.0, 1.43, light=False),
        _index(5203, 46_700_000, 920.0, 5.72, light=False),
        _index(5201, 167_000_000, 3900.0, 21.2, light=False),
        _index(5200, 275_000_000, 7800.0, 36.46, light=False),
    ),
)
