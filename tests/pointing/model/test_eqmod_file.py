"""Alignment points of INDI's EQMod driver are observations of a model."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.pointing.model.fit import fit
from mountnav.pointing.model.mechanical import Mechanical
from mountnav.pointing.model.rigorous import angles, direction, wrapped
from mountnav.pointing.model.tpoint_file import read_observations_text
from mountnav.units import DEG_PER_HOUR
from tests.pointing.model.model_data import telescope

SIDEREAL_H = 5.5
DRIVERS_OWN = Path(__file__).parent / "data" / "indi_eqmod_alignment.xml"
"""Written by `indi_eqmod_telescope` 1.2 (INDI 1.9.9) on our fake: four places east of the meridian, four
west, each synced 0.02 h east of where the motors stood, then *Write File*."""


def written(m: Mechanical) -> str:
    """Points as the driver writes them: sidereal time and right ascensions in hours, six digits."""
    lines = [
        "<aligndata>",
        f'    <site name="2026-11-26@21:00:00" lon="22.27" lat="{_deg(m.site_latitude_rad)}">',
    ]
    seen_lon_rad, seen_lat_rad = angles(m.seen)
    read_lon_rad, read_lat_rad = angles(direction(m.read_lon_rad, m.read_lat_rad))
    for index in range(len(m)):
        values = {
            "index": str(index),
            "synctime": f"{SIDEREAL_H:g}",
            "celestialra": _hours(seen_lon_rad[index]),
            "celestialde": _deg(seen_lat_rad[index]),
            "telescopera": _hours(read_lon_rad[index]),
            "telescopede": _deg(read_lat_rad[index]),
        }
        lines.append("        <point>")
        lines += [f"            <{tag}>\n{text}\n            </{tag}>" for tag, text in values.items()]
        lines.append("        </point>")
    return "\n".join([*lines, "    </site>", "</aligndata>"]) + "\n"


def _hours(hour_angle_rad: float) -> str:
    return f"{(SIDEREAL_H - math.degrees(hour_angle_rad) / DEG_PER_HOUR) % 24.0:g}"


def _deg(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):g}"


def german(latitude_deg: float) -> Mechanical:
    """A telescope that looks through the pole at negative hour angles, as German mounts do."""
    terms = {"IH": 200.0, "ID": -300.0, "CH": 400.0, "NP": 120.0, "ME": 500.0, "MA": -350.0}
    both = telescope("equatorial", terms, n=80, both_sides=True, latitude_deg=latitude_deg)
    return both.chosen((angles(both.seen)[0] < 0.0) == both.beyond)


def test_what_the_driver_itself_wrote_gives_the_offset_that_was_put_in() -> None:
    there = read_observations_text(DRIVERS_OWN.read_text(), name=DRIVERS_OWN.name)
    assert len(there) == 8
    assert there.beyond.sum() == 4
    seen_lon_rad, seen_lat_rad = there.seen_angles
    synced_deg = np.degrees(wrapped(seen_lon_rad - there.read_lon_rad))
    assert synced_deg == pytest.approx(-0.02 * DEG_PER_HOUR, abs=6.0 / 3600.0)
    assert np.degrees(seen_lat_rad - there.read_lat_rad) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [48.93, -31.2])
def test_the_model_of_a_german_mount_is_found_again(latitude_deg: float) -> None:
    there = german(latitude_deg)
    assert 10 < len(there) < 80
    assert 0 < there.beyond.sum() < len(there)
    again = read_observations_text(written(there))
    assert np.array_equal(again.beyond, there.beyond)
    terms = ("CH", "NP", "ME", "MA")
    found, true = fit(again, terms).coefficients_arcsec, fit(there, terms).coefficients_arcsec
    assert found == pytest.approx(true, abs=6.0)  # six digits
    assert math.degrees(again.site_latitude_rad) == pytest.approx(latitude_deg, abs=1e-4)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<celestialde>", "<other>", "the XML is broken"),
        ("celestialde>", "dec>", "point 1: celestialde is None"),
        ("5.5", "nan", "point 1: synctime is"),
        ("5.5", "99", "point 1: synctime is '.*99.*', not a number within ±24"),
        ('lat="48.93"', "", "the site's latitude is None"),
        ("<site", "<!DOCTYPE a><site", "entities of its own"),
        ("</aligndata>", "", "the XML is broken"),
    ],
)
def test_what_makes_no_sense_is_refused_by_its_place(old: str, new: str, said: str) -> None:
    text = written(german(48.93))
    assert old in text
    with pytest.raises(BadRequest, match=said):
        read_observations_text(text.replace(old, new), name="points.xml")


@pytest.mark.parametrize(
    "text",
    ["<aligndata/>", "<aligndata><site lat='1'/></aligndata>", "<aligndata>" + "<a>" * 20 + "</a>" * 20],
)
def test_a_file_without_points_is_refused(text: str) -> None:
    with pytest.raises(BadRequest, match=r"points\.xml"):
        read_observations_text(text, name="points.xml")


@given(st.text(max_size=60))
def test_no_text_raises_anything_else(text: str) -> None:
    with contextlib.suppress(BadRequest):
        read_observations_text("<aligndata" + text)
