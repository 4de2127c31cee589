"""Files of results: rows are added at their end, whole or not at all, and read back to resume a run.

A run that is ended by force loses at most the frame under way; of Parquet files, which are written again each
time, what came since the last time.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from api.batch.inputs import FrameFile
from api.batch.rows import FRAME_COLUMNS, Cell, Column, Row
from mountnav.archive.columns import parquet_schema
from mountnav.errors import BadRequest
from mountnav.extras import extra

if TYPE_CHECKING:
    import pyarrow as pa

PARQUET_EACH_S = 30.0
"""Seconds after which a Parquet file is written again at the earliest: what a run ended by force may lose."""
PARQUET_SHARE = 0.05
"""And only when so large a part of its rows is new: a long file isn't written a thousand times."""
LONGEST_LINE_BYTES = 64 << 20
"""Of a result file that is read back. A record has 3 kB; longer ones are none."""


class ResultFile(Protocol):
    """Where rows go."""

    def add(self, row: Row) -> None:
        """Add a row. Raises `OSError`."""

    def close(self) -> None:
        """Write what is left. Raises `OSError`."""


class TextTable:
    """A CSV or ECSV file, or one of these on the standard output.

    Parameters
    ----------
    path : str
        "-" for the standard output.
    ecsv : bool
        With units and descriptions before the rows, as astropy reads them.

    Raises
    ------
    BadRequest
        It holds something else, or can't be opened.
    """

    def __init__(self, path: str, columns: Sequence[Column], *, ecsv: bool) -> None:
        self._columns = columns
        head = "".join(_ecsv_head(columns)) if ecsv else ""
        names = _line([column.name for column in columns])
        self._file = _Lines(path, head + names)

    def add(self, row: Row) -> None:
        """Add a row. Raises `OSError`."""
        self._file.write(_line([row[column.name] for column in self._columns]))

    def close(self) -> None:
        """Close it."""
        self._file.close()


class JsonLines:
    """A file of JSON records, one a line: those of ``mountnav solve --json``."""

    def __init__(self, path: str) -> None:
        self._file = _Lines(path, "")

    def add_record(self, record: dict[str, Any]) -> None:
        """Add a record. Raises `OSError`."""
        self._file.write(json.dumps(record, ensure_ascii=False, separators=(",", ":")) + "\n")

    def close(self) -> None:
        """Close it."""
        self._file.close()


class ParquetTable:
    """A Parquet file, replaced by a longer one now and then, and at the end.

    Raises
    ------
    BadRequest
        It holds something else, or can't be read.
    """

    def __init__(self, path: str, columns: Sequence[Column]) -> None:
        self._path = Path(path)
        self._schema = parquet_schema(columns)
        self._table: pa.Table = self._schema.empty_table()
        self._fresh: list[Row] = []
        self._written_s = time.monotonic()
        if self._path.exists():
            self._table = self._read()
        elif not os.access(self._path.parent, os.W_OK):  # known now, and not after a night's work
            raise BadRequest(
                f"{path} can't be written: there is no such folder, or it is closed",
                advice="name another file",
            )

    def add(self, row: Row) -> None:
        """Add a row. Raises `OSError`."""
        self._fresh.append(row)
        waited_s = time.monotonic() - self._written_s
        if waited_s > PARQUET_EACH_S and len(self._fresh) >= PARQUET_SHARE * self._table.num_rows:
            self.close()

    def close(self) -> None:
        """Write the whole. Raises `OSError`."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        from mountnav.files import replace_bytes

        fresh = pa.Table.from_pylist(self._fresh, schema=self._schema)
        whole = pa.concat_tables([self._table, fresh]).combine_chunks()
        content = io.BytesIO()
        pq.write_table(whole, content, compression="zstd")
        replace_bytes(self._path, content.getbuffer())
        self._table, self._fresh, self._written_s = whole, [], time.monotonic()

    def _read(self) -> pa.Table:
        import pyarrow as pa
        import pyarrow.parquet as pq

        from mountnav.files import require_plain

        try:
            require_plain(self._path)
            found = pq.read_table(self._path)
        except (OSError, pa.ArrowException) as error:
            why = getattr(error, "strerror", None) or str(error)
            raise _not_ours(str(self._path), why) from error
        if not found.schema.equals(self._schema):
            raise _not_ours(str(self._path), "its columns are different")
        return found.cast(self._schema)


class _Lines:
    """Lines at the end of a file, each written at once; what a former run left unfinished is cut off.

    Parameters
    ----------
    head : str
        How the file begins; a file that is there must begin so.
    """

    def __init__(self, path: str, head: str) -> None:
        self._standard = path == "-"
        self._number = -1
        if self._standard:
            sys.stdout.write(head)
            return
        begins = head.encode()
        try:
            # a pipe or a device is written to as well, but what it holds can't be looked at
            self._number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
            size = os.fstat(self._number).st_size
            if size:
                if os.pread(self._number, len(begins), 0) != begins:
                    raise _not_ours(path, "its first line is different")
                os.ftruncate(self._number, _whole_lines(self._number, size))
            else:
                self._put(begins)
        except OSError as error:
            raise BadRequest(
                f"{path} can't be written: {error.strerror or error}", advice="name another file"
            ) from error

    def write(self, line: str) -> None:
        """Write a line. Raises `OSError`."""
        if self._standard:
            sys.stdout.write(line)
            sys.stdout.flush()
        else:
            self._put(line.encode("utf-8", "surrogateescape"))

    def close(self) -> None:
        if self._number >= 0:
            os.close(self._number)
            self._number = -1

    def _put(self, content: bytes) -> None:
        left = memoryview(content)
        while left:
            left = left[os.write(self._number, left) :]


def _whole_lines(number: int, size: int) -> int:
    """Where the last whole line of a file ends."""
    at = size
    while at:
        start = max(0, at - (1 << 16))
        found = os.pread(number, at - start, start).rfind(b"\n")
        if found >= 0:
            return start + found + 1
        at = start
    return 0


def _line(cells: Sequence[Cell]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow([_text(cell) for cell in cells])
    return line.getvalue()


def _text(cell: Cell) -> str:
    """A cell; one line each, so that a file cut short is mended by its last line."""
    if cell is None:
        return ""
    if isinstance(cell, str):
        return " ".join(cell.splitlines())
    return repr(cell)


def _ecsv_head(columns: Sequence[Column]) -> Iterator[str]:
    from astropy.table import Column as TableColumn
    from astropy.table import Table

    kinds = {"string": "str", "double": "float64", "int64": "int64", "bool": "bool"}
    table = Table(
        [
            TableColumn(
                [], name=one.name, dtype=kinds[one.kind], unit=one.unit or None, description=one.about or None
            )
            for one in columns
        ]
    )
    text = io.StringIO()
    table.write(text, format="ascii.ecsv", delimiter=",")
    for line in text.getvalue().splitlines(keepends=True):
        if line.startswith("#"):
            yield line


def _not_ours(path: str, why: str) -> BadRequest:
    return BadRequest(
        f"{path} exists already and is not a file of such results: {why}",
        advice="name another file, or remove it",
    )


def kind_of(path: str) -> str:
    """What a result file is by its name: "csv", "ecsv", "parquet", or "json".

    Raises
    ------
    BadRequest
        Its ending says none of these.
    """
    kinds = {".csv": "csv", ".ecsv": "ecsv", ".parquet": "parquet", ".json": "json", ".jsonl": "json"}
    kinds[".ndjson"] = "json"
    try:
        return kinds[Path(path).suffix.lower()]
    except KeyError:
        raise BadRequest(
            f"the kind of results that {path} holds is not known",
            advice="end it in .jsonl, .csv, .ecsv or .parquet",
        ) from None


class Held:
    """What a result file holds, by the content of the files.

    Parameters
    ----------
    path : str or None
        A file that isn't there holds nothing; None for no file.
    retry : bool
        What wasn't solved is to be tried again.

    Raises
    ------
    BadRequest
        It can't be read.
    """

    def __init__(self, path: str | None, *, retry: bool) -> None:
        self._solved: dict[tuple[str, str], bool] = {}
        self.without_hash = 0
        if path is not None and Path(path).exists():
            for row in _read_rows(path):
                sha256, extension = row.get("sha256"), row.get("extension")
                if not sha256:
                    self.without_hash += 1
                    continue
                solved = str(row.get("solved")).lower() == "true"
                if solved or not retry:
                    key = str(sha256), "" if extension is None else str(extension)
                    self._solved[key] = solved or self._solved.get(key, False)

    def solved(self, sha256: str, frame: FrameFile) -> bool | None:
        """Whether it is solved there; None if it isn't held."""
        return self._solved.get((sha256, "" if frame.hdu is None else str(frame.hdu)))


def _read_rows(path: str) -> Iterator[dict[str, Any]]:
    kind = kind_of(path)
    try:
        if kind == "parquet":
            with extra("parquet", "Parquet files"):
                import pyarrow.parquet as pq

            from mountnav.files import require_plain

            require_plain(Path(path))
            yield from pq.read_table(path, columns=["sha256", "extension", "solved"]).to_pylist()
            return
        from mountnav.files import open_buffered

        with open_buffered(Path(path)) as file:
            lines = _lines_of(file)
            if kind == "json":
                yield from (json.loads(line) for line in lines)
            else:
                yield from csv.DictReader(itertools.dropwhile(lambda line: line.startswith("# "), lines))
    except OSError as error:
        raise BadRequest(
            f"--resume {path}: {error.strerror or error}", advice="name a result file"
        ) from error
    except (ValueError, csv.Error, KeyError, AttributeError) as error:  # pyarrow's errors are ValueErrors
        raise BadRequest(
            f"--resume {path} holds no results: {str(error)[:200]}",
            advice="name a result file of `mountnav solve`",
        ) from error


def _lines_of(file: io.BufferedReader) -> Iterator[str]:
    """The whole lines; one without an end was never finished."""
    while line := file.readline(LONGEST_LINE_BYTES):
        if not line.endswith(b"\n"):
            return
        yield line.decode("utf-8", "replace")


__all__ = ["FRAME_COLUMNS", "Held", "JsonLines", "ParquetTable", "ResultFile", "TextTable", "kind_of"]
