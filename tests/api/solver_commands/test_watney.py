"""`watney-solve`: its JSON and lines, its angles by its own formula, its exit codes."""

from __future__ import annotations

import io
import json
import math
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import given
from hypothesis import strategies as st

from api.solver_commands.host import LocalHost
from api.solver_commands.in_process import SolverInProcess
from api.solver_commands.watney import DONE, FAILED, run
from mountnav.catalog.embedded import embedded_catalog
from mountnav.frames import Frame, Hint
from mountnav.measuring.hfd import measure_hfd
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Solution
from mountnav.solving.solve import solve
from tests.api.solver_commands.drawn_frames import (
    ANGLES_DEG,
    CENTER,
    HEIGHT_PX,
    PARITIES,
    SCALE_ARCSEC,
    WIDTH_PX,
    as_fits,
    as_png,
    drawn,
)

RADIUS_DEG = 0.5 * math.hypot(WIDTH_PX, HEIGHT_PX) * SCALE_ARCSEC / 3600.0
NEAR = ["-m", "-r", f"{CENTER.ra_deg + 0.2}", "-d", f"{CENTER.dec_deg}", "-f", f"{RADIUS_DEG:.3f}", "-s", "2"]
PLAIN = ["success", "ra", "dec", "ra_hms", "dec_dms", "fieldRadius", "orientation", "pixScale", "parity"]
MEASURED = ["starsDetected", "starsUsed", "timeSpent", "searchIterations"]
EXTENDED = [
    "imageWidth", "imageHeight", "searchRunCenter", "searchRunRadius", "quadMatches", "fieldWidth",
    "fieldHeight", "fits_cd1_1", "fits_cd1_2", "fits_cd2_1", "fits_cd2_2", "fits_cdelt1", "fits_cdelt2",
    "fits_crota1", "fits_crota2", "fits_crpix1", "fits_crpix2", "fits_crval1", "fits_crval2",
]  # fmt: skip


@pytest.fixture(scope="module")
def solver() -> SolverInProcess:
    return SolverInProcess()


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _ours(frame: Frame) -> Solution:
    solution = solve(frame, embedded_catalog(), hint=Hint(center=CENTER)).solution
    assert solution is not None
    return solution


@pytest.mark.long
@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize("angle_deg", ANGLES_DEG)
def test_the_answer_is_by_watneys_own_formulas(
    angle_deg: float, parity: int, solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    frame = drawn(angle_deg, parity)
    as_fits(Path("f.fits"), frame)
    arguments = ["nearby", "-i", "f.fits", *NEAR, "--extended", "True", "-w", "f.wcs"]
    assert run(arguments, LocalHost(), solver) == DONE
    told = json.loads(capsys.readouterr().out)
    assert list(told) == PLAIN + MEASURED + EXTENDED
    ours = _ours(frame)
    assert separation_arcsec(Icrs(told["ra"], told["dec"]), ours.center) / SCALE_ARCSEC < 0.01
    assert told["pixScale"] == pytest.approx(ours.scale_arcsec_px, rel=1e-4)
    assert told["parity"] == ("normal" if ours.parity == 1 else "flipped")
    assert told["fieldRadius"] == pytest.approx(RADIUS_DEG, rel=1e-3)
    # its CROTA1 is the angle of CD1_2 and CD2_2, its CROTA2 that of the other two
    cd = {key: told[f"fits_cd{key}"] for key in ("1_1", "1_2", "2_1", "2_2")}
    sign = -1 if cd["1_1"] * cd["2_2"] < cd["1_2"] * cd["2_1"] else 1
    assert told["fits_crota1"] == pytest.approx(math.degrees(math.atan2(sign * cd["1_2"], cd["2_2"])))
    assert told["fits_crota2"] == pytest.approx(-math.degrees(math.atan2(cd["2_1"], sign * cd["1_1"])))
    assert told["orientation"] == told["fits_crota1"]
    assert told["fits_cdelt1"] == pytest.approx(sign * ours.scale_arcsec_px / 3600, rel=1e-4)
    up_deg = math.degrees(math.atan2(cd["1_2"], cd["2_2"]))
    assert abs((up_deg - ours.rotation_deg + 180) % 360 - 180) < 0.01
    header = fits.getheader("f.wcs")
    assert header["IMAGEW"] == WIDTH_PX
    assert header["CTYPE1"] == "RA---TAN"
    assert header["CD1_1"] == pytest.approx(cd["1_1"])


def test_rows_of_a_picture_count_as_in_its_file(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    as_png(Path("p.png"))
    assert run(["nearby", "-i", "p.png", *NEAR], LocalHost(), solver) == DONE
    told = json.loads(capsys.readouterr().out)
    assert list(told) == PLAIN
    assert told["parity"] == "flipped"
    assert told["dec_dms"].startswith("32 59 5") or told["dec_dms"].startswith("33 0 0")


def test_lines_with_tabs_and_files(solver: SolverInProcess, capsys: pytest.CaptureFixture[str]) -> None:
    as_fits(Path("f.fits"))
    ra = ["-r", "06 36 00", "--dec=33 00 00.5", "-g", "1-3", "-m"]
    files = ["-o", "out.tsv", "--out-format", "tsv", "--log-file=log.txt", "--use-parallelism", "true"]
    assert run(["nearby", "--image", "f.fits", *ra, *files], LocalHost(), solver) == DONE
    assert capsys.readouterr().out == ""
    lines = dict(line.split("\t") for line in Path("out.tsv").read_text("ascii").splitlines())
    assert list(lines) == PLAIN
    assert lines["success"] == "true"
    assert "success" in Path("log.txt").read_text("ascii")


class _Piped(LocalHost):
    """A host whose standard input holds something."""

    def __init__(self, content: bytes) -> None:
        self.content = content

    def read_input(self) -> bytes:
        return self.content


def test_an_image_comes_from_standard_input(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    content = as_fits(Path("f.fits")).read_bytes()
    assert run(["nearby", "--image-stdin", *NEAR], _Piped(content), solver) == DONE
    assert json.loads(capsys.readouterr().out)["success"] is True
    assert run(["nearby", "--image-stdin", *NEAR], _Piped(b""), solver) == FAILED
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(content)))
    assert LocalHost().read_input() == content


def _list_of_stars(path: Path) -> None:
    stars = measure_hfd(drawn(), least_snr=20.0)
    columns = [
        fits.Column("X_IMAGE", "E", array=stars.x_px + 1),
        fits.Column("Y_IMAGE", "E", array=stars.y_px + 1),
        fits.Column("MAG_AUTO", "E", array=-2.5 * np.log10(stars.flux)),
    ]
    fits.HDUList([fits.PrimaryHDU(), fits.BinTableHDU.from_columns(columns)]).writeto(path)


def test_a_list_of_stars_is_solved_like_its_frame(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    _list_of_stars(Path("f.xyls"))
    size = ["--xyls-imagesize", f"{WIDTH_PX}x{HEIGHT_PX}"]
    assert run(["nearby", "--xyls", "f.xyls", *size, *NEAR], LocalHost(), solver) == DONE
    told = json.loads(capsys.readouterr().out)
    assert told["success"] is True
    assert separation_arcsec(Icrs(told["ra"], told["dec"]), CENTER) / SCALE_ARCSEC < 0.3
    content = Path("f.xyls").read_bytes()
    assert run(["nearby", "--xyls-stdin", *size, *NEAR], _Piped(content), solver) == DONE
    assert json.loads(capsys.readouterr().out)["success"] is True
    assert run(["nearby", "--xyls", "f.xyls", *NEAR], LocalHost(), solver) == FAILED
    assert "--xyls-imagesize" in capsys.readouterr().out


@pytest.mark.long
def test_blind_searches_the_whole_sky(
    solver: SolverInProcess, sky_index: object, capsys: pytest.CaptureFixture[str]
) -> None:
    as_fits(Path("f.fits"))
    radii = ["--min-radius", "0.5", "--max-radius", "8"]
    assert run(["blind", "-i", "f.fits", *radii], LocalHost(), solver) == DONE
    told = json.loads(capsys.readouterr().out)
    assert separation_arcsec(Icrs(told["ra"], told["dec"]), CENTER) / SCALE_ARCSEC < 0.1
    assert run(["blind", "-i", "f.fits", "--min-radius", "4"], LocalHost(), solver) == DONE
    assert json.loads(capsys.readouterr().out) == {"success": False}


def test_headers_are_used_where_they_are_asked_for(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    as_fits(Path("f.fits"), RA=CENTER.ra_deg, DEC=CENTER.dec_deg, FOCALLEN=154.7, XPIXSZ=9.0)
    assert run(["nearby", "-i", "f.fits", "-h", "-s", "5"], LocalHost(), solver) == DONE
    assert json.loads(capsys.readouterr().out)["success"] is True


def test_what_is_not_solved_is_no_error(solver: SolverInProcess, capsys: pytest.CaptureFixture[str]) -> None:
    pixels = np.random.default_rng(8).normal(1000.0, 10.0, (HEIGHT_PX, WIDTH_PX)).astype(np.uint16)
    fits.PrimaryHDU(pixels).writeto("noise.fits")
    arguments = ["nearby", "-i", "noise.fits", *NEAR, "-w", "noise.wcs", "--extended"]
    assert run(arguments, LocalHost(), solver) == DONE
    told = json.loads(capsys.readouterr().out)
    assert told["success"] is False
    assert list(told) == ["success", *MEASURED]
    assert not Path("noise.wcs").exists()


BAD = {
    "empty": lambda path: path.write_bytes(b""),
    "truncated": lambda path: path.write_bytes(as_fits(path).read_bytes()[:1000]),
    "fifo": os.mkfifo,
    "folder": lambda path: path.mkdir(),
    "missing": lambda path: None,
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_frame_is_an_error(
    kind: str, solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    BAD[kind](Path("bad.fits"))
    assert run(["nearby", "-i", "bad.fits", *NEAR, "-o", "out.json"], LocalHost(), solver) == FAILED
    out = capsys.readouterr().out
    assert out.startswith("WATNEY ERROR: ")
    assert out.count("\n") == 1
    assert not Path("out.json").exists()


@pytest.mark.long
@pytest.mark.parametrize(
    "arguments",
    [
        ["sideways", "-i", "f.fits"],
        ["nearby", "-i", "f.fits"],
        ["nearby", "-i", "f.fits", "-m", "-r", "10", "-d", "20"],
        ["nearby", "-i", "f.fits", "-m", "-r", "x", "-d", "20", "-f", "2"],
        ["nearby", "-i", "f.fits", "-m", "-r", "10", "-d", "120", "-f", "2"],
        ["nearby", "-i", "f.fits", "-m", "-r", "10", "-d", "20", "-f", "nan"],
        ["nearby", "-i", "p.png", "-h"],
        ["nearby", "-m"],
        ["blind", "-i", "f.fits", "--nonsense", "3"],
        ["blind", "-i", "f.fits", "-q"],
        ["blind", "-i", "f.fits", "--out-format", "xml"],
        ["blind", "-i", "f.fits", "--min-radius", "9"],
        ["blind", "-i", "f.fits", "--max-radius", "17"],
        ["blind", "-i"],
    ],
)
def test_arguments_that_make_no_sense_are_errors(
    arguments: list[str], solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    as_fits(Path("f.fits"))
    as_png(Path("p.png"))
    assert run(arguments, LocalHost(), solver) == FAILED
    assert "ERROR(S):" in capsys.readouterr().out


def test_a_folder_that_is_not_there_is_an_error(
    solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    as_fits(Path("f.fits"))
    assert run(["nearby", "-i", "f.fits", *NEAR, "-o", "no/out.json"], LocalHost(), solver) == FAILED
    assert capsys.readouterr().out.startswith("WATNEY ERROR: ")


@given(st.lists(st.text(max_size=6), max_size=4))
def test_any_arguments_end_with_an_exit_code(arguments: list[str]) -> None:
    class Quiet(LocalHost):
        def open(self, path: str) -> io.BytesIO:
            raise FileNotFoundError(path)

        def write(self, path: str, content: bytes) -> None:
            raise AssertionError(path)

        def out(self, text: str) -> None:
            pass

        def read_input(self) -> bytes:
            return b""

    assert run(["blind", *arguments], Quiet(), SolverInProcess()) == FAILED
