"""Binary tables of a FITS file [FITS 4.0, section 7.3], read range by range, with their offsets known."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.catalog.malformed import malformed_at
from mountnav.errors import BadCatalog
from mountnav.files import open_plain
from mountnav.reading.content import OnDisk
from mountnav.reading.fits_headers import BLOCK_LENGTH, COLUMN_BYTES, COLUMN_NUMBERS, Cards, read_cards

Array = NDArray[np.float64]

_FORM = re.compile(r"\s*(\d*)([LXBIJKAEDCMPQ])")
_NUMPY = {"L": "u1", **COLUMN_NUMBERS}
"""Columns of one number, as numpy calls them; logical ones are a byte."""
_LARGEST_READ_BYTES = 64 * 2**20
"""Bytes of rows that are read at a time; chosen by hand: memory grows with it."""


@dataclass(frozen=True, slots=True)
class FitsColumn:
    """A column as its header describes it.

    Attributes
    ----------
    name, unit : str
        TTYPE, TUNIT.
    kind : str
        The letter of TFORM.
    count, offset : int
        Elements in a row, and the byte of the row at which they start.
    scale, zero : float
        TSCAL, TZERO.
    null : int or None
        TNULL.
    """

    name: str
    unit: str
    kind: str
    count: int
    offset: int
    scale: float
    zero: float
    null: int | None

    @property
    def is_number(self) -> bool:
        """Whether each row holds one number or truth value."""
        return self.kind in _NUMPY and self.count == 1

    @property
    def is_text(self) -> bool:
        """Whether it holds characters."""
        return self.kind == "A"


@dataclass(frozen=True, slots=True)
class FitsTable:
    """A binary table.

    Attributes
    ----------
    cards : Cards
        Its header.
    data_at : int
        Offset of the first row.
    """

    path: Path
    cards: Cards
    columns: tuple[FitsColumn, ...]
    row_bytes: int
    rows: int
    data_at: int

    def read(self, wanted: dict[str, FitsColumn], first: int, end: int) -> NDArray[np.void]:
        """Read a range of rows.

        Parameters
        ----------
        wanted : dict
            Columns by the names that the fields of the answer shall have.

        Returns
        -------
        ndarray, shape (end - first,)
            Structured; values as stored. For `numbers`, `whole_numbers` and `texts`.

        Raises
        ------
        BadCatalog
            The file has become shorter.
        """
        kind = np.dtype(
            {
                "names": list(wanted),
                "formats": [f"S{c.count}" if c.is_text else _NUMPY[c.kind] for c in wanted.values()],
                "offsets": [c.offset for c in wanted.values()],
                "itemsize": self.row_bytes,
            }
        )
        rows: NDArray[np.void] = np.fromfile(
            self.path, dtype=kind, count=end - first, offset=self.data_at + first * self.row_bytes
        )
        if rows.size < end - first:
            at = self.data_at + (first + rows.size) * self.row_bytes
            raise malformed_at(self.path.name, at, f"{self.rows} rows", "the end")
        return rows

    def rows_at_once(self, most: int = 500_000) -> int:
        """How many rows are read in one go, so that wide tables don't fill the memory."""
        return max(1, min(most, _LARGEST_READ_BYTES // max(1, self.row_bytes)))


def numbers(stored: NDArray[Any], column: FitsColumn) -> Array:
    """Values of a numerical or logical column: scaled, NaN where there is none.

    Parameters
    ----------
    stored : ndarray, shape (n,)
        A field of `FitsTable.read`.

    Returns
    -------
    ndarray, shape (n,)
        Truth values as 1 and 0.
    """
    if column.kind == "L":
        known = (stored == ord("T")) | (stored == ord("F"))
        return np.where(known, stored == ord("T"), np.nan)
    with np.errstate(invalid="ignore"):  # signaling NaNs, as damaged files have them
        values = stored.astype(np.float64)
    if column.kind in "BIJK" and column.null is not None:
        values[stored == column.null] = np.nan
    if column.scale != 1.0 or column.zero != 0.0:
        values = values * column.scale + column.zero
    return values


def whole_numbers(stored: NDArray[Any], column: FitsColumn) -> NDArray[np.int64] | None:
    """Values of an integer column without loss of digits; None if it isn't one."""
    if column.kind not in "IJK" or column.scale != 1.0 or column.zero != 0.0:
        return None
    values = stored.astype(np.int64)
    if column.null is not None:
        values[stored == column.null] = 0
    return values


def texts(stored: NDArray[Any]) -> NDArray[np.str_]:
    """Values of a column of characters, without padding."""
    return np.char.strip(np.char.decode(stored, "latin-1"))


def fits_tables(path: Path) -> tuple[Cards, list[FitsTable]]:
    """Look over a FITS file: every header is read, no data.

    Returns
    -------
    (Cards, list of FitsTable)
        The primary header, and all binary tables in their order.

    Raises
    ------
    BadCatalog
        It is no FITS file, or shorter than its headers say.
    """
    with open_plain(path) as file:
        content = OnDisk(file)
        if content[:9] != b"SIMPLE  =":
            raise malformed_at(path.name, 0, "a FITS file ('SIMPLE  =')", repr(content[:9]))
        at, tables, primary = 0, [], None
        while at < len(content):
            if primary is not None and content[at : at + 8] != b"XTENSION":
                break  # special records may follow the last extension
            cards = read_cards(content, at)
            if cards is None:
                raise malformed_at(path.name, at, "a whole FITS header", f"the end at byte {len(content)}")
            data_at = at + cards.length
            length = _data_length(cards, path, at)
            end = data_at + -(-length // BLOCK_LENGTH) * BLOCK_LENGTH
            if end > len(content):
                raise malformed_at(
                    path.name, len(content), f"data up to byte {end}", f"the end at byte {len(content)}"
                )
            if cards.values.get("XTENSION") == "BINTABLE":
                tables.append(_table(path, cards, data_at))
            primary = primary or cards
            at = end
    if primary is None:
        raise malformed_at(path.name, 0, "a FITS header", "nothing")
    return primary, tables


def _data_length(cards: Cards, path: Path, at: int) -> int:
    axes = [cards.integer(f"NAXIS{number}", -1) for number in range(1, cards.integer("NAXIS", 0) + 1)]
    bits, groups, extra = abs(cards.integer("BITPIX", 0)), cards.integer("GCOUNT", 1), cards.integer("PCOUNT")
    if bits not in (8, 16, 32, 64) or min([*axes, groups, extra, 0]) < 0:
        raise malformed_at(
            path.name, at, "BITPIX, NAXISn, GCOUNT and PCOUNT of the standard", f"BITPIX {bits}, axes {axes}"
        )
    elements = 1 if axes else 0
    for axis in axes:
        elements *= axis
    return bits // 8 * groups * (extra + elements)


def _table(path: Path, cards: Cards, data_at: int) -> FitsTable:
    columns, offset = [], 0
    for number in range(1, cards.integer("TFIELDS") + 1):
        form = _FORM.match(str(cards.values.get(f"TFORM{number}", "")))
        if form is None:
            raise malformed_at(
                path.name,
                data_at - cards.length,
                f"TFORM{number} of a binary table",
                repr(cards.values.get(f"TFORM{number}")),
            )
        count, kind = int(form[1] or 1), form[2]
        null = cards.values.get(f"TNULL{number}")
        columns.append(
            FitsColumn(
                str(cards.values.get(f"TTYPE{number}", "")).strip(),
                str(cards.values.get(f"TUNIT{number}", "")).strip(),
                kind,
                count,
                offset,
                cards.real(f"TSCAL{number}", 1.0),
                cards.real(f"TZERO{number}", 0.0),
                null if isinstance(null, int) else None,
            )
        )
        offset += -(-count // 8) if kind == "X" else count * COLUMN_BYTES[kind]
    row_bytes, rows = cards.integer("NAXIS1"), cards.integer("NAXIS2")
    if columns and offset != row_bytes:
        raise malformed_at(
            path.name,
            data_at - cards.length,
            f"rows of {offset} bytes, as the columns say",
            f"NAXIS1 {row_bytes}",
        )
    return FitsTable(path, cards, tuple(columns), row_bytes, rows, data_at)


def column_named(table: FitsTable, name: str) -> FitsColumn | None:
    """Find a column whatever its case.

    Raises
    ------
    BadCatalog
        There are two of that name.
    """
    found = [column for column in table.columns if column.name.lower() == name.lower()]
    if len(found) > 1:
        raise BadCatalog(f"has two columns {name!r}", device=table.path.name, advice="rename one of them")
    return found[0] if found else None
