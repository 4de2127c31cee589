"""Readers of star catalogs as they come: a package for each kind, declared there and listed here."""

from __future__ import annotations

from pathlib import Path

from mountnav.catalog.readers import astap, astrometry_net, gaia, gaia_bright, siril, ucac4, usno_b1
from mountnav.catalog.readers.kind import CatalogKind, Credit, Reader
from mountnav.errors import BadCatalog, BadRequest
from mountnav.files import require_plain

__all__ = ["CATALOGS", "credit_of", "open_reader"]

CATALOGS: dict[str, CatalogKind] = {
    kind.name: kind
    for kind in (
        ucac4.CATALOG,
        usno_b1.CATALOG,
        gaia.CATALOG,
        gaia_bright.CATALOG,
        astrometry_net.CATALOG,
        astap.CATALOG,
        siril.CATALOG,
    )
}
"""All kinds by name, in the order in which messages list them."""


def open_reader(kind: str, path: Path) -> Reader:
    """Open a catalog as it came.

    Parameters
    ----------
    kind : str
        One of `CATALOGS`.
    path : Path
        A file, or the folder that holds the files.

    Raises
    ------
    BadRequest
        There is no such kind.
    BadCatalog
        There is no such file, or it isn't of that kind.
    """
    if kind not in CATALOGS:
        raise BadRequest(f"there is no kind of catalog {kind!r}", advice=f"there are: {', '.join(CATALOGS)}")
    if not path.exists():
        raise BadCatalog("there is no such file or folder", device=str(path), advice="check the path")
    if not path.is_dir():
        try:
            require_plain(path)
        except OSError as fault:
            raise BadCatalog(
                f"it can't be read: {fault.strerror}", device=str(path), advice="give a file or a folder"
            ) from fault
    return CATALOGS[kind].open(path)


def credit_of(made_from: str) -> Credit | None:
    """The credit of an imported catalog; None if its kind isn't stated, or isn't known.

    Parameters
    ----------
    made_from : str
        As in the header: the kind of the import, a colon, and what was read.
    """
    kind = CATALOGS.get(made_from.split(":", 1)[0])
    return None if kind is None else kind.credit
