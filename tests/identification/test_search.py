"""Star lists: found under any rotation, mirror, scale and shift; chance and wrong places refused."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.stars import Stars
from mountnav.frames import Hint
from mountnav.identification.budget import Budget
from mountnav.identification.full import Points, Search, hypotheses
from mountnav.identification.rounds import Round, scale_windows
from mountnav.identification.search import identify
from mountnav.identification.search_area import tiles
from mountnav.identification.selection import spread_brightest, star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, gnomonic, gnomonic_inverse, separation_arcsec
from tests.identification.listed_sky import listed

WIDTH, HEIGHT = 1000, 800
PLACE = Icrs(210.0, 40.0)


@dataclass(frozen=True)
class InventedSky:
    """Random stars round a place, and nothing elsewhere."""

    stars: Stars
    name: str = "invented"

    def cone(self, center, radius_deg, *, epoch_yr, mag_limit=None):
        s = self.stars
        ra, dec = np.radians(s.ra_deg), np.radians(s.dec_deg)
        ra0, dec0 = math.radians(center.ra_deg), math.radians(center.dec_deg)
        cosine = np.sin(dec) * math.sin(dec0) + np.cos(dec) * math.cos(dec0) * np.cos(ra - ra0)
        chosen = np.flatnonzero((cosine >= math.cos(math.radians(radius_deg))) & (s.mag <= (mag_limit or 99)))
        return replace(s.only(chosen), epoch_yr=epoch_yr, band="V", source=self.name)


def invented_sky(seed=3, count=3000, half_deg=3.0):
    rng = np.random.default_rng(seed)
    xi, eta = np.radians(rng.uniform(-half_deg, half_deg, (2, count)))
    ra, dec = gnomonic_inverse(xi, eta, PLACE.ra_deg, PLACE.dec_deg)
    mag = np.sort(11.0 - rng.exponential(1.2, count))
    nothing = np.zeros(count)
    return InventedSky(Stars(ra, dec, np.full(count, 0.05), mag, nothing, nothing, 2000.0, "V", "invented"))


SKY = invented_sky()


def seen(center, *, scale, rotation_deg, parity, seed=0, junk=30, lost=0.1):
    """What a camera would measure: the sky's stars, some lost, with noise and sources that are no stars."""
    rng = np.random.default_rng(seed)
    stars = SKY.cone(center, 3.0, epoch_yr=2000.0)
    xi, eta = (
        np.degrees(v) * 3600 / scale
        for v in gnomonic(stars.ra_deg, stars.dec_deg, center.ra_deg, center.dec_deg)
    )
    angle = math.radians(rotation_deg)
    # +y has position angle `rotation`; +x lies 90° clockwise of it as the sky is seen, hence west
    up = xi * math.sin(angle) + eta * math.cos(angle)
    right = -parity * (xi * math.cos(angle) - eta * math.sin(angle))
    x, y = right + (WIDTH - 1) / 2, up + (HEIGHT - 1) / 2
    keep = (x > 0) & (x < WIDTH - 1) & (y > 0) & (y < HEIGHT - 1) & (rng.random(x.size) > lost)
    flux = 10 ** (-0.4 * (stars.mag[keep] - 20 + rng.normal(0, 0.2, keep.sum())))
    extra_x, extra_y = rng.uniform(0, WIDTH, junk), rng.uniform(0, HEIGHT, junk)
    extra = rng.choice(flux, junk) if flux.size else np.ones(junk)
    return listed(
        np.concatenate((x[keep] + rng.normal(0, 0.1, keep.sum()), extra_x)),
        np.concatenate((y[keep] + rng.normal(0, 0.1, keep.sum()), extra_y)),
        np.concatenate((flux, extra)),
        WIDTH,
        HEIGHT,
    )


@pytest.mark.long
@given(
    st.floats(0, 360),
    st.sampled_from((1, -1)),
    st.floats(4.0, 8.0),
    st.floats(-1800, 1800),
    st.floats(-1800, 1800),
    st.integers(0, 10**6),
)
@settings(max_examples=25, deadline=None)
def test_the_solution_turns_mirrors_scales_and_shifts_with_the_camera(
    rotation_deg, parity, scale, east, north, seed
):
    center = displaced(PLACE, east, north)
    measurements = seen(center, scale=scale, rotation_deg=rotation_deg, parity=parity, seed=seed)
    hint = Hint(PLACE, 0.8, scale * 0.96, scale * 1.05)
    got = identify(measurements, SKY, hint, epoch_yr=2000.0)
    assert got.reference is not None, got.detail
    plate = got.reference.plate
    assert separation_arcsec(plate.center(), center) < 0.2 * scale
    assert plate.parity == parity
    assert abs((plate.rotation_deg() - rotation_deg + 180) % 360 - 180) < 0.05
    assert plate.scale_arcsec_px() == pytest.approx(scale, rel=1e-3)
    assert got.false_probability < 1e-9


@pytest.mark.long
@given(st.integers(0, 2**32 - 1), st.integers(5, 150))
@settings(max_examples=10, deadline=None)
def test_random_lists_never_solve(seed, count):
    rng = np.random.default_rng(seed)
    measurements = listed(
        rng.uniform(0, WIDTH, count), rng.uniform(0, HEIGHT, count), rng.exponential(1, count), WIDTH, HEIGHT
    )
    got = identify(measurements, SKY, Hint(PLACE, 0.1, 5.7, 6.3), epoch_yr=2000.0, budget_s=0.4)
    assert got.reference is None
    assert got.reason is not None
    assert got.numbers["measured"] == count


def test_scale_unknown_or_wrong_still_solves_rightly():
    measurements = seen(PLACE, scale=6.0, rotation_deg=20, parity=1)
    for hint in (Hint(PLACE, 0.3), Hint(PLACE, 0.3, 4.8, 5.3), Hint(PLACE, 0.3, scale_low_arcsec_px=3.0)):
        got = identify(measurements, SKY, hint, epoch_yr=2000.0)
        assert got.reference is not None, got.detail
        assert separation_arcsec(got.reference.plate.center(), PLACE) < 1.0


def test_selection_is_bright_even_and_without_what_is_no_star():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 100, 200), rng.uniform(0, 100, 200)
    x[:50], y[:50] = rng.uniform(0, 10, (2, 50))  # the brightest crowd in a corner
    x[-2:], y[-2:] = (0, 100), (0, 100)
    chosen = spread_brightest(x, y, 32, regions=4, cap=1.0)
    cell = (np.minimum(x[chosen] // 25, 3)) + 4 * np.minimum(y[chosen] // 25, 3)
    assert np.bincount(cell.astype(int)).max() <= 2
    assert np.all(np.diff(chosen) > 0)
    flags = np.array([0, Flag.TRAIL, Flag.SATURATED, Flag.NO_PEAK, Flag.BLEED])
    assert list(
        star_like(listed(np.arange(5.0), np.arange(5.0), np.arange(5.0, 0, -1), 9, 9, flags=flags))
    ) == [
        0,
        2,
    ]


def test_tiles_cover_the_circle_nearest_first():
    center = Icrs(10.0, 80.0)
    places = tiles(center, 2.0, 0.5)
    away = [separation_arcsec(center, one) / 3600 for one in places]
    assert away == sorted(away) or np.all(np.diff(away) > -1e-6)
    rng = np.random.default_rng(2)
    for _ in range(100):
        angle, far = rng.uniform(0, 2 * np.pi), 2.0 * 3600 * math.sqrt(rng.random())
        point = displaced(center, far * math.sin(angle), far * math.cos(angle))
        assert min(separation_arcsec(point, one) for one in places) / 3600 < 0.5 / math.sqrt(3) + 0.01
    assert tiles(center, 0.1, 0.5) == [center]


def test_windows_cover_the_scales():
    assert scale_windows(2.0, 2.2) == [(2.0, 2.2)]
    assert scale_windows(2.2, 2.0) == []
    windows = sorted(scale_windows(None, None))
    assert windows[0][0] == pytest.approx(0.3)
    assert windows[-1][1] == pytest.approx(200)
    assert all(a[1] == pytest.approx(b[0]) for a, b in pairwise(windows))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(6))
def test_rounds_over_wide_areas_find_frames_between_tiles_by_the_inner_stars(seed):
    rng = np.random.default_rng(seed)
    parameters = IdentificationSettings()
    # anywhere between the tiles, half of the stars lost
    place = displaced(PLACE, *(3600.0 * rng.uniform(-1.0, 1.0, 2)))
    measured = seen(
        place, scale=6.0, rotation_deg=360 * rng.random(), parity=1, seed=seed, junk=100, lost=0.5
    )
    points = Points(measured.x_px, measured.y_px, WIDTH, HEIGHT)
    tried = []
    for inner in (False, True):
        turn = Round((24, 80), (5.7, 6.3), 0.0, 1.5, most_triangles=10**9, inner=inner)
        search = Search(Budget.of(60.0))
        found = hypotheses(points, turn, SKY, PLACE, epoch_yr=2000.0, settings=parameters, search=search)
        assert any(separation_arcsec(one.plate.center(), place) < 60.0 for one in found)
        search = Search(Budget.of(60.0))
        nowhere = Points(rng.uniform(0, WIDTH, 150), rng.uniform(0, HEIGHT, 150), WIDTH, HEIGHT)
        list(hypotheses(nowhere, turn, SKY, PLACE, epoch_yr=2000.0, settings=parameters, search=search))
        tried.append(search.hypotheses)
    # and what is hopeless costs less
    assert tried[1] < 0.7 * tried[0]


def test_a_round_ends_where_its_work_does():
    """The nearest tiles are compared with the frame whatever is left."""
    rng = np.random.default_rng(11)
    points = Points(rng.uniform(0, WIDTH, 60), rng.uniform(0, HEIGHT, 60), WIDTH, HEIGHT)
    turn = Round((12, 50), (5.0, 5.5), 0.0, 2.0)
    tried = {}
    for most in (0, 300_000, math.inf):
        search = Search(Budget.of(30.0), round_ends=most)
        list(
            hypotheses(
                points, turn, SKY, PLACE, epoch_yr=2000.0, settings=IdentificationSettings(), search=search
            )
        )
        tried[most] = search.tiles_tried
        assert search.hypotheses > 0
    assert tried[0] == 1
    assert tried[0] < tried[300_000] < tried[math.inf]
