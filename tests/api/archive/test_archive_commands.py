"""`mountnav archive` from the list to the report: what is solved, refused, set aside, and told."""

from __future__ import annotations

import io
import json
import shutil
import sys
import warnings
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from astropy import units
from astropy.io import fits
from astropy.io.votable import parse
from astropy.io.votable.ucd import check_ucd
from astropy.table import Table
from astropy.wcs import WCS, FITSFixedWarning
from pyarrow.dataset import dataset

from benchmarks.archive.drawn import judged
from mountnav.archive.folder import Folder
from mountnav.identification.lens import Lens
from mountnav.sky.coordinates import Icrs
from tests.api.archive.conftest import SOLVING
from tests.api.command_here import run_here


def _rows(archive: Path, name: str) -> list[dict[str, object]]:
    run = Folder.open(archive).run(None)
    return [
        row for number in sorted(run.done()) for row in pq.read_table(run.chunk(number) / name).to_pylist()
    ]


@pytest.fixture(scope="module")
def archive(lists: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archive that was run in two parts."""
    path = tmp_path_factory.mktemp("made") / "archive"
    done = run_here("archive", "init", path, "--frames", lists, "--chunk-frames", "4", "--pairs", *SOLVING)
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("10 frames in 3 chunks; run ")
    for part in ("1/2", "2/2"):
        done = run_here("archive", "work", path, "--chunk", part)
        assert done.returncode == 0, done.stderr
    return path


@pytest.mark.long
def test_every_frame_is_accounted_for(archive: Path, lists: Path) -> None:
    frames = _rows(archive, "frames.parquet")
    assert [row["number"] for row in frames] == list(range(10))
    refusals = {row["number"]: row["reason_code"] for row in _rows(archive, "refusals.parquet")}
    assert refusals == {3: "BAD_FRAME", 9: "UNREAD"}
    solved = {row["number"]: row for row in _rows(archive, "solutions.parquet")}
    found = judged([row | solved.get(row["number"], {}) for row in frames], lists)
    assert (found["solved"], found["false"]) == (8, 0)
    pairs = _rows(archive, "pairs.parquet")
    assert {row["number"] for row in pairs} == set(solved)
    assert {len(str(row["address"])) for row in frames} == {64}


@pytest.mark.long
def test_status_verify_and_report_say_the_same(archive: Path, tmp_path: Path) -> None:
    status = run_here("archive", "status", archive, "--json")
    told = json.loads(status.stdout)
    assert status.returncode == 0
    assert (told["frames_done"], told["solved"], told["refused"], told["set_aside"]) == (10, 8, 2, 0)
    verified = run_here("archive", "verify", archive, "--frames")
    assert verified.returncode == 0, verified.stdout
    assert "10 frames accounted for: 8 solved, 2 refused, 0 set aside" in verified.stdout
    assert run_here("archive", "report", archive, "--out", tmp_path / "r.html").returncode == 0
    page = (tmp_path / "r.html").read_text()
    assert "BAD_FRAME" in page


def test_what_is_done_is_not_done_again_and_only_from_the_same_settings(archive: Path, lists: Path) -> None:
    done = run_here("archive", "run", archive)
    assert (done.returncode, done.stderr) == (0, "nothing is left to do\n")
    again = run_here("archive", "again", archive, "--pairs", *SOLVING)
    assert "has these settings already" in again.stderr
    other = run_here("archive", "init", archive, "--frames", lists, *SOLVING)
    assert other.returncode == 2
    assert "is not empty" in other.stderr


def test_other_programs_read_it_without_us(archive: Path) -> None:
    run = Folder.open(archive).run(None)
    files = [*map(str, sorted(run.chunks.glob("*/solutions.parquet")))]
    whole = dataset(files, partitioning="hive", partition_base_dir=str(run.chunks)).to_table()
    assert set(whole["chunk"].to_pylist()) == {0, 1, 2}
    assert whole.num_rows == 8
    assert whole.schema.field("scale_arcsec_px").metadata[b"unit"] == b"arcsec / pix"


def test_headers_are_written_for_other_programs(archive: Path, tmp_path: Path) -> None:
    for kind, word in (("sip", "TAN"), ("tpv", "TPV")):
        done = run_here("archive", "wcs", archive, "--out", tmp_path / kind, "--kind", kind)
        assert done.stderr.startswith("8 headers")
        first = tmp_path / kind / "00000" / "000000000-000000.wcs"
        assert word in fits.Header.fromfile(first)["CTYPE1"]


@pytest.mark.long
def test_a_gwcs_is_written_that_puts_stars_where_wcslib_puts_them(archive: Path, tmp_path: Path) -> None:
    asdf = pytest.importorskip("asdf", reason="the extra gwcs isn't installed")
    done = run_here("archive", "wcs", archive, "--out", tmp_path, "--kind", "gwcs")
    assert done.stderr.startswith("8 headers"), done.stderr
    solutions = {row["number"]: row for row in _rows(archive, "solutions.parquet")}
    stars = [row for row in _rows(archive, "pairs.parquet") if row["number"] == 0]
    x, y = ([row[key] for row in stars] for key in ("x_px", "y_px"))
    with asdf.open(tmp_path / "00000" / "000000000-000000.asdf") as opened:
        assert opened["mountnav"]["file"].endswith("lists/000000.xy")
        assert opened["mountnav"]["run"] == Folder.open(archive).run(None).name
        told = opened["wcs"](x, y, with_bounding_box=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        wcs = WCS(json.loads(str(solutions[0]["wcs"])))
    assert np.abs(np.subtract(told, wcs.all_pix2world(x, y, 0))).max() < 1e-11


def test_a_gwcs_without_the_package_is_refused_and_nothing_written(
    archive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for missing in ("asdf", "gwcs"):
        monkeypatch.setitem(sys.modules, missing, None)
    done = run_here("archive", "wcs", archive, "--out", tmp_path / "out", "--kind", "gwcs")
    assert done.returncode == 2
    assert "pip install 'mountnav[gwcs]'" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_lens_that_tpv_has_no_words_for_is_left_out_and_told(archive: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(archive, copy)
    path = Folder.open(copy).run(None).chunk(0) / "solutions.parquet"
    table = pq.read_table(path)
    lens = Lens(Icrs(1.0, 2.0), 50.0, 50.0, np.eye(2) * 70.0, np.array([-0.04]), 100, 100).zpn_cards()
    words = pa.array([json.dumps(lens), *table["wcs"].to_pylist()[1:]])
    pq.write_table(table.set_column(table.schema.get_field_index("wcs"), "wcs", words), path)
    done = run_here("archive", "wcs", copy, "--out", tmp_path / "tpv", "--kind", "tpv")
    assert done.returncode == 1
    assert "7 headers" in done.stderr
    assert "1 frames were left out; the first one is " in done.stderr
    done = run_here("archive", "wcs", copy, "--out", tmp_path / "sip")
    assert (done.returncode, len(list((tmp_path / "sip").rglob("*.wcs")))) == (0, 8)


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("init", "new", "--frames", "none-*.fits"), "nothing fits the pattern"),
        (("init", "new", "--frames", "none.csv"), "No such file"),
        (("init", "new", "--frames", "odd.csv"), "row 1, a.fits: "),
        (("init", "new", "--frames", "odd.txt"), "nothing fits the pattern"),
        (("init", "new", "--frames", "odd.csv", "--undated", "soon"), "'soon' is not a date"),
        (("init", "new", "--frames", "odd.csv", "--deadline", "0.1"), "too short"),
        (("work", "new", "--chunk", "3/2"), "'3/2' is not a part"),
    ],
)
def test_bad_usage_is_one_line_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "odd.csv").write_text("file,ra_deg\na.fits,12.0\n")
    (tmp_path / "odd.txt").write_text("none-*.fits\n")
    done = run_here("archive", *words)
    assert done.returncode == 2
    assert why in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_an_archive_that_is_not_there_is_told(tmp_path: Path) -> None:
    done = run_here("archive", "status", tmp_path / "none")
    assert done.returncode == 1
    assert "is not an archive" in done.stderr


@pytest.mark.long
def test_stars_go_to_virtual_observatory_tools_with_names_units_and_ucds(
    archive: Path, tmp_path: Path
) -> None:
    pairs = [row for row in _rows(archive, "pairs.parquet") if row["number"] == 0]
    numbers = list(range(100, 100 + len(pairs)))
    named = {
        "source_id": numbers,
        "ra": [row["ra_deg"] for row in pairs],
        "dec": [row["dec_deg"] for row in pairs],
        "ref_epoch": [2016.0] * len(pairs),
    }
    pq.write_table(pa.table(named), tmp_path / "gaia.parquet")
    total = len(_rows(archive, "pairs.parquet"))
    for name in ("stars.parquet", "stars.fits"):
        done = run_here(
            "archive", "stars", archive, "-o", tmp_path / name, "--names", tmp_path / "gaia.parquet"
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr.endswith(f"{name}: {total} stars, {len(pairs)} with a name\n")
    parquet = pq.read_table(tmp_path / "stars.parquet")
    assert parquet["name"].null_count == 0  # astropy reads no text that is missing
    votable = io.BytesIO(parquet.schema.metadata[b"IVOA.VOTable-Parquet.content"])
    by_astropy, of_fits = Table.read(parse(votable)), Table.read(tmp_path / "stars.fits")
    assert by_astropy.colnames == of_fits.colnames == parquet.column_names
    assert by_astropy["dx_arcsec"].unit == of_fits["dx_arcsec"].unit == units.arcsec
    assert by_astropy["ra_deg"].meta["ucd"] == "pos.eq.ra;meta.main"
    for names in (parquet["name"].to_pylist(), of_fits["name"]):
        assert len(names) == total
        assert set(map(str, names[: len(pairs)])) == {f"Gaia DR3 {at}" for at in numbers}
    for name in ("mag", "x_px", "epoch_yr"):
        assert of_fits[name].tolist() == parquet[name].to_pylist()
    header = fits.getheader(tmp_path / "stars.fits", 1)
    ucds = {header[f"TTYPE{at}"]: header[f"TUCD{at}"] for at in range(1, header["TFIELDS"] + 1)}
    assert ucds["mag"] == "phot.mag"
    assert all(check_ucd(ucd, check_controlled_vocabulary=True) for ucd in ucds.values())
    with fits.open(tmp_path / "stars.fits") as opened:
        opened.verify("exception")
    again = run_here("archive", "stars", archive, "-o", tmp_path / "stars.fits")
    assert again.returncode == 2
    assert "is there already" in again.stderr
    assert run_here("archive", "stars", archive, "-o", tmp_path / "stars.txt").returncode == 2


@pytest.mark.long
def test_headers_put_stars_where_wcslib_puts_them(archive: Path, tmp_path: Path) -> None:
    pairs: dict[object, list[dict[str, object]]] = {}
    for row in _rows(archive, "pairs.parquet"):
        pairs.setdefault(row["number"], []).append(row)
    for kind in ("sip", "tpv"):
        run_here("archive", "wcs", archive, "--out", tmp_path / kind, "--kind", kind)
    for number, stars in pairs.items():
        places = []
        for kind in ("sip", "tpv"):
            (path,) = (tmp_path / kind).glob(f"*/{number:09d}-*.wcs")
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", FITSFixedWarning)  # it is a header without an image
                wcs = WCS(fits.Header.fromfile(path))
            ra, dec = ([row[key] for row in stars] for key in ("ra_deg", "dec_deg"))
            places.append(np.column_stack(wcs.all_world2pix(ra, dec, 0)))
        # where the deviations of the table say that the plate has the star
        solution = next(row for row in _rows(archive, "solutions.parquet") if row["number"] == number)
        scale = float(str(solution["scale_arcsec_px"]))
        measured = np.array([[row["x_px"], row["y_px"]] for row in stars], dtype=float)
        off = np.array([[row["dx_arcsec"], row["dy_arcsec"]] for row in stars], dtype=float)
        assert np.abs(places[0] - places[1]).max() < 0.01
        apart = np.hypot(*(places[0] - measured).T) - np.hypot(*off.T) / scale
        assert np.abs(apart).max() < 0.01
