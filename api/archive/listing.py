"""Which frames an archive gets: files, folders, patterns, URLs, lists of these, and tables with hints."""

from __future__ import annotations

import codecs
import csv
import glob
import io
import itertools
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from api.archive.fetching import is_remote, spread
from api.batch.inputs import ALL_EXTENSIONS, MOST_LIST_BYTES, found_files, frames_of
from api.solver.hints import asked_hint
from mountnav.archive.tables import read_rows
from mountnav.archive.work_list import Entry
from mountnav.errors import BadRequest
from mountnav.files import open_buffered, read_bytes
from mountnav.frames import Hint

LISTS = (".txt", ".lst", ".list")
TABLES = (".csv", ".ecsv", ".parquet")

HINTS = ("ra_deg", "dec_deg", "radius_deg", "scale_arcsec_px", "scale_low_arcsec_px", "scale_high_arcsec_px")
"""Columns of a table that are hints of each frame."""


def listed_frames(words: Sequence[str], hdu: str | None) -> Iterator[Entry]:
    """The frames that are meant, in order.

    Parameters
    ----------
    words : sequence of str
        Each a file, a folder, a pattern, a URL, a URL's pattern; a text file of such, one a line; or a table
        with a column ``file``, and such of `HINTS` and ``extension``.
    hdu : str or None
        Extension of all that name none; "all" for each image of a FITS file here.

    Raises
    ------
    BadRequest
        Nothing was named, or it can't be read.
    """
    if not words:
        raise BadRequest("no frame was named", advice="--frames: files, folders, patterns, a list or a table")
    for word in words:
        suffix = "" if glob.has_magic(word) or is_remote(word) else os.path.splitext(word)[1].lower()
        if suffix in TABLES:
            yield from _of_table(Path(word), hdu)
        elif suffix in LISTS:
            for line in _lines(Path(word)):
                yield from _of_word(line, hdu)
        else:
            yield from _of_word(word, hdu)


def _of_word(word: str, hdu: str | None) -> Iterator[Entry]:
    if is_remote(word):
        _require_one(word, hdu)
        for url in spread(word):
            yield Entry(url, hdu)
        return
    for path in found_files([Path(word)], None):
        for frame in frames_of(path, hdu):
            yield _entry(path, None if frame.hdu is None else str(frame.hdu))


def _require_one(url: str, hdu: str | None) -> None:
    if hdu == ALL_EXTENSIONS:
        raise BadRequest(
            f"{url}: the extensions of a URL aren't known", advice="name them in a table, a row each"
        )


def _entry(path: Path, extension: str | None, hint: Hint | None = None) -> Entry:
    """A frame that is a file here, by its whole path: workers begin in other folders."""
    name = _text(path)
    try:
        size: int | None = path.stat().st_size
    except OSError:
        size = None  # its turn comes, and then it is told what is wrong with it
    return Entry(name, extension, size, hint)


def _text(path: Path) -> str:
    name = os.path.abspath(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        raise BadRequest(
            f"{os.fsencode(name)!r} is not UTF-8, and tables can hold nothing else",
            advice="rename the file or folder",
        ) from None
    return name


def _lines(path: Path) -> Iterator[str]:
    try:
        content = read_bytes(path, MOST_LIST_BYTES)
    except OSError as fault:
        raise BadRequest(f"{path}: {fault.strerror or fault}", advice="name a text file") from fault
    content = content.removeprefix(codecs.BOM_UTF8)
    for line in content.split(b"\0" if b"\0" in content else b"\n"):
        if line.strip():
            yield os.fsdecode(line.rstrip(b"\r"))


def _of_table(path: Path, hdu: str | None) -> Iterator[Entry]:
    for at, row in enumerate(_rows(path)):
        file = str(row.get("file") or "").strip()
        if not file:
            raise BadRequest(f"{path}: row {at + 1} names no file", advice="it needs a column `file`")
        try:
            values = {name: _number(row.get(name)) for name in HINTS}
            ra, dec, radius, scale, low, high = values.values()
            hint = asked_hint(ra, dec, radius, scale, low, high)
        except (ValueError, BadRequest) as fault:
            raise BadRequest(f"{path}: row {at + 1}, {file}: {fault}", advice="correct the row") from fault
        told = row.get("extension")
        extension = hdu if told in (None, "") else str(told)
        if is_remote(file):
            _require_one(file, extension)
            yield Entry(file, extension, None, hint)
        else:
            # a table beside its frames may name them from there
            for frame in frames_of(path.parent / file, extension):
                yield _entry(frame.path, None if frame.hdu is None else str(frame.hdu), hint)


def _rows(path: Path) -> Iterator[Mapping[str, Any]]:
    if path.suffix.lower() == ".parquet":
        yield from read_rows(path)
        return
    try:
        with open_buffered(path) as raw, io.TextIOWrapper(raw, encoding="utf-8", newline="") as text:
            lines = itertools.dropwhile(lambda line: line.startswith("#"), text)
            reader = csv.reader(lines)
            names = next(reader, [])
            if len(names) == 1 and " " in names[0]:
                raise BadRequest(
                    f"{path}: its columns are separated by spaces", advice="separate them by commas"
                )
            for row in reader:
                if row:
                    yield dict(zip(names, row, strict=False))
    except (OSError, ValueError, csv.Error) as fault:
        raise BadRequest(
            f"{path} can't be read: {fault}", advice="CSV, ECSV with commas, or Parquet"
        ) from fault


def _number(value: Any) -> float | None:
    if value is None or value == "":
        return None
    number = float(value)
    return None if math.isnan(number) else number
