"""The horizon: files of other programs, lines between points, walls, and poles too thin for steps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadSettings
from mountnav.pointing.limits import Horizon

STELLARIUM = """# polygonal horizon of the garden
# az alt
0    12
90   5.5
180  20   # the house
270  8
"""
NINA = "\ufeff0 12\r\n90\t5.5\r\n\r\n180;20\r\n270, 8\r\n"


@pytest.mark.parametrize("text", [STELLARIUM, NINA])
def test_files_of_other_programs(tmp_path: Path, text: str) -> None:
    path = tmp_path / "horizon.txt"
    path.write_bytes(text.encode("utf-8"))
    horizon = Horizon.read(path)
    assert [horizon.altitude_at(az) for az in (0.0, 45.0, 180.0, 315.0, 360.0, -90.0)] == [
        12.0,
        8.75,
        20.0,
        10.0,
        12.0,
        8.0,
    ]
    assert horizon.highest_deg == 20.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0 10\n90 zwanzig\n", "line 2"),
        ("0 10\n90\n", "line 2"),
        ("0 10\n12,5 30\n", "line 2"),
        ("0 10\n90 nan\n", "line 2"),
        ("0 10\n", "1 point"),
        ("# nothing\n", "0 point"),
        ("0 10\n20 95\n", "not a point of a horizon"),
        ("0 10\n500 20\n", "not a point of a horizon"),
    ],
)
def test_what_is_no_horizon_is_said_with_its_line(text: str, says: str) -> None:
    with pytest.raises(BadSettings, match=says):
        Horizon.parse(text)


def test_a_file_that_is_not_there() -> None:
    with pytest.raises(BadSettings, match="can't be read"):
        Horizon.read(Path("no-such-horizon.txt"))


def test_walls_and_any_order_of_the_points() -> None:
    points = ((0.0, 5.0), (200.0, 5.0), (200.0, 40.0), (230.0, 40.0), (230.0, 5.0))
    for turned in (points, points[::-1], points[2:] + points[:2]):
        horizon = Horizon(turned)
        assert horizon.altitude_at(199.9) == pytest.approx(5.0)
        assert horizon.altitude_at(200.0) == 40.0
        assert horizon.altitude_at(215.0) == 40.0
        assert horizon.altitude_at(230.0) == 40.0
        assert horizon.altitude_at(230.1) == pytest.approx(5.0)
        assert horizon.altitude_at(20.0) == pytest.approx(5.0)


@st.composite
def horizons(draw: st.DrawFn) -> Horizon:
    points = draw(st.lists(st.tuples(st.floats(0.0, 360.0), st.floats(-5.0, 60.0)), min_size=2, max_size=12))
    return Horizon(tuple(points))


@pytest.mark.long
@given(horizons(), st.floats(-400.0, 800.0), st.floats(0.0, 200.0))
def test_the_highest_near_a_direction_is_not_below_any_that_is_so_near(
    horizon: Horizon, az_deg: float, reach_deg: float
) -> None:
    highest = horizon.highest_near(np.array([az_deg]), np.array([reach_deg]))[0]
    near = horizon.altitudes(az_deg + np.linspace(-1.0, 1.0, 2001) * min(reach_deg, 180.0))
    assert highest >= near.max() - 1e-9
    # and not above what is a little farther
    wider = [
        az for az, _ in horizon.points_deg if abs((az - az_deg + 180.0) % 360.0 - 180.0) <= reach_deg + 0.2
    ]
    edge = horizon.altitudes(az_deg + np.linspace(-1.0, 1.0, 4001) * (reach_deg + 0.11))
    inside = [alt for az, alt in horizon.points_deg if az in wider]
    assert highest <= max([edge.max(), *inside]) + 1e-9


def test_a_pole_a_hundredth_of_a_degree_wide_is_not_stepped_over() -> None:
    horizon = Horizon(((0.0, 5.0), (123.45, 5.0), (123.455, 50.0), (123.46, 5.0)))
    near = horizon.highest_near(np.arange(122.0, 125.0, 0.33), np.full(10, 0.25))
    assert near.max() == 50.0
