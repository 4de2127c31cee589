"""`PlateSolve2` and `PlateSolve3`: N.I.N.A. and CCDciel see the frame that ASTAP's result shows them."""

from __future__ import annotations

import math
import os
from pathlib import Path

import pytest

from api.solver_commands import astap
from api.solver_commands.host import LocalHost
from api.solver_commands.in_process import SolverInProcess
from api.solver_commands.platesolve import SOLVED, UNSOLVED, run_platesolve2, run_platesolve3
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.solver_commands.drawn_frames import (
    CENTER,
    HEIGHT_DEG,
    HEIGHT_PX,
    IN_TURNS,
    SCALE_ARCSEC,
    WIDTH_PX,
    as_fits,
    as_png,
    drawn,
)
from tests.api.solver_commands.program_readers import (
    Seen,
    ccdciel_apm,
    ccdciel_ps3,
    nina_apm,
    nina_ini,
    nina_ps3,
)

RA, DEC = math.radians(CENTER.ra_deg + 0.3), math.radians(CENTER.dec_deg - 0.2)
WIDE, HIGH = math.radians(HEIGHT_DEG * WIDTH_PX / HEIGHT_PX), math.radians(HEIGHT_DEG)


@pytest.fixture(scope="module")
def solver() -> SolverInProcess:
    return SolverInProcess()


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _order_2(name: str, *, regions: int = 9, wide: float = WIDE, high: float = HIGH) -> list[str]:
    return [f"{RA},{DEC},{wide},{high},{regions},{name},0"]


def _order_3(name: str) -> list[str]:
    return [name, f"{RA}", f"{DEC}", f"{WIDE}", f"{HIGH}"]


def _apart_px(one: Seen | tuple[float, float], other: Seen) -> float:
    place = Icrs(one.ra_deg, one.dec_deg) if isinstance(one, Seen) else Icrs(*one)
    return separation_arcsec(place, Icrs(other.ra_deg, other.dec_deg)) / SCALE_ARCSEC


@pytest.mark.long
@pytest.mark.parametrize(("angle_deg", "parity", "kind"), IN_TURNS)
def test_programs_see_what_they_see_by_astap(
    angle_deg: float, parity: int, kind: str, solver: SolverInProcess
) -> None:
    name = f"frame.{kind}"
    (as_fits if kind == "fits" else as_png)(Path(name), drawn(angle_deg, parity))
    host = LocalHost()
    arguments = ["-ra", f"{math.degrees(RA) / 15}", "-spd", f"{math.degrees(DEC) + 90}", "-r", "2"]
    assert astap.run(["-f", name, "-fov", f"{HEIGHT_DEG}", *arguments], host, solver) == astap.SOLVED
    text = Path("frame.ini").read_text("ascii")
    truth = nina_ini(text)
    assert truth is not None
    said = dict(line.split("=", 1) for line in text.splitlines())
    matrix = [float(said[key]) for key in ("CD1_1", "CD1_2", "CD2_1", "CD2_2")]

    assert run_platesolve2(_order_2(name), host, solver) == SOLVED
    apm = Path("frame.apm").read_text("ascii")
    seen = nina_apm(apm)
    assert seen is not None
    assert _apart_px(seen, truth) < 0.01
    assert seen.scale_arcsec == pytest.approx(truth.scale_arcsec, rel=1e-4)
    assert abs((seen.angle_deg - truth.angle_deg + 180) % 360 - 180) < 0.01
    assert seen.flipped == truth.flipped
    plate = ccdciel_apm(apm)
    assert plate is not None
    assert _apart_px(plate[:2], truth) < 0.01
    assert plate[2] == pytest.approx(matrix, abs=1e-3 * SCALE_ARCSEC / 3600)

    assert run_platesolve3(_order_3(name), host, solver) == SOLVED
    ps3 = Path("frame_PS3.txt").read_text("ascii")
    seen = nina_ps3(ps3)
    assert seen is not None
    assert _apart_px(seen, truth) < 0.01
    assert seen.scale_arcsec == pytest.approx(truth.scale_arcsec, rel=1e-4)
    assert abs((seen.angle_deg - truth.angle_deg + 180) % 360 - 180) < 0.01
    plate = ccdciel_ps3(ps3)
    assert plate is not None
    assert _apart_px(plate[:2], truth) < 0.01
    assert plate[2] == pytest.approx(matrix, abs=1e-3 * SCALE_ARCSEC / 3600)


def test_a_result_of_platesolve2_has_three_lines_and_its_twenty_letters(solver: SolverInProcess) -> None:
    as_fits(Path("a, b.fits"))
    assert run_platesolve2(_order_2("a, b.fits"), LocalHost(), solver) == SOLVED
    lines = Path("a, b.apm").read_text("ascii").splitlines()
    assert len(lines) == 3
    assert len(lines[2]) == 20
    assert [len(line.split(",")) for line in lines[:2]] == [3, 5]


def test_an_argument_that_a_shell_has_parted_is_joined(solver: SolverInProcess) -> None:
    as_fits(Path("a b.fits"))
    assert run_platesolve2(_order_2("a b.fits")[0].split(" "), LocalHost(), solver) == SOLVED
    assert Path("a b.apm").is_file()


@pytest.mark.long
def test_a_file_alone_is_solved_blind(solver: SolverInProcess, sky_index: object) -> None:
    as_fits(Path("f.fits"))
    assert run_platesolve2(["f.fits"], LocalHost(), solver) == SOLVED
    assert run_platesolve3(["f.fits"], LocalHost(), solver) == SOLVED
    assert run_platesolve3(["f.fits", "0", "0", "0", "0"], LocalHost(), solver) == SOLVED


BAD = {
    "empty": lambda path: path.write_bytes(b""),
    "truncated": lambda path: path.write_bytes(as_fits(path).read_bytes()[:20000]),
    "fifo": os.mkfifo,
    "folder": lambda path: path.mkdir(),
    "missing": lambda path: None,
}


@pytest.mark.parametrize("kind", BAD)
def test_what_is_no_frame_never_succeeds(kind: str, solver: SolverInProcess) -> None:
    BAD[kind](Path("bad.fits"))
    assert run_platesolve2(_order_2("bad.fits"), LocalHost(), solver) == UNSOLVED
    apm = Path("bad.apm").read_text("ascii")
    assert nina_apm(apm) is None
    assert ccdciel_apm(apm) is None
    assert len(apm.splitlines()) == 3
    assert run_platesolve3(_order_3("bad.fits"), LocalHost(), solver) == UNSOLVED
    ps3 = Path("bad_PS3.txt").read_text("ascii")
    assert nina_ps3(ps3) is None
    assert ccdciel_ps3(ps3) is None
    assert len(ps3.splitlines()) == 7


@pytest.mark.long
def test_a_field_of_quite_another_size_is_no_success(solver: SolverInProcess) -> None:
    as_fits(Path("f.fits"))
    order = _order_2("f.fits", wide=3 * WIDE, high=3 * HIGH, regions=1)
    assert run_platesolve2(order, LocalHost(), solver) == UNSOLVED
    assert nina_apm(Path("f.apm").read_text("ascii")) is None


def test_an_old_result_does_not_outlive_a_failure(solver: SolverInProcess) -> None:
    Path("gone.apm").write_text("1,1,1\n1,1,1,1,1\nValid plate solution\n")
    assert run_platesolve2(_order_2("gone.fits"), LocalHost(), solver) == UNSOLVED
    assert nina_apm(Path("gone.apm").read_text("ascii")) is None


@pytest.mark.parametrize("arguments", [[], [""]])
def test_without_a_file_the_usage_is_told(
    arguments: list[str], solver: SolverInProcess, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_platesolve2(arguments, LocalHost(), solver) == UNSOLVED
    assert run_platesolve3(arguments, LocalHost(), solver) == UNSOLVED
    assert capsys.readouterr().err.count("usage:") == 2
    assert not list(Path().iterdir())


def test_the_image_is_never_written_over(solver: SolverInProcess) -> None:
    content = as_fits(Path("f.apm")).read_bytes()
    assert run_platesolve2(_order_2("f.apm"), LocalHost(), solver) == UNSOLVED
    assert Path("f.apm").read_bytes() == content
