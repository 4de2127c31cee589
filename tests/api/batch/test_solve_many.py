"""`mountnav solve` over folders and lists: what is written, what is passed over, how it ends."""

from __future__ import annotations

import csv
import io
import json
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from astropy.io import fits
from astropy.table import Table
from astropy.wcs import WCS, FITSFixedWarning
from PIL import Image

from api.batch.rows import FRAME_COLUMNS
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.batch.conftest import HINT, PLACE, SCALE_ARCSEC_PX
from tests.api.command_here import run_here

ORDER = ["a.fits", "below/b.fits", "broken.fits", "c.fit"]
MOUNTNAV = [sys.executable, "-m", "api.main"]


@pytest.mark.long
def test_a_folder_is_solved_in_order_and_a_bad_file_stops_nothing(folder: Path) -> None:
    done = run_here("solve", folder, "--json", *HINT)
    assert done.returncode == 1
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert [os.path.relpath(record["file"], folder) for record in records] == ORDER
    assert [record["solved"] for record in records] == [True, True, False, True]
    assert "sha256" not in records[0]
    assert done.stderr.startswith("3 of 4 frames solved in ")
    assert done.stderr.endswith("\nnot solved: 1 × no usable image\n")
    for record in (records[0], records[1], records[3]):
        miss_arcsec = separation_arcsec(Icrs(record["ra_deg"], record["dec_deg"]), PLACE)
        assert miss_arcsec < SCALE_ARCSEC_PX


@pytest.mark.long
def test_patterns_and_lists_name_frames_too(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    listed = tmp_path / "list.txt"
    listed.write_text(f"{folder}/c.fit\r\n\n{folder}/below/*.fits\n{folder}/none.fits\n")
    done = run_here("solve", "--list", listed, "--json", *HINT)
    files = [os.path.relpath(json.loads(line)["file"], folder) for line in done.stdout.splitlines()]
    assert files == ["c.fit", "below/b.fits", "none.fits"]
    standard = io.TextIOWrapper(io.BytesIO(f"{folder}/a.fits\0".encode()))
    monkeypatch.setattr(sys, "stdin", standard)
    done = run_here("solve", f"{folder}/**/b.fits", "--list", "-", "--json", *HINT)
    files = [os.path.relpath(json.loads(line)["file"], folder) for line in done.stdout.splitlines()]
    assert files == ["below/b.fits", "a.fits"]
    assert done.returncode == 0


@pytest.mark.long
@pytest.mark.parametrize(
    ("words", "why"),
    [
        ((), "no frame was named"),
        (("nothing*.fits",), "nothing fits the pattern"),
        (("--list", "/there/is/none"), "--list /there/is/none: No such file"),
        (("--list", "/dev/zero"), "--list /dev/zero: it is a device"),
        ((".",), "holds no frame"),
        (("x.fits", "--retry"), "--retry without --resume"),
        (("x.fits", "--json", "--csv", "-"), "two kinds of results on the standard output"),
        (("x.fits", "--parquet", "-"), "Parquet can't go to the standard output"),
        (("x.fits", "--resume", "results.txt"), "the kind of results that results.txt holds is not known"),
        (("x.fits", "y.fits", "--annotate", "one.png"), "is one picture, but there are 2 frames"),
        (("x.fits", "--csv", "/there/is/none.csv"), "/there/is/none.csv can't be written: No such file"),
        (("x.fits", "--parquet", "/there/is/none.parquet"), "/there/is/none.parquet can't be written"),
        (("x.fits", "--parquet", "/dev/null"), "not a file of such results: it is a device, not a file"),
    ],
)
def test_bad_usage_is_one_line_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], why: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run_here("solve", *words, *HINT)
    assert done.returncode == 2
    assert why in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_the_same_rows_in_each_kind_of_file(folder: Path, tmp_path: Path) -> None:
    names = [str(tmp_path / f"r.{kind}") for kind in ("csv", "ecsv", "parquet")]
    done = run_here("solve", folder, "--csv", names[0], "--ecsv", names[1], "--parquet", names[2], *HINT)
    assert done.returncode == 1
    with open(names[0]) as file:
        rows = list(csv.DictReader(file))
    table, parquet = Table.read(names[1]), pq.read_table(names[2])
    columns = [column.name for column in FRAME_COLUMNS]
    assert columns == list(rows[0]) == table.colnames == parquet.column_names
    assert [row["solved"] for row in rows] == ["True", "True", "False", "True"]
    assert list(table["solved"]) == parquet["solved"].to_pylist() == [True, True, False, True]
    assert str(table["ra_deg"].unit) == "deg"
    assert rows[2]["ra_deg"] == ""
    assert table["ra_deg"].mask[2]
    assert parquet["ra_deg"][2].as_py() is None
    assert (
        rows[2]["reason_code"] == table["reason_code"][2] == parquet["reason_code"][2].as_py() == "BAD_FRAME"
    )
    assert float(rows[0]["ra_deg"]) == table["ra_deg"][0] == parquet["ra_deg"][0].as_py()
    cards = json.loads(parquet["wcs"][0].as_py())
    assert cards["CRVAL1"] == parquet["ra_deg"][0].as_py()
    assert int(rows[0]["width_px"]) == 640


@pytest.mark.long
@pytest.mark.parametrize("kind", ["jsonl", "csv", "ecsv", "parquet"])
def test_a_run_is_resumed_by_content_and_not_by_name(folder: Path, tmp_path: Path, kind: str) -> None:
    results = tmp_path / f"results.{kind}"
    first = run_here("solve", folder / "a.fits", folder / "broken.fits", "--resume", results, *HINT)
    assert first.returncode == 1
    (folder / "a.fits").rename(folder / "z.fits")
    second = run_here("solve", folder, "--resume", results, *HINT)
    assert second.returncode == 1
    assert "2 of 2 frames solved" in second.stderr
    assert "2 passed over, for the result file holds them (1 of them not solved)" in second.stderr
    assert "z.fits" not in second.stdout
    third = run_here("solve", folder, "--resume", results, "--retry", "--json", *HINT)
    assert "3 passed over" in third.stderr
    assert [json.loads(line)["file"] for line in third.stdout.splitlines()] == [str(folder / "broken.fits")]


@pytest.mark.long
def test_the_line_that_was_not_finished_is_done_again(folder: Path, tmp_path: Path) -> None:
    results = tmp_path / "results.jsonl"
    run_here("solve", folder / "a.fits", folder / "c.fit", "--resume", results, *HINT)
    whole = results.read_bytes()
    results.write_bytes(whole[:-20])
    done = run_here("solve", folder / "a.fits", folder / "c.fit", "--resume", results, *HINT)
    assert "1 of 1 frames solved" in done.stderr
    lines = results.read_text().splitlines()
    assert [Path(json.loads(line)["file"]).name for line in lines] == ["a.fits", "c.fit"]


@pytest.mark.long
@pytest.mark.parametrize("kind", ["csv", "ecsv", "parquet"])
def test_rows_are_added_and_files_of_others_left_alone(folder: Path, tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"r.{kind}"
    for name in ("a.fits", "c.fit"):
        assert run_here("solve", folder / name, f"--{kind}", path, *HINT).returncode == 0
    rows = pq.read_table(path) if kind == "parquet" else Table.read(path)
    assert [Path(str(name)).name for name in rows["file"]] == ["a.fits", "c.fit"]
    other = tmp_path / f"other.{kind}"
    other.write_text("my,own,table\n1,2,3\n")
    done = run_here("solve", folder / "a.fits", f"--{kind}", other, *HINT)
    assert done.returncode == 2
    assert "exists already and is not a file of such results" in done.stderr
    assert other.read_text() == "my,own,table\n1,2,3\n"


@pytest.mark.long
def test_headers_are_updated_and_the_pixels_stay(folder: Path, tmp_path: Path) -> None:
    path, results = folder / "a.fits", tmp_path / "r.csv"
    path.chmod(0o640)
    before = fits.getdata(path)
    done = run_here("solve", path, "--update", "--resume", results, *HINT)
    assert done.returncode == 0, done.stderr
    with fits.open(path, checksum=True) as hdus:
        header = hdus[0].header
        assert (hdus[0].data == before).all()
        assert header["CHECKSUM"]
        assert "mountnav" in str(header["HISTORY"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        center = WCS(header).all_pix2world([[319.5, 239.5]], 0)[0]
    assert separation_arcsec(Icrs(*map(float, center)), PLACE) < SCALE_ARCSEC_PX
    assert path.stat().st_mode & 0o777 == 0o640
    # the file is another one now, and still the one that was solved
    again = run_here("solve", path, "--resume", results, *HINT)
    assert "1 passed over" in again.stderr


def test_what_has_no_header_is_told_and_fails(folder: Path) -> None:
    picture = folder / "a.png"
    pixels = fits.getdata(folder / "a.fits").astype(np.uint16)
    Image.fromarray(pixels).save(picture)
    before = picture.read_bytes()
    done = run_here("solve", picture, "--update", *HINT)
    assert done.returncode == 1
    assert "not a FITS file" in done.stderr
    assert picture.read_bytes() == before


@pytest.mark.long
def test_headers_beside_stars_and_pictures(folder: Path, tmp_path: Path) -> None:
    (folder / "a.png").write_bytes(b"no picture")
    pairs, pictures = tmp_path / "pairs.ecsv", tmp_path / "pictures"
    run_here("solve", folder, "--wcs", "--pairs", pairs, "--annotate", pictures, *HINT)
    # two frames have the name a: their files bear the whole one
    assert sorted(path.name for path in folder.rglob("*.wcs")) == ["a.fits.wcs", "b.wcs", "c.wcs"]
    assert sorted(path.name for path in pictures.iterdir()) == ["a.fits.png", "b.png", "c.png"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FITSFixedWarning)
        wcs = WCS(fits.getheader(folder / "c.wcs"))
    stars = Table.read(pairs)
    stars = stars[[str(name).endswith("c.fit") for name in stars["file"]]]
    assert len(stars) > 10
    sky = wcs.all_pix2world(np.column_stack((stars["x_px"], stars["y_px"])), 0)
    off = np.hypot(*((sky - np.column_stack((stars["ra_deg"], stars["dec_deg"]))) * 3600.0).T)
    assert np.median(off) < SCALE_ARCSEC_PX
    with Image.open(pictures / "c.png") as picture:
        colors = np.asarray(picture)
    assert picture.size == (640, 480)
    # the ring of the first star, drawn where FITS viewers show it
    star = stars[0]
    x, y = int(star["x_px"]) + 9, 479 - int(star["y_px"])
    around = colors[max(0, y - 2) : y + 3, max(0, x - 2) : x + 3].reshape(-1, 3).astype(int)
    assert (np.abs(around - (80, 230, 120)).sum(axis=1) < 30).any()


@pytest.mark.long
def test_each_extension_of_a_file(tmp_path: Path, drawn: list[bytes]) -> None:
    path, results = tmp_path / "mosaic.fits", tmp_path / "r.csv"
    images = [fits.ImageHDU(fits.getdata(io.BytesIO(one)), name=f"CCD{n}") for n, one in enumerate(drawn, 1)]
    mask = fits.ImageHDU(np.zeros((480, 640), np.uint8), name="MASK")
    fits.HDUList([fits.PrimaryHDU(), *images, mask]).writeto(path)
    done = run_here("solve", path, "--extension", "all", "--resume", results, "--update", "--json", *HINT)
    assert done.returncode == 0, done.stdout
    records = [json.loads(line) for line in done.stdout.splitlines()]
    assert [record["extension"] for record in records] == [1, 2, 3]
    with fits.open(path, checksum=True) as hdus:
        for number in (1, 2, 3):
            assert hdus[number].header["CRVAL1"] == records[number - 1]["ra_deg"]
        assert "CRVAL1" not in hdus[4].header
    again = run_here("solve", path, "--extension", "all", "--resume", results, *HINT)
    assert "3 passed over" in again.stderr
    single = run_here("solve", path, "--json", *HINT)
    (note,) = [note for note in json.loads(single.stdout)["notes"] if "other" in note]
    assert "other images in the file: 2" in note
    assert "--extension all" in note


@pytest.mark.long
def test_side_by_side_gives_the_same_in_the_same_order(folder: Path, tmp_path: Path) -> None:
    plain, pooled = (
        subprocess.run(
            [*MOUNTNAV, "solve", str(folder), "--json", "--jobs", jobs, "--wcs", *HINT],
            capture_output=True,
            text=True,
            timeout=300,
        )
        for jobs in ("1", "2")
    )
    assert plain.returncode == pooled.returncode == 1, pooled.stderr
    one, two = ([json.loads(line) for line in done.stdout.splitlines()] for done in (plain, pooled))
    for record in (*one, *two):
        del record["time_s"]
    assert one == two
    assert "3 of 4 frames solved" in pooled.stderr
    assert len(list(folder.rglob("*.wcs"))) == 3


@pytest.mark.long
@pytest.mark.parametrize("jobs", ["1", "2"])
def test_an_interrupt_ends_it_with_a_summary_and_whole_results(
    tmp_path: Path, drawn: list[bytes], jobs: str
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for number in range(2000):
        (frames / f"{number:04d}.fits").symlink_to(tmp_path / "one.fits")
    (tmp_path / "one.fits").write_bytes(drawn[0])
    results = tmp_path / "r.parquet"
    command = [*MOUNTNAV, "solve", str(frames), "--json", "--jobs", jobs, "--parquet", str(results), *HINT]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        process.send_signal(signal.SIGINT)
        # `communicate` would read past what `readline` has in its buffer
        rest = process.stdout.read()
        assert process.stderr is not None
        said = process.stderr.read()
    assert process.returncode == 130, said
    assert said.startswith("interrupted: ")
    records = [json.loads(line) for line in (first + rest).splitlines()]
    assert 0 < len(records) < 2000
    assert pq.read_table(results).num_rows == len(records)
    assert [record["file"] for record in records] == [
        str(frames / f"{number:04d}.fits") for number in range(len(records))
    ]
