"""Lists of stars that other programs measured: FITS tables (`.xyls`, `.axy`), CSV, plain text.

What a file is, is decided by its content, never by its name.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from mountnav.errors import BadFrame
from mountnav.frames import StarList
from mountnav.reading.content import Content
from mountnav.reading.fits_headers import Hdu, walk
from mountnav.reading.header_hints import hint_from_header

if TYPE_CHECKING:
    from mountnav.reading.fits_headers import Value

__all__ = ["ListFormat", "is_star_list", "read_star_list"]

Array = NDArray[np.float64]

_HEAD_BYTES = 4096
"""How much of a file is looked at to tell what it is; chosen by hand. Doubled, nothing changes but for lists
that begin with more than 4 kB of comments."""
MOST_LIST_BYTES = 32_000_000
"""Longest list that is read, bytes: half a million stars as text. Doubled, a hostile one takes twice as much
memory."""
MOST_STARS = 100_000
"""Of these the brightest are kept; the fullest frames have a tenth. Doubled, a hostile list takes twice as
long."""
MOST_SIDE_PX = 100_000
"""Longest side of a frame that stars may lie in: no detector has as many."""
_MARGIN_PX = 1.0
"""A list that doesn't tell its frame's size is taken to reach so far beyond the outermost star."""

_X_NAMES = ("x", "x_image", "xwin_image", "xcentroid", "xpos", "x_px", "field_x")
_Y_NAMES = ("y", "y_image", "ywin_image", "ycentroid", "ypos", "y_px", "field_y")
_FLUX_NAMES = ("flux", "flux_auto", "flux_best", "flux_iso", "peak", "adu")
_MAG_NAMES = ("mag", "mag_auto", "mag_best", "mag_iso", "magnitude")
_DATA_LINE = re.compile(rb"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*([,;\s]\s*[-+\d.]|$)")
"""A line that begins with a number, and goes on with a second one."""


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
    lines = [line for line in head.splitlines()[:20] if line.strip() and not line.lstrip().startswith(b"#")]
    # the last line of the head may be cut; the first may be a header
    return any(_DATA_LINE.match(line) for line in lines[:2])


def read_star_list(content: Content, label: str, wanted: ListFormat | None = None) -> StarList:
    """Read a list of stars.

    Parameters
    ----------
    content : bytes, bytearray or OnDisk
    label : str
        What to call it.
    wanted : ListFormat, optional

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
        columns, header = _fits_columns(content, label)
    else:
        columns = _text_columns(bytes(content[:]), label)
    x, y, flux = _chosen(columns, wanted, label)
    sound = np.isfinite(x) & np.isfinite(y) & (np.abs(x) < MOST_SIDE_PX) & (np.abs(y) < MOST_SIDE_PX)
    x, y, flux = x[sound] - wanted.first_px, y[sound] - wanted.first_px, flux[sound]
    order = np.argsort(-np.where(np.isfinite(flux), flux, -np.inf), kind="stable")[:MOST_STARS]
    x, y, flux = x[order], y[order], flux[order]
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
    return int(value) if isinstance(value, int | float) and math.isfinite(value) else 0


def _reach(places: Array) -> int:
    return max(1, math.ceil(float(places.max()) + _MARGIN_PX)) if places.size else 1


def _fits_columns(content: Content, label: str) -> tuple[dict[str, Array], dict[str, Value]]:
    """Columns of numbers of the first table, and the cards of primary header and table."""
    from astropy.io import fits

    hdus = walk(content, label)
    table = next((hdu for hdu in hdus if _is_table(hdu)), None)
    if table is None:
        raise BadFrame("there is no table in this file", device=label, advice="send an image or a star list")
    if table.data_start + table.data_length > len(content):
        raise BadFrame("the table is cut short", device=label, advice="send the whole file")
    columns: dict[str, Array] = {}
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with fits.open(BytesIO(bytes(content[:])), memmap=False) as opened:
                data: Any = opened[table.number].data
                for name in [] if data is None else data.names:
                    values = np.asarray(data[name])
                    if values.ndim == 1 and values.dtype.kind in "iuf":
                        columns[name.lower()] = values.astype(np.float64)
    except Exception as fault:  # a damaged table raises whatever it likes
        raise BadFrame(
            f"the table can't be read: {fault}", device=label, advice="write the list again"
        ) from fault
    return columns, {**hdus[0].cards.values, **table.cards.values}


def _text_columns(content: bytes, label: str) -> dict[str, Array]:
    """Columns of a text: named by a header line where there is one, else x, y, flux."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as fault:
        raise BadFrame("this is no text", device=label, advice="send an image or a star list") from fault
    rows: list[list[float]] = []
    names: list[str] = []
    for line in text.splitlines():
        words = [
            word.strip() for word in re.split(r"[,;\s]+", line.strip().lstrip("#").strip()) if word.strip()
        ]
        if not words:
            continue
        numbers = _numbers(words)
        if numbers is None:
            if not rows and _names_columns(words):
                names = [word.strip("\"'").lower() for word in words]
            elif not line.lstrip().startswith("#"):
                raise BadFrame(
                    f"line {line[:40]!r} of the list has no numbers", device=label, advice="x and y on a line"
                )
        elif not line.lstrip().startswith("#"):
            rows.append(numbers)
    width = min((len(row) for row in rows), default=0)
    if width < 2:
        raise BadFrame("the list has no stars", device=label, advice="x and y of one star on each line")
    values = np.array([row[:width] for row in rows], dtype=np.float64)
    given = names if len(names) >= width else ["x", "y", "flux"]
    return {name: values[:, at] for at, name in enumerate(given[:width])}


def _numbers(words: Sequence[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _names_columns(words: Sequence[str]) -> bool:
    low = [word.strip("\"'").lower() for word in words]
    return any(word in _X_NAMES for word in low) and any(word in _Y_NAMES for word in low)


def _chosen(columns: dict[str, Array], wanted: ListFormat, label: str) -> tuple[Array, Array, Array]:
    """The columns of x, y and brightness (the larger, the brighter; NaN where there is none)."""
    x = _column(columns, wanted.x_column, _X_NAMES)
    y = _column(columns, wanted.y_column, _Y_NAMES)
    if x is None or y is None:
        there = ", ".join(sorted(columns)[:20]) or "none"
        raise BadFrame(f"no columns of x and y; there are: {there}", device=label, advice="name the columns")
    if wanted.sort_column is not None:
        found = columns.get(wanted.sort_column.lower())
        if found is None:
            raise BadFrame(
                f"there is no column {wanted.sort_column}", device=label, advice="name one that is there"
            )
        faint_first = wanted.ascending
        if faint_first is None:
            faint_first = wanted.sort_column.lower() in _MAG_NAMES
        return x, y, -found if faint_first else found
    flux = _column(columns, None, _FLUX_NAMES)
    if flux is None:
        mag = _column(columns, None, _MAG_NAMES)
        flux = np.full(x.size, np.nan) if mag is None else 10.0 ** (-0.4 * np.clip(mag, -50.0, 50.0))
    return x, y, flux


def _column(columns: dict[str, Array], named: str | None, usual: Sequence[str]) -> Array | None:
    if named is not None:
        return columns.get(named.lower())
    return next((columns[name] for name in usual if name in columns), None)
