"""Every reader finds one center, one scale, one rotation: in all orientations, of FITS and PNG."""

from __future__ import annotations

from pathlib import Path

import pytest

from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import half_turn_deg, separation_arcsec
from tests.api.solver_commands import readers
from tests.api.solver_commands.fields import (
    CENTER,
    SCALE_ARCSEC_PX,
    call,
    fits_field,
    pixels,
    png_field,
)

pytestmark = pytest.mark.filterwarnings("ignore::astropy.wcs.wcs.FITSFixedWarning")

ONE_CENTER_PX = 0.01
"""How far the centers of two readers may lie apart."""


def assert_one_answer(folder: Path, rotation_deg: float, parity: int, kind: str) -> None:
    """Solve a field, and have it read by all."""
    drawn = pixels(rotation_deg, parity)
    field = (png_field if kind == "png" else fits_field)(folder / f"field.{kind}", drawn)
    code, out, err = call("solve-field", "-p", "-O", "-N", "none", field)
    assert (code, err) == (0, "")
    code, keys, err = call("wcsinfo", folder / "field.wcs")
    assert (code, err) == (0, "")
    found = [readers.siril(out, folder / "field.wcs"), readers.indi(out), readers.stellarsolver(keys)]
    first = found[0]
    assert first is not None
    center = Icrs(first.ra_deg, first.dec_deg)
    # a stretched picture of 8 bits has clipped stars: its center is good to some hundredths of a pixel
    assert separation_arcsec(center, CENTER) < (0.02 if kind == "fits" else 0.1) * SCALE_ARCSEC_PX
    for read in found:
        assert read is not None
        off_px = separation_arcsec(Icrs(read.ra_deg, read.dec_deg), center) / SCALE_ARCSEC_PX
        assert off_px < ONE_CENTER_PX
        if read.scale_arcsec_px is not None:
            assert read.scale_arcsec_px == pytest.approx(SCALE_ARCSEC_PX, rel=3e-5)
        if read.orientation_deg is not None:
            assert half_turn_deg(read.orientation_deg - rotation_deg) == pytest.approx(0.0, abs=0.01)
        if read.parity is not None:
            assert read.parity == ("pos" if parity > 0 else "neg")
    assert f"Field parity: {'pos' if parity > 0 else 'neg'}" in out.splitlines()


@pytest.mark.long
@pytest.mark.parametrize(("parity", "kind"), [(1, "fits"), (-1, "png")])
def test_all_readers_find_one_answer(tmp_path: Path, parity: int, kind: str) -> None:
    assert_one_answer(tmp_path, 33.0, parity, kind)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["fits", "png"])
@pytest.mark.parametrize("parity", [1, -1])
@pytest.mark.parametrize("rotation_deg", [0.0, 45.0, 90.0, 135.0, 180.0, 225.0, 270.0, 315.0])
def test_in_all_orientations(tmp_path: Path, rotation_deg: float, parity: int, kind: str) -> None:
    assert_one_answer(tmp_path, rotation_deg, parity, kind)


def test_a_frame_that_is_not_solved_is_solved_for_nobody(tmp_path: Path) -> None:
    field = fits_field(tmp_path / "field.fits", pixels()[::8, ::8].copy())
    code, out, _ = call("solve-field", "-O", field)
    assert code == 0
    assert readers.siril(out, tmp_path / "field.wcs") is None
    assert readers.indi(out) is None
    code, keys, _ = call("wcsinfo", tmp_path / "field.wcs")
    assert code == 255
    assert readers.stellarsolver(keys) is None
