"""`mountnav series` on files: the table, the JSON object, and the exit codes."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from typer.testing import CliRunner

from api.cli.app import app
from mountnav.errors import BadRequest
from mountnav.sky.sphere import displaced
from tests.series.conftest import CENTER

FRAME_KEYS = {
    "file", "mid_exposure_utc", "mode", "solved", "ra_deg", "dec_deg", "center_sigma_arcsec", "rotation_deg",
    "scale_arcsec_px", "false_probability", "shift", "audit_arcsec", "measured", "persistent", "notes",
    "time_s",
}  # fmt: skip


@pytest.fixture(scope="module")
def files(draw, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Five frames as a camera would write them; the first header tells the place."""
    folder = tmp_path_factory.mktemp("night")
    paths = []
    for number in range(5):
        frame = draw(number, displaced(CENTER, 20.0 * number, -8.0 * number), told=CENTER)
        header = fits.Header()
        header.update(frame.header)
        paths.append(folder / f"light_{number}.fits")
        fits.PrimaryHDU(frame.pixels, header).writeto(paths[-1])
    return paths


def run(*arguments: str | Path):
    return CliRunner().invoke(app, ["series", *map(str, arguments)])


@pytest.mark.long
def test_the_table(files: list[Path]) -> None:
    done = run(*files)
    assert done.exit_code == 0, done.output
    lines = done.stdout.splitlines()
    assert [line.split()[1] for line in lines[1:6]] == ["full", *["preliminary"] * 4]
    assert all(line.endswith(f"light_{i}.fits") for i, line in enumerate(lines[1:6]))
    drift = next(line for line in lines if line.startswith("drift:"))
    assert "times cos δ" in drift
    assert float(drift.split()[2]) == pytest.approx(20.0, abs=0.1)
    assert max(map(len, lines)) < 140


@pytest.mark.long
def test_the_object(files: list[Path]) -> None:
    done = run(*files, "--json", "--audit", "2")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert set(record) == {"frames", "segments", "drift", "reason", "persistent_sources"}
    assert [one["file"] for one in record["frames"]] == [str(one) for one in files]
    assert all(set(one) == FRAME_KEYS for one in record["frames"])
    assert record["frames"][0]["shift"] is None
    assert [one["audit_arcsec"] is not None for one in record["frames"]] == [False, False, True, False, True]
    assert record["drift"]["dec_arcsec_min"] == pytest.approx(-8.0, abs=0.1)
    assert record["drift"]["ra_cosdec_sigma_arcsec_min"] > 0
    assert record["segments"][0]["frames"] == [0, 1, 2, 3, 4]
    assert record["persistent_sources"] > 50
    assert record["reason"] is None


@pytest.mark.long
def test_files_that_are_no_frames_are_told_and_the_code_is_1(files: list[Path], tmp_path: Path) -> None:
    cut = tmp_path / "cut.fits"
    cut.write_bytes(files[1].read_bytes()[:20000])
    done = run(files[0], cut, tmp_path / "absent.fits", tmp_path, files[2], files[3], "--json")
    assert done.exit_code == 1
    record = json.loads(done.stdout)
    assert [one["solved"] for one in record["frames"]] == [True, False, False, False, True, True]
    assert all(one["notes"] for one in record["frames"][1:4])
    assert record["drift"]["frames"] == 3


@pytest.mark.long
def test_without_dates_there_is_no_drift_and_a_reason(files: list[Path], tmp_path: Path) -> None:
    bare = []
    for path in files[:3]:
        with fits.open(path) as hdus:
            header = hdus[0].header.copy()
            del header["DATE-OBS"]
            bare.append(tmp_path / path.name)
            fits.PrimaryHDU(np.array(hdus[0].data), header).writeto(bare[-1])
    done = run(*bare, "--json")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record["drift"] is None
    assert "taken" in record["reason"]
    assert record["frames"][2]["shift"]["pairs"] > 50


@pytest.mark.long
@pytest.mark.parametrize(
    "options", [("--ra", "400", "--dec", "1"), ("--ra", "10"), ("--audit", "-1"), ("--profile", "best")]
)
def test_bad_usage_is_refused_before_anything_is_done(files: list[Path], options: tuple[str, ...]) -> None:
    done = run(files[0], *options)
    assert isinstance(done.exception, BadRequest)  # api.main makes it exit code 2
    assert done.stdout == ""


def test_no_files_is_bad_usage() -> None:
    assert run().exit_code == 2


@pytest.mark.long
@pytest.mark.shared
@pytest.mark.parametrize(
    ("profile", "allowed_arcsec"),
    [("measured", 1.5), pytest.param("paper", 2.6, marks=pytest.mark.long)],
)
def test_a_real_series(shared: Path, profile: str, allowed_arcsec: float) -> None:
    """Eight frames of one field, three minutes apart, with the truth of an outside solver (0.5″).

    Allowed are 0.3 px, and 0.5 px in the profile `paper`, whose plain mean has false neighbors in it.
    """
    folder = shared / "data" / "frames"
    known = [
        one
        for one in json.loads((folder / "manifest.json").read_text())["frames"]
        if one.get("series_id") == "exotic-hatp32-a"
    ]
    assert len(known) == 8
    done = run(*(folder / one["file"] for one in known), "--json", "--audit", "0", "--profile", profile)
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert [one["mode"] for one in record["frames"]] == ["full", *["preliminary"] * 7]
    for one, true in zip(record["frames"], known, strict=True):
        assert os.path.basename(one["file"]) == os.path.basename(true["file"])
        east = (one["ra_deg"] - true["ra_deg"]) * 3600 * np.cos(np.radians(true["dec_deg"]))
        north = (one["dec_deg"] - true["dec_deg"]) * 3600
        assert np.hypot(east, north) < allowed_arcsec
    drift = record["drift"]
    minutes = [3 * i for i in range(8)]
    for name, key, factor in (
        ("ra_cosdec", "ra_deg", np.cos(np.radians(46.75))),
        ("dec", "dec_deg", 1.0),
    ):
        true_rate = np.polyfit(minutes, [one[key] * 3600 * factor for one in known], 1)[0]
        assert abs(drift[f"{name}_arcsec_min"] - true_rate) < 3 * drift[f"{name}_sigma_arcsec_min"]
