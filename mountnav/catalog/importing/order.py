"""What is to be imported, how far it is, what came of it, and the record that a later run compares with."""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.packed.format import Header
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.readers.kind import Part
from mountnav.catalog.space_motion import unit_vectors
from mountnav.catalog.stars import StarFlag
from mountnav.errors import BadRequest
from mountnav.files import read_text
from mountnav.parsing import json_of
from mountnav.sky.coordinates import Icrs

_MARGIN_DEG = 0.1
"""A zone's stars may have left it: the zones are those of the catalog's making, not of its epoch."""


@runtime_checkable
class KnowsDeclinations(Protocol):
    """A reader that knows between which declinations a part lies: others needn't be read at all."""

    def dec_range_deg(self, part: Part) -> tuple[float, float]:
        """Lowest and highest declination of the part."""
        ...


@dataclass(frozen=True, slots=True)
class Selection:
    """Which stars are wanted. What isn't given is no limit.

    Attributes
    ----------
    mag_limit : float, optional
        Faintest magnitude in the catalog's band, inclusive; stars without one are left out.
    center : Icrs, optional
        None: the whole sky.
    radius_deg : float, optional
        With `center`: how far the stars may be from it at the catalog's epoch.
    dec_range_deg : (float, float), optional
        Lowest and highest declination, both inclusive.

    Raises
    ------
    BadRequest
        A value is not finite or out of range.
    """

    mag_limit: float | None = None
    center: Icrs | None = None
    radius_deg: float | None = None
    dec_range_deg: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.mag_limit is not None and not -5.0 <= self.mag_limit <= 40.0:
            raise BadRequest(f"no magnitude limit: {self.mag_limit}", advice="give one of -5 to 40")
        if (self.center is None) != (self.radius_deg is None):
            raise BadRequest("a cone has a center and a radius", advice="give RA, Dec and radius")
        if self.radius_deg is not None and not 0.0 < self.radius_deg <= 180.0:
            raise BadRequest(
                f"no radius of a cone: {self.radius_deg}°", advice="give one of 0 to 180 degrees"
            )
        if self.dec_range_deg is not None:
            low, high = self.dec_range_deg
            if not -90.0 <= low < high <= 90.0:
                raise BadRequest(
                    f"no range of declinations: {low}° to {high}°",
                    advice="give the lower first, both within -90 and 90 degrees",
                )

    @property
    def is_everything(self) -> bool:
        """Whether nothing is left out."""
        return self == EVERYTHING

    def __str__(self) -> str:
        told = []
        if self.mag_limit is not None:
            told.append(f"to magnitude {self.mag_limit:.10g}")
        if self.center is not None and self.radius_deg is not None:
            ra, dec = f"{self.center.ra_deg:.10g}°", f"{self.center.dec_deg:.10g}°"
            told.append(f"within {self.radius_deg:.10g}° of RA {ra}, Dec {dec}")
        if self.dec_range_deg is not None:
            told.append(f"Dec {self.dec_range_deg[0]:.10g}° to {self.dec_range_deg[1]:.10g}°")
        return ", ".join(told)

    def wants_some_of(self, dec_range_deg: tuple[float, float]) -> bool:
        """Whether a zone of these declinations can hold a star that is wanted."""
        low, high = dec_range_deg[0] - _MARGIN_DEG, dec_range_deg[1] + _MARGIN_DEG
        wanted = [(-90.0, 90.0)] if self.dec_range_deg is None else [self.dec_range_deg]
        if self.center is not None and self.radius_deg is not None:
            wanted.append((self.center.dec_deg - self.radius_deg, self.center.dec_deg + self.radius_deg))
        return all(low <= last and first <= high for first, last in wanted)

    def of(self, columns: CatalogColumns) -> CatalogColumns:
        """The stars that are wanted, in the order they came."""
        if self.is_everything:
            return columns
        chosen: NDArray[np.bool_] = np.ones(columns.ra_deg.size, dtype=np.bool_)
        if self.mag_limit is not None:
            # as `PackedStore.cone`: a limit of 14 must not lose the stars of 14.000 to rounding
            chosen &= columns.mag <= self.mag_limit + 1e-6
            if columns.flags is not None:  # a stand-in is no magnitude
                chosen &= (columns.flags & StarFlag.NO_MAGNITUDE) == 0
        if self.dec_range_deg is not None:
            chosen &= (columns.dec_deg >= self.dec_range_deg[0]) & (columns.dec_deg <= self.dec_range_deg[1])
        if self.center is not None and self.radius_deg is not None:
            chosen[chosen] = self._in_cone(columns.ra_deg[chosen], columns.dec_deg[chosen])
        if chosen.all():
            return columns
        return rows_of(columns, np.flatnonzero(chosen))

    def _in_cone(self, ra_deg: NDArray[np.float64], dec_deg: NDArray[np.float64]) -> NDArray[np.bool_]:
        assert self.center is not None
        assert self.radius_deg is not None
        axis = unit_vectors(self.center.ra_deg, self.center.dec_deg)
        chord = unit_vectors(ra_deg, dec_deg) - axis[:, np.newaxis]
        inside: NDArray[np.bool_] = (chord**2).sum(axis=0) <= (
            2.0 * np.sin(np.radians(self.radius_deg) / 2.0)
        ) ** 2
        return inside


EVERYTHING = Selection()


def rows_of(columns: CatalogColumns, rows: NDArray[np.int64]) -> CatalogColumns:
    """Some stars of the columns, in the order of `rows`."""
    return CatalogColumns(
        ra_deg=columns.ra_deg[rows],
        dec_deg=columns.dec_deg[rows],
        pm_ra_cosdec_mas_yr=columns.pm_ra_cosdec_mas_yr[rows],
        pm_dec_mas_yr=columns.pm_dec_mas_yr[rows],
        mag=columns.mag[rows],
        error_curve=columns.error_curve[rows],
        color_mag=None if columns.color_mag is None else columns.color_mag[rows],
        flags=None if columns.flags is None else columns.flags[rows],
    )


@dataclass(frozen=True, slots=True)
class ImportOrder:
    """What is to be imported.

    Attributes
    ----------
    kind : str
        One of `mountnav.catalog.readers.CATALOGS`.
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


RECORD = "record.json"

Stamp = tuple[str, int, int]
"""A file as it is: path, size in bytes, time of the last change in ns."""


def stamp(part: Part) -> Stamp:
    """The file of a part as it is now.

    Raises
    ------
    OSError
        It isn't there, or can't be looked at.
    """
    there = part.path.stat()
    return str(part.path.absolute()), there.st_size, there.st_mtime_ns


@dataclass(frozen=True, slots=True)
class ImportRecord:
    """What is read, and how.

    Attributes
    ----------
    program : str
        Version of mountnav: another may read the same file otherwise.
    kind, selection, made_from : str
        Of the catalog, what of it is taken, and what the reader says it is made from.
    parts : mapping
        Name of each part to the `Stamp` of its file.
    """

    program: str
    kind: str
    selection: str
    made_from: str
    parts: Mapping[str, Stamp]

    @classmethod
    def of(
        cls, program: str, kind: str, selection: str, made_from: str, parts: Sequence[Part]
    ) -> ImportRecord:
        """The record of an import that begins now. Raises OSError if a file isn't there."""
        return cls(program, kind, selection, made_from, {part.name: stamp(part) for part in parts})

    def contradicts(self, earlier: ImportRecord, done: Collection[str]) -> str | None:
        """Why the parts that an earlier run brought in are of no use now.

        Parts that aren't in yet may have changed: a file that was found damaged is copied again, and then the
        import goes on.

        Parameters
        ----------
        done : collection of str
            Names of the parts that are in.

        Returns
        -------
        str or None
            None if they can stay.
        """
        if self.program != earlier.program:
            return f"the earlier run was made by mountnav {earlier.program}"
        if (self.kind, self.selection) != (earlier.kind, earlier.selection):
            return "the earlier run had other options"
        if self.made_from != earlier.made_from:
            return f"the earlier run read another catalog: {earlier.made_from}"
        for name in sorted(done):
            if name not in self.parts:
                return f"the file of {name}, which was imported, is no longer there"
            if self.parts[name] != tuple(earlier.parts.get(name, ())):
                return f"the file of {name}, which was imported, has changed"
        return None

    def write(self, folder: Path) -> None:
        """Write it into the import's folder, whole or not at all."""
        new = folder / f"{RECORD}.new"
        with new.open("w", encoding="utf-8") as file:
            json.dump(asdict(self), file)
            file.flush()
            os.fsync(file.fileno())
        new.replace(folder / RECORD)

    @classmethod
    def read(cls, folder: Path) -> ImportRecord | None:
        """What lies in an import's folder; None if there is nothing, or nothing sound."""
        try:
            found = json_of(read_text(folder / RECORD))
            parts = {
                str(name): (str(path), int(size), int(changed))
                for name, (path, size, changed) in found["parts"].items()
            }
            program, kind, selection, made_from = (
                str(found[key]) for key in ("program", "kind", "selection", "made_from")
            )
            return cls(program, kind, selection, made_from, parts)
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return None
