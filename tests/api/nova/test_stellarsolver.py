"""StellarSolver itself, the library that Ekos solves by, set to our address."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import pytest

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.nova.nova_service import (
    HEIGHT_PX,
    SCALE_ARCSEC_PX,
    TRUTH,
    WIDTH_PX,
    Standing,
    drawn,
    noise,
    pixels,
)
from tests.api.stellarsolver import compiled

pytestmark = [pytest.mark.asyncio(loop_scope="module"), pytest.mark.long]
SOURCE = Path(__file__).with_name("stellarsolver_online.cpp")
ITS_OWN_RACE = 4
"""Exit code of the driver: StellarSolver has stopped listening while our answer was on its way (its `run`
leaves its loop when it looks between the stages of monitoring and of the log), and would wait for ever."""
TRIES = 4
"""Seen once in some thirty runs. Doubled, slow answers of ours would hide behind it."""


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small program around the library, compiled."""
    return compiled(SOURCE, tmp_path_factory.mktemp("stellarsolver") / "online")


async def run(driver: Path, nova: Standing, tmp_path: Path, frame: bytes, kind: str) -> tuple[int, str, str]:
    """Exit code, standard output, log."""
    (tmp_path / "frame.fits").write_bytes(frame)
    (tmp_path / "raw").write_bytes(pixels().astype("=u2").tobytes())
    process = await asyncio.create_subprocess_exec(
        str(driver),
        str(tmp_path / "frame.fits"),
        str(tmp_path / "raw"),
        str(WIDTH_PX),
        str(HEIGHT_PX),
        nova.url,
        "any-key",
        kind,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=os.environ | {"QT_QPA_PLATFORM": "offscreen"},
    )
    out, err = await process.communicate()
    return process.returncode or 0, out.decode(), err.decode(errors="replace")


@pytest.mark.parametrize("kind", ["image", "stars"])
async def test_it_understands_what_it_is_told(
    driver: Path, nova: Standing, tmp_path: Path, kind: str
) -> None:
    for _ in range(TRIES):
        code, out, log = await run(driver, nova, tmp_path, drawn(), kind)
        if code != ITS_OWN_RACE:
            break
    assert code == 0, log
    ra, dec, scale, orientation, width_arcmin, height_arcmin, wcs = map(float, out.split())
    assert separation_arcsec(Icrs(ra, dec), TRUTH) < 0.2 * SCALE_ARCSEC_PX
    assert scale == pytest.approx(SCALE_ARCSEC_PX, rel=1e-3)
    assert abs(orientation) < 0.1
    assert width_arcmin == pytest.approx(WIDTH_PX * SCALE_ARCSEC_PX / 60, rel=1e-3)
    assert height_arcmin == pytest.approx(HEIGHT_PX * SCALE_ARCSEC_PX / 60, rel=1e-3)
    assert wcs == 1, "it read our WCS file"
    assert ("list of stars" in log) is (kind == "stars")


async def test_noise_is_a_failure_to_it(driver: Path, nova: Standing, tmp_path: Path) -> None:
    code, out, log = await run(driver, nova, tmp_path, noise(), "image")
    assert (code, out) == (1, "")
    assert "Solver Failed" in log
