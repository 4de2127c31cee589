"""What tables of results hold: columns with units, and the cells that a verdict fills.

The tables of `mountnav solve` and those of an archive are made of the same columns.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from mountnav.extras import extra

if TYPE_CHECKING:
    import pyarrow as pa

    from mountnav.solution import Solution, Verdict

Cell = str | float | int | bool | None
Row = dict[str, Cell]


@dataclass(frozen=True, slots=True)
class Column:
    """A column: name, kind, unit as astropy writes it (or none), and what it says."""

    name: str
    kind: Literal["string", "double", "int64", "bool"]
    unit: str
    about: str


FILE = Column("file", "string", "", "path as it was named")
EXTENSION = Column("extension", "string", "", "FITS extension where one was chosen, else empty")
SHA256 = Column("sha256", "string", "", "of the file's bytes as this run left them")
SOLVED = Column("solved", "bool", "", "")
WCS = Column("wcs", "string", "", "the FITS cards as a JSON object")

PLATE_COLUMNS = (
    Column("ra_deg", "double", "deg", "ICRS place of the frame's geometric center"),
    Column("dec_deg", "double", "deg", ""),
    Column("center_sigma_arcsec", "double", "arcsec", "one-sigma error of the center per coordinate"),
    Column("scale_arcsec_px", "double", "arcsec / pix", "at the center"),
    Column("rotation_deg", "double", "deg", "position angle of the image's +y axis, east of north"),
    Column("parity", "int64", "", "+1: east left when north is up, not mirrored; -1: mirrored"),
    Column("width_px", "int64", "pix", ""),
    Column("height_px", "int64", "pix", ""),
    Column("rms_arcsec", "double", "arcsec", "residual of the pairs in the fit"),
    Column("pairs", "int64", "", "stars in the fit"),
    Column("false_probability", "double", "", "chance that a wrong position would have looked as good"),
    Column("mode", "string", "", "full/cubic, blind/linear, ..."),
    Column("catalog", "string", "", "whose stars the plate rests on"),
)
"""Of a frame that is solved."""

EXPOSURE = Column("exposure", "int64", "", "of a plate that was exposed several times, counted from 1")

REASON_COLUMNS = (
    Column("reason_code", "string", "", "why it was not solved, for programs: NO_MATCH, ..."),
    Column("reason", "string", "", "why it was not solved, for people"),
)

TOLD_COLUMNS = (
    Column("notes", "string", "", "separated by |"),
    Column("contradictions", "string", "", "hints that turned out wrong, separated by |"),
)

QUALITY_COLUMNS = (
    Column("stars", "int64", "", "star-like sources measured"),
    Column("fwhm_px", "double", "pix", ""),
    Column("fwhm_arcsec", "double", "arcsec", ""),
    Column("ellipticity", "double", "", ""),
    Column("sky_adu", "double", "adu", ""),
    Column("noise_adu", "double", "adu", ""),
    Column("zero_point_mag", "double", "mag", "of a star of 1 ADU"),
    Column("limiting_mag", "double", "mag", "faintest star that stands 5 sigma above the sky"),
    Column("sky_mag_arcsec2", "double", "mag / arcsec2", ""),
)
"""What the frame tells of the night, solved or not."""

STAR_COLUMNS = (
    Column("x_px", "double", "pix", "measured, 0-based"),
    Column("y_px", "double", "pix", ""),
    Column("ra_deg", "double", "deg", "the star's ICRS place at the frame's epoch"),
    Column("dec_deg", "double", "deg", ""),
    Column("dx_arcsec", "double", "arcsec", "measured minus catalog, to the east, with cos dec"),
    Column("dy_arcsec", "double", "arcsec", "measured minus catalog, to the north"),
    Column("flux", "double", "adu", ""),
    Column("flux_sigma", "double", "adu", ""),
    Column("mag", "double", "mag", "of the star, in the band"),
    Column("band", "string", "", ""),
    Column("color_mag", "double", "mag", "the star's color index"),
    Column("centroid_sigma_arcsec", "double", "arcsec", "expected error per coordinate"),
    Column("catalog_sigma_arcsec", "double", "arcsec", "expected error per coordinate"),
    Column("flags", "int64", "", "of the measurement"),
    Column("star_flags", "int64", "", "of the catalog"),
    Column("used", "bool", "", "in the fit; else rejected by its deviation"),
)
"""Of an identified star."""

_KINDS = {"string": "string", "double": "float64", "int64": "int64", "bool": "bool"}


def parquet_schema(columns: Sequence[Column]) -> pa.Schema:
    """The schema of a Parquet file of these columns, with units and descriptions.

    Raises
    ------
    BadRequest
        pyarrow is not installed.
    """
    with extra("parquet", "Parquet files"):
        import pyarrow as pa
    return pa.schema(
        [
            pa.field(column.name, pa.type_for_alias(_KINDS[column.kind]), metadata=_metadata(column))
            for column in columns
        ]
    )


def _metadata(column: Column) -> dict[str, str]:
    return {key: text for key, text in (("unit", column.unit), ("description", column.about)) if text}


def verdict_cells(verdict: Verdict) -> Row:
    """The cells of a verdict in all columns of plate, reason, told, quality, and ``solved`` and ``wcs``.

    Returns
    -------
    dict
        What isn't known is None, and so are NaN and infinities.
    """
    solution, quality = verdict.solution, verdict.quality
    columns = (*PLATE_COLUMNS, *REASON_COLUMNS, *TOLD_COLUMNS, *QUALITY_COLUMNS)
    row: Row = {column.name: None for column in columns}
    row["solved"], row["wcs"] = solution is not None, None
    row["notes"] = " | ".join(verdict.notes) or None
    row["contradictions"] = " | ".join(map(str, verdict.contradictions)) or None
    if quality is not None:
        row |= {column.name: finite(getattr(quality, column.name)) for column in QUALITY_COLUMNS}
    if solution is None:
        reason = str(verdict.reason) if verdict.reason else "not solved"
        row["reason"] = f"{reason}: {verdict.detail}" if verdict.detail else reason
        row["reason_code"] = verdict.reason.name if verdict.reason else None
        return row
    return row | plate_cells(solution)


def plate_cells(solution: Solution) -> Row:
    """The cells of a solution in all columns of plate, and ``wcs``."""
    return {
        "ra_deg": finite(solution.center.ra_deg),
        "dec_deg": finite(solution.center.dec_deg),
        "center_sigma_arcsec": finite(solution.center_sigma_arcsec),
        "scale_arcsec_px": finite(solution.scale_arcsec_px),
        "rotation_deg": finite(solution.rotation_deg),
        "parity": 1 if solution.parity > 0 else -1,
        "width_px": int(solution.wcs["IMAGEW"]),
        "height_px": int(solution.wcs["IMAGEH"]),
        "rms_arcsec": finite(solution.rms_arcsec),
        "pairs": int(solution.pairs),
        "false_probability": finite(solution.false_probability),
        "mode": solution.mode,
        "catalog": solution.catalog,
        "wcs": json.dumps(solution.wcs),
    }


def star_rows(solution: Solution) -> Iterator[Row]:
    """A row of `STAR_COLUMNS` for each identified star."""
    pairs = solution.identified
    arrays = {
        column.name: getattr(pairs, column.name).tolist() for column in STAR_COLUMNS if column.name != "band"
    }
    band = pairs.band or None
    for at in range(len(pairs)):
        yield {
            column.name: band if column.name == "band" else finite(arrays[column.name][at])
            for column in STAR_COLUMNS
        }


def finite(value: Cell) -> Cell:
    """The value; None for NaN and infinities."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
