"""Gaia extracts as FITS binary tables."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.readers.fits_tables import (
    FitsColumn,
    FitsTable,
    fits_tables,
    numbers,
    texts,
    whole_numbers,
)
from mountnav.catalog.readers.gaia.tables import (
    LARGEST_CHUNK,
    QUANTITIES,
    Block,
    Layout,
    Piece,
    epoch_in_texts,
    found_columns,
    require_unit,
)
from mountnav.errors import BadCatalog

_PIECE_BYTES = 256 * 2**20
"""As in `csv_file`."""


class FitsFile:
    """The first binary table of a FITS file. Implements `mountnav.catalog.readers.gaia.tables.TableFile`.

    Raises
    ------
    BadCatalog
        It is no FITS file, is cut short, or its table isn't Gaia's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        primary, tables = fits_tables(path)
        if not tables:
            raise malformed_at(path.name, path.stat().st_size, "a binary table extension", "the end")
        self.table: FitsTable = tables[0]
        columns = {column.name: column for column in self.table.columns}
        names = found_columns(path.name, [column.name for column in self.table.columns])
        self._columns = {key: columns[name] for key, name in names.items()}
        for key, column in self._columns.items():
            self._require_form(key, column)
            require_unit(path.name, column.name, QUANTITIES[key], column.unit)
        told = None
        if "ref_epoch" not in names:
            cards = [*primary.values.values(), *self.table.cards.values.values()]
            comments = [*primary.comments.values(), *self.table.cards.comments.values()]
            told = epoch_in_texts(path.name, [str(text) for text in (*cards, *comments)])
        self.layout = Layout(names, told)

    def pieces(self) -> Sequence[Piece]:
        """Row ranges of some 256 MB."""
        size, rows = self.table.row_bytes, self.table.rows
        step = max(1, _PIECE_BYTES // size)
        return [
            Piece(first, min(first + step, rows), size * (min(first + step, rows) - first))
            for first in range(0, max(rows, 1), step)
        ]

    def blocks(self, piece: Piece, quantities: Sequence[str]) -> Iterator[Block]:
        """Rows of a piece; see `mountnav.catalog.readers.gaia.tables.TableFile`."""
        wanted = {key: self._columns[key] for key in quantities}
        step = self.table.rows_at_once(LARGEST_CHUNK)
        for first in range(piece.first, piece.end, step):
            stored = self.table.read(wanted, first, min(first + step, piece.end))
            values = {key: _values(key, stored[key], column) for key, column in wanted.items()}

            def error_at(row: int, expected: str, found: str, first: int = first) -> BadCatalog:
                at = self.table.data_at + (first + row) * self.table.row_bytes
                return malformed_at(
                    self.path.name, at, expected, f"{found} (row {first + row + 1} of the table)"
                )

            yield Block(values, error_at)

    def _require_form(self, key: str, column: FitsColumn) -> None:
        is_text = QUANTITIES[key].kind == "text"
        if not (column.is_text if is_text else column.is_number):
            raise BadCatalog(
                f"column {column.name!r} has the form {column.count}{column.kind}, expected "
                + ("characters" if is_text else "one number a row"),
                device=self.path.name,
                advice="save it with the archive's columns",
            )


def _values(key: str, stored: NDArray[Any], column: FitsColumn) -> NDArray[Any]:
    kind = QUANTITIES[key].kind
    if kind == "text":
        return texts(stored)
    if kind == "whole":
        whole = whole_numbers(stored, column)
        return numbers(stored, column) if whole is None else whole
    return numbers(stored, column)
