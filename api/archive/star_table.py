"""A light table of all stars of a run, with names: one file that Virtual Observatory tools read.

Parquet holds the columns' units and UCDs as a VOTable header (VOParquet) and as metadata of the fields; FITS
as TUNITn and TUCDn. Both are written in bounded memory.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mountnav.archive.columns import Column
from mountnav.archive.folder import RunFolder
from mountnav.archive.identifiers import WITHIN_ARCSEC, NamedStars, first_named
from mountnav.archive.recipe import recipe_in
from mountnav.archive.store import read_counts
from mountnav.archive.tables import TableFile, read_rows
from mountnav.errors import BadRequest
from mountnav.files import open_plain
from mountnav.units import julian_year

NAME_LENGTH = 31
"""Characters of a star's name in FITS: "Gaia DR3" and 19 digits are 28."""
_BLOCK = 2880
"""Bytes of a FITS block."""
_ROWS_AT_ONCE = 10_000
"""Rows of a frame's or several frames' stars that are written at once; for speed alone."""


@dataclass(frozen=True, slots=True)
class VoColumn:
    """A column, and what VO tools call what it holds (UCD1+)."""

    column: Column
    ucd: str


def _of(name: str, kind: Any, unit: str, about: str, ucd: str) -> VoColumn:
    return VoColumn(Column(name, kind, unit, about), ucd)


STARS = (
    _of("number", "int64", "", "frame, by its place in the work list", "meta.id;obs.image"),
    _of("epoch_yr", "double", "yr", "Julian year of the frame", "time.epoch"),
    _of("name", "string", "", "by its own catalog, joined by place", "meta.id;meta.main"),
    _of("name_apart_arcsec", "double", "arcsec", "from that catalog's place", "pos.angDistance"),
    _of("ra_deg", "double", "deg", "ICRS, catalog, at the epoch", "pos.eq.ra;meta.main"),
    _of("dec_deg", "double", "deg", "ICRS, catalog, at the epoch", "pos.eq.dec;meta.main"),
    _of("dx_arcsec", "double", "arcsec", "measured minus catalog, east", "pos.eq.ra;arith.diff"),
    _of("dy_arcsec", "double", "arcsec", "measured minus catalog, north", "pos.eq.dec;arith.diff"),
    _of("x_px", "double", "pix", "measured, 0-based", "pos.cartesian.x;instr.det"),
    _of("y_px", "double", "pix", "measured, 0-based", "pos.cartesian.y;instr.det"),
    _of("flux", "double", "adu", "measured", "phot.count"),
    _of("flux_sigma", "double", "adu", "its error", "stat.error;phot.count"),
    _of("mag", "double", "mag", "of the catalog", "phot.mag"),
    _of("flags", "int64", "", "of the measurement", "meta.code.qual"),
    _of("used", "bool", "", "in the fit", "meta.code"),
)
"""Of the table."""

_FROM_PAIRS = (
    "number",
    "ra_deg",
    "dec_deg",
    "dx_arcsec",
    "dy_arcsec",
    "x_px",
    "y_px",
    "flux",
    "flux_sigma",
    "mag",
)


def write_stars(
    run: RunFolder, out: Path, catalogs: Sequence[NamedStars], within_arcsec: float = WITHIN_ARCSEC
) -> tuple[int, int]:
    """Write all stars of a run's finished chunks, and where catalogs are given their names.

    Parameters
    ----------
    out : Path
        A new file, .parquet or .fits.
    catalogs : sequence of NamedStars
        The first that knows a star names it.
    within_arcsec : float
        How far a star may be from its catalog's place.

    Returns
    -------
    int, int
        How many stars, and how many of them have a name.

    Raises
    ------
    BadRequest
        The run keeps no stars, or the file is of another kind, or there.
    OSError
    """
    if not recipe_in(run).decides["pairs"]:
        raise BadRequest(
            f"the run {run.name} keeps no stars", advice="begin one that does: mountnav archive again --pairs"
        )
    if out.suffix not in (".parquet", ".fits"):
        raise BadRequest(f"{out}: stars are written as .parquet or .fits", advice="name such a file")
    if out.exists():
        raise BadRequest(f"{out} is there already", advice="name a new file")
    try:
        return (_as_parquet if out.suffix == ".parquet" else _as_fits)(run, out, catalogs, within_arcsec)
    except BaseException:
        out.unlink(missing_ok=True)
        raise


def _rows(run: RunFolder, catalogs: Sequence[NamedStars], within_arcsec: float) -> Iterator[dict[str, Any]]:
    """The stars, chunk after chunk."""
    undated = _year(str(recipe_in(run).decides["settings"].get("undated_utc") or ""))
    for chunk in sorted(run.done()):
        path = run.chunk(chunk)
        told = read_rows(path / "frames.parquet", ["number", "mid_exposure_utc"])
        years = {row["number"]: _year(str(row["mid_exposure_utc"] or "")) or undated for row in told}
        waiting: list[dict[str, Any]] = []
        names = [*_FROM_PAIRS, "flags", "used"]
        for row in read_rows(path / "pairs.parquet", names):
            if waiting and row["number"] != waiting[0]["number"]:
                yield from _named(waiting, years[waiting[0]["number"]], catalogs, within_arcsec)
                waiting = []
            waiting.append(dict(row))
        if waiting:
            yield from _named(waiting, years[waiting[0]["number"]], catalogs, within_arcsec)


def _named(
    rows: list[dict[str, Any]],
    epoch_yr: float | None,
    catalogs: Sequence[NamedStars],
    within_arcsec: float,
) -> Iterator[dict[str, Any]]:
    """The stars of a frame."""
    names: list[str | None] = [None] * len(rows)
    apart = np.full(len(rows), np.nan)
    if catalogs and epoch_yr is not None:
        ra, dec = (np.array([row[key] for row in rows], dtype=np.float64) for key in ("ra_deg", "dec_deg"))
        names, apart = first_named(catalogs, ra, dec, epoch_yr, within_arcsec)
    for row, name, away in zip(rows, names, apart.tolist(), strict=True):
        # no text is empty, not missing: astropy reads no Parquet file where one is missing
        told = {"name": name or "", "name_apart_arcsec": None if name is None else away}
        yield row | told | {"epoch_yr": epoch_yr}


def _year(text: str) -> float | None:
    if not text:
        return None
    return julian_year(datetime.fromisoformat(text.replace("Z", "+00:00")))


def _as_parquet(
    run: RunFolder, out: Path, catalogs: Sequence[NamedStars], within_arcsec: float
) -> tuple[int, int]:
    metadata = {
        "IVOA.VOTable-Parquet.version": "1.0",
        "IVOA.VOTable-Parquet.content": _votable(run.name),
    }
    table = TableFile(out, [one.column for one in STARS], metadata)
    known = 0
    try:
        for row in _rows(run, catalogs, within_arcsec):
            table.add(row)
            known += row["name"] != ""
        table.close()
    except BaseException:
        table.abandon()
        raise
    return table.rows, known


_VOTABLE_KINDS = {"string": "unicodeChar", "double": "double", "int64": "long", "bool": "boolean"}


def _votable(run: str) -> str:
    """The VOTable without data that a VOParquet file carries: its columns."""
    from astropy.io.votable.tree import Field, Resource, TableElement, VOTableFile

    file = VOTableFile(version="1.4")
    resource = Resource()
    file.resources.append(resource)
    table = TableElement(file)
    table.description = f"Stars of run {run} of an archive, by mountnav"
    resource.tables.append(table)
    for one in STARS:
        column = one.column
        # astropy wants a length
        size = {"arraysize": str(NAME_LENGTH)} if column.kind == "string" else {}
        table.fields.append(
            Field(
                file,
                name=column.name,
                ID=column.name,
                datatype=_VOTABLE_KINDS[column.kind],
                ucd=one.ucd,
                unit=column.unit or None,
                **size,
            )
        )
        table.fields[-1].description = column.about
    written = io.BytesIO()
    file.to_xml(written)
    return written.getvalue().decode()


_FITS_KINDS = {"string": f"S{NAME_LENGTH}", "double": ">f8", "int64": ">i8", "bool": "S1"}


def _as_fits(
    run: RunFolder, out: Path, catalogs: Sequence[NamedStars], within_arcsec: float
) -> tuple[int, int]:
    from astropy.io import fits

    count = sum(int(read_counts(run, chunk)["files"]["pairs.parquet"]["rows"]) for chunk in run.done())
    forms = {"string": f"{NAME_LENGTH}A", "double": "D", "int64": "K", "bool": "L"}
    empty = fits.BinTableHDU.from_columns(
        [fits.Column(one.column.name, forms[one.column.kind], unit=one.column.unit or None) for one in STARS]
    )
    for at, one in enumerate(STARS, 1):
        empty.header[f"TUCD{at}"] = one.ucd
        empty.header.comments[f"TTYPE{at}"] = one.column.about
    empty.header["EXTNAME"] = "STARS"
    empty.header["HISTORY"] = f"run {run.name} of an archive, by mountnav"
    empty.header["NAXIS2"] = count
    kind = np.dtype([(one.column.name, _FITS_KINDS[one.column.kind]) for one in STARS])
    known = written = 0
    with open(out, "xb") as file:
        file.write(fits.PrimaryHDU().header.tostring().encode("ascii"))
        file.write(empty.header.tostring().encode("ascii"))
        part: list[dict[str, Any]] = []
        for row in _rows(run, catalogs, within_arcsec):
            known += row["name"] != ""
            written += 1
            part.append(row)
            if len(part) == _ROWS_AT_ONCE:
                file.write(_packed(part, kind).tobytes())
                part = []
        file.write(_packed(part, kind).tobytes())
        file.write(b"\0" * (-written * kind.itemsize % _BLOCK))
    if written != count:
        raise BadRequest(f"the run {run.name} went on meanwhile", advice="give the command again")
    return written, known


def _packed(rows: list[dict[str, Any]], kind: np.dtype[np.void]) -> NDArray[np.void]:
    """Rows as FITS holds them."""
    packed = np.zeros(len(rows), dtype=kind)
    for one in STARS:
        name, values = one.column.name, [row[one.column.name] for row in rows]
        if one.column.kind == "double":
            packed[name] = [np.nan if value is None else value for value in values]
        elif one.column.kind == "int64":
            packed[name] = [int(value or 0) for value in values]
        elif one.column.kind == "bool":
            packed[name] = [b"T" if value else b"F" for value in values]
        else:
            packed[name] = [str(value or "").encode("ascii")[:NAME_LENGTH] for value in values]
    return packed


def checked_names(paths: Sequence[Path]) -> None:
    """Refuse what can't be read before anything is written. Raises `BadRequest`."""
    for path in paths:
        try:
            open_plain(path).close()
        except OSError as fault:
            raise BadRequest(f"{path}: {fault.strerror or fault}", advice="name a file of stars") from fault
