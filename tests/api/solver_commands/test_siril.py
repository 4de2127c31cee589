"""Siril itself, from 1.2 on, without its window, with our `solve-field` as its local astrometry.net.

Debian 12 has 1.0, which calls no `solve-field`: the tests skip there. A newer one is found in the PATH.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec
from tests.api.solver_commands.fields import (
    CENTER,
    HEIGHT_PX,
    SCALE_ARCSEC_PX,
    WIDTH_PX,
    environment,
    executables,
    fits_field,
    pixels,
)

pytestmark = [
    pytest.mark.long,
    pytest.mark.filterwarnings("ignore::astropy.wcs.wcs.FITSFixedWarning"),
]

PIXEL_UM = 5.0
FOCAL_MM = 206.265 * PIXEL_UM / SCALE_ARCSEC_PX
ASKED = f"platesolve 83.0,21.5 -noflip -focal={FOCAL_MM:.3f} -pixelsize={PIXEL_UM} -localasnet"
"""0.2° off the truth, which Siril takes for its radius of 10°."""
COMBINATIONS = [(45 * eighth, parity) for eighth in range(8) for parity in (1, -1)]


@pytest.fixture(scope="module")
def siril() -> list[str]:
    """The command."""
    found = shutil.which("siril-cli")
    if found is None:
        pytest.skip("siril-cli is not installed")
    # its library of windows wants a display, though no window is ever opened
    display = ["xvfb-run", "-a"] if shutil.which("xvfb-run") else []
    told = subprocess.run([*display, found, "--version"], capture_output=True, text=True, timeout=120)
    version = re.search(r"siril (\d+)\.(\d+)", told.stdout)
    if version is None:
        pytest.skip(f"siril-cli doesn't run here: {(told.stdout + told.stderr).strip()[-200:]}")
    if (int(version[1]), int(version[2])) < (1, 2):
        pytest.skip(f"{version[0]} calls no solve-field: 1.2 does")
    return [*display, found]


def run(siril: list[str], folder: Path, *lines: str) -> str:
    """Run a script in a folder; what Siril logged."""
    (folder / "script.ssf").write_text("\n".join(("requires 1.2.0", *lines, "close", "")))
    commands = executables(folder / "bin", "solve-field")
    # settings of its own: it keeps the last focal length
    home = {**environment(commands), "HOME": str(folder)}
    line = [*siril, "-d", str(folder), "-s", str(folder / "script.ssf")]
    done = subprocess.run(line, capture_output=True, text=True, env=home, cwd=folder, timeout=600)
    return done.stdout + done.stderr


def test_it_reads_our_solution_in_any_orientation(siril: list[str], tmp_path: Path) -> None:
    lines = []
    for number, (rotation_deg, parity) in enumerate(COMBINATIONS):
        fits_field(tmp_path / f"field{number}.fit", pixels(float(rotation_deg), parity))
        lines += [f"load field{number}", ASKED, f"save solved{number}"]
    log = run(siril, tmp_path, *lines)
    assert log.count("Local astrometry.net solve succeeded") == len(COMBINATIONS), log
    for number, (rotation_deg, parity) in enumerate(COMBINATIONS):
        header = fits.getheader(tmp_path / f"solved{number}.fit")
        # it counts pixels from half a pixel lower than FITS, with any solver: CRPIX is W/2
        assert (header["CRPIX1"], header["CRPIX2"]) == (WIDTH_PX / 2, HEIGHT_PX / 2)
        center = Icrs(header["CRVAL1"], header["CRVAL2"])
        assert separation_arcsec(center, CENTER) < 0.01 * SCALE_ARCSEC_PX, (rotation_deg, parity)
        matrix = WCS(header).pixel_scale_matrix
        assert np.sqrt(abs(np.linalg.det(matrix))) * 3600 == pytest.approx(SCALE_ARCSEC_PX, rel=1e-4)
        assert np.sign(np.linalg.det(matrix)) == -parity
        up_deg = np.degrees(np.arctan2(matrix[0, 1], matrix[1, 1]))
        assert half_turn_deg(up_deg - rotation_deg) == pytest.approx(0.0, abs=0.02)


def test_noise_is_a_failure_to_it(siril: list[str], tmp_path: Path) -> None:
    drawn = pixels().copy()
    rng = np.random.default_rng(5)
    rng.shuffle(drawn.reshape(-1, 8))  # the stars' light, but no sky
    fits_field(tmp_path / "noise.fit", drawn)
    log = run(siril, tmp_path, "load noise", ASKED, "save solved")
    assert "solve succeeded" not in log
    assert not (tmp_path / "solved.fit").exists()
    assert re.search(r"Plate Solving failed|not enough stars|failed", log, re.I), log
