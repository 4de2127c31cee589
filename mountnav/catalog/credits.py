"""Whose work a catalog is, and on what terms: an entry for each kind (docs/catalog-licenses.md)."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Credit:
    """What is to be said when a catalog is used.

    Attributes
    ----------
    terms : str
        License or terms of use, in a line.
    credit : str
        The line of credit that its makers ask for.
    """

    terms: str
    credit: str


GAIA_TERMS = (
    "open and free to use with credit to ESA/Gaia/DPAC; the terms of passing it on are not settled: keep it "
    "to yourself"
)
GAIA_CREDIT = (
    "This work has made use of data from the European Space Agency (ESA) mission Gaia "
    "(https://www.cosmos.esa.int/gaia), processed by the Gaia Data Processing and Analysis Consortium (DPAC)."
)

EMBEDDED = Credit(
    "BSD-2-Clause, as Debian's package tycho2 has it; TYCHO2-NOTICE.txt goes wherever the data goes",
    "The Tycho-2 Catalogue: Høg et al., A&A 355, L27 (2000); observations of the ESA Hipparcos satellite.",
)

CREDITS: dict[str, Credit] = {
    "ucac4": Credit(
        "a work of the US Naval Observatory, available free of charge; 2MASS and APASS magnitudes are in it",
        "UCAC4: Zacharias et al., AJ 145, 44 (2013); APASS, funded by the Robert Martin Ayers Sciences Fund.",
    ),
    "usno-b1": Credit(
        "free for personal and institutional science; plate archives keep rights: redistribution needs leave",
        "USNO-B1.0: Monet et al., AJ 125, 984 (2003), from plates of Palomar, ESO and UK Schmidt.",
    ),
    "gaia": Credit(GAIA_TERMS, GAIA_CREDIT),
    "astrometry-net": Credit(
        "as the catalog that the index was built from (Gaia: " + GAIA_TERMS + ")",
        "Astrometry.net index files: Lang et al., AJ 139, 1782 (2010); built from the catalog named above.",
    ),
    "astap": Credit("made from Gaia (" + GAIA_TERMS + "); ASTAP itself is MPL-2.0", GAIA_CREDIT),
    "siril": Credit("made from Gaia DR3 (" + GAIA_TERMS + "); see its Zenodo record", GAIA_CREDIT),
}
"""By kind of import."""


def credit_of(made_from: str) -> Credit | None:
    """The credit of an imported catalog.

    Parameters
    ----------
    made_from : str
        As in the header: the kind of the import, a colon, and what was read.

    Returns
    -------
    Credit or None
        None if the kind isn't told, or isn't known.
    """
    return CREDITS.get(made_from.split(":", 1)[0])
