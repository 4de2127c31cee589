"""`mountnav archive learn`: the next run knows the scale, tells so, and is the same in any order."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from mountnav.archive.folder import Folder
from mountnav.archive.recipe import recipe_in
from mountnav.archive.tables import read_rows
from tests.api.archive.conftest import SOLVING
from tests.api.command_here import run_here
from tests.archive.test_store import tree

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def unscaled(lists: Path) -> Path:
    """The lists with places, but without scales; the sixth is of another telescope, a half longer."""
    with open(lists) as file:
        rows = list(csv.DictReader(file))
    sixth = lists.parent / rows[5]["file"]
    head, *stars = sixth.read_text().split()
    apart = [[float(value) for value in line.split(",")] for line in stars]
    kept = [
        f"{1.5 * x - 400},{1.5 * y - 300},{flux}" for x, y, flux in apart if 267 < x < 1332 and 200 < y < 999
    ]
    other = lists.parent / "lists" / "other.xy"
    other.write_text("\n".join([head, *kept, "0,0,0.0001", "1599,1199,0.0001"]) + "\n")
    rows[5]["file"] = "lists/other.xy"
    table = lists.parent / "unscaled.csv"
    with open(table, "w", newline="") as file:
        written = csv.DictWriter(file, ["file", "ra_deg", "dec_deg", "radius_deg"], extrasaction="ignore")
        written.writeheader()
        written.writerows(row | {"radius_deg": 1} for row in rows)
    return table


def test_the_next_run_knows_the_scale_and_tells_so(
    unscaled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mountnav.archive.learning.LEAST_FRAMES", 4)
    monkeypatch.setattr("mountnav.archive.learning.LEAST_ALIKE", 0.8)
    path = tmp_path / "archive"
    init = run_here("archive", "init", path, "--frames", unscaled, "--chunk-frames", "4", *SOLVING)
    assert init.returncode == 0, init.stderr
    nothing = run_here("archive", "learn", path)
    assert nothing.returncode == 1
    assert "nothing was learned" in nothing.stderr
    assert len(Folder.open(path).runs()) == 1
    assert run_here("archive", "run", path, "--jobs", "1").returncode == 0
    learned = run_here("archive", "learn", path)
    assert learned.returncode == 0, learned.stderr
    assert learned.stdout.startswith("camera without a name, 1599 × 1199: 5.9")
    folder = Folder.open(path)
    older, newer = map(folder.run, folder.runs())
    assert recipe_in(newer).decides["learned"] == {"run": recipe_in(older).hash, "chunks": [0, 1, 2]}
    for part in ("2/3", "1/3", "0/3"):
        assert run_here("archive", "work", path, "--chunk", part).returncode == 0
    before = tree(newer.chunks)
    rows = [row for number in range(3) for row in read_rows(newer.chunk(number) / "frames.parquet")]
    assert [row["number"] for row in rows if row["prior"] == "failed"] == [5]
    held = [row for row in rows if row["prior"] == "held"]
    assert [row["number"] for row in held] == [0, 1, 2, 4, 6, 7, 8]
    assert {row["prior_frames"] for row in held} == {7}
    assert "the camera's prior" in str(rows[5]["contradictions"])
    assert rows[5]["solved"]
    # the same in another order, and by a worker that makes the recipe again
    for number in (0, 1, 2):
        newer.chunk(number).rename(tmp_path / f"away{number}")
    assert run_here("archive", "run", path, "--jobs", "2").returncode == 0
    assert tree(newer.chunks) == before
    assert run_here("archive", "verify", path).returncode == 0
    report = tmp_path / "r.html"
    assert run_here("archive", "report", path, "--out", report).returncode == 0
    assert "Frames for which a learned scale was tried" in report.read_text()
