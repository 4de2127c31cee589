"""Alignment points of EQASCOM are observations of a model."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from api.cli.app import app
from mountnav.errors import BadRequest
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.rigorous import angles
from mountnav.pointing.model.tpoint_file import (
    read_coefficients,
    read_observations_file,
    read_observations_text,
)
from mountnav.units import DEG_PER_HOUR
from tests.pointing.model.model_data import telescope

TURN = 9_024_000
"""Counts of a turn of an EQ6."""
TERMS = ("CH", "NP", "ME", "MA")


def german(latitude_deg: float) -> Mechanical:
    """Looks on both sides of the pier."""
    terms = {"IH": 200.0, "ID": -300.0, "CH": 400.0, "NP": 120.0, "ME": 500.0, "MA": -350.0}
    return telescope("equatorial", terms, n=40, both_sides=True, latitude_deg=latitude_deg)


def written(m: Mechanical, *, turn: int = TURN, ra_turn: int = TURN, comma: bool = True) -> str:
    """The file as EQASCOM writes it, by the rules of its own arithmetic.

    The first point is taken at 21:00, when the sidereal time is 5.5 h; each further one a minute later.
    """
    south = m.site_latitude_rad < 0.0
    lines = ["", "[alignment_preset0]", "STAR_COUNT=0", "NAME=", "[alignment_preset3]"]
    lines += [f"STAR_COUNT={len(m)}", "NAME=Größter Garten"]
    seen_ha_deg, seen_dec_deg = np.degrees(angles(m.seen))
    axes_ha_deg, axes_dec_deg = np.degrees(m.seen_angles)
    for index in range(len(m)):
        sidereal_h = (5.5 + index / 60.0 * 1.00273791) % 24.0
        ra_h = (sidereal_h - seen_ha_deg[index] / DEG_PER_HOUR) % 24.0
        # what a perfect mount would count for the star, on the side where it stands
        east_of_pier = not m.beyond[index]
        pier = int(east_of_pier != south)
        flipped_ra_h = ra_h - 12.0 if east_of_pier else ra_h
        from_home_h = (flipped_ra_h - sidereal_h - 6.0 + 12.0) % 24.0 - 12.0
        target = (
            (1.0 if south else -1.0) * from_home_h / 24.0 * ra_turn,
            (-1.0 if south else 1.0)
            * ((180.0 - seen_dec_deg[index] if pier else seen_dec_deg[index]) - 360.0 * (south and pier))
            / 360.0
            * turn,
        )
        read_ha_deg, read_dec_deg = math.degrees(m.read_lon_rad[index]), math.degrees(m.read_lat_rad[index])
        off_ha_deg = (read_ha_deg - axes_ha_deg[index] + 180.0) % 360.0 - 180.0
        way = -1.0 if south else 1.0
        stood = (
            target[0] + way * off_ha_deg / 360.0 * ra_turn,
            target[1] - (read_dec_deg - axes_dec_deg[index]) / 360.0 * turn,
        )
        clock = f"{21 + index // 60}:{index % 60:02d}:00"
        numbers = [f"{ra_h:.14g}", f"{seen_dec_deg[index]:.14g}"]
        numbers += [str(round(8388608 + one)) for one in (*target, *stood)]
        text = ";".join(numbers)
        lines.append(f"Star{index + 1}=26.11.2026 {clock};{text.replace('.', ',') if comma else text};")
    return "\r\n".join([*lines, "[alignment_preset5]", "STAR_COUNT=0"]) + "\r\n"


@pytest.mark.parametrize("latitude_deg", [48.93, -31.2])
@pytest.mark.parametrize("comma", [True, False])
def test_the_model_of_a_german_mount_is_found_again(latitude_deg: float, comma: bool) -> None:
    there = german(latitude_deg)
    assert 5 < there.beyond.sum() < len(there) - 5
    again = read_observations_text(written(there, comma=comma), latitude_deg=latitude_deg)
    assert np.array_equal(again.beyond, there.beyond)
    assert again.seen == pytest.approx(there.seen, abs=2e-6)
    found, true = fit(again, TERMS).coefficients_arcsec, fit(there, TERMS).coefficients_arcsec
    assert found == pytest.approx(true, abs=0.5)  # a count is 0.14″


def test_letters_of_the_pc_s_own_are_read(tmp_path: Path) -> None:
    file = tmp_path / "ALIGN.ini"
    file.write_bytes(written(german(48.93)).encode("latin-1"))
    assert len(read_observations_file(file, latitude_deg=48.93)) == len(german(48.93))


def test_a_command_makes_a_model_of_it(tmp_path: Path) -> None:
    file, out = tmp_path / "ALIGN.ini", tmp_path / "east.json"
    file.write_bytes(written(german(48.93)).encode("latin-1"))
    ran = CliRunner().invoke(app, ["model", "fit", str(file), "--site", "48.93", "22.27", "-o", str(out)])
    assert ran.exit_code == 0, ran.output
    assert out.exists()
    without = CliRunner().invoke(app, ["model", "fit", str(file)])
    assert "doesn't say where the mount stands" in str(without.exception)


def test_points_are_no_coefficients() -> None:
    with pytest.raises(BadRequest, match="alignment points, no coefficients"):
        read_coefficients(written(german(48.93)))


def test_a_latitude_of_the_wrong_half_of_the_earth_is_refused() -> None:
    with pytest.raises(BadRequest, match="don't fit the declinations"):
        read_observations_text(written(german(48.93)), latitude_deg=-48.93)


def test_axes_with_other_gears_are_refused() -> None:
    with pytest.raises(BadRequest, match="don't fit the times"):
        read_observations_text(written(german(48.93), ra_turn=7_500_000), latitude_deg=48.93)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("STAR_COUNT=0", "STAR_COUNT=2\r\nNAME=roof", r"3 presets with points: 0 \(.*3 \(Größter Garten\)"),
        ("Star7=", "Star99=", "preset 3, point 7: '' is not seven values"),
        ("26.11.2026 21:02:00;", "some time;", "point 3: 'some time' is no time"),
        ("26.11.2026 21:02:00;", "26.11.2026 25:02:00;", "is no time"),
        ("26.11.2026 21:02:00;", "26.11.2026 21:02:00;nan", "point 3: .* is not a number within ±24"),
        ("NAME=Größter", "STAR_COUNT=1001\r\nNAME=", "'1001' points"),
        ("[alignment_preset3]", "[alignment_preset]", "holds no observations"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_place(old: str, new: str, said: str) -> None:
    text = written(german(48.93))
    assert old in text
    with pytest.raises(BadRequest, match=said):
        read_observations_text(text.replace(old, new), name="ALIGN.ini", latitude_deg=48.93)


def test_points_of_one_declination_say_too_little() -> None:
    line = "26.11.2026 21:00:00;5;{dec};8388608;{count};8388608;{count};"
    one = line.format(dec=45, count=8388608 + TURN // 8)
    text = f"[alignment_preset0]\nSTAR_COUNT=1\nStar1={one}\n"
    with pytest.raises(BadRequest, match="more than one number of counts"):
        read_observations_text(text, latitude_deg=48.0)


@given(st.text(max_size=80))
def test_no_text_raises_anything_else(text: str) -> None:
    with contextlib.suppress(BadRequest):
        read_observations_text("[alignment_preset0]\nSTAR_COUNT=1\nStar1=" + text, latitude_deg=1.0)
