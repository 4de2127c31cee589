"""For which year a Gaia extract's positions hold, as far as the file itself tells."""

from __future__ import annotations

import re
from collections.abc import Iterable

from mountnav.errors import BadCatalog

RELEASE_EPOCHS_YR = {"1": 2015.0, "2": 2015.5, "3": 2016.0}
"""Reference epochs of the data releases [Gaia archive, gaia_source.ref_epoch]; EDR3 is as DR3."""
VIZIER_EPOCHS_YR = {"337": 2015.0, "345": 2015.5, "350": 2016.0, "355": 2016.0}
"""Of VizieR's catalogs I/337 (DR1), I/345 (DR2), I/350 (EDR3), I/355 (DR3) [their ReadMe: RA_ICRS at Ep]."""
EARLIEST_YR, LATEST_YR = 1980.0, 2100.0
"""What a column of epochs may hold: people move their extracts, and days or seconds are far off."""

ADVICE = (
    "ten years of proper motion hang on it: add ref_epoch to the query's columns (or, from VizieR, save it "
    "as a VOTable, which tells the epoch)"
)

_RELEASE = re.compile(r"gaia[ _]*e?dr([123])(?!\d)", re.IGNORECASE)
_VIZIER = re.compile(r"\bI[/_](337|345|350|355)(?!\d)")
_EPOCH = re.compile(r"\bEp(?:och)?\s*=\s*J?(20[123]\d(?:\.\d+)?)(?!\d)", re.IGNORECASE)
# J2000 is an equinox as a rule, no epoch of Gaia's
_YEAR = re.compile(r"^\s*J?\s*(20[123]\d(?:\.\d*)?)\s*$", re.IGNORECASE)


def epoch_of_label(label: str) -> float | None:
    """Read an epoch such as "J2016.0" or "2016"; None if it is none that can be Gaia's."""
    year = _YEAR.match(label)
    return float(year[1]) if year else None


def epoch_in_texts(file: str, texts: Iterable[str]) -> float | None:
    """Look for the epoch in what a file tells about itself.

    Parameters
    ----------
    file : str
        For the message.
    texts : iterable of str
        Descriptions, comments, the query, the release.

    Returns
    -------
    float or None
        Julian year; None if nothing tells it.

    Raises
    ------
    BadCatalog
        Two different epochs are told.
    """
    found: set[float] = set()
    for text in texts:
        found |= {RELEASE_EPOCHS_YR[release] for release in _RELEASE.findall(text)}
        found |= {VIZIER_EPOCHS_YR[number] for number in _VIZIER.findall(text)}
        found |= {float(year) for year in _EPOCH.findall(text)}
    if len(found) > 1:
        raise BadCatalog(
            f"speaks of several epochs, {', '.join(str(year) for year in sorted(found))}, and has no column "
            "ref_epoch",
            device=file,
            advice=ADVICE,
        )
    return found.pop() if found else None


def unknown_epoch(file: str) -> BadCatalog:
    """Make the error for a file that doesn't tell the epoch of its positions."""
    return BadCatalog("doesn't tell for which year its positions hold", device=file, advice=ADVICE)
