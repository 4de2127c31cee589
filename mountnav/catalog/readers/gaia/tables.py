"""The one face of the file formats that Gaia extracts come in."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from numpy.typing import NDArray

from mountnav.errors import BadCatalog

LARGEST_CHUNK = 400_000


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows of a file that are read as a whole.

    Attributes
    ----------
    first, end : int
        Rows, row groups or bytes, as the format counts.
    size_bytes : int
    """

    first: int
    end: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class Block:
    """Some rows of a file.

    Attributes
    ----------
    values : dict
        Arrays by quantity, shape (n,): numbers and truth values (1, 0) as float64, NaN where there is none;
        whole numbers as int64, 0 where there is none; texts as str.
    error_at : callable
        Makes the error for a row of the block: (row, expected, found) -> BadCatalog.
    """

    values: dict[str, NDArray[Any]]
    error_at: Callable[[int, str, str], BadCatalog]


@dataclass(frozen=True, slots=True)
class Layout:
    """What the head of a file tells.

    Attributes
    ----------
    columns : dict
        The file's column by quantity (keys of `mountnav.catalog.readers.gaia.quantities.QUANTITIES`).
    epoch_yr : float or None
        Where no column has it: as told by the coordinate system, a description, the release.
    """

    columns: Mapping[str, str]
    epoch_yr: float | None = field(default=None)


class TableFile(Protocol):
    """A table on disk."""

    @property
    def layout(self) -> Layout:
        """What its head tells."""
        ...

    def pieces(self) -> Sequence[Piece]:
        """The file in pieces that are read one by one, in a fixed order."""
        ...

    def blocks(self, piece: Piece, quantities: Sequence[str]) -> Iterator[Block]:
        """The rows of a piece, some at a time, with the quantities asked for. Raises `BadCatalog`."""
        ...
