"""Gaia extracts as VOTables [IVOA VOTable 1.4], whichever way they hold their rows."""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers.expat import ExpatError

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.catalog.readers.gaia.tables import (
    LARGEST_CHUNK,
    QUANTITIES,
    Block,
    Layout,
    Piece,
    epoch_in_texts,
    epoch_of_label,
    found_columns,
    require_unit,
)
from mountnav.errors import BadCatalog
from mountnav.files import open_unpacked

LARGEST_BYTES = 1_000_000_000
"""A VOTable is read as a whole; a larger one wouldn't fit the memory of an observatory's computer."""

_END = re.compile(rb"</(?:\w+:)?VOTABLE\s*>\s*(?:<!--.*-->\s*)?$", re.DOTALL)
_UNREADABLE = (
    RecursionError,
    ExpatError,
    ElementTree.ParseError,
    ValueError,
    TypeError,
    LookupError,
    OSError,
    SyntaxError,
    NotImplementedError,
)


class VoTableFile:
    """The first table of a VOTable. Implements `mountnav.catalog.readers.gaia.tables.TableFile`.

    Raises
    ------
    BadCatalog
        It is no VOTable, is cut short, too large, the answer to a failed query, or its columns aren't Gaia's.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._head = _Head()
        content = self._content()
        try:
            self._head.read(io.BytesIO(content))
        except _UNREADABLE as broken:
            raise malformed_at(path.name, 0, "a VOTable", str(broken)) from broken
        self._require_good_answer(self._head.infos)
        names = found_columns(path.name, self._head.units)
        for key, name in names.items():
            require_unit(path.name, name, QUANTITIES[key], self._head.units[name])
        told = None
        if "ref_epoch" not in names:
            told = self._head.epoch_yr(names["ra"])
            told = told or epoch_in_texts(path.name, self._head.texts)
        self.layout = Layout(names, told)

    def pieces(self) -> Sequence[Piece]:
        """The whole file."""
        return [Piece(0, 1, self.path.stat().st_size)]

    def blocks(self, piece: Piece, quantities: Sequence[str]) -> Iterator[Block]:
        """Rows; see `mountnav.catalog.readers.gaia.tables.TableFile`."""
        from astropy.io import votable

        listed = list(self._head.units)
        wanted = {key: listed.index(self.layout.columns[key]) for key in quantities}
        try:
            parsed = votable.parse(
                io.BytesIO(self._content()),
                columns=sorted(set(wanted.values())),
                table_number=0,
                verify="ignore",
            )
            table = parsed.get_first_table()
            rows, ids = table.array, [field.ID for field in table.all_fields]
        except (*_UNREADABLE, votable.exceptions.VOWarning) as broken:
            raise malformed_at(
                self.path.name,
                0,
                "a VOTable that can be read",
                (str(broken) or repr(broken)).splitlines()[0][:200],
            ) from broken
        infos = [(info.name or "", info.value or "", info.content or "") for info in _infos(parsed.resources)]
        self._require_good_answer(
            [*infos, *((i.name or "", i.value or "", i.content or "") for i in table.infos)]
        )
        if self._head.rows is not None and len(rows) != self._head.rows:
            raise malformed_at(
                self.path.name,
                len(rows),
                f"{self._head.rows} rows, as the table says",
                f"{len(rows)}",
                unit="row",
            )
        fields = {key: ids[number] for key, number in wanted.items()}
        for first in range(0, len(rows), LARGEST_CHUNK):
            part = rows[first : first + LARGEST_CHUNK]

            def error_at(row: int, expected: str, found: str, first: int = first) -> BadCatalog:
                return malformed_at(self.path.name, first + row, expected, found, unit="row")

            yield Block(
                {key: _values(self.path.name, key, part[field]) for key, field in fields.items()}, error_at
            )

    def _content(self) -> bytes:
        """The text, unpacked; refused if it has no end."""
        size = self.path.stat().st_size
        packed = self.path.name.lower().endswith(".gz")
        content = b""
        if size <= LARGEST_BYTES:
            try:
                with open_unpacked(self.path, packed=packed) as file:
                    content = file.read(LARGEST_BYTES + 1)
            except (EOFError, gzip.BadGzipFile, zlib.error) as broken:
                raise malformed_at(self.path.name, size, "a whole gzip file", str(broken)) from broken
        if size > LARGEST_BYTES or len(content) > LARGEST_BYTES:
            raise BadCatalog(
                f"is larger than {LARGEST_BYTES // 10**6} MB; a VOTable can only be read as a whole",
                device=self.path.name,
                advice="save it as FITS, CSV or Parquet, or in several files",
            )
        if not _END.search(content[-4096:]):
            raise malformed_at(
                self.path.name, len(content), "the end tag </VOTABLE>", repr(content[-40:]), unit="byte"
            )
        return content

    def _require_good_answer(self, infos: Sequence[tuple[str, str, str]]) -> None:
        for name, value, content in infos:
            status = value.strip().upper() if name.strip().upper() == "QUERY_STATUS" else ""
            if status == "ERROR":
                raise BadCatalog(
                    f"is a server's error: {' '.join(content.split())[:200] or 'no reason told'}",
                    device=self.path.name,
                    advice="ask the server again",
                )
            if status == "OVERFLOW" or "truncated result" in f"{value} {content}".lower():
                raise BadCatalog(
                    "isn't whole: the server cut its answer at the greatest number of rows",
                    device=self.path.name,
                    advice="raise the limit (MAXREC, TOP; log in at the archive), or ask for smaller areas",
                )


class _Head:
    """Everything before the rows of the first table."""

    def __init__(self) -> None:
        self.infos: list[tuple[str, str, str]] = []
        self.units: dict[str, str] = {}
        self.rows: int | None = None
        self.texts: list[str] = []
        self._systems: dict[str, str] = {}
        self._refs: dict[str, str] = {}

    def read(self, file: io.BytesIO) -> None:
        root = ""
        for event, element in ElementTree.iterparse(file, events=("start", "end")):
            tag = element.tag.rpartition("}")[2]
            if not root:
                root = tag
                if root != "VOTABLE":
                    raise ValueError(f"its outermost element is {root}")
            if event == "start" and tag == "TABLE":
                told = element.get("nrows", "")
                self.rows = int(told) if told.isdecimal() and len(told) < 19 else None
                self.texts.append(element.get("name", ""))
            if event == "start" and tag == "DATA":
                return
            if event == "end":
                self._note(tag, element)

    def _note(self, tag: str, element: ElementTree.Element) -> None:
        name, value = element.get("name", ""), element.get("value", "")
        if tag == "INFO":
            self.infos.append((name, value, element.text or ""))
            self.texts += [value, element.text or ""]
        elif tag == "COOSYS":
            self._systems[element.get("ID", "")] = element.get("epoch", "")
        elif tag == "PARAM":
            self.texts.append(value)
        elif tag == "DESCRIPTION":
            self.texts.append(element.text or "")
        elif tag == "FIELD":
            if name in self.units:
                name = f"{name} "  # a second of that name: `found_columns` refuses it if it matters
            self.units[name] = element.get("unit", "")
            self._refs[name] = element.get("ref", "")

    def epoch_yr(self, ra_column: str) -> float | None:
        """Epoch of the coordinate system that the column refers to."""
        return epoch_of_label(self._systems.get(self._refs[ra_column], ""))


def _infos(resources: Sequence[Any]) -> Iterator[Any]:
    for resource in resources:
        yield from resource.infos
        for table in resource.tables:
            yield from table.infos
        yield from _infos(resource.resources)


def _values(file: str, key: str, column: Any) -> NDArray[Any]:
    kind = QUANTITIES[key].kind
    data, mask = np.ma.getdata(column), np.ma.getmaskarray(column)
    if kind == "text":
        texts = np.array(
            [text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text) for text in data]
        )
        texts = texts.astype(str)
        texts[mask] = ""
        return np.char.strip(texts)
    if data.dtype.kind not in "biuf" or data.ndim != 1:
        raise BadCatalog(
            f"the column of {QUANTITIES[key].names[0]!r} holds no numbers",
            device=file,
            advice="save it with the archive's types: numbers as numbers",
        )
    if kind == "whole" and data.dtype.kind in "iu":
        return np.where(mask, 0, data).astype(np.int64)
    numbers = data.astype(np.float64)
    numbers[mask] = np.nan
    return numbers
