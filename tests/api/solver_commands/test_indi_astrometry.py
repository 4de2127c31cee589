"""INDI's astrometry driver, the real one, with our `solve-field` as its solver."""

from __future__ import annotations

import base64
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.indi.codec.messages import Changed, Reader, State
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.solver_commands.fields import (
    CENTER,
    ROTATION_DEG,
    SCALE_ARCSEC_PX,
    environment,
    executables,
    fits_field,
    pixels,
)

DRIVER = shutil.which("indi_astrometry")
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(DRIVER is None, reason="indi_astrometry is not installed"),
]


@pytest.fixture
def driver(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    """The driver, as an INDI server starts it: it talks over its standard input and output."""
    commands = executables(tmp_path / "bin", "solve-field")
    # its own files have fixed names: one run at a time, and nothing of it is left
    if [*Path("/tmp").glob("ccdsolver*"), *Path("/tmp").glob("solution.wcs")]:
        pytest.skip("the driver's files lie in /tmp: somebody uses it")
    assert DRIVER is not None
    home = {**environment(commands), "HOME": str(tmp_path)}
    with subprocess.Popen(
        [DRIVER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=home,
        cwd=tmp_path,
    ) as process:
        yield process
        process.kill()
    for path in [*Path("/tmp").glob("ccdsolver*"), *Path("/tmp").glob("solution.wcs")]:
        path.unlink(missing_ok=True)


def tell(driver: subprocess.Popen[bytes], xml: str) -> None:
    """Send a message."""
    assert driver.stdin is not None
    driver.stdin.write(xml.encode())
    driver.stdin.flush()


def vector(kind: str, name: str, *values: tuple[str, str]) -> str:
    """A message that sets properties."""
    inner = "".join(f"<one{kind} name='{one}'>{value}</one{kind}>" for one, value in values)
    return f"<new{kind}Vector device='Astrometry' name='{name}'>{inner}</new{kind}Vector>"


def heard_until(driver: subprocess.Popen[bytes], name: str) -> dict[str, float]:
    """Read until a property's values come, or the solver says that it failed."""
    assert driver.stdout is not None
    reader = Reader()
    while True:
        part = os.read(driver.stdout.fileno(), 65536)
        assert part, "the driver has ended"
        for event in reader.feed(part):
            text = repr(event)
            assert "Solver failed" not in text, text
            assert "[ERROR]" not in text, text
            if isinstance(event, Changed) and event.name == name and event.state is State.OK:
                return {one: float(str(value)) for one, value in event.values.items()}


def test_the_driver_reads_our_solution(tmp_path: Path, driver: subprocess.Popen[bytes]) -> None:
    content = fits_field(tmp_path / "field.fits", pixels()).read_bytes()
    tell(driver, "<getProperties version='1.7'/>")
    tell(driver, vector("Switch", "CONNECTION", ("CONNECT", "On")))
    # its own default options, of which astrometry.net itself no longer knows one
    options = "--no-verify --no-plots --no-fits2fits --resort --downsample 2 -O"
    tell(
        driver,
        vector(
            "Text",
            "ASTROMETRY_SETTINGS",
            ("ASTROMETRY_SETTINGS_BINARY", "solve-field"),
            ("ASTROMETRY_SETTINGS_OPTIONS", options),
        ),
    )
    tell(
        driver,
        "<newBLOBVector device='Astrometry' name='ASTROMETRY_DATA'>"
        f"<oneBLOB name='ASTROMETRY_DATA_BLOB' size='{len(content)}' format='.fits'>"
        f"{base64.b64encode(content).decode()}</oneBLOB></newBLOBVector>",
    )
    found = heard_until(driver, "ASTROMETRY_RESULTS")
    center = Icrs(found["ASTROMETRY_RESULTS_RA"], found["ASTROMETRY_RESULTS_DE"])
    assert separation_arcsec(center, CENTER) < 0.1 * SCALE_ARCSEC_PX
    assert found["ASTROMETRY_RESULTS_PIXSCALE"] == pytest.approx(SCALE_ARCSEC_PX, rel=1e-3)
    assert found["ASTROMETRY_RESULTS_ORIENTATION"] == pytest.approx(ROTATION_DEG, abs=0.05)
