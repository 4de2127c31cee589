"""All Sky Plate Solver's command: N.I.N.A. sees the frame that ASTAP's result shows it."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

from api.solver_commands import asps, astap
from api.solver_commands.host import LocalHost
from api.solver_commands.in_process import SolverInProcess
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.solver_commands.drawn_frames import (
    CENTER,
    HEIGHT_DEG,
    IN_TURNS,
    SCALE_ARCSEC,
    as_fits,
    as_png,
    drawn,
)
from tests.api.solver_commands.program_readers import nina_asps, nina_ini

PIXEL_UM = 9.0
FOCAL_MM = math.degrees(3600.0 * PIXEL_UM * 1e-3) / SCALE_ARCSEC
OPTICS = [f"{FOCAL_MM:.2f}", f"{PIXEL_UM:.2f}"]
AT = [f"{CENTER.ra_deg + 0.3:.2f}", f"{CENTER.dec_deg - 0.2:.2f}", "2.00"]


@pytest.fixture(scope="module")
def solver() -> SolverInProcess:
    return SolverInProcess()


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.long
@pytest.mark.parametrize(("angle_deg", "parity", "kind"), IN_TURNS)
def test_nina_sees_what_it_sees_by_astap(
    angle_deg: float, parity: int, kind: str, solver: SolverInProcess
) -> None:
    name = f"frame.{kind}"
    (as_fits if kind == "fits" else as_png)(Path(name), drawn(angle_deg, parity))
    host = LocalHost()
    near = ["-ra", f"{CENTER.ra_deg / 15}", "-spd", f"{CENTER.dec_deg + 90}", "-r", "2"]
    assert astap.run(["-f", name, "-fov", f"{HEIGHT_DEG}", *near], host, solver) == astap.SOLVED
    truth = nina_ini(Path("frame.ini").read_text("ascii"))
    assert asps.run(["/solvefile", name, "frame.txt", *OPTICS, *AT], host, solver) == asps.SOLVED
    text = Path("frame.txt").read_text("ascii")
    seen = nina_asps(text)
    assert truth is not None
    assert seen is not None
    places = [Icrs(one.ra_deg, one.dec_deg) for one in (seen, truth)]
    assert separation_arcsec(*places) / SCALE_ARCSEC < 0.01
    assert seen.scale_arcsec == pytest.approx(truth.scale_arcsec, rel=1e-4)
    assert abs((seen.angle_deg - truth.angle_deg + 180) % 360 - 180) < 0.01
    assert float(text.splitlines()[7]) == pytest.approx(FOCAL_MM, rel=1e-3)


@pytest.mark.long
def test_without_place_and_optics_the_whole_sky_is_searched(
    solver: SolverInProcess, sky_index: object
) -> None:
    as_fits(Path("f.fits"))
    zeros = ["0", "0", "0", "0", "0"]
    assert asps.run(["/solvefile", "f.fits", "f.txt", *zeros], LocalHost(), solver) == asps.SOLVED
    assert asps.run(["/SolveFile", "f.fits", "f.txt"], LocalHost(), solver) == asps.SOLVED


BAD = {
    "empty": lambda path: path.write_bytes(b""),
    "fifo": os.mkfifo,
    "folder": lambda path: path.mkdir(),
    "missing": lambda path: None,
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_frame_never_succeeds(kind: str, solver: SolverInProcess) -> None:
    BAD[kind](Path("bad.fits"))
    order = ["/solvefile", "bad.fits", "bad.txt", *OPTICS, *AT]
    assert asps.run(order, LocalHost(), solver) == asps.UNSOLVED
    text = Path("bad.txt").read_text("ascii")
    assert nina_asps(text) is None
    assert text.startswith("FAILED\n")


@pytest.mark.parametrize(
    "arguments", [[], ["/solvefile"], ["/other", "a", "b"], ["/solvefile", "f.fits", "./f.fits"]]
)
def test_what_makes_no_sense_changes_nothing(
    arguments: list[str], solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    content = as_fits(Path("f.fits")).read_bytes()
    assert asps.run(arguments, LocalHost(), solver) == asps.UNSOLVED
    assert capsys.readouterr().err.count("\n") == 1
    assert [path.name for path in Path().iterdir()] == ["f.fits"]
    assert Path("f.fits").read_bytes() == content
