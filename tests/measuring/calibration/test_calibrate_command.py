"""`mountnav calibrate` as a user runs it: what it prints, its files, its exit codes."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from api.main import main
from tests.measuring.synthetic_camera import SyntheticCamera, write


@dataclass
class Done:
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


def run(*arguments: str | Path) -> Done:
    """The console script's own entry, without a new process for each command."""
    out, err = io.StringIO(), io.StringIO()
    words = ["mountnav", "calibrate", *map(str, arguments)]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", words)
        with pytest.raises(SystemExit) as left:
            main()
    code = left.value.code
    return Done(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("night")
    camera = SyntheticCamera()
    for i in range(5):
        write(folder / f"b{i}.fits", camera.exposed(0.0, 0.0, i), IMAGETYP="Bias Frame", EXPTIME=0.0)
        write(folder / f"d{i}.fits", camera.exposed(0.0, 60.0, 10 + i), IMAGETYP="Dark Frame", EXPTIME=60.0)
        write(
            folder / f"f{i}.fits",
            camera.exposed(40000.0, 2.0, 20 + i),
            IMAGETYP="Flat",
            EXPTIME=2.0,
            FILTER="R",
        )
    write(
        folder / "light.fits",
        camera.exposed(600.0, 60.0, 30),
        IMAGETYP="Light",
        EXPTIME=60.0,
        FILTER="R",
        OBJECT="M 1",
    )
    return folder


@pytest.fixture(scope="module")
def built(folder: Path) -> Done:
    """A build with a pattern, a shell's list of files, and a repeated option."""
    darks = sorted(folder.glob("d*.fits"))
    flats = sorted(folder.glob("f*.fits"))
    words = ["build", "--bias", folder / "b*.fits", "--dark", *darks]
    words += ["--flat", flats[0], "--flat", *flats[1:], "--out", folder / "masters"]
    command = [sys.executable, "-m", "api.main", "calibrate", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    return Done(done.returncode, done.stdout, done.stderr)


@pytest.mark.long
def test_build_tells_what_it_made(folder: Path, built: Done) -> None:
    assert built.returncode == 0, built.stderr
    lines = built.stdout.splitlines()
    assert lines[0].startswith("bias_400x300.fits: 5 frames, level 502")
    assert lines[1].startswith("dark_400x300_60s.fits: 5 frames")
    assert lines[2].startswith("flat_400x300_R.fits: 5 frames")
    assert ", gain 1." in lines[2]
    made = sorted(path.name for path in (folder / "masters").iterdir())
    assert made == [
        "bad_pixels_400x300.fits",
        "bias_400x300.fits",
        "dark_400x300_60s.fits",
        "flat_400x300_R.fits",
    ]


@pytest.mark.long
@pytest.mark.usefixtures("built")
def test_info_for_people_and_programs(folder: Path) -> None:
    done = run("info", folder / "masters")
    assert done.returncode == 0
    assert len(done.stdout.splitlines()) == 4
    facts = json.loads(run("info", folder / "masters", "--json").stdout)
    assert facts["bias_adu"] == pytest.approx(503.0, abs=1.0)
    dark = next(one for one in facts["masters"] if one["kind"] == "dark")
    assert dark["exposure_s"] == 60.0
    assert dark["frames"] == 5
    assert dark["unit"] == "ADU/s"


@pytest.mark.long
@pytest.mark.usefixtures("built")
def test_apply_writes_calibrated_frames(folder: Path) -> None:
    other = folder / "small.fits"
    write(other, np.zeros((100, 100), np.uint16) + np.arange(100, dtype=np.uint16))
    done = run("apply", folder / "masters", folder / "light.fits", other, "--out", folder / "out")
    assert done.returncode == 1
    first, *rest = done.stdout.splitlines()
    assert "bias_400x300.fits, dark_400x300_60s.fits, flat_400x300_R.fits" in first
    assert "the frame has 100 × 100 pixels" in " ".join(rest)
    with fits.open(folder / "out" / "light.fits") as hdus:
        hdus.verify("exception")
        assert hdus[0].data.dtype == np.dtype(">f4")
        assert hdus[0].header["CALSTAT"] == "BDF"
        assert hdus[0].header["OBJECT"] == "M 1"
        assert hdus[0].header["SATURATE"] > 60000
    again = run("apply", folder / "masters", folder / "out" / "light.fits", "--out", folder / "twice")
    assert again.returncode == 1
    assert "already applied" in again.stdout
    itself = run("apply", folder / "masters", folder / "light.fits", "--out", folder)
    assert itself.returncode == 1
    assert "over itself" in itself.stdout


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("build", "--out", "m"), 2, "nothing to build"),
        (("build", "--bias", "none.fits", "--out", "m"), 2, "not there"),
        (("build", "--bias", "{}/d0.fits", "--out", "m"), 1, "d0.fits: its header calls it a dark"),
        (("build", "--bias", "{}/b0.fits", "--out", "m", "--method", "sum"), 2, "mean or median"),
        (("build", "--bias", "{}/b0.fits", "{}/small.fit", "--out", "m"), 2, "small.fit: it has 100"),
        (("info", "none"), 2, "is not a folder"),
        (("info", "{}"), 2, "holds no masters"),
    ],
)
def test_bad_usage_is_one_line(
    folder: Path, tmp_path: Path, arguments: tuple[str, ...], code: int, words: str
) -> None:
    if not (folder / "small.fit").exists():
        write(folder / "small.fit", np.zeros((100, 100), np.uint16))
    filled = [word.format(folder) if "{}" in word else word for word in arguments]
    filled = [str(tmp_path / "m") if word == "m" else word for word in filled]
    done = run(*filled)
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "m").exists()
