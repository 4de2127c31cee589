"""The tables of an archive: their columns, and Parquet files that hold the same bytes for the same rows.

The version of the schema stands in each archive (`mountnav.archive.folder.FORMAT`). New columns come at the
end, and none changes its meaning. `number` is the frame's place in the work list, and joins all tables.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mountnav.archive.columns import (
    EXPOSURE,
    EXTENSION,
    FILE,
    PLATE_COLUMNS,
    QUALITY_COLUMNS,
    REASON_COLUMNS,
    SOLVED,
    STAR_COLUMNS,
    TOLD_COLUMNS,
    WCS,
    Column,
    Row,
    parquet_schema,
)
from mountnav.errors import BadRequest

if TYPE_CHECKING:
    import pyarrow as pa

NUMBER = Column("number", "int64", "", "place in the work list, from 0; the same in all tables")

LIST_COLUMNS = (
    NUMBER,
    FILE,
    EXTENSION,
    Column("bytes", "int64", "byte", "size as the list was made; empty where it wasn't known"),
    Column("ra_deg", "double", "deg", "hint of the table, ICRS; empty: the run's, or the header's"),
    Column("dec_deg", "double", "deg", ""),
    Column("radius_deg", "double", "deg", "how wrong that may be"),
    Column("scale_low_arcsec_px", "double", "arcsec / pix", "hint of the table"),
    Column("scale_high_arcsec_px", "double", "arcsec / pix", ""),
)
"""The work list: a row for each frame that is to be solved."""

PRIOR_COLUMNS = (
    Column(
        "prior",
        "string",
        "",
        "held: solved at the scale learned of its camera, and the odds are those of that scale alone; "
        "failed: not so, and then treated as without it; empty: nothing was assumed",
    ),
    Column("prior_frames", "int64", "", "frames that the scale was learned from"),
    Column("prior_scale_low_arcsec_px", "double", "arcsec / pix", "what was assumed"),
    Column("prior_scale_high_arcsec_px", "double", "arcsec / pix", ""),
)
"""What was assumed of a frame from others."""

FRAME_TABLE = (
    NUMBER,
    FILE,
    EXTENSION,
    Column(
        "address", "string", "", "SHA-256 of content, extension, hint and recipe: what decides the result"
    ),
    Column("sha256", "string", "", "of the file's bytes, header and pixels; empty where it couldn't be read"),
    Column("bytes", "int64", "byte", "of the file as it was read"),
    Column("outcome", "string", "", "solved, refused, or set_aside"),
    SOLVED,
    Column("instrument", "string", "", "INSTRUME"),
    Column("telescope", "string", "", "TELESCOP"),
    Column("field", "string", "", "OBJECT"),
    Column("mid_exposure_utc", "string", "", "ISO 8601; empty where the header doesn't tell"),
    *QUALITY_COLUMNS,
    *TOLD_COLUMNS,
    *PRIOR_COLUMNS,
)
"""A row for each frame of the chunk, in the order of the work list."""

SOLUTION_TABLE = (NUMBER, *PLATE_COLUMNS, WCS)
"""A row for each frame that was solved."""

REFUSAL_TABLE = (
    NUMBER,
    *REASON_COLUMNS,
    Column("set_aside", "bool", "", "no verdict: it was tried twice, and hung, or ended what tried it"),
)
"""A row for each frame that was not."""

EXPOSURE_TABLE = (NUMBER, EXPOSURE, *PLATE_COLUMNS, WCS)
"""A row for each exposure of each plate that was solved, in runs that seek several; the first is that of the
solutions."""

PAIR_TABLE = (NUMBER, *STAR_COLUMNS)
"""A row for each identified star, where pairs were asked for."""

COST_TABLE = (
    NUMBER,
    Column("read_s", "double", "s", "wall time of decoding"),
    Column("measure_s", "double", "s", "wall time"),
    Column("identify_s", "double", "s", "wall time"),
    Column("total_s", "double", "s", "wall time from the order to the answer, tries included"),
    Column("tries", "int64", "", "1, or 2 where the first one hung or died"),
    Column(
        "fetch_s", "double", "s", "wall time until the frame was here and hashed, while others were solved"
    ),
    Column("waited_s", "double", "s", "that part of it during which nothing else was left to solve"),
)
"""What each frame took: the only table that differs from run to run. Its metadata tell host and libraries."""

ROWS_AT_ONCE = 20_000
"""Rows that a table keeps in memory before they are written, as one row group. Doubled, a worker that writes
pairs holds some 10 MB more."""


class TableFile:
    """A Parquet file that is written row by row, in bounded memory.

    The same rows give the same bytes: what is written depends on their number alone, not on when they come.

    Parameters
    ----------
    path : Path
        A new file.
    metadata : dict, optional
        Texts that go with the table as a whole.
    """

    def __init__(self, path: Path, columns: Sequence[Column], metadata: dict[str, str] | None = None) -> None:
        import pyarrow.parquet as pq

        schema = parquet_schema(columns)
        self._schema: pa.Schema = schema.with_metadata(metadata) if metadata else schema
        self._file = open(path, "xb")  # noqa: SIM115  closed by `close`
        self._writer = pq.ParquetWriter(self._file, self._schema, compression="zstd")
        self._names = [column.name for column in columns]
        self._columns: list[list[Any]] = [[] for _ in columns]
        self.rows = 0

    def add(self, row: Row) -> None:
        """Add a row; what it doesn't name is empty. Raises `OSError`."""
        for name, column in zip(self._names, self._columns, strict=True):
            column.append(row.get(name))
        self.rows += 1
        if len(self._columns[0]) >= ROWS_AT_ONCE:
            self._flush()

    def close(self) -> None:
        """Write what is left, and have it on the disk. Raises `OSError`."""
        self._flush()
        self._writer.close()
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Close it as it is: nobody will read it."""
        with suppress(Exception):  # a full disk has been told already
            self._writer.close()
        self._writer.is_open = False  # else it tries again as it goes
        with suppress(OSError):
            self._file.close()

    def _flush(self) -> None:
        import pyarrow as pa

        if not self._columns[0]:
            return
        arrays = [
            pa.array(values, field.type) for values, field in zip(self._columns, self._schema, strict=True)
        ]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self._columns = [[] for _ in self._names]


def write_table(
    path: Path, columns: Sequence[Column], rows: Iterable[Row], metadata: dict[str, str] | None = None
) -> int:
    """Write a new Parquet file, on the disk when this returns; how many rows it has. Raises `OSError`."""
    table = TableFile(path, columns, metadata)
    try:
        for row in rows:
            table.add(row)
        table.close()
    except BaseException:
        table.abandon()
        raise
    return table.rows


def read_rows(path: Path, names: Sequence[str] | None = None) -> Iterator[Row]:
    """The rows of a Parquet file of ours, in bounded memory.

    Raises
    ------
    BadRequest
        It isn't there, or is damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        with pq.ParquetFile(path) as file:
            for batch in file.iter_batches(columns=list(names) if names is not None else None):
                yield from batch.to_pylist()
    except (OSError, pa.ArrowException) as fault:
        raise BadRequest(
            f"{path} can't be read: {fault}", advice="`mountnav archive verify` says what else is damaged"
        ) from fault


def sha256_of(path: Path) -> str:
    """Hash a file of the store. Raises `OSError`."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
