"""The habits of catalogs: what each is off by, how deep it goes, what it misses and what it makes up."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CatalogKind:
    """A catalog's habits.

    Attributes
    ----------
    band
        Of its magnitudes.
    color_share
        Magnitude in the band = V minus so many times B-V; ignored for "G".
    color_factor
        The catalog's own color index is so many times B-V.
    epoch_yr
        Of the file's positions.
    observed_yr
        Mean epoch of its observations: the errors grow from there.
    faintest_mag
        In the band: here half of the stars are missing, and none fainter by 0.3 is there.
    complete
        Share of the brighter stars that it has.
    resolves_arcsec
        Closer pairs are one star at their photocenter.
    false_share
        False stars per true one.
    without_motion
        Share of the stars that have no proper motion.
    error_mags, sigma_mas, sigma_pm_mas_yr
        Errors per coordinate at magnitudes between which the logarithm runs evenly.
    """

    name: str
    band: str
    color_share: float
    color_name: str
    color_factor: float
    epoch_yr: float
    observed_yr: float
    faintest_mag: float
    complete: float
    resolves_arcsec: float
    false_share: float
    without_motion: float
    mag_error: float
    error_mags: tuple[float, ...]
    sigma_mas: tuple[float, ...]
    sigma_pm_mas_yr: tuple[float, ...]


KINDS = {
    # errors: about those of Gaia EDR3 [Lindegren et al., A&A 649, A2, 2021]
    "gaia": CatalogKind(
        "invented Gaia", "G", 0.0, "BP-RP", 1.3, 2016.0, 2016.0, 20.5, 0.995, 0.6, 0.001, 0.01, 0.01,
        (13.0, 15.0, 17.0, 18.0, 19.0, 20.0, 21.0),
        (0.015, 0.02, 0.05, 0.1, 0.17, 0.4, 1.0),
        (0.02, 0.025, 0.07, 0.13, 0.22, 0.5, 1.4),
    ),
    # such that the errors of 2026.9 are those measured: 37, 64 and 103 to 125 mas [CATALOGS §0]
    "ucac4": CatalogKind(
        "invented UCAC4", "UCAC", 0.35, "B-V", 1.0, 2000.0, 2001.0, 16.2, 0.98, 2.5, 0.002, 0.03, 0.05,
        (8.0, 12.0, 14.0, 16.0, 16.5),
        (15.0, 20.0, 28.0, 60.0, 75.0),
        (1.2, 1.5, 2.6, 4.2, 4.8),
    ),
    # places as on plates of about 1980, motions unknown; what they would amount to is in the errors
    "usno-b1": CatalogKind(
        "invented USNO-B1.0", "R", 0.55, "B-R", 1.55, 2000.0, 1980.0, 20.5, 0.97, 3.0, 0.02, 1.0, 0.25,
        (12.0, 21.0),
        (200.0, 200.0),
        (6.0, 6.0),
    ),
}  # fmt: skip
"""The catalogs of [S23 §3.2] and today's."""
