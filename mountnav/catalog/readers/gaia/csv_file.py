"""Gaia extracts as text: CSV, ECSV and VizieR's tables, packed or not, read in blocks whatever their size."""

from __future__ import annotations

import csv
import gzip
import math
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.readers.gaia.parquet_file import arrow_values
from mountnav.catalog.readers.gaia.tables import (
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
from mountnav.files import open_unpacked

_PIECE_BYTES = 256 * 2**20
"""A file is divided into parts of so many bytes: what an interrupted import reads again at most. Chosen by
hand."""
_BLOCK_BYTES = 16 * 2**20
"""Text that is parsed at a time; chosen by hand: pyarrow's columns take a few times as much memory."""
_LONGEST_LINE_BYTES = 2**20
"""A longer line is no table's: it is refused, so that a file without line ends can't fill the memory. Chosen
by hand."""
_DELIMITERS = (" ", ",", "\t", ";", "|")
"""ECSV has the first two [APE 6], other tables all but the first."""
_LONGEST_HEAD_LINES = 20_000
"""Lines of comments before the data after which a file is given up; chosen by hand, far above what the
descriptions of Gaia's columns take."""
_NOTHING = ["", "null", "NULL", "nan", "NaN", "None", "--"]
_TRUTHS = {"true": 1.0, "t": 1.0, "1": 1.0, "false": 0.0, "f": 0.0, "0": 0.0}
"""Words for true and false in the columns that are flags."""
_SOURCE_ID = r"^([0-9]{1,18}|[0-8][0-9]{18})$"
_RULE = re.compile(r"^[-\s|,;]*--[-\s|,;]*$")
_PADDING = re.compile(rb" *([\t|,;\n]) *")
_BROKEN_GZIP = (EOFError, gzip.BadGzipFile, zlib.error)


class CsvFile:
    """A text table. Implements `mountnav.catalog.readers.gaia.tables.TableFile`.

    Offsets in messages count bytes of the text, unpacked.

    Raises
    ------
    BadCatalog
        It has no line of column names, or its columns aren't Gaia's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._packed = path.name.lower().endswith(".gz")
        comments, names_line, following, at = self._head()
        described = described_columns("\n".join(comments)) if _is_ecsv(comments) else described_columns("")
        self._delimiter = _delimiter(comments, names_line)
        if self._delimiter not in _DELIMITERS:
            raise malformed_at(
                path.name, 0, "a delimiter of ECSV: a comma or a space", repr(self._delimiter[:40])
            )
        self._names = [name.strip() for name in self._cells(names_line)]
        units = [""] * len(self._names)
        self._is_padded = False
        self._data_at = at
        if len(following) == 2 and _RULE.match(following[1]):  # VizieR: a line of units, a rule
            self._data_at += sum(len(line.encode("utf-8")) for line in following)
            units = self._cells(following[0]) + units
            self._is_padded = True
        columns = found_columns(path.name, self._names)
        for key, name in columns.items():
            unit = units[self._names.index(name.strip())] or described.unit(name.strip())
            require_unit(path.name, name, QUANTITIES[key], unit)
        told = None
        if "ref_epoch" not in columns:
            told = described.epoch_yr(columns["ra"].strip())
            told = told or epoch_in_texts(path.name, [*described.texts(), *comments])
        self.layout = Layout(columns, told)
        self._at = {key: self._names.index(name.strip()) for key, name in columns.items()}

    def pieces(self) -> Sequence[Piece]:
        """Byte ranges of 256 MB; a packed file is one piece. A line belongs to the range it begins in."""
        size = self.path.stat().st_size
        if self._packed:
            return [Piece(self._data_at, -1, size)]
        return [
            Piece(first, min(first + _PIECE_BYTES, size), min(first + _PIECE_BYTES, size) - first)
            for first in range(self._data_at, max(size, self._data_at + 1), _PIECE_BYTES)
        ]

    def blocks(self, piece: Piece, quantities: Sequence[str]) -> Iterator[Block]:
        """Rows of a piece; see `mountnav.catalog.readers.gaia.tables.TableFile`."""
        for at, text in self._lines(piece):
            values = self._values(at, text, quantities)

            def error_at(row: int, expected: str, found: str, at: int = at, text: bytes = text) -> BadCatalog:
                offsets = [offset for offset, line in _each_line(at, text) if line.strip()]
                return malformed_at(self.path.name, offsets[row], expected, found)

            yield Block(values, error_at)

    def _opened(self) -> BinaryIO:
        return open_unpacked(self.path, packed=self._packed)

    def _head(self) -> tuple[list[str], str, list[str], int]:
        """Comment lines without '#', the line of names, up to two lines after it, where the rows begin."""
        comments: list[str] = []
        at = 0
        try:
            with self._opened() as file:
                for _ in range(_LONGEST_HEAD_LINES):
                    line = file.readline(_LONGEST_LINE_BYTES)
                    if not line.endswith(b"\n"):
                        raise malformed_at(
                            self.path.name,
                            at,
                            "lines, one of them of column names",
                            _shown(line) or "the end",
                        )
                    at += len(line)
                    text = self._text(at - len(line), line).lstrip("\ufeff")
                    if text.startswith("#"):
                        comments.append(text[1:].removeprefix(" ").rstrip("\r\n"))
                    elif text.strip():
                        following = [self._text(at, file.readline(_LONGEST_LINE_BYTES)) for _ in range(2)]
                        return comments, text.rstrip("\r\n"), following, at
        except _BROKEN_GZIP as broken:
            raise malformed_at(self.path.name, at, "a whole gzip file", str(broken)) from broken
        raise malformed_at(self.path.name, at, "a line of column names", "comments only")

    def _text(self, at: int, line: bytes) -> str:
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError as broken:
            raise malformed_at(self.path.name, at, "text in UTF-8", _shown(line)) from broken

    def _cells(self, line: str) -> list[str]:
        return next(csv.reader([line.rstrip("\r\n")], delimiter=self._delimiter), [])

    def _lines(self, piece: Piece) -> Iterator[tuple[int, bytes]]:
        """Whole lines in blocks, each with its offset."""
        at = piece.first
        try:
            with self._opened() as file:
                if self._packed:
                    file.read(at)
                elif at > self._data_at:
                    file.seek(at - 1)
                    at += len(file.readline()) - 1
                else:
                    file.seek(at)
                while self._packed or at < piece.end:
                    text = file.read(_BLOCK_BYTES if self._packed else min(_BLOCK_BYTES, piece.end - at))
                    if not text:
                        return
                    if not text.endswith(b"\n"):
                        text += file.readline(_LONGEST_LINE_BYTES)
                    if not text.endswith(b"\n"):
                        raise malformed_at(
                            self.path.name,
                            at + text.rfind(b"\n") + 1,
                            "a line with its end",
                            _shown(text[text.rfind(b"\n") + 1 :]),
                            advice="the file is cut off: copy it again (if it is whole, end its last line)",
                        )
                    yield at, text
                    at += len(text)
        except _BROKEN_GZIP as broken:
            raise malformed_at(
                self.path.name, at, "a whole gzip file", str(broken) or "a cut one", unit="unpacked byte"
            ) from broken

    def _values(self, at: int, text: bytes, quantities: Sequence[str]) -> dict[str, NDArray[Any]]:
        with extra("parquet", "Gaia's CSV files", BadCatalog):
            import pyarrow as pa
            from pyarrow import csv as pa_csv

        key_at = {self._at[key]: key for key in quantities}
        is_number = {key: QUANTITIES[key].kind == "number" for key in quantities}
        try:
            table = pa_csv.read_csv(
                pa.py_buffer(_PADDING.sub(rb"\1", text) if self._is_padded else text),
                read_options=pa_csv.ReadOptions(
                    column_names=[key_at.get(number, f" {number}") for number in range(len(self._names))]
                ),
                parse_options=pa_csv.ParseOptions(delimiter=self._delimiter),
                convert_options=pa_csv.ConvertOptions(
                    include_columns=list(quantities),
                    column_types={key: pa.float64() if is_number[key] else pa.string() for key in quantities},
                    null_values=_NOTHING,
                    strings_can_be_null=True,
                ),
            )
        except pa.ArrowException as broken:
            raise self._first_bad_line(at, text, quantities, broken) from broken
        columns = {key: table.column(key).combine_chunks() for key in quantities}
        values = {
            key: arrow_values(self.path.name, key, column)
            for key, column in columns.items()
            if QUANTITIES[key].kind in ("number", "text")
        }
        for key in quantities:
            if QUANTITIES[key].kind == "whole":
                values[key] = _source_ids(columns[key])
            elif QUANTITIES[key].kind == "truth":
                words, which = np.unique(
                    np.array(columns[key].fill_null("").to_pylist(), dtype=str), return_inverse=True
                )
                known = np.array([_TRUTHS.get(word.strip().lower(), np.nan) for word in words])
                values[key] = known[which]
        return values

    def _first_bad_line(
        self, at: int, text: bytes, quantities: Sequence[str], broken: Exception
    ) -> BadCatalog:
        """The line that stopped the reading, found again slowly."""
        for offset, line in _each_line(at, text):
            if not line.strip():
                continue
            cells = self._cells(self._text(offset, line))
            if len(cells) != len(self._names):
                return malformed_at(
                    self.path.name, offset, f"{len(self._names)} cells", f"{len(cells)}: {_shown(line)}"
                )
            for key in quantities:
                cell = cells[self._at[key]]
                if QUANTITIES[key].kind == "number" and not _is_number(cell):
                    return malformed_at(
                        self.path.name, offset, f"a number as {self._names[self._at[key]]}", repr(cell[:40])
                    )
        return malformed_at(self.path.name, at, "rows of a table", str(broken).splitlines()[0][:200])


def _is_ecsv(comments: list[str]) -> bool:
    return bool(comments) and comments[0].startswith("%ECSV")


def _delimiter(comments: list[str], names_line: str) -> str:
    if _is_ecsv(comments):
        for line in comments:
            if line.startswith("delimiter:"):
                return line.partition(":")[2].strip().strip("'\"") or " "
        return " "
    return max(_DELIMITERS[1:], key=names_line.count)


def _is_number(cell: str) -> bool:
    if cell.strip() in _NOTHING:
        return True
    try:
        return not math.isinf(float(cell))
    except ValueError:
        return False


def _source_ids(column: Any) -> NDArray[np.int64]:
    """Identifiers; 0 for what is none, such as one that lost its last digits in a spreadsheet."""
    with extra("parquet", "Gaia's CSV files", BadCatalog):
        import pyarrow as pa
        import pyarrow.compute as pc

    column = pc.utf8_trim_whitespace(column.fill_null(""))
    whole = pc.match_substring_regex(column, _SOURCE_ID)
    ids: NDArray[np.int64] = pc.if_else(whole, column, "0").cast(pa.int64()).to_numpy(zero_copy_only=False)
    return ids


def _each_line(at: int, text: bytes) -> Iterator[tuple[int, bytes]]:
    for line in text.splitlines(keepends=True):
        yield at, line
        at += len(line)


def _shown(line: bytes) -> str:
    text = line.decode("utf-8", "replace").rstrip("\r\n")
    return repr(text if len(text) <= 60 else text[:57] + "…")
