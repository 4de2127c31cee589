"""`mountnav accuracy`: tables that agree with each other, pictures that hold the data, bad wishes refused."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from api.cli.accuracy import accuracy, rejected_percents
from mountnav.catalog.embedded import embedded_catalog
from mountnav.errors import BadRequest
from mountnav.identification.accuracy import Deviations
from mountnav.simulation.catalog_errors import ErringCatalog
from mountnav.simulation.optics import optics_preset
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from tests.api.command_here import exit_code

PLACE = Icrs(301.0, 36.0)
OPTICS = replace(
    optics_preset("ison-nm"),
    width_px=800,
    height_px=640,
    scale_arcsec_px=6.2,
    zero_point_mag=21.0,
    fwhm_px=2.6,
)
PLAIN: dict[str, Any] = {
    "ra": PLACE.ra_deg,
    "dec": PLACE.dec_deg,
    "radius": 0.3,
    "scale": 6.2,
    "reject": "0,10",
}


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two frames of one field, and between them a file that is none."""
    folder = tmp_path_factory.mktemp("frames")
    sky = ErringCatalog(embedded_catalog(), seed=5)
    paths = []
    for number in range(2):
        optics = replace(OPTICS, rotation_deg=70.0 * number)
        frame = draw_frame(
            PLACE, optics, sky, exposure_s=2.0, mid_exposure_utc=datetime(2013, 6, 1, tzinfo=UTC), seed=number
        )
        paths.append(folder / f"field{number}.fits")
        header = fits.Header()
        for name, value in frame.header.items():
            header[name] = value
        fits.PrimaryHDU(frame.pixels, header).writeto(paths[-1])
    notes = folder / "notes[1].fits"
    notes.write_text("these are my notes")
    return [paths[0], notes, paths[1]]


@pytest.fixture(scope="module")
def record(frames: list[Path]) -> dict[str, Any]:
    """What --json prints for the three files, with pictures."""
    done = subprocess.run(
        [
            *(sys.executable, "-m", "api.main", "accuracy", *map(str, frames)),
            *("--ra", str(PLACE.ra_deg), "--dec", str(PLACE.dec_deg), "--radius", "0.3", "--scale", "6.2"),
            *("--reject", "0,5,10", "--json", "--plot", str(frames[0].parent / "pictures" / "new")),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    result: dict[str, Any] = json.loads(done.stdout)
    return result


@pytest.mark.long
def test_json_tells_of_each_frame_and_of_all(frames: list[Path], record: dict[str, Any]) -> None:
    assert [one["file"] for one in record["frames"]] == [str(path) for path in frames]
    assert [one["solved"] for one in record["frames"]] == [True, False, True]
    assert record["solved"] == 2
    assert record["catalog"] == embedded_catalog().name
    first, bad, last = record["frames"]
    assert bad["reason"]
    assert bad["rows"] == []
    assert [row["rejected_percent"] for row in record["overall"]] == [0, 5, 10]
    for row, mine, other in zip(record["overall"], first["rows"], last["rows"], strict=True):
        for kind in ("ra_arcsec", "dec_arcsec", "mag"):
            assert abs(row[kind]["number"] - mine[kind]["number"] - other[kind]["number"]) <= 1
    everything = record["overall"][0]["ra_arcsec"]
    assert everything["number"] == first["pairs"] + last["pairs"] > 100
    # the sky errs by the catalog's sigma: about 0.1″ at 2013
    assert 0.06 < everything["standard_deviation"] < 0.25
    assert everything["most_modulus"] >= record["overall"][2]["ra_arcsec"]["most_modulus"]
    assert 0.8 < record["fit_factor"] < 1.0


@pytest.mark.long
def test_pictures_are_written(frames: list[Path], record: dict[str, Any]) -> None:
    folder = frames[0].parent / "pictures" / "new"
    assert sorted(path.name for path in folder.iterdir()) == ["histograms.png", "residuals-800x640.png"]
    for path in folder.iterdir():
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("L"))
        assert min(pixels.shape) > 300
        assert 0.01 < np.mean(pixels < 200) < 0.5


@pytest.mark.long
def test_markdown_and_the_table_for_people_hold_the_same_numbers(
    frames: list[Path], record: dict[str, Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(accuracy, frames, **PLAIN | {"as_markdown": True}) == 1
    text = capsys.readouterr().out
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]]
        for line in text.splitlines()
        if line.startswith("| ")
    ]
    assert len(rows[0]) == 8
    assert [row[0] for row in rows[1::6]] == ["field0.fits", "field1.fits", "all 2"]
    assert "Not solved: " in text
    assert "notes[1].fits" in text
    last = rows[-6:]
    for row, kind in zip(last[:3], ("ra_arcsec", "dec_arcsec", "mag"), strict=True):
        want = record["overall"][0][kind]
        names = ("number", "mean", "standard_deviation", "least_modulus", "most_modulus")
        assert [float(cell) for cell in row[3:]] == pytest.approx([want[name] for name in names], abs=5.1e-4)
    assert exit_code(accuracy, frames, **PLAIN) == 1
    people = capsys.readouterr().out
    assert "2 of 3 frames solved" in people
    assert "notes[1].fits  not solved" in people
    for row in rows[1:]:
        assert "".join((row[1], row[2], *row[3:])).replace(" ", "") in people.replace(" ", "")


@pytest.mark.long
def test_independent_deviations_are_larger_and_all_pairs_are_more(
    frames: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    def overall(**how: bool) -> dict[str, Any]:
        assert exit_code(accuracy, [frames[0]], **PLAIN | how | {"as_json": True}) == 0
        got: dict[str, Any] = json.loads(capsys.readouterr().out)
        return got

    plain, independent, every = overall(), overall(leave_one_out=True), overall(all_pairs=True)
    a, b = (one["overall"][0]["ra_arcsec"]["standard_deviation"] for one in (plain, independent))
    # the fit takes p/n from its pairs' variance, and its own error adds as much to an independent pair's
    assert b / a == pytest.approx(1 / plain["fit_factor"] ** 2, rel=0.05)
    assert b > a
    assert every["overall"][0]["ra_arcsec"]["number"] >= plain["overall"][0]["ra_arcsec"]["number"]
    assert (every["every_pair"], independent["leave_one_out"]) == (True, True)


@pytest.mark.parametrize("sigma", [0.0, -0.03, float("nan")])
def test_a_bad_catalog_sigma_is_refused_before_anything_is_read(sigma: float) -> None:
    with pytest.raises(BadRequest, match="--catalog-sigma"):
        accuracy([Path("there-is-none.fits")], **PLAIN, catalog_sigma=sigma)


@pytest.mark.parametrize("reject", ["", "x", "5,", "-1", "100", "nan", "inf", "5;10", "0,5,10%"])
def test_bad_shares_are_refused_before_anything_is_read(reject: str) -> None:
    with pytest.raises(BadRequest, match="--reject"):
        accuracy([Path("there-is-none.fits")], **PLAIN | {"reject": reject})


@pytest.mark.parametrize(
    "change",
    [
        {"as_json": True, "as_markdown": True},
        {"ra": None},
        {"dec": 91.0},
        {"ra": math.nan},
        {"scale": -1.0},
        {"radius": 0.0},
        {"ra": None, "dec": None},
    ],
)
def test_bad_wishes_are_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BadRequest):
        accuracy([Path("there-is-none.fits")], **PLAIN | change)


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("keep")
    for folder in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(BadRequest, match="--plot"):
            accuracy([Path("there-is-none.fits")], **PLAIN | {"plot": folder})
    assert (tmp_path / "file").read_text() == "keep"


@pytest.mark.long
def test_bad_usage_exits_2() -> None:
    command = [sys.executable, "-m", "api.main", "accuracy", "none.fits", "--reject", "5,x"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "--reject" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.long
def test_nothing_solved_is_told_in_every_form(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for form in ({}, {"as_json": True}, {"as_markdown": True}):
        assert exit_code(accuracy, [tmp_path / "none.fits"], **PLAIN | form | {"plot": tmp_path / "p"}) == 1
        assert "none.fits" in capsys.readouterr().out
    assert list((tmp_path / "p").iterdir()) == []


def test_shares_are_taken_once_and_in_order() -> None:
    assert rejected_percents("10, 0,2.5,10") == (10.0, 0.0, 2.5)


def strewn(n: int) -> Deviations:
    rng = np.random.default_rng(2)
    mag = np.where(np.arange(n) % 7 == 0, np.nan, rng.normal(0.0, 0.1, n))
    x, y = rng.uniform(0, 399, n), rng.uniform(0, 299, n)
    columns: list[Any] = [*rng.normal(0.0, 0.3, (2, n)), mag, x, y, *rng.normal(0.0, 0.3, (2, n))]
    return Deviations(*columns)


@pytest.mark.long
def test_histograms_hold_every_measurement() -> None:
    from api.cli.accuracy_plots import histograms

    found = strewn(500)
    panels = histograms(found, frames=3).axes
    for axes, number in zip(panels, (500, 500, 428), strict=True):
        bars: list[Any] = list(axes.patches)
        drawn = sum(bar.get_height() for bar in bars)
        told = next(text.get_text() for text in axes.texts).splitlines()
        outside = int(told[2].split()[0]) if len(told) > 2 else 0
        assert drawn + outside == number
    without = replace(found, mag=np.full(500, np.nan))
    assert len(histograms(without, frames=1).axes) == 2


def arrows_of(found: Deviations, frames: int) -> Any:
    # here, because every process that collects tests would import matplotlib: a second for each
    from matplotlib.quiver import Quiver

    from api.cli.accuracy_plots import residual_map

    (arrows,) = (
        one
        for one in residual_map(found, 400, 300, frames=frames).axes[0].collections
        if isinstance(one, Quiver)
    )
    return arrows


def test_arrows_are_the_deviations_along_the_frames_axes() -> None:
    found = strewn(50)
    arrows = arrows_of(found, frames=1)
    assert np.asarray(arrows.U) == pytest.approx(found.along_x_arcsec)
    assert np.asarray(arrows.V) == pytest.approx(found.along_y_arcsec)
    assert np.asarray(arrows.X) == pytest.approx(found.x_px)


def test_of_many_measurements_the_cells_means_are_drawn() -> None:
    found = strewn(5000)
    pushed = replace(found, along_x_arcsec=found.along_x_arcsec + 1.0)
    arrows = arrows_of(pushed, frames=9)
    assert arrows.X.size == 14 * 11
    assert np.mean(np.asarray(arrows.U)) == pytest.approx(1.0, abs=0.02)
    assert np.std(np.asarray(arrows.V)) < 0.1
