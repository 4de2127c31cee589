"""Gaia extracts: what the archive, VizieR or astroquery put on disk, with the archive's column names."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers.kind import CatalogKind, Credit, Edition, Reader

TERMS = (
    "open and free to use with credit to ESA/Gaia/DPAC; the terms of passing it on are not settled: keep it "
    "to yourself"
)
"""Of Gaia's data; catalogs that were made from it quote them."""
CREDIT = (
    "This work has made use of data from the European Space Agency (ESA) mission Gaia "
    "(https://www.cosmos.esa.int/gaia), processed by the Gaia Data Processing and Analysis Consortium (DPAC)."
)

_V_LESS_G_MAG = 0.3
"""V of a field star less its G, about: the doctor's model of star counts is in V. Twice as much, and the
doctor would believe that an extract reaches 0.3 mag deeper than it does."""
_FETCHED_BYTES_PER_STAR = 88.0
"""Of the recommended columns as FITS or Parquet (docs/how-to/catalog-doctor.md): what is to be fetched."""


def _open(path: Path) -> Reader:
    from mountnav.catalog.readers.gaia.reader import open_catalog

    return open_catalog(path)


def _to(limit_g: int, stars: int, sigma_arcsec: float) -> Edition:
    return Edition(
        name=f"Gaia DR3 to G {limit_g}",
        stars=stars,
        faintest_mag=limit_g + _V_LESS_G_MAG,
        sigma_arcsec=sigma_arcsec,
        download_gb=stars * _FETCHED_BYTES_PER_STAR / 1e9,
        obtained=(
            "the Gaia archive (gea.esac.esa.int/archive, table gaiadr3.gaia_source) in parts, as FITS or "
            "Parquet, or CDS I/355; the columns: `mountnav docs catalog-doctor`"
        ),
    )


CATALOG = CatalogKind(
    name="gaia",
    files="a Gaia extract with the archive's column names: FITS, CSV, ECSV, VOTable or Parquet",
    credit=Credit(TERMS, CREDIT),
    open=_open,
    editions=(
        _to(15, 37_000_000, 0.001),
        _to(17, 160_000_000, 0.001),
        _to(18, 300_000_000, 0.002),
        _to(19, 570_000_000, 0.003),
        _to(20, 1_000_000_000, 0.006),
    ),
)
