"""Star catalogs that an observatory can get: how many stars, how deep, how precise, how large, from where.

Counts, depths and sizes are those of the catalogs' own descriptions (CDS I/259, I/284, I/322A; the ASTAP and
Siril projects' pages; a table of the sizes of index files), or estimates: docs/catalog-doctor.md says which.
"""

from __future__ import annotations

from dataclasses import dataclass

from mountnav.catalog.credits import CREDITS

BYTES_PER_STAR = 18.0
"""Of an imported catalog, at most: a star with color and flags, and its share of the tables."""


@dataclass(frozen=True, slots=True)
class ObtainableCatalog:
    """A catalog that can be had.

    Attributes
    ----------
    name : str
        For people.
    kind : str
        Of its import: `mountnav catalog import KIND PATH`.
    stars : int
        About.
    faintest_mag : float
        How deep it is complete, as a V magnitude.
    sigma_arcsec : float
        Typical position error per coordinate in 2026 of the stars that a narrow field needs.
    download_gb : float
        What must be fetched, in 10⁹ bytes.
    obtained : str
        Where from, in words: nothing is fetched unasked, and the computer may have no network.
    densest_deg2 : float or None
        If it was thinned out: so many stars per square degree at most, the brightest.
    has_magnitudes : bool
        Without them the solver doesn't know which stars are the bright ones: it isn't recommended then.
    """

    name: str
    kind: str
    stars: int
    faintest_mag: float
    sigma_arcsec: float
    download_gb: float
    obtained: str
    densest_deg2: float | None = None
    has_magnitudes: bool = True

    @property
    def command(self) -> str:
        """What brings it in, once it is on a disk here."""
        return f"mountnav catalog import {self.kind} {'FILE' if self.kind == 'siril' else 'FOLDER'}"

    @property
    def terms(self) -> str:
        """License or terms of use, in a line."""
        return CREDITS[self.kind].terms

    @property
    def installed_gb(self) -> float:
        """Size once imported, in 10⁹ bytes."""
        return self.stars * BYTES_PER_STAR / 1e9


_GAIA_FROM = (
    "the Gaia archive (gea.esac.esa.int/archive, table gaiadr3.gaia_source) in parts, as FITS or Parquet, or "
    "CDS I/355; the columns: docs/catalog-doctor.md"
)
_ASTAP_FROM = "the ASTAP project's pages (hnsky.org/astap.htm, star databases), unpacked"
_INDEX_FROM = "data.astrometry.net, index-{} of the 5200 series"


def _gaia(limit_g: int, stars: int, sigma_arcsec: float) -> ObtainableCatalog:
    return ObtainableCatalog(
        name=f"Gaia DR3 to G {limit_g}",
        kind="gaia",
        stars=stars,
        # a field star's V is about 0.3 above its G
        faintest_mag=limit_g + 0.3,
        sigma_arcsec=sigma_arcsec,
        download_gb=stars * 88.0 / 1e9,
        obtained=_GAIA_FROM,
    )


def _astap(
    name: str, stars: int, faintest_mag: float, densest_deg2: float, download_gb: float
) -> ObtainableCatalog:
    return ObtainableCatalog(
        name=f"ASTAP {name}",
        kind="astap",
        stars=stars,
        faintest_mag=faintest_mag,
        sigma_arcsec=0.15,
        download_gb=download_gb,
        obtained=_ASTAP_FROM,
        densest_deg2=densest_deg2,
    )


def _index(
    scale: int, stars: int, densest_deg2: float, download_gb: float, *, light: bool
) -> ObtainableCatalog:
    return ObtainableCatalog(
        name=f"astrometry.net {scale}{' LITE' if light else ''}",
        kind="astrometry-net",
        stars=stars,
        faintest_mag=20.5,
        # without proper motions the stars stand where they were in 2015.5
        sigma_arcsec=0.1 if light else 0.005,
        download_gb=download_gb,
        obtained=_INDEX_FROM.format(scale) + (", folder LITE" if light else ""),
        # from the files' sizes, less a fifth: nobody states it
        densest_deg2=densest_deg2,
        has_magnitudes=not light,
    )


OBTAINABLE: tuple[ObtainableCatalog, ...] = (
    ObtainableCatalog(
        name="UCAC4",
        kind="ucac4",
        stars=113_780_093,
        faintest_mag=16.3,
        sigma_arcsec=0.11,
        download_gb=8.9,
        obtained="CDS I/322A (folder UCAC4/u4b of its file server), or the Naval Observatory's DVD",
    ),
    ObtainableCatalog(
        name="USNO-B1.0",
        kind="usno-b1",
        stars=1_045_913_669,
        faintest_mag=21.0,
        sigma_arcsec=0.3,
        download_gb=83.7,
        obtained="the Naval Observatory's Flagstaff Station, on request; not the packed form that CDS serves",
    ),
    _gaia(15, 37_000_000, 0.001),
    _gaia(17, 160_000_000, 0.001),
    _gaia(18, 300_000_000, 0.002),
    _gaia(19, 570_000_000, 0.003),
    _gaia(20, 1_000_000_000, 0.006),
    _astap("D05", 20_000_000, 17.0, 500.0, 0.1),
    _astap("D20", 80_000_000, 18.0, 2000.0, 0.4),
    _astap("D50", 180_000_000, 18.0, 5000.0, 0.9),
    _astap("D80", 240_000_000, 18.0, 8000.0, 1.2),
    ObtainableCatalog(
        name="Siril's Gaia catalog",
        kind="siril",
        stars=94_870_000,
        faintest_mag=20.0,
        sigma_arcsec=0.01,
        download_gb=1.52,
        obtained="Zenodo record 14692304 (siril_cat_healpix8_astro.dat), unpacked",
        densest_deg2=2400.0,
    ),
    _index(5205, 11_600_000, 225.0, 0.615, light=True),
    _index(5203, 46_700_000, 920.0, 2.45, light=True),
    _index(5201, 167_000_000, 3900.0, 9.49, light=True),
    _index(5200, 275_000_000, 7800.0, 17.2, light=True),
    _index(5205, 11_600_000, 225.0, 1.43, light=False),
    _index(5203, 46_700_000, 920.0, 5.72, light=False),
    _index(5201, 167_000_000, 3900.0, 21.2, light=False),
    _index(5200, 275_000_000, 7800.0, 36.46, light=False),
)
"""Those that can be imported."""

ONLINE = (
    "or, where there is a network, ask Gaia DR3 as frames come: [[catalogs.online]] "
    'with protocol = "vizier", table = "I/355"'
)


def in_size(gigabytes: float) -> str:
    """A size for people: "620 MB", "2.0 GB"."""
    return f"{gigabytes * 1000:.0f} MB" if gigabytes < 1.0 else f"{gigabytes:.1f} GB"
