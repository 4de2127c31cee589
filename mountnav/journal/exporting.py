"""The journal as tables for other programs: CSV, Parquet, FITS; every column with its unit."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import Boolean, Integer, Table

from mountnav.errors import BadRequest
from mountnav.extras import extra
from mountnav.files import require_replaceable
from mountnav.journal.database import Facts, Number, UtcTime
from mountnav.journal.reading import ALL, JournalReader, Wanted
from mountnav.journal.tables import command, entry, look
from mountnav.units import SECONDS_PER_DAY

TABLES: Mapping[str, Table] = {"looks": look, "commands": command, "entries": entry}
"""What can be exported."""
ENDINGS = (".csv", ".parquet", ".fits")
# Rows that are read and written at once. Chosen by hand to bound the memory; doubled, it takes twice as
# much.
_CHUNK = 5000
_FITS_UNITS = {"": None, "deg_C": None}
"""FITS has no degree Celsius; the name `temperature_c` tells it all the same."""
_UNITS = {
    "_arcsec_px": "arcsec/pixel",
    "_arcsec2": "arcsec2",
    "_arcsec": "arcsec",
    "_deg": "deg",
    "_hpa": "hPa",
    "_c": "deg_C",
    "_um": "um",
    "_px": "pixel",
    "_mag": "mag",
    "_adu": "adu",
    "_s": "s",
}


@dataclass(frozen=True, slots=True)
class Exported:
    """A column of an export.

    Attributes
    ----------
    name : str
        As in the journal.
    unit : str
        As FITS writes units; empty for words, numbers of things, and truth values. Instants: ``UTC``.
    """

    name: str
    unit: str
    kind: str


def columns_of(table: Table) -> list[Exported]:
    """The columns of an exported table, in the journal's order."""
    found = []
    for column in table.columns:
        kinds = (
            (UtcTime, "time"),
            (Number, "number"),
            (Boolean, "truth"),
            (Integer, "count"),
            (Facts, "json"),
        )
        kind = next((name for of, name in kinds if isinstance(column.type, of)), "text")
        unit = "UTC" if kind == "time" else _unit(column.name) if kind == "number" else ""
        found.append(Exported(column.name, unit, kind))
    return found


def _unit(name: str) -> str:
    return next((unit for ending, unit in _UNITS.items() if name.endswith(ending)), "")


def export(reader: JournalReader, what: str, path: Path, wanted: Wanted = ALL) -> int:
    """Write rows of one table into a file, by its ending. A file that is there is replaced at the end.

    Parameters
    ----------
    path : Path
        ``.csv``, ``.parquet`` or ``.fits``.

    Returns
    -------
    int
        Number of rows.

    Raises
    ------
    BadRequest
        No such table, or no such ending.
    JournalFailed, BadSettings, Unknown
        It can't be read.
    OSError
        The file can't be written.
    """
    if what not in TABLES:
        raise BadRequest(f"there is no table {what!r}", advice=f"one of {', '.join(TABLES)}")
    if path.suffix.lower() not in ENDINGS:
        raise BadRequest(
            f"{path.name}: the format can't be told from the name", advice=f"end it with {', '.join(ENDINGS)}"
        )
    table = TABLES[what]
    columns = columns_of(table)
    write = {".csv": _csv, ".parquet": _parquet, ".fits": _fits}[path.suffix.lower()]
    require_replaceable(path)
    part = path.with_name(path.name + ".part")
    try:
        count = write(part, what, columns, reader.rows(table, wanted))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return count


def _csv(path: Path, _what: str, columns: list[Exported], rows: Iterable[Mapping[str, Any]]) -> int:
    """Comma-separated, UTF-8; the unit stands behind the name in brackets."""
    count = 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f"{one.name} [{one.unit}]" if one.unit else one.name for one in columns])
        for row in rows:
            writer.writerow([_cell(row[one.name], one) for one in columns])
            count += 1
    return count


def _cell(value: Any, column: Exported) -> str:
    if value is None:
        return ""
    if column.kind == "time":
        return _iso(value)
    if column.kind == "json":
        return json.dumps(value, ensure_ascii=False)
    if column.kind == "number":
        return repr(float(value))
    return ("true" if value else "false") if column.kind == "truth" else str(value)


def _iso(utc: datetime) -> str:
    return utc.strftime("%Y-%m-%dT%H:%M:%S.%fZ")


def _parquet(path: Path, what: str, columns: list[Exported], rows: Iterable[Mapping[str, Any]]) -> int:
    """Instants as microseconds UTC; the unit stands in each field's metadata under ``unit``."""
    with extra("parquet", "Parquet files"):
        import pyarrow as pa
        import pyarrow.parquet as pq

    kinds = {
        "time": pa.timestamp("us", tz="UTC"),
        "number": pa.float64(),
        "count": pa.int64(),
        "truth": pa.bool_(),
        "json": pa.string(),
        "text": pa.string(),
    }
    schema = pa.schema(
        [pa.field(one.name, kinds[one.kind], metadata={"unit": one.unit}) for one in columns],
        metadata={"table": what, "made by": "mountnav journal export"},
    )
    count = 0
    with pq.ParquetWriter(path, schema) as writer:
        for chunk in _chunks(rows):
            arrays = [
                pa.array([_arrow(row[one.name], one) for row in chunk], kinds[one.kind]) for one in columns
            ]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema))
            count += len(chunk)
    return count


def _arrow(value: Any, column: Exported) -> Any:
    return json.dumps(value, ensure_ascii=False) if column.kind == "json" and value is not None else value


def _fits(path: Path, what: str, columns: list[Exported], rows: Iterable[Mapping[str, Any]]) -> int:
    """A binary table; instants as ISO 8601 and as days (MJD, UTC), -1 for truth and counts not known."""
    from astropy.io import fits

    held: dict[str, list[Any]] = {one.name: [] for one in columns}
    count = 0
    for row in rows:
        for one in columns:
            held[one.name].append(row[one.name])
        count += 1
    made = []
    for one in columns:
        values = held.pop(one.name)
        if one.kind == "number":
            array = np.array([math.nan if value is None else value for value in values], dtype=np.float64)
            made.append(
                fits.Column(name=one.name, format="D", unit=_FITS_UNITS.get(one.unit, one.unit), array=array)
            )
        elif one.kind in ("count", "truth"):
            array = np.array([-1 if value is None else int(value) for value in values], dtype=np.int64)
            made.append(fits.Column(name=one.name, format="K", null=-1, array=array))
        elif one.kind == "time":
            made.append(_text_column(fits, one.name, ["" if v is None else _iso(v) for v in values]))
            days = np.array([math.nan if value is None else _mjd(value) for value in values])
            made.append(fits.Column(name=f"{one.name}_mjd", format="D", unit="d", array=days))
        else:
            made.append(_text_column(fits, one.name, [_cell(value, one) for value in values]))
    table = fits.BinTableHDU.from_columns(made, name=what.upper())
    table.header["TIMESYS"] = ("UTC", "of all instants")
    table.header["CREATOR"] = "mountnav journal export"
    table.writeto(path, overwrite=True)
    return count


def _text_column(fits: Any, name: str, values: list[str]) -> Any:
    r"""FITS holds ASCII alone: what else there is stands as escapes (``\u2033`` for a second of arc)."""
    held = [value.encode("ascii", "backslashreplace") for value in values]
    width = max([1, *(len(value) for value in held)])
    return fits.Column(name=name, format=f"{width}A", array=np.array(held, dtype=f"S{width}"))


def _mjd(utc: datetime) -> float:
    since = utc - datetime(1858, 11, 17, tzinfo=utc.tzinfo)
    return since.days + (since.seconds + since.microseconds * 1e-6) / SECONDS_PER_DAY


def _chunks(rows: Iterable[Mapping[str, Any]]) -> Iterator[list[Mapping[str, Any]]]:
    moving = iter(rows)
    while chunk := list(islice(moving, _CHUNK)):
        yield chunk
