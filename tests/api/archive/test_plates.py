"""Photographic plates in an archive: a row and a header for each exposure."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest

from benchmarks.archive.plates import SCALE_ARCSEC_PX, drawn_plate, write_plate
from mountnav.archive.folder import Folder
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.archive.conftest import SOLVING
from tests.api.command_here import run_here


@pytest.mark.long
def test_a_plate_has_a_row_and_a_header_for_each_exposure(tmp_path: Path) -> None:
    plates = {"twice.fits": drawn_plate(1), "empty.fits": drawn_plate(7)}
    lines = ["file,ra_deg,dec_deg,radius_deg"]
    for name, plate in plates.items():
        write_plate(plate, tmp_path / name)
        place = plate.exposures[0] if plate.exposures else Icrs(120.0, 20.0)
        lines.append(f"{name},{place.ra_deg + 0.2:.3f},{place.dec_deg - 0.2:.3f},1")
    (tmp_path / "list.csv").write_text("\n".join(lines) + "\n")
    archive = tmp_path / "archive"
    words = ("--frames", tmp_path / "list.csv", "--profile", "plate", "--pairs", *SOLVING)
    assert run_here("archive", "init", archive, *words).returncode == 0
    assert run_here("archive", "work", archive).returncode == 0
    assert run_here("archive", "verify", archive).returncode == 0
    chunk = Folder.open(archive).run(None).chunk(0)
    rows = pq.read_table(chunk / "exposures.parquet").to_pylist()
    assert [(row["number"], row["exposure"]) for row in rows] == [(0, 1), (0, 2)]
    for place in plates["twice.fits"].exposures:
        apart = [separation_arcsec(place, Icrs(row["ra_deg"], row["dec_deg"])) for row in rows]
        assert min(apart) < SCALE_ARCSEC_PX
    (solution,) = pq.read_table(chunk / "solutions.parquet").to_pylist()
    assert (solution["number"], solution["wcs"]) == (0, rows[0]["wcs"])
    (frame, _) = pq.read_table(chunk / "frames.parquet").to_pylist()
    assert "2 exposures on one plate" in frame["notes"]
    assert run_here("archive", "wcs", archive, "--out", tmp_path / "headers").returncode == 0
    names = sorted(path.name for path in (tmp_path / "headers/00000").iterdir())
    assert names == ["000000000-twice-exposure2.wcs", "000000000-twice.wcs"]


def test_other_archives_have_no_table_of_exposures(tmp_path: Path) -> None:
    from tests.archive.made import archive, finished

    folder, run = archive(tmp_path / "archive", 2)
    finished(folder, run)
    assert not list(run.chunks.rglob("exposures.parquet"))
