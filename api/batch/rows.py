"""One row a frame: the columns of CSV, ECSV and Parquet files, and of the table of identified stars."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from api.batch.outcomes import Outcome
from api.http.file_names import shown

if TYPE_CHECKING:
    pass

Cell = str | float | int | bool | None
Row = dict[str, Cell]


@dataclass(frozen=True, slots=True)
class Column:
    """A column: name, kind, unit as astropy writes it (or none), and what it says."""

    name: str
    kind: Literal["string", "double", "int64", "bool"]
    unit: str
    about: str


FRAME_COLUMNS = (
    Column("file", "string", "", "path as it was named"),
    Column("extension", "string", "", "FITS extension where one was chosen, else empty"),
    Column("sha256", "string", "", "of the file's bytes as this run left them"),
    Column("solved", "bool", "", ""),
    Column("ra_deg", "double", "deg", "ICRS place of the frame's geometric center"),
    Column("dec_deg", "double", "deg", ""),
    Column("center_sigma_arcsec", "double", "arcsec", "one-sigma error of the center per coordinate"),
    Column("scale_arcsec_px", "double", "arcsec / pix", "at the center"),
    Column("rotation_deg", "double", "deg", "position angle of the image's +y axis, east of north"),
    Column("parity", "int64", "", "+1: east left when north is up, as the sky is seen; -1: mirrored"),
    Column("width_px", "int64", "pix", ""),
    Column("height_px", "int64", "pix", ""),
    Column("rms_arcsec", "double", "arcsec", "residual of the pairs in the fit"),
    Column("pairs", "int64", "", "stars in the fit"),
    Column("false_probability", "double", "", "chance that a wrong position would have looked as good"),
    Column("mode", "string", "", "full/cubic, blind/linear, ..."),
    Column("catalog", "string", "", "whose stars the plate rests on"),
    Column("reason_code", "string", "", "why it was not solved, for programs: NO_MATCH, ..."),
    Column("reason", "string", "", "why it was not solved, for people"),
    Column("notes", "string", "", "parted by |"),
    Column("contradictions", "string", "", "hints that turned out wrong, parted by |"),
    Column("stars", "int64", "", "star-like sources measured"),
    Column("fwhm_px", "double", "pix", ""),
    Column("fwhm_arcsec", "double", "arcsec", ""),
    Column("ellipticity", "double", "", ""),
    Column("sky_adu", "double", "adu", ""),
    Column("noise_adu", "double", "adu", ""),
    Column("zero_point_mag", "double", "mag", "of a star of 1 ADU"),
    Column("limiting_mag", "double", "mag", "faintest star that stands 5 sigma above the sky"),
    Column("sky_mag_arcsec2", "double", "mag / arcsec2", ""),
    Column("time_s", "double", "s", "wall time"),
    Column("wcs", "string", "", "the FITS cards as a JSON object"),
)
"""One row a frame; new columns come at the end, and none changes its meaning."""

PAIR_COLUMNS = (
    Column("file", "string", "", "path as it was named"),
    Column("extension", "string", "", "FITS extension where one was chosen, else empty"),
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
"""One row an identified star."""


def frame_row(outcome: Outcome) -> Row:
    """The row of a frame; what isn't known is None."""
    answer = outcome.answer()
    row: Row = {column.name: answer.get(column.name) for column in FRAME_COLUMNS}
    wcs, quality = answer["wcs"], answer["quality"] or {}
    row |= {name: quality.get(name) for name in row if name in quality}
    row |= {
        "extension": None if outcome.frame.hdu is None else str(outcome.frame.hdu),
        "sha256": outcome.sha256 or None,
        "notes": " | ".join(answer["notes"]) or None,
        "contradictions": " | ".join(answer["contradictions"]) or None,
        "time_s": answer["time_s"]["total"],
        "wcs": None if wcs is None else json.dumps(wcs),
        "width_px": None if wcs is None else wcs["IMAGEW"],
        "height_px": None if wcs is None else wcs["IMAGEH"],
    }
    return row


def pair_rows(outcome: Outcome) -> Iterator[Row]:
    """A row for each identified star."""
    solution = outcome.solution
    if solution is None:
        return
    pairs = solution.identified
    names = [column.name for column in PAIR_COLUMNS]
    arrays = {
        name: getattr(pairs, name).tolist() for name in names if name not in ("file", "extension", "band")
    }
    same: Row = {
        "file": shown(outcome.frame.path),
        "extension": None if outcome.frame.hdu is None else str(outcome.frame.hdu),
        "band": pairs.band or None,
    }
    for at in range(len(pairs)):
        yield {name: same[name] if name in same else _finite(arrays[name][at]) for name in names}


def _finite(value: Cell) -> Cell:
    return None if isinstance(value, float) and not math.isfinite(value) else value
