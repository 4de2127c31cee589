"""Lenses too wide for a plate, at doors that promise one: a plate of the center, and a word of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import pytest

from api.solver_commands.astap import SOLVED
from api.solver_commands.astap import run as run_astap
from api.solver_commands.host import Asked, LocalHost
from api.solver_commands.solve_field import run as run_solve_field
from benchmarks.wide_fields import Wide, asked, drawn_lens, field_errors_px
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.sky.wcs import is_zpn
from tests.api.solver_commands.drawn_frames import as_fits, drawn
from tests.api.solver_commands.program_readers import ccdciel_wcs, nina_ini

if TYPE_CHECKING:
    from mountnav.frames import Frame
    from mountnav.identification.blind.index import BlindIndex
    from mountnav.solution import Verdict

SEED = 8
"""An equidistant lens of 150°."""


@pytest.fixture(scope="module")
def wide() -> Wide:
    return drawn_lens(SEED)


@pytest.fixture(scope="module")
def verdict(wide: Wide, sky_index: BlindIndex) -> Verdict:
    found = asked(wide, sky_index, lists=True)
    assert found.solution is not None
    assert is_zpn(found.solution.wcs)
    assert field_errors_px(wide, found).max() < 0.5
    return found


class _Known:
    """A solver that has solved it already."""

    def __init__(self, verdict: Verdict) -> None:
        self._verdict = verdict

    def solve(self, asked: Asked, *, cancelled: object = None) -> Verdict:
        return self._verdict

    def read(self, file: BinaryIO, name: str) -> Frame:
        return drawn()


@pytest.mark.long
def test_a_plate_of_the_center_is_given_and_told(
    wide: Wide,
    verdict: Verdict,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    as_fits(tmp_path / "sky.fits", _black(wide))
    assert verdict.solution is not None
    center = verdict.solution.center
    assert run_astap(["-f", "sky.fits", "-r", "180"], LocalHost(), _Known(verdict)) == SOLVED
    told = capsys.readouterr().out
    assert "WARNING" in told
    assert "too wide for TAN" in told
    seen = nina_ini((tmp_path / "sky.ini").read_text())
    assert seen is not None
    assert separation_arcsec(Icrs(seen.ra_deg, seen.dec_deg), center) < 1.0
    cards, shown = ccdciel_wcs((tmp_path / "sky.wcs").read_bytes())
    assert any("RA---TAN'" in card for card in cards)
    assert "too wide" in shown
    assert run_solve_field(["--overwrite", "sky.fits"], LocalHost(), _Known(verdict)) == 0
    told = capsys.readouterr().out
    assert "WARNING: the lens is too wide for TAN" in told
    assert f"Field center: (RA,Dec) = ({center.ra_deg:3.6f}, {center.dec_deg:3.6f}) deg." in told
    for made in ("sky.solved", "sky.corr", "sky-indx.xyls", "sky.new"):
        assert (tmp_path / made).stat().st_size


def _black(wide: Wide) -> Frame:
    from dataclasses import replace

    import numpy as np

    return replace(drawn(), pixels=np.zeros((wide.height_px, wide.width_px), dtype=np.uint16))
