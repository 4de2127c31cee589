"""Readers of star catalogs as they come: one file each, all with the same face."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol

from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.errors import BadCatalog, BadRequest
from mountnav.files import require_plain

KINDS: dict[str, str] = {
    "ucac4": "UCAC4 zone files (z001 to z900)",
    "usno-b1": "USNO-B1.0 zone files (bNNNN.cat)",
    "gaia": "a Gaia extract with the archive's column names: FITS, CSV, ECSV, VOTable or Parquet",
    "astrometry-net": "astrometry.net index files (5200 series, and others with or without stars' columns)",
    "astap": "ASTAP / HNSKY star databases (.1476, .290)",
    "siril": "Siril's local Gaia catalog files",
}
"""What `open_reader` knows, with a description for people."""


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a catalog that is read as a whole: an import goes on after the last one that is in.

    Attributes
    ----------
    name : str
        Unique within the catalog, the same at every run.
    path : Path
        Its file.
    size_bytes : int
        How much there is to read: for the progress bar.
    """

    name: str
    path: Path
    size_bytes: int


class Reader(Protocol):
    """What a reader of one kind of catalog can do.

    Attributes
    ----------
    name : str
        The catalog's name for people and provenance: "UCAC4".
    band : str
        Photometric band of the magnitudes.
    color_name : str
        "B-V", "BP-RP", or empty.
    epoch_yr : float
        Julian year of all positions that it gives.
    made_from : str
        One line for people: what was read, and where it comes from.
    """

    name: str
    band: str
    color_name: str
    epoch_yr: float
    made_from: str

    def parts(self) -> Sequence[Part]:
        """The pieces, in a fixed order."""
        ...

    def read(self, part: Part) -> Iterator[CatalogColumns]:
        """The stars of a piece, in chunks of at most some 500,000. Raises `BadCatalog`."""
        ...


def open_reader(kind: str, path: Path) -> Reader:
    """Open a catalog as it came.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    path : Path
        A file, or the folder that holds the files.

    Returns
    -------
    Reader

    Raises
    ------
    BadRequest
        There is no such kind.
    BadCatalog
        There is no such file, or it isn't of that kind.
    """
    if kind not in KINDS:
        raise BadRequest(f"there is no kind of catalog {kind!r}", advice=f"there are: {', '.join(KINDS)}")
    if not path.exists():
        raise BadCatalog("there is no such file or folder", device=str(path), advice="check the path")
    if not path.is_dir():
        try:
            require_plain(path)
        except OSError as fault:
            raise BadCatalog(
                f"it can't be read: {fault.strerror}", device=str(path), advice="give a file or a folder"
            ) from fault
    opened: Callable[[Path], Reader] = import_module(
        f"mountnav.catalog.readers.{kind.replace('-', '_')}"
    ).open_catalog
    return opened(path)
