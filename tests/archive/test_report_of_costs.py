"""What a report says of what a run took: whether processes waited for frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mountnav.archive.report import as_html, reported
from mountnav.archive.store import chunk_written
from mountnav.archive.tables import COST_TABLE, read_rows, write_table
from mountnav.archive.work_list import WorkList
from tests.archive.made import RECIPE, archive, result_of


@pytest.mark.parametrize(
    ("waited_s", "said"), [(2.0, "Reading is the limit"), (0.1, "Reading is not the limit")]
)
def test_a_report_says_whether_reading_is_the_limit(tmp_path: Path, waited_s: float, said: str) -> None:
    folder, run = archive(tmp_path / "archive", frames=3)
    (chunk,) = WorkList.open(folder).chunks
    with chunk_written(run, chunk, RECIPE) as writer:
        for entry in chunk.entries():
            writer.add(replace(result_of(entry), total_s=0.7, fetch_s=3.0, waited_s=waited_s))
    assert said in as_html(reported(folder, run))
    # costs as they were kept before anybody asked for waiting
    path = run.cost(0)
    older = [column for column in COST_TABLE if column.name not in ("fetch_s", "waited_s")]
    rows = [{one.name: row[one.name] for one in older} for row in read_rows(path)]
    path.unlink()
    write_table(path, older, rows, {})
    assert "Reading is not the limit" in as_html(reported(folder, run))
