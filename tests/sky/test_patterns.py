"""Mosaics, offsets and spirals on the sphere: covered without holes, at the pole and across right ascension
0."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs
from mountnav.sky.patterns import MOST_PANELS, Panel, Pattern, mosaic, offsets, spiral
from mountnav.sky.sphere import displaced, gnomonic, position_angle_deg, separation_arcsec

centers = st.builds(
    Icrs,
    st.sampled_from([0.0, 0.001, 359.999, 180.0]) | st.floats(0.0, 359.9),
    st.sampled_from([90.0, -90.0, 89.9, -89.9, 0.0]) | st.floats(-90.0, 90.0),
)
angles = st.floats(0.0, 359.9)


def within(panel: Panel, place: Icrs, width_deg: float, height_deg: float, slack: float = 1e-9) -> bool:
    """Whether a camera of that field on the panel, turned as it is to be, sees the place."""
    xi, eta = gnomonic([place.ra_deg], [place.dec_deg], panel.place.ra_deg, panel.place.dec_deg)
    if not np.isfinite(xi[0]):
        return False
    angle = math.radians(panel.position_angle_deg)
    up = xi[0] * math.sin(angle) + eta[0] * math.cos(angle)
    side = xi[0] * math.cos(angle) - eta[0] * math.sin(angle)
    return bool(
        abs(side) <= math.tan(math.radians(width_deg / 2.0)) + slack
        and abs(up) <= math.tan(math.radians(height_deg / 2.0)) + slack
    )


@pytest.mark.long
@given(
    centers,
    angles,
    st.integers(1, 5),
    st.integers(1, 5),
    st.floats(0.1, 2.0),
    st.floats(0.1, 2.0),
    st.lists(st.tuples(st.floats(-0.49, 0.49), st.floats(-0.49, 0.49)), min_size=5, max_size=5),
)
def test_nothing_within_a_mosaic_is_left_out(
    center: Icrs,
    angle_deg: float,
    across: int,
    down: int,
    width_deg: float,
    height_deg: float,
    samples: list[tuple[float, float]],
) -> None:
    panels = mosaic(
        center,
        across=across,
        down=down,
        width_deg=width_deg,
        height_deg=height_deg,
        overlap=0.05,
        position_angle_deg=angle_deg,
    )
    assert len(panels) == across * down
    pattern = Pattern(center, angle_deg)
    for x, y in samples:
        # within what the panels' middles span, and a little less than half a field beyond
        right = x * ((across - 1) * width_deg + 0.9 * width_deg) * 0.95
        up = y * ((down - 1) * height_deg + 0.9 * height_deg) * 0.95
        place, _ = pattern.at(right, up)
        assert any(within(panel, place, width_deg, height_deg, slack=1e-6) for panel in panels)


@given(centers, angles)
def test_neighbors_are_a_step_apart_and_stand_alike(center: Icrs, angle_deg: float) -> None:
    panels = mosaic(
        center,
        across=3,
        down=3,
        width_deg=1.0,
        height_deg=0.8,
        overlap=0.2,
        position_angle_deg=angle_deg,
    )
    by_place = {(panel.column, panel.row): panel for panel in panels}
    middle = by_place[2, 2]
    assert separation_arcsec(middle.place, center) < 1e-6
    for neighbor, step_arcsec in (((1, 2), 2880.0), ((3, 2), 2880.0), ((2, 1), 2304.0), ((2, 3), 2304.0)):
        assert separation_arcsec(middle.place, by_place[neighbor].place) == pytest.approx(
            step_arcsec, abs=1e-3
        )
    # one after the other is beside it
    for one, other in pairwise(panels):
        assert abs(one.column - other.column) + abs(one.row - other.row) == 1


@given(centers, angles, st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_the_first_offset_of_a_pattern_is_along_its_angle(
    center: Icrs, angle_deg: float, right_deg: float, up_deg: float
) -> None:
    pattern = Pattern(center, angle_deg)
    above, turned = pattern.at(0.0, 0.5)
    assert separation_arcsec(center, above) == pytest.approx(1800.0, abs=1e-6)
    if abs(center.dec_deg) < 89.99:
        assert math.cos(math.radians(position_angle_deg(center, above) - angle_deg)) == pytest.approx(1.0)
        right, _ = pattern.at(0.5, 0.0)
        off = math.radians(position_angle_deg(center, right) - angle_deg + 90.0)
        assert math.cos(off) == pytest.approx(1.0)
    # the angle that is told is that of the way upwards there
    place, turned = pattern.at(right_deg, up_deg)
    further, _ = pattern.at(right_deg, up_deg + 0.01)
    if abs(place.dec_deg) < 89.9:
        assert math.cos(math.radians(position_angle_deg(place, further) - turned)) == pytest.approx(
            1.0, abs=1e-6
        )


def test_a_snake_begins_above_on_the_left_and_turns_at_the_ends() -> None:
    panels = mosaic(Icrs(100.0, 0.0), across=3, down=2, width_deg=1.0, height_deg=1.0, overlap=0.0)
    assert [(panel.column, panel.row) for panel in panels] == [(1, 1), (2, 1), (3, 1), (3, 2), (2, 2), (1, 2)]
    # with north up the east is on the left
    assert panels[0].place.ra_deg == pytest.approx(101.0, abs=0.01)
    assert panels[0].place.dec_deg == pytest.approx(0.5)
    lines = mosaic(
        Icrs(100.0, 0.0), across=3, down=2, width_deg=1.0, height_deg=1.0, overlap=0.0, snake=False
    )
    assert [panel.column for panel in lines] == [1, 2, 3, 1, 2, 3]


steps_of_a_pattern = st.lists(
    st.tuples(st.floats(-900.0, 900.0), st.floats(-900.0, 900.0)), min_size=1, max_size=9
)


@given(centers, steps_of_a_pattern)
def test_offsets_lie_where_a_tangent_plane_has_them(center: Icrs, steps: list[tuple[float, float]]) -> None:
    for panel, (right, up) in zip(offsets(center, steps), steps, strict=True):
        # small ones differ from a step along a great circle by millionths only
        assert separation_arcsec(panel.place, displaced(center, -right, up)) < 0.01
        assert separation_arcsec(panel.place, center) == pytest.approx(math.hypot(right, up), abs=0.01)


@given(centers, st.floats(0.05, 1.0), st.floats(0.0, 4.0))
def test_a_spiral_covers_its_circle_and_goes_outwards(center: Icrs, step_deg: float, windings: float) -> None:
    radius_deg = windings * step_deg
    places = list(spiral(center, step_deg, radius_deg))
    assert separation_arcsec(places[0], center) < 1e-6
    assert all(separation_arcsec(one, center) <= 3600.0 * radius_deg + 1.0 for one in places)
    # all points of the square grid within the circle, each once
    grid = range(-6, 7)
    wanted = sum(math.hypot(x, y) * step_deg <= radius_deg + 1e-9 for x in grid for y in grid)
    assert len(places) == wanted
    for one, other in pairwise(places[:9]):
        assert separation_arcsec(one, other) <= 3600.0 * step_deg * 1.5


@pytest.mark.parametrize(
    "wrong",
    [
        {"across": 0},
        {"across": MOST_PANELS + 1},
        {"width_deg": 0.0},
        {"width_deg": math.nan},
        {"overlap": 1.0},
        {"overlap": -0.1},
        {"across": 10, "width_deg": 10.0},
    ],
)
def test_what_makes_no_mosaic_is_refused(wrong: dict[str, float]) -> None:
    usual: dict[str, float] = {"across": 2, "down": 2, "width_deg": 1.0, "height_deg": 1.0}
    with pytest.raises(BadRequest):
        mosaic(Icrs(10.0, 10.0), **{**usual, **wrong})  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [[], [(math.inf, 0.0)], [(0.0, 1e6)], [(0.0, 0.0)] * (MOST_PANELS + 1)])
def test_what_makes_no_pattern_is_refused(wrong: list[tuple[float, float]]) -> None:
    with pytest.raises(BadRequest):
        offsets(Icrs(10.0, 10.0), wrong)
