"""`mountnav solve` of a list of stars."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from astropy.io import fits

from mountnav.identification.blind.index import BlindIndex
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from tests.api.command_here import run_here
from tests.api.solver_commands.fields import CENTER, call, fits_field, pixels


@pytest.mark.long
@pytest.mark.parametrize(
    "hint", [(), ("--ra", "83", "--dec", "21.5", "--radius", "2")], ids=["blind", "hinted"]
)
def test_a_list_is_solved_like_its_image(
    tmp_path: Path, sky_index: BlindIndex, hint: tuple[str, ...]
) -> None:
    field = fits_field(tmp_path / "field.fits", pixels())
    assert call("image2xy", field, "-o", tmp_path / "stars.xyls")[0] == 0
    data = fits.getdata(tmp_path / "stars.xyls")
    lines = [f"{x},{y},{flux}" for x, y, flux in zip(data["X"], data["Y"], data["FLUX"], strict=True)]
    (tmp_path / "stars.csv").write_text("\n".join(["x,y,flux", *lines]))
    told = run_here("solve", "--json", *hint, tmp_path / "stars.xyls", tmp_path / "stars.csv")
    assert told.returncode == 0, told.stderr
    records = [json.loads(line) for line in told.stdout.splitlines()]
    assert len(records) == 2
    for record in records:
        # a text doesn't tell the frame's size: its center is that of the stars
        within_px = 0.05 if record["file"].endswith("xyls") else 20.0
        center = Icrs(record["ra_deg"], record["dec_deg"])
        assert separation_arcsec(center, CENTER) < 10.0 * within_px
        assert "solved from a list of stars: their light was not looked at" in record["notes"]


def test_a_broken_list_is_refused_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "stars.csv").write_text("1,2\n3,pears\n")
    told = run_here("solve", "--no-blind", tmp_path / "stars.csv")
    assert told.returncode == 1
    assert "has no number for y" in told.stdout
