"""`wcsinfo` beside the real one, of plates of ours and of anybody; without it, against its formulas."""

from __future__ import annotations

import math
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.api.solver_commands.fields import call
from tests.api.solver_commands.readers import assert_same_wcsinfo

real = shutil.which("wcsinfo", path="/usr/bin")
needs_real = pytest.mark.skipif(real is None, reason="astrometry.net is not installed")

SIP = {
    "A_ORDER": 2, "B_ORDER": 2, "A_2_0": 2e-6, "A_1_1": -1e-6, "B_0_2": 3e-6,
    "AP_ORDER": 2, "BP_ORDER": 2, "AP_2_0": -2e-6, "AP_1_1": 1e-6, "BP_0_2": -3e-6,
}  # fmt: skip


def plate(path: Path, **cards: object) -> Path:
    """A `.wcs` file."""
    header = fits.Header()
    header["CTYPE1"], header["CTYPE2"] = "RA---TAN", "DEC--TAN"
    header["CRVAL1"], header["CRVAL2"], header["CRPIX1"], header["CRPIX2"] = 83.2123, 21.4567, 400.5, 300.5
    header["CD1_1"], header["CD1_2"], header["CD2_1"], header["CD2_2"] = -0.0027, 1e-4, 1e-4, 0.0027
    header["IMAGEW"], header["IMAGEH"] = 800, 600
    header.update({key: value for key, value in cards.items() if value is not None})
    for key, value in cards.items():
        if value is None:
            header.remove(key, ignore_missing=True)
    fits.PrimaryHDU(header=header).writeto(path, overwrite=True)
    return path


def ours(*arguments: str | Path) -> dict[str, str]:
    """Keys and values of ours."""
    code, out, err = call("wcsinfo", *arguments)
    assert (code, err) == (0, "")
    return dict(line.split(" ", 1) for line in out.splitlines())


def theirs(*arguments: str | Path) -> dict[str, str]:
    """Keys and values of the real one."""
    assert real is not None
    done = subprocess.run([real, *map(str, arguments)], capture_output=True, text=True, check=True)
    return dict(line.split(" ", 1) for line in done.stdout.splitlines())


@needs_real
@pytest.mark.parametrize(
    "cards",
    [
        {},
        SIP | {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP"},
        SIP | {"CTYPE1": "RA---TAN-SIP", "CTYPE2": "DEC--TAN-SIP", "CRPIX1": 900.25, "CRPIX2": -40.0},
        {"CD1_1": 0.0027},
        {"CRVAL2": 89.9123},
        {"CRVAL2": -89.8123, "CD2_2": -0.0027},
        {"CRVAL1": 0.0512},
        {"CRVAL1": 359.9712, "CRVAL2": -60.0123},
        {"CD1_1": -2.7e-6, "CD1_2": 1e-7, "CD2_1": 1e-7, "CD2_2": 2.7e-6},
        {"CD1_1": -1e-4, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 1e-4},
        {"CD1_1": -0.05, "CD2_2": 0.05},
        {"CD1_1": None, "CD1_2": None, "CD2_1": None, "CD2_2": None, "CDELT1": -0.002, "CDELT2": 0.002},
        {"CTYPE1": "DEC--TAN", "CTYPE2": "RA---TAN", "CRVAL1": 21.4567, "CRVAL2": 83.2123},
    ],
)  # fmt: skip
def test_every_key_as_the_real_one_has_it(tmp_path: Path, cards: dict[str, object]) -> None:
    path = plate(tmp_path / "x.wcs", **cards)
    assert_same_wcsinfo(ours(path), theirs(path))


@needs_real
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    ra_deg=st.floats(0.0, 359.9),
    dec_deg=st.floats(-85.0, 85.0),
    turn_deg=st.floats(-180.0, 180.0),
    scale_deg=st.floats(1e-5, 1e-2),
    mirrored=st.booleans(),
)
def test_any_plate(
    tmp_path: Path, ra_deg: float, dec_deg: float, turn_deg: float, scale_deg: float, mirrored: bool
) -> None:
    cos, sin = scale_deg * math.cos(math.radians(turn_deg)), scale_deg * math.sin(math.radians(turn_deg))
    sign = 1.0 if mirrored else -1.0
    path = plate(
        tmp_path / "x.wcs",
        CRVAL1=ra_deg,
        CRVAL2=dec_deg,
        CD1_1=sign * cos,
        CD1_2=sin,
        CD2_1=-sign * sin,
        CD2_2=cos,
    )
    found = ours(path)
    assert float(found["orientation"]) == pytest.approx(turn_deg, abs=1e-5) or abs(turn_deg) > 179.99
    assert found["parity"] == ("1" if mirrored else "-1")
    assert_same_wcsinfo(found, theirs(path))


def test_sizes_and_extensions(tmp_path: Path) -> None:
    path = plate(tmp_path / "x.wcs", IMAGEW=None, IMAGEH=None)
    code, out, err = call("wcsinfo", path)
    assert (code, out) == (255, "")
    assert "IMAGEW" in err
    assert ours("-W", "400", "-H", "300", path)["imagew"] == "400"
    fits.append(
        path,
        np.zeros((30, 40), np.int16),
        fits.getheader(plate(tmp_path / "y.wcs", IMAGEW=None, IMAGEH=None)),
    )
    assert ours("-e", "1", path)["imagew"] == "40"


@pytest.mark.parametrize(
    "cards",
    [{"CTYPE1": "GLON-TAN"}, {"CRVAL1": None}, {"CD1_1": None}, {"CTYPE1": None}, {"CRPIX1": "left"},
     {"CD1_1": 0.0, "CD1_2": 0.0, "CD2_1": 0.0, "CD2_2": 0.0}],
)  # fmt: skip
def test_what_is_no_plate_is_refused_in_a_line(tmp_path: Path, cards: dict[str, object]) -> None:
    code, out, err = call("wcsinfo", plate(tmp_path / "x.wcs", **cards))
    if code == 0:  # a plate without a scale: nothing is wide
        assert "pixscale 0" in out
        return
    assert (code, out) == (255, "")
    assert err.count("\n") == 1


def test_bad_files_and_usage(tmp_path: Path) -> None:
    for content in (b"", b"SIMPLE  =", b"\xff" * 4000):
        path = tmp_path / "bad.wcs"
        path.write_bytes(content)
        code, out, err = call("wcsinfo", path)
        assert (code, out, err.count("\n")) == (255, "", 1)
    assert call("wcsinfo", tmp_path / "none.wcs")[0] == 255
    assert call("wcsinfo")[0] == 255
    assert call("wcsinfo", "-x", "y")[0] == 255
    assert call("wcsinfo", "-e", "nine", "y")[0] == 255
