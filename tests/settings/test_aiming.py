"""`[[telescope.point]]` and `[telescope.rotator]`: what they mean, and what is refused with a fix."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from mountnav.errors import BadSettings
from mountnav.navigation.aim_points import OffsetPoint, PixelPoint
from mountnav.navigation.rotator import RotatorRules
from mountnav.settings.aiming import PointSettings, RotatorSettings
from mountnav.settings.observatory import Settings

PLAIN = """
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[[telescope]]
id = "east"
mount = { url = "fake+lx200://" }
camera = { kind = "simulated" }
"""


def test_points_are_pixels_or_other_tubes() -> None:
    settings = Settings.parse(
        PLAIN
        + """
[[telescope.point]]
name = "slit"
x_px = 10.5
y_px = 20
turned_deg = 5
[[telescope.point]]
name = "guide tube"
east_arcsec = 600
north_arcsec = -300
at_rotation_deg = 12
"""
    )
    slit, tube = (one.point for one in settings.telescope[0].point)
    assert slit == PixelPoint("slit", 10.5, 20.0, turned_deg=5.0)
    assert tube == OffsetPoint("guide tube", 600.0, -300.0, 12.0)


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"name": "a"}, "neither a pixel nor another tube"),
        ({"name": "a", "x_px": 1.0}, "neither a pixel"),
        ({"name": "a", "x_px": 1.0, "y_px": 1.0, "east_arcsec": 1.0}, "neither a pixel"),
        ({"name": "a", "x_px": 1.0, "y_px": 1.0, "width_px": 100}, "one side of its frame"),
        ({"name": "", "x_px": 1.0, "y_px": 1.0}, "pattern"),
        ({"name": "a", "x_px": float("nan"), "y_px": 1.0}, "finite"),
    ],
)
def test_points_that_make_no_sense_are_refused(written: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        PointSettings.model_validate(written)


def test_cable_limits_are_said_in_either_way() -> None:
    url = "indi://host/Rotator"
    assert RotatorSettings(url=url).rules == RotatorRules(0.0, 360.0)
    assert RotatorSettings(url=url, never_through_deg=-90.0).rules == RotatorRules(-90.0, 270.0)
    made = RotatorSettings(url=url, least_deg=-100.0, most_deg=100.0, sense=-1, tolerance_deg=1.0)
    assert made.rules == RotatorRules(-100.0, 100.0, -1, 1.0)


@pytest.mark.parametrize(
    ("written", "words"),
    [
        ({"url": "lx200+serial:///dev/tty"}, "pattern"),
        ({"url": "indi://h/R", "least_deg": 0.0}, "one cable limit alone"),
        ({"url": "indi://h/R", "least_deg": 10.0, "most_deg": 5.0}, "cable limits"),
        ({"url": "indi://h/R", "least_deg": -300.0, "most_deg": 300.0}, "cable limits"),
        ({"url": "indi://h/R", "least_deg": 0.0, "most_deg": 9.0, "never_through_deg": 1.0}, "twice"),
        ({"url": "indi://h/R", "sense": 0}, "sense"),
    ],
)
def test_rotators_that_make_no_sense_are_refused(written: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        RotatorSettings.model_validate(written)


@pytest.mark.parametrize(
    ("added", "words"),
    [
        (
            '[[telescope.point]]\nname = "a"\nx_px = 1\ny_px = 1\n[[telescope.point]]\nname = "a"\nx_px = 2\n'
            "y_px = 1\n",
            "stands twice",
        ),
        (
            '[[telescope.point]]\nname = "a"\neast_arcsec = 1\nnorth_arcsec = 1\nat_rotation_deg = 0\n'
            '[telescope.rotator]\nurl = "simulated://"\n',
            "the rotator turns the image",
        ),
    ],
)
def test_what_contradicts_each_other_is_refused(added: str, words: str) -> None:
    with pytest.raises(BadSettings, match=words):
        Settings.parse(PLAIN + added)


def test_a_simulated_rotator_needs_a_simulated_camera() -> None:
    real = PLAIN.replace('{ kind = "simulated" }', '{ kind = "folder", path = "/" }')
    with pytest.raises(BadSettings, match="simulated camera"):
        Settings.parse(real + '[telescope.rotator]\nurl = "simulated://"\n')
