"""Gaia extracts as Apache Parquet files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.readers.gaia.tables import (
    LARGEST_CHUNK,
    QUANTITIES,
    Block,
    Layout,
    Piece,
    described_columns,
    epoch_in_texts,
    found_columns,
    require_unit,
)
from mountnav.errors import BadCatalog
from mountnav.extras import extra
from mountnav.files import open_buffered

if TYPE_CHECKING:
    import pyarrow as pa

_PIECE_ROWS = 2_000_000
"""Row groups are put together to parts of so many rows: what an interrupted import reads again at most.
Chosen by hand."""
_MAGIC = b"PAR1"


class ParquetFile:
    """A Parquet file. Implements `mountnav.catalog.readers.gaia.tables.TableFile`.

    Raises
    ------
    BadCatalog
        It is no Parquet file, is cut short, or its columns aren't Gaia's.
    """

    def __init__(self, path: Path) -> None:
        with extra("parquet", "Parquet files", BadCatalog):
            import pyarrow as pa
            import pyarrow.parquet as pq

        self.path = path
        size = path.stat().st_size
        with open_buffered(path) as file:
            start = file.read(4)
            file.seek(max(0, size - 4))
            end = file.read(4)
        if start != _MAGIC:
            raise malformed_at(path.name, 0, f"a Parquet file ({_MAGIC!r})", repr(start))
        if size < 12 or end != _MAGIC:
            raise malformed_at(
                path.name, max(0, size - 4), f"the end of a Parquet file ({_MAGIC!r})", repr(end)
            )
        try:
            with pq.ParquetFile(path) as file_:
                schema, metadata = file_.schema_arrow, file_.metadata
        except (pa.ArrowException, OSError, ValueError) as broken:
            raise malformed_at(path.name, size, "the description at the end", _first_line(broken)) from broken
        names = found_columns(path.name, schema.names)
        told = schema.metadata or {}
        described = described_columns(told.get(b"table_meta_yaml", b"").decode("utf-8", "replace"))
        for key, name in names.items():
            fields = schema.field(name).metadata or {}
            unit = fields.get(b"unit", b"").decode("utf-8", "replace")
            require_unit(path.name, name, QUANTITIES[key], unit or described.unit(name))
        epoch = None
        if "ref_epoch" not in names:
            epoch = described.epoch_yr(names["ra"]) or epoch_in_texts(
                path.name, [value.decode("utf-8", "replace") for value in told.values()]
            )
        self.layout = Layout(names, epoch)
        self._groups = [metadata.row_group(number) for number in range(metadata.num_row_groups)]
        self._rows = [group.num_rows for group in self._groups]

    def pieces(self) -> Sequence[Piece]:
        """Row groups, several together where they are small."""
        pieces, first, rows, size = [], 0, 0, 0
        for number, group in enumerate(self._groups):
            rows, size = rows + group.num_rows, size + group.total_byte_size
            if rows >= _PIECE_ROWS or number == len(self._groups) - 1:
                pieces.append(Piece(first, number + 1, size))
                first, rows, size = number + 1, 0, 0
        return pieces or [Piece(0, 0, 0)]

    def blocks(self, piece: Piece, quantities: Sequence[str]) -> Iterator[Block]:
        """Rows of a piece; see `mountnav.catalog.readers.gaia.tables.TableFile`."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        if piece.first == piece.end:
            return
        wanted = [self.layout.columns[key] for key in quantities]
        row = sum(self._rows[: piece.first])
        try:
            with pq.ParquetFile(self.path, page_checksum_verification=True) as file:
                for batch in file.iter_batches(
                    batch_size=LARGEST_CHUNK, row_groups=list(range(piece.first, piece.end)), columns=wanted
                ):
                    values = {
                        key: arrow_values(self.path.name, key, batch.column(name))
                        for key, name in zip(quantities, wanted, strict=True)
                    }
                    yield Block(values, self._error_from(row))
                    row += batch.num_rows
        except (pa.ArrowException, OSError) as broken:
            raise malformed_at(
                self.path.name, row, "whole columns", _first_line(broken), unit="row"
            ) from broken

    def _error_from(self, first: int) -> Any:
        def error_at(row: int, expected: str, found: str) -> BadCatalog:
            return malformed_at(self.path.name, first + row, expected, found, unit="row")

        return error_at


def arrow_values(file: str, key: str, column: pa.Array[Any]) -> NDArray[Any]:
    """Values of a quantity from an Arrow column.

    Parameters
    ----------
    file : str
        For the message.
    key : str
        The quantity.

    Returns
    -------
    ndarray, shape (n,)
        As `mountnav.catalog.readers.gaia.tables.Block` has them.

    Raises
    ------
    BadCatalog
        The column is of a type that such a quantity can't have.
    """
    import pyarrow as pa

    kind = QUANTITIES[key].kind
    try:
        if kind == "text":
            return np.array(column.cast(pa.string()).fill_null("").to_pylist(), dtype=str)
        if kind == "whole" and pa.types.is_integer(column.type):
            whole: NDArray[np.int64] = column.cast(pa.int64()).fill_null(0).to_numpy(zero_copy_only=False)
            return whole
        if pa.types.is_boolean(column.type):
            column = column.cast(pa.int8())
        if pa.types.is_string(column.type) or pa.types.is_dictionary(column.type):
            raise pa.ArrowInvalid(f"{column.type}")
        numbers: NDArray[np.float64] = column.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
        return numbers.astype(np.float64)
    except pa.ArrowException as wrong:
        raise BadCatalog(
            f"the column of {QUANTITIES[key].names[0]!r} is of type {column.type}",
            device=file,
            advice="save it with the archive's types: numbers as numbers",
        ) from wrong


def _first_line(broken: Exception) -> str:
    return (str(broken) or type(broken).__name__).splitlines()[0][:200]
