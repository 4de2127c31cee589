"""One row a frame: the columns of CSV, ECSV and Parquet files, and of the table of identified stars."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from api.batch.outcomes import Outcome
from api.http.file_names import shown
from mountnav.archive.columns import (
    EXTENSION,
    FILE,
    PLATE_COLUMNS,
    QUALITY_COLUMNS,
    REASON_COLUMNS,
    SHA256,
    SOLVED,
    STAR_COLUMNS,
    TOLD_COLUMNS,
    WCS,
    Cell,
    Column,
    Row,
    star_rows,
    verdict_cells,
)

if TYPE_CHECKING:
    from mountnav.solution import Verdict

__all__ = ["FRAME_COLUMNS", "PAIR_COLUMNS", "Cell", "Column", "Row", "frame_row", "pair_rows"]

FRAME_COLUMNS = (
    FILE,
    EXTENSION,
    SHA256,
    SOLVED,
    *PLATE_COLUMNS,
    *REASON_COLUMNS,
    *TOLD_COLUMNS,
    *QUALITY_COLUMNS,
    Column("time_s", "double", "s", "wall time"),
    WCS,
)
"""One row a frame; new columns come at the end, and none changes its meaning."""

PAIR_COLUMNS = (FILE, EXTENSION, *STAR_COLUMNS)
"""One row an identified star."""


def frame_row(outcome: Outcome) -> Row:
    """The row of a frame; what isn't known is None."""
    cells = verdict_cells(outcome.verdict or _unread(outcome.unread))
    if outcome.verdict is None:
        cells["reason"] = outcome.unread
    total_s = 0.0 if outcome.verdict is None else outcome.verdict.times.total_s
    cells |= _named(outcome)
    cells |= {"sha256": outcome.sha256 or None, "time_s": round(total_s, 4)}
    return {column.name: cells[column.name] for column in FRAME_COLUMNS}


def pair_rows(outcome: Outcome) -> Iterator[Row]:
    """A row for each identified star."""
    if outcome.solution is not None:
        named = _named(outcome)
        for row in star_rows(outcome.solution):
            yield named | row


def _named(outcome: Outcome) -> Row:
    extension = outcome.frame.hdu
    return {
        "file": shown(outcome.frame.path),
        "extension": None if extension is None else str(extension),
    }


def _unread(why: str) -> Verdict:
    from mountnav.solution import Reason, Times, Verdict

    return Verdict(None, Reason.BAD_FRAME, why, 0, Times())
