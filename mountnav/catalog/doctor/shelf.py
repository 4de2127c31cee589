"""The catalogs of a shelf under the names that commands know them by, for the doctor."""

from __future__ import annotations

from mountnav.catalog.doctor.diagnosis import Shelved
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.stars import Catalog
from mountnav.sky.coordinates import utc_now

_J2000_UNIX_S = 946_728_000.0
_JULIAN_YEAR_S = 365.25 * 86400.0


def shelved(catalog: Catalog) -> tuple[Shelved, ...]:
    """The catalogs on this machine that a solver with this catalog asks.

    Parameters
    ----------
    catalog : Catalog
        A shelf, or a single catalog.

    Returns
    -------
    tuple of Shelved
        What is asked over a network is not among them: its stars can't be counted beforehand.
    """
    at_hand = getattr(catalog, "at_hand", (catalog,))
    return tuple(Shelved(_slug(one), one) for one in at_hand)


def julian_year_now() -> float:
    """The year to count stars for: proper motion matters little, and a tenth of a year nothing."""
    return round(2000.0 + (utc_now().timestamp() - _J2000_UNIX_S) / _JULIAN_YEAR_S, 1)


def _slug(catalog: Catalog) -> str:
    return catalog.path.stem if isinstance(catalog, PackedStore) else catalog.name
