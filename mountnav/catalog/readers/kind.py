"""How a kind of catalog is declared, and what its reader can do.

The list of kinds is in `mountnav.catalog.readers`. This module imports little: the command line knows all
kinds, and imports the reader of one only when it reads a catalog.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from mountnav.catalog.packed.packing import CatalogColumns

INSTALLED_BYTES_PER_STAR = 18.0
"""Bytes of a star in an imported catalog with color and flags, its share of the tables included, by which the
doctor of catalogs says how large a catalog will be on the disk. Twice as many, and every size in its advice
is
twice as large; which catalog it recommends stays the same."""


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


@dataclass(frozen=True, slots=True)
class Credit:
    """What is to be said when a catalog is used (docs/reference/catalog-licenses.md).

    Attributes
    ----------
    terms : str
        License or terms of use, in a line.
    credit : str
        The line of credit that its makers ask for.
    """

    terms: str
    credit: str


@dataclass(frozen=True, slots=True)
class Edition:
    """A catalog of a kind that an observatory can get: how many stars, how deep, how precise, how large.

    Attributes
    ----------
    name : str
        For people.
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
    is_one_file : bool
        Whether an import is given a file rather than a folder.
    """

    name: str
    stars: int
    faintest_mag: float
    sigma_arcsec: float
    download_gb: float
    obtained: str
    densest_deg2: float | None = None
    has_magnitudes: bool = True
    is_one_file: bool = False

    @property
    def installed_gb(self) -> float:
        """Size once imported, in 10⁹ bytes."""
        return self.stars * INSTALLED_BYTES_PER_STAR / 1e9


@dataclass(frozen=True, slots=True)
class CatalogKind:
    """A kind of catalog that can be imported, as its own package declares it.

    Attributes
    ----------
    name : str
        What commands call it: ``mountnav catalog import NAME PATH``.
    files : str
        For people: which files these are.
    open : callable
        Opens the file, or the folder that holds the files, as a `Reader`; raises `BadCatalog` if it isn't of
        this kind. Imports the reader only then.
    editions : tuple of Edition
        Those that the doctor of catalogs recommends from.
    is_one_catalog : bool
        Whether all imports of the whole sky are alike, so that the doctor doesn't recommend one to an
        operator who has it; of other kinds there are deeper and shallower ones.
    source_bytes_per_star : int or None
        Size of a record where it is fixed: the stars are then counted by the size of the files, and an import
        that can't fit on the disk is refused before it begins.
    """

    name: str
    files: str
    credit: Credit
    open: Callable[[Path], Reader]
    editions: tuple[Edition, ...] = ()
    is_one_catalog: bool = False
    source_bytes_per_star: int | None = None
