"""Trails are found as lines however faint, broken or bent; stars, streaks and spikes aren't."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.measuring.background import estimate_background
from mountnav.measuring.detection import smooth
from mountnav.measuring.measure import measure
from mountnav.measuring.measurements import Flag
from mountnav.measuring.trails import Trail, find_line_segments, find_trails
from tests.measuring.nearest import nearest
from tests.measuring.painted import as_frame
from tests.measuring.skies import Array, exposed, field, stamped
from tests.measuring.spoiling import add_trail
from tests.short_part import one_in

SIZE = (900, 1000)
NOISE = float(np.sqrt(125.0))
FLAT = np.full(SIZE, 100.0)
ALONE = field(450, seed=1, size=SIZE)
CROWD = field(9_000, seed=4, faint=60.0, size=SIZE)
STARS = {"sparse": ALONE, "crowded": CROWD}


@cache
def drawn(stars: str) -> Array:
    return stamped(*STARS[stars], size=SIZE)


@cache
def sparse() -> Array:
    """A frame of the sparse field; for copies."""
    return exposed(FLAT, drawn("sparse"))


def trails_of(image: np.ndarray, fwhm_px: float = 3.0, bin_px: int = 1) -> list[Trail]:
    pixels = image.astype(np.float32)
    background = estimate_background(pixels)
    return find_trails(smooth(pixels - background.level_image(), background, 1.2, bin_px), fwhm_px)


def share_covered(
    trails: list[Trail], ends: tuple[float, float, float, float], sagitta_px: float = 0.0
) -> float:
    """Share of the painted trail's visible length that lies on a found one."""
    x0, y0, x1, y1 = ends
    t = np.linspace(0.0, 1.0, 300)
    length = np.hypot(x1 - x0, y1 - y0)
    bow = sagitta_px * 4.0 * t * (1.0 - t)
    x, y = x0 + (x1 - x0) * t - bow * (y1 - y0) / length, y0 + (y1 - y0) * t + bow * (x1 - x0) / length
    seen = (x > 0) & (y > 0) & (x < SIZE[1] - 1) & (y < SIZE[0] - 1)
    on = np.zeros(seen.sum(), dtype=bool)
    for trail in trails:
        on |= trail.touches(x[seen], y[seen], 1.0)
    return float(on.mean())


ACROSS = (-20.0, 120.0, 1020.0, 700.0)
INSIDE = (200.0, 750.0, 800.0, 300.0)


@pytest.mark.long
@pytest.mark.parametrize("stars", list(STARS))
@pytest.mark.parametrize(
    ("ends", "height", "extra"),
    one_in(
        2,
        [
            (ACROSS, 1.0, {}),
            (ACROSS, 30.0, {}),
            (ACROSS, 1.0, {"sagitta_px": 8.0}),
            (ACROSS, 10.0, {"dash_px": (120.0, 60.0)}),
            (INSIDE, 1.0, {}),
            (INSIDE, 300.0, {}),
            ((430.0, 300.0, 570.0, 380.0), 5.0, {}),
            ((500.0, -20.0, 506.0, 920.0), 3.0, {}),
        ],
    ),
)
def test_a_trail_is_found(
    stars: str, ends: tuple[float, float, float, float], height: float, extra: dict[str, Any]
) -> None:
    image = exposed(FLAT, drawn(stars))
    add_trail(image, ends, height * NOISE, **extra)
    trails = trails_of(image)
    assert share_covered(trails, ends, extra.get("sagitta_px", 0.0)) > 0.85
    assert len(trails) <= 2
    assert not any(trail.spike for trail in trails)


ANY_WAY = {"angle": st.floats(0.0, 180.0), "x": st.floats(350.0, 650.0), "y": st.floats(350.0, 550.0)}


@pytest.mark.long
@given(**ANY_WAY)
@settings(max_examples=6, deadline=None)
def test_any_direction_will_do(angle: float, x: float, y: float) -> None:
    found_whichever_way(angle, x, y)


@pytest.mark.long
@given(**ANY_WAY)
@settings(max_examples=40, deadline=None)
def test_many_directions_will_do(angle: float, x: float, y: float) -> None:
    found_whichever_way(angle, x, y)


def found_whichever_way(angle: float, x: float, y: float) -> None:
    u, v = 700.0 * np.cos(np.radians(angle)), 700.0 * np.sin(np.radians(angle))
    image = sparse().copy()
    ends = (x - u, y - v, x + u, y + v)
    add_trail(image, ends, 2.0 * NOISE)
    trails = trails_of(image)
    assert share_covered(trails, ends) > 0.9
    assert len(trails) == 1


@pytest.mark.long
def test_several_at_once_and_the_same_in_bins_of_two() -> None:
    image = sparse().copy()
    all_ends = [ACROSS, INSIDE, (850.0, -10.0, 640.0, 910.0), (-10.0, 800.0, 1010.0, 640.0)]
    for k, ends in enumerate(all_ends):
        add_trail(image, ends, (2.0 + 5.0 * k) * NOISE, seed=k)
    for bin_px in (1, 2):
        trails = trails_of(image, bin_px=bin_px)
        assert len(trails) == 4
        for ends in all_ends:
            assert share_covered(trails, ends) > 0.9


@pytest.mark.long
@pytest.mark.parametrize("seed", one_in(2, range(4)))
def test_stars_alone_make_no_trail(seed: int) -> None:
    for count, faint in ((450, 150.0), (9_000, 60.0)):
        stars = stamped(*field(count, seed=20 + seed, faint=faint, size=SIZE), size=SIZE)
        assert trails_of(exposed(FLAT, stars, seed=seed)) == []


@pytest.mark.parametrize(
    "angle",
    [pytest.param(0.0, marks=pytest.mark.long), 37.0, 90.0, pytest.param(145.0, marks=pytest.mark.long)],
)
def test_a_frame_of_star_trails_has_no_satellites(angle: float) -> None:
    x, y, electrons = field(500, seed=6, faint=400.0, size=SIZE)
    steps = np.linspace(-10.0, 10.0, 21)
    u, v = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    stars = sum(stamped(x + s * u, y + s * v, electrons / steps.size, size=SIZE) for s in steps)
    image = exposed(FLAT, np.asarray(stars))
    assert trails_of(image, fwhm_px=7.7) == []
    found = measure(as_frame(image - 500.0))
    assert not (found.flags & Flag.TRAIL).any()


@pytest.mark.long
def test_spikes_belong_to_their_star() -> None:
    image = sparse().copy()
    rows, columns = np.mgrid[0 : SIZE[0], 0 : SIZE[1]]
    dx, dy = columns - 480.0, rows - 430.0
    along, across = dx * 0.8 + dy * 0.6, dy * 0.8 - dx * 0.6
    for a, b in ((along, across), (across, along)):
        image += 3e5 / (20.0 + np.abs(a)) ** 1.7 * np.exp(-(b**2) / 2.5) * 20.0
    image += 3e7 / (2 * np.pi * 1.27**2) * np.exp(-(dx**2 + dy**2) / (2 * 1.27**2))
    found = measure(as_frame(image - 500.0))
    star = np.hypot(found.x_px - 480.0, found.y_px - 430.0).argmin()
    assert np.hypot(found.x_px[star] - 480.0, found.y_px[star] - 430.0) < 2.0
    assert not found.flags[star] & Flag.NO_PEAK
    assert not (found.flags & Flag.TRAIL).any()
    false = nearest(np.c_[ALONE[0], ALONE[1]], np.c_[found.x_px, found.y_px])[0] > 2.0
    false[star] = False
    assert (false & (found.flags == 0) & (found.flux > 4.0 * found.flux_sigma)).sum() <= 3


@pytest.mark.long
def test_a_trail_spoils_what_it_crosses_and_nothing_else() -> None:
    plain = measure(as_frame(sparse() - 500.0))
    image = sparse().copy()
    bright = np.flatnonzero((ALONE[2] > 3e4) & (np.abs(ALONE[0] - 500.0) < 300.0))[0]
    x, y = ALONE[0][bright], ALONE[1][bright]
    slope = 0.55
    ends = (-20.0, y - slope * (x + 20.0), 1020.0, y + slope * (1020.0 - x))
    add_trail(image, ends, 40.0 * NOISE)
    found = measure(as_frame(image - 500.0))

    def off(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        across: np.ndarray = np.abs(y - ends[1] - slope * (x - ends[0])) / math.hypot(1.0, slope)
        return across

    on = off(found.x_px, found.y_px) < 3.0
    assert (found.flags[on] & Flag.TRAIL).all()
    crossed = (off(plain.x_px, plain.y_px) < 1.0) & (plain.flux > 2e4)
    assert crossed.any()
    tree = np.c_[found.x_px, found.y_px]
    assert (nearest(tree, np.c_[plain.x_px, plain.y_px][crossed])[0] < 1.5).all()
    beside = (off(plain.x_px, plain.y_px) > 9.0) & (plain.flux > 3e3) & (plain.flags == 0)
    distance, index = nearest(tree, np.c_[plain.x_px, plain.y_px][beside])
    assert np.percentile(distance, 99) < 0.05
    assert not (found.flags[index] & Flag.TRAIL).any()
    false = nearest(np.c_[ALONE[0], ALONE[1]], np.c_[found.x_px, found.y_px])[0] > 2.0
    assert (false & (found.flags == 0)).sum() <= 5


@given(x0=st.integers(20, 180), x1=st.integers(20, 180), upright=st.booleans(), mirrored=st.booleans())
@settings(max_examples=25, deadline=None)
def test_segments_lie_where_a_line_was_drawn(x0: int, x1: int, upright: bool, mirrored: bool) -> None:
    picture = np.random.default_rng(x0 * 200 + x1).normal(size=(200, 200)).astype(np.float32)
    rows = np.arange(200)
    columns = np.rint(x0 + (x1 - x0) * rows / 199.0).astype(int)
    picture[rows, 199 - columns if mirrored else columns] += np.float32(2.5)
    found = find_line_segments(picture if upright else picture.T, 30.0, 6.0)
    assert found.x0.size > 0
    ends = [(found.x0[0], found.y0[0]), (found.x1[0], found.y1[0])]
    for x, y in ends if upright else [(b, a) for a, b in ends]:
        true = x0 + (x1 - x0) * y / 199.0
        assert abs(x - (199 - true if mirrored else true)) < 4.0
