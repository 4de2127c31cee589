"""What the known series of index files are made of: catalog, epoch, band, errors."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Series:
    """Index files of one making.

    Attributes
    ----------
    name : str
    epoch_yr : float
        Julian year of the positions in the star tree.
    band : str
        Of the magnitudes.
    sigma_mas : tuple of (magnitude, mas)
        One-sigma position error at the epoch, by magnitude. Empty for Gaia's.
    """

    name: str
    epoch_yr: float
    band: str
    sigma_mas: tuple[tuple[float, float], ...] = ()


SERIES: dict[int, Series] = {
    41: Series(
        "Tycho-2 (index files)",
        2000.0,
        "VT",
        ((7.0, 32.0), (8.5, 33.0), (9.5, 38.0), (10.5, 53.0), (11.5, 86.0), (12.5, 118.0)),
    ),
    42: Series("2MASS (index files)", 1999.5, "J", ((13.0, 80.0), (16.0, 120.0))),
    50: Series("Gaia DR2 (index files)", 2015.5, "G"),
    52: Series("Gaia DR2 and Tycho-2 (index files)", 2015.5, "G"),
}
"""By INDEXID // 100 [data.astrometry.net; the author's 5000-README for the epoch of Gaia's].

The 4100 series (and Debian's index-tycho2 files, which have its numbers) holds Tycho-2's mean positions at
J2000: 100,000 of its stars lie 0.009″ (median) from Tycho-2 there. Sigma: Tycho-2's own at 2000, with 0.03″
for positions that went through 32-bit floating-point degrees. 2MASS was observed from 1997 to 2001 and is
good to 0.08″ [M. F. Skrutskie et al., AJ 131, 1163 (2006)]."""

MAGNITUDE_COLUMNS: dict[str, str] = {
    "phot_g_mean_mag": "G",
    "mag": "G",
    "mag_vt": "VT",
    "vt": "VT",
    "j_mag": "J",
    "jmag": "J",
    "mag_j": "J",
}
"""Band by tag-along column, lower case. "mag" is that of the 5200 series' larger version: G, and VT for the
stars that it has from Tycho-2."""

TYCHO_EPOCH_YR = 1991.5
"""Where the 5200 series has Tycho-2's stars isn't documented: as observed around then, or moved to 2000. They
are taken as doubtful, of unknown motion since then."""
