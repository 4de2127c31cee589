"""What is to be imported, how far it is, and what came of it: what job and callers tell each other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from mountnav.catalog.importing.selection import EVERYTHING, Selection
from mountnav.catalog.packed.format import Header


@dataclass(frozen=True, slots=True)
class ImportOrder:
    """What is to be imported.

    Attributes
    ----------
    kind : str
        One of `mountnav.catalog.readers.KINDS`.
    source : Path
        A file, or the folder that holds the files.
    slug : str
        The name it will have.
    folder : Path
        Of the imported catalogs; made if it isn't there.
    selection : Selection
        What of it is taken.
    force : bool
        Whether it may take the place of a catalog of that name.
    """

    kind: str
    source: Path
    slug: str
    folder: Path
    selection: Selection = EVERYTHING
    force: bool = False


@dataclass(frozen=True, slots=True)
class ImportProgress:
    """How far an import is.

    Attributes
    ----------
    stage : str
        "reading", "packing" (sorting and writing), "checking".
    share : float
        Of the stage, 0 to 1.
    parts_done, parts : int
    bytes_done, size_bytes : int
        Of the source, as far as it is read.
    stars : int
        So far.
    """

    stage: Literal["reading", "packing", "checking"]
    share: float
    parts_done: int
    parts: int
    bytes_done: int
    size_bytes: int
    stars: int


@dataclass(frozen=True, slots=True)
class Imported:
    """What came of it.

    Attributes
    ----------
    path : Path
        The packed file.
    header : Header
    parts : int
        How many were read, earlier runs included.
    resumed : int
        How many of them were in before this run.
    compared : int
        Stars of the source that were looked for in the file, and found.
    """

    path: Path
    header: Header
    parts: int
    resumed: int
    compared: int
