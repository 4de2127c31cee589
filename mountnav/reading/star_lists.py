"""Lists of stars that other programs measured: FITS tables (`.xyls`, `.axy`), CSV, plain text, two sequences.

What a file is, is decided by its content, never by its name. Lists come from strangers: whatever a header
claims, no more memory is taken than a few times what the file has bytes. FITS tables are read here and not by
astropy for that reason, and because it warns of odd cards for all threads at once.
"""

from __future__ import annotations

import io
import math
import re
from array import array
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.frames import StarList
from mountnav.reading.content import Content
from mountnav.reading.fits_headers import COLUMN_BYTES, COLUMN_NUMBERS, Hdu, Value, walk
from mountnav.reading.header_hints import hint_from_header

__all__ = ["ListFormat", "is_star_list", "read_star_list", "star_list_of"]

Array = NDArray[np.float64]
Column = Callable[[], Array]

_HEAD_BYTES = 4096
"""How much of a file is looked at to tell what it is; chosen by hand. Doubled, nothing changes but for lists
that begin with more than 4 kB of comments."""
_HEAD_LINES = 100
"""Lines of that which are looked at: SExtractor's list of columns is some twenty lines; chosen by hand."""
MOST_LIST_BYTES = 32_000_000
"""Longest list that is read, bytes: half a million stars as text. Doubled, a hostile one takes twice as much
memory."""
MOST_ROWS = 500_000
"""Rows of the longest list that is read; of them `MOST_STARS` are kept. Doubled, a hostile one takes twice as
long."""
MOST_STARS = 100_000
"""Of these the brightest are kept; the fullest frames have a tenth. Doubled, a hostile list takes twice as
long."""
MOST_SIDE_PX = 100_000
"""Longest side of a frame that stars may lie in: no detector has as many."""
_MOST_COLUMNS = 1000
"""Columns of a table; FITS allows 999 [FITS 4.0, section 7.3.1], and a text has no reason for more."""
_MARGIN_PX = 1.0
"""A list that doesn't tell its frame's size is taken to reach so far beyond the outermost star."""

_X_NAMES = (
    "x",
    "x_image",
    "xwin_image",
    "xcentroid",
    "x_centroid",
    "xpos",
    "x_px",
    "xc",
    "xcenter",
    "field_x",
)
_Y_NAMES = (
    "y",
    "y_image",
    "ywin_image",
    "ycentroid",
    "y_centroid",
    "ypos",
    "y_px",
    "yc",
    "ycenter",
    "field_y",
)
_FLUX_NAMES = (
    "flux",
    "flux_auto",
    "flux_best",
    "flux_iso",
    "flux_aper",
    "flux_fit",
    "peak",
    "adu",
    "amplitude",
)
_MAG_NAMES = ("mag", "mag_auto", "mag_best", "mag_iso", "mag_aper", "magnitude")
_NUMBER = rb"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_DATA_LINE = re.compile(
    rb"\s*" + _NUMBER + rb"(?:\s*[,;]\s*|\s+)(?:" + _NUMBER + rb"|[nN]a[nN])\s*(?:[,;\s]|$)"
)
"""A line that begins with two numbers."""
_NUMBERED_NAME = re.compile(r"#\s*(\d{1,3})\s+([A-Za-z]\w*)")
"""SExtractor's line for a column: its number and its name."""
_FORM = re.compile(r"(\d{0,9})([LXBIJKAEDCMPQ])")


@dataclass(frozen=True, slots=True)
class ListFormat:
    """How a list of stars is to be read; what is left out is found in the list.

    Attributes
    ----------
    x_column, y_column : str or None
        Names of the columns; case doesn't matter.
    sort_column : str or None
        Column of the brightness.
    ascending : bool or None
        The brightest have the least value of it: magnitudes. None: by the column's name.
    width_px, height_px : int or None
        Of the frame; else the cards IMAGEW and IMAGEH, else what holds all stars.
    first_px : {0, 1}
        Coordinate of the middle of the first pixel. FITS counts from 1.
    y : {"rows", "up"}
        "rows": along the rows of the frame's file. "up": counted from the last row.
    """

    x_column: str | None = None
    y_column: str | None = None
    sort_column: str | None = None
    ascending: bool | None = None
    width_px: int | None = None
    height_px: int | None = None
    first_px: Literal[0, 1] = 1
    y: Literal["rows", "up"] = "rows"


def is_star_list(content: Content) -> bool:
    """Whether a file looks like a list of stars: a FITS table without an image, or lines of numbers."""
    head = bytes(content[:_HEAD_BYTES])
    if head[:6] == b"SIMPLE":
        try:
            hdus = walk(content, "list")
        except BadFrame:
            return False
        return not any(hdu.shape for hdu in hdus) and any(map(_is_table, hdus))
    if b"\0" in head or not head:
        return False
    lines = [line for line in head.removeprefix(b"\xef\xbb\xbf").splitlines()[:_HEAD_LINES] if line.strip()]
    rows = [line for line in lines if not line.lstrip().startswith(b"#")]
    # the first may be a header, and say so
    if rows and not _DATA_LINE.match(rows[0]):
        return _names_position(_lowered(_words(rows[0].decode("latin-1"))), ListFormat())
    return bool(rows)


def read_star_list(content: Content, label: str, wanted: ListFormat | None = None) -> StarList:
    """Read a list of stars.

    FITS: the first table that has the columns. Text: one star a line, parted by commas, semicolons or blanks;
    columns are named by a first line (``x,y,flux``), by SExtractor's comments, or are x, y and, if there is
    a third, flux.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
        The file, in memory or where it lies on disk.
    label : str
        What to call it.

    Returns
    -------
    StarList
        The brightest first where the list tells brightness, else in its own order. Stars without finite
        coordinates are left out.

    Raises
    ------
    BadFrame
        It is no list of stars, has no such columns, or is too long.
    """
    wanted = wanted or ListFormat()
    if len(content) > MOST_LIST_BYTES:
        raise BadFrame(
            f"the list has {len(content) // 1_000_000} MB", device=label, advice="send the brightest stars"
        )
    header: dict[str, Value] = {}
    if content[:6] == b"SIMPLE":
        columns, header = _fits_columns(content, label, wanted)
    else:
        columns = _text_columns(bytes(content[:]), label, wanted)
    x_name, y_name, light_name = _chosen(columns, wanted, label)
    x, y = columns[x_name](), columns[y_name]()
    if light_name is None:
        flux = np.full(x.size, np.nan)
    else:
        flux = columns[light_name]()
        flux = -flux if _faint_first(light_name, wanted) else flux
    return _list_of(x, y, flux, header, wanted, label)


def star_list_of(
    x: Sequence[float] | Array,
    y: Sequence[float] | Array,
    flux: Sequence[float] | Array | None = None,
    *,
    wanted: ListFormat | None = None,
    label: str = "star list",
) -> StarList:
    """Make a list of stars of sequences, as a JSON document or a program's arrays have them.

    Parameters
    ----------
    x, y : sequence of float, shape (n,)
        Pixels, as the program counts them.
    flux : sequence of float, shape (n,), optional
        The larger, the brighter; magnitudes if `wanted` says ascending.
    wanted : ListFormat, optional
        Sizes, first pixel, direction of y, direction of the brightness.

    Returns
    -------
    StarList
        As of `read_star_list`.

    Raises
    ------
    BadFrame
        They are no numbers, too many, or not of one length.
    """
    wanted = wanted or ListFormat()
    columns = [_numbers(values, label) for values in ((x, y) if flux is None else (x, y, flux))]
    if len({column.size for column in columns}) != 1:
        raise BadFrame("x, y and flux are not of one length", device=label, advice="send one of each a star")
    light = np.full(columns[0].size, np.nan) if flux is None else columns[2]
    return _list_of(columns[0], columns[1], -light if wanted.ascending else light, {}, wanted, label)


def _numbers(values: Sequence[float] | Array, label: str) -> Array:
    if not isinstance(values, list | tuple | np.ndarray):
        raise BadFrame("x and y are not lists of numbers", device=label, advice="send one number a star")
    if len(values) > MOST_ROWS:
        raise BadFrame(f"a list of {len(values)} stars", device=label, advice="send the brightest stars")
    if isinstance(values, list | tuple) and not all(type(value) in (int, float) for value in values):
        raise BadFrame("x and y are not lists of numbers", device=label, advice="send one number a star")
    try:
        column = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as fault:
        raise BadFrame(
            f"x and y are not lists of numbers: {fault}", device=label, advice="send one number a star"
        ) from fault
    if column.ndim != 1:
        raise BadFrame("x and y are not plain lists", device=label, advice="send one number a star")
    return column


def _list_of(
    x: Array, y: Array, flux: Array, header: dict[str, Value], wanted: ListFormat, label: str
) -> StarList:
    """Leave out what is no position, sort, and count from 0 along the rows."""
    with np.errstate(invalid="ignore"):
        sound = np.isfinite(x) & np.isfinite(y) & (np.abs(x) < MOST_SIDE_PX) & (np.abs(y) < MOST_SIDE_PX)
    x, y, flux = x[sound] - wanted.first_px, y[sound] - wanted.first_px, flux[sound]
    order = np.argsort(-np.where(np.isfinite(flux), flux, -np.inf), kind="stable")[:MOST_STARS]
    x, y, flux = x[order], y[order], np.where(np.isfinite(flux), flux, np.nan)[order]
    width = wanted.width_px or _card(header, "IMAGEW") or _reach(x)
    height = wanted.height_px or _card(header, "IMAGEH") or _reach(y)
    if not (0 < width <= MOST_SIDE_PX and 0 < height <= MOST_SIDE_PX):
        raise BadFrame(f"a frame of {width} × {height} pixels", device=label, advice="give its true size")
    if wanted.y == "up":
        y = height - 1 - y
    return StarList(x, y, flux, width, height, hint_from_header(header, width, height, {}), label)


def _is_table(hdu: Hdu) -> bool:
    return hdu.number > 0 and str(hdu.cards.values.get("XTENSION", "")).strip() in ("BINTABLE", "TABLE")


def _card(header: dict[str, Value], name: str) -> int:
    value = header.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return 0
    return int(value)


def _reach(places: Array) -> int:
    return max(1, math.ceil(float(places.max()) + _MARGIN_PX)) if places.size else 1


# -- FITS ----------------------------------------------------------------------------------------------------


def _fits_columns(
    content: Content, label: str, wanted: ListFormat
) -> tuple[dict[str, Column], dict[str, Value]]:
    """Columns of numbers of the first table that has x and y, and the cards of primary header and table."""
    hdus = walk(content, label)
    tables = [hdu for hdu in hdus if _is_table(hdu)]
    if not tables:
        raise BadFrame("there is no table in this file", device=label, advice="send an image or a star list")
    found: dict[str, Column] = {}
    for table in tables:
        columns = _table_columns(content, table, label)
        if _names_position(columns, wanted):
            return columns, {**hdus[0].cards.values, **table.cards.values}
        found = found or columns
    raise _no_position(found, label)


def _table_columns(content: Content, table: Hdu, label: str) -> dict[str, Column]:
    """The columns of one number a row, not yet read."""
    cards = table.cards
    if str(cards.values["XTENSION"]).strip() != "BINTABLE":
        return {}  # tables of text are written by nobody who measures stars
    row_bytes, rows, count = (cards.integer(name) for name in ("NAXIS1", "NAXIS2", "TFIELDS"))
    if not (0 < row_bytes <= MOST_LIST_BYTES and 0 <= rows <= MOST_ROWS and 0 <= count <= _MOST_COLUMNS):
        raise BadFrame(
            f"a table of {count} columns and {rows} rows of {row_bytes} bytes",
            device=label,
            advice="send the brightest stars, x, y and brightness of each",
        )
    # its heap, which may lie behind, is of no use here
    if table.data_start + rows * row_bytes > len(content):
        raise BadFrame("the table is cut short", device=label, advice="send the whole file")
    data = content[table.data_start : table.data_start + rows * row_bytes]
    columns: dict[str, Column] = {}
    at = 0
    for number in range(1, count + 1):
        form = _FORM.match(str(cards.values.get(f"TFORM{number}", "")).strip().upper())
        if form is None:
            raise BadFrame(
                f"column {number} of the table has no sane format", device=label, advice="write it again"
            )
        repeat, letter = int(form[1] or 1), form[2]
        width = -(-repeat // 8) if letter == "X" else repeat * COLUMN_BYTES[letter]
        if at + width > row_bytes:
            raise BadFrame(
                f"the columns need more than the {row_bytes} bytes of a row",
                device=label,
                advice="write the list again",
            )
        name = str(cards.values.get(f"TTYPE{number}", f"col{number}")).strip().lower()
        if letter in COLUMN_NUMBERS and repeat == 1 and name not in columns:
            scale, zero = cards.real(f"TSCAL{number}", 1.0), cards.real(f"TZERO{number}", 0.0)
            columns[name] = _stored_column(data, rows, row_bytes, at, COLUMN_NUMBERS[letter], scale, zero)
        at += width
    return columns


def _stored_column(
    data: bytes | bytearray, rows: int, row_bytes: int, at: int, kind: str, scale: float, zero: float
) -> Column:
    def read() -> Array:
        if not rows:
            return np.zeros(0)
        stored = np.ndarray((rows,), np.dtype(kind), data, offset=at, strides=(row_bytes,))
        with np.errstate(over="ignore", invalid="ignore"):
            return stored.astype(np.float64) * scale + zero

    return read


# -- text ----------------------------------------------------------------------------------------------------


def _text_columns(content: bytes, label: str, wanted: ListFormat) -> dict[str, Column]:
    """The columns of a text that are of use."""
    headers: list[list[str]] = []
    numbered: dict[int, str] = {}
    names: list[str] | None = None
    places: dict[str, int] = {}
    values: dict[str, array[float]] = {}
    rows = 0
    for line in _lines(content, label):
        words = _words(line.lstrip("#"))
        if line.startswith("#") or (names is None and _names_position(_lowered(words), wanted)):
            if match := _NUMBERED_NAME.match(line):
                numbered[int(match[1])] = match[2].lower()
            headers = [*headers[-_HEAD_LINES:], _lowered(words)]
            continue
        if names is None:
            if len(words) > _MOST_COLUMNS:
                raise BadFrame(
                    f"more than {_MOST_COLUMNS} columns", device=label, advice="x and y of one star a line"
                )
            names = _column_names(headers, numbered, len(words), wanted)
            chosen = _chosen(names, wanted, label)
            places = {name: names.index(name) for name in chosen if name is not None}
            values = {name: array("d") for name in places}
        rows += 1
        if rows > MOST_ROWS:
            raise BadFrame(f"more than {MOST_ROWS} stars", device=label, advice="send the brightest stars")
        for number, (name, at) in enumerate(places.items()):
            value = _number(words, at)
            if value is None and number < 2:
                raise BadFrame(
                    f"line {line[:40]!r} of the list has no number for {name}",
                    device=label,
                    advice="x and y of one star on each line",
                )
            values[name].append(math.nan if value is None else value)
    if names is None:
        raise BadFrame("the list has no stars", device=label, advice="x and y of one star on each line")
    return {name: _text_column(column) for name, column in values.items()}


def _text_column(column: array[float]) -> Column:
    return lambda: np.array(column, dtype=np.float64)


def _lines(content: bytes, label: str) -> Iterator[str]:
    """Lines that aren't blank, one after the other: a list of all of them would take many times the text."""
    try:
        for line in io.TextIOWrapper(io.BytesIO(content), encoding="utf-8-sig"):
            if stripped := line.strip():
                yield stripped
    except UnicodeDecodeError as fault:
        raise BadFrame("this is not a text", device=label, advice="send an image or a star list") from fault


def _words(line: str) -> list[str]:
    """The fields of a line; of an endless one the first."""
    if "," in line or ";" in line:
        parted = re.split("[,;]", line, maxsplit=_MOST_COLUMNS)
    else:
        parted = line.split(maxsplit=_MOST_COLUMNS)
    words = [word.strip().strip("\"'") for word in parted]
    while words and not words[-1]:
        words.pop()  # a comma at the end
    return words


def _lowered(words: Sequence[str]) -> list[str]:
    return [word.lower() for word in words]


def _number(words: Sequence[str], at: int) -> float | None:
    try:
        return float(words[at])
    except (ValueError, IndexError):
        return None


def _column_names(
    headers: Sequence[list[str]], numbered: dict[int, str], count: int, wanted: ListFormat
) -> list[str]:
    """What the columns are called: by the last line that names as many, else x, y and flux."""
    for words in headers[::-1]:
        if len(words) == count and _names_position(words, wanted):
            return words
    if numbered:
        return [numbered.get(number, "") for number in range(1, count + 1)]
    return ["x", "y", "flux"][:count] + [""] * (count - 3)


# -- choice --------------------------------------------------------------------------------------------------


def _chosen(there: Collection[str], wanted: ListFormat, label: str) -> tuple[str, str, str | None]:
    """The columns of x, y and brightness; None where nothing tells brightness."""
    x, y = _named(there, wanted.x_column, _X_NAMES), _named(there, wanted.y_column, _Y_NAMES)
    if x is None or y is None:
        raise _no_position(there, label)
    light = _named(there, wanted.sort_column, (*_FLUX_NAMES, *_MAG_NAMES))
    if light is None and wanted.sort_column is not None:
        raise BadFrame(f"there is no column {wanted.sort_column}", device=label, advice=_there(there))
    return x, y, light


def _faint_first(name: str, wanted: ListFormat) -> bool:
    """Whether a larger number means fainter."""
    if wanted.ascending is not None and wanted.sort_column is not None:
        return wanted.ascending
    return name in _MAG_NAMES


def _names_position(there: Collection[str], wanted: ListFormat) -> bool:
    return all(
        _named(there, given, usual) is not None
        for given, usual in ((wanted.x_column, _X_NAMES), (wanted.y_column, _Y_NAMES))
    )


def _named(there: Collection[str], given: str | None, usual: Sequence[str]) -> str | None:
    """The column that was named, or the first that has a usual name."""
    wanted = usual if given is None else (given.lower(),)
    return next((name for name in wanted if name in there), None)


def _no_position(there: Collection[str], label: str) -> BadFrame:
    return BadFrame("there are no columns of x and y", device=label, advice=_there(there))


def _there(there: Collection[str]) -> str:
    names = [name[:20] for name in there if name]
    return f"there are: {', '.join(sorted(names)[:20]) or 'none'}"
