"""StellarSolver itself, the library that Ekos solves by, set to our installed commands."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from api.solver_daemon.installing import install
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec
from tests.api.solver_commands.fields import (
    CENTER,
    HEIGHT_PX,
    SCALE_ARCSEC_PX,
    WIDTH_PX,
    fits_field,
    pixels,
)
from tests.api.stellarsolver import compiled

pytestmark = pytest.mark.long
SOURCE = Path(__file__).with_name("stellarsolver_local.cpp")
NEAR = ("83", "21.5")
BLIND = ("0", "0")
COMBINATIONS = [(45.0 * eighth, parity) for eighth in range(8) for parity in (1, -1)]


@dataclass(frozen=True, slots=True)
class Told:
    """What it understood."""

    center: Icrs
    scale_arcsec_px: float
    orientation_deg: float
    width_arcmin: float
    height_arcmin: float
    negative_parity: bool
    wcs_read: bool


@dataclass(frozen=True, slots=True)
class Driver:
    """The small program around the library, our commands, and a solver that is warm."""

    program: Path
    commands: Path
    folder: Path
    environment: dict[str, str]

    def run(self, drawn: np.ndarray, at: tuple[str, str], kind: str, given: str) -> tuple[Told | None, str]:
        """What it understood, or None; its log."""
        # as folders of pictures are called
        folder = self.folder / "Bilder für heute"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        field = fits_field(folder / "light 1.fits", drawn)
        (folder / "raw").write_bytes(drawn.astype("=u2").tobytes())
        size = (str(WIDTH_PX), str(HEIGHT_PX), str(SCALE_ARCSEC_PX))
        line = [str(self.program), str(field), str(folder / "raw"), *size, *at]
        line += [str(self.commands), kind, given]
        done = subprocess.run(line, capture_output=True, text=True, env=self.environment, timeout=300)
        if done.returncode:
            return None, done.stderr
        ra, dec, scale, orientation, width, height, parity, wcs = map(float, done.stdout.split())
        return Told(Icrs(ra, dec), scale, orientation, width, height, parity == 1, wcs == 1), done.stderr


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driver]:
    """All of it; the solver is ended afterwards."""
    folder = tmp_path_factory.mktemp("stellarsolver")
    program = compiled(SOURCE, folder / "local")
    install(folder / "bin")
    environment = {
        **os.environ,
        "QT_QPA_PLATFORM": "offscreen",
        "HOME": str(folder),
        "LC_ALL": "C.UTF-8",
        "MOUNTNAV_RUN": str(folder / "run"),
        "MOUNTNAV_SOLVER": "",
    }
    solver = [sys.executable, "-m", "api.main", "solver"]
    subprocess.run([*solver, "start"], env=environment, check=True, capture_output=True, timeout=300)
    yield Driver(program, folder / "bin", folder, environment)
    subprocess.run([*solver, "stop"], env=environment, check=False, capture_output=True, timeout=300)


def as_astap(rotation_deg: float, parity: int) -> tuple[float, float]:
    """Scale and orientation by its rule for ASTAP: CDELT1 with its sign, CROTA1 with the other."""
    return -parity * SCALE_ARCSEC_PX, -rotation_deg


def as_astrometry(rotation_deg: float, parity: int) -> tuple[float, float]:
    """The same by `wcsinfo`."""
    return SCALE_ARCSEC_PX, rotation_deg


def as_watney(rotation_deg: float, parity: int) -> tuple[float, float]:
    """The same by Watney's JSON."""
    return SCALE_ARCSEC_PX, -parity * rotation_deg


@pytest.mark.parametrize(
    ("kind", "given", "rule"),
    [("astap", "image", as_astap), ("astrometry", "stars", as_astrometry), ("watney", "image", as_watney)],
)
def test_it_understands_each_command_in_any_orientation(
    driver: Driver, kind: str, given: str, rule: Callable[[float, int], tuple[float, float]]
) -> None:
    for rotation_deg, parity in COMBINATIONS:
        told, log = driver.run(pixels(rotation_deg, parity), NEAR, kind, given)
        assert told is not None, log
        which = (rotation_deg, parity)
        off_px = separation_arcsec(told.center, CENTER) / SCALE_ARCSEC_PX
        # a list of StellarSolver's own stars has its errors
        assert off_px < (0.01 if given == "image" else 0.05), which
        scale, orientation_deg = rule(*which)
        assert told.scale_arcsec_px == pytest.approx(scale, rel=1e-4), which
        assert half_turn_deg(told.orientation_deg - orientation_deg) == pytest.approx(0.0, abs=0.02), which
        # of frames a pixel less is counted by one of its rules
        assert abs(told.width_arcmin) == pytest.approx(WIDTH_PX * SCALE_ARCSEC_PX / 60, rel=2e-3)
        assert abs(told.height_arcmin) == pytest.approx(HEIGHT_PX * SCALE_ARCSEC_PX / 60, rel=2e-3)
        assert told.negative_parity is (parity == -1), which
        assert told.wcs_read, "it read our WCS file"


@pytest.mark.parametrize(
    ("kind", "given"), [("astap", "image"), ("astrometry", "image"), ("watney", "stars")]
)
def test_it_solves_blind_and_takes_noise_for_a_failure(driver: Driver, kind: str, given: str) -> None:
    told, log = driver.run(pixels(), BLIND, kind, given)
    assert told is not None, log
    assert separation_arcsec(told.center, CENTER) < 0.05 * SCALE_ARCSEC_PX
    noise = np.random.default_rng(8).normal(1000, 20, (HEIGHT_PX, WIDTH_PX)).astype(np.uint16)
    told, log = driver.run(noise, NEAR, kind, given)
    assert told is None, log
