"""Star lists: found under any rotation, mirror, scale and shift; chance and wrong places refused."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.stars import Stars
from mountnav.frames import Hint
from mountnav.identification.area import tiles
from mountnav.identification.confirmation import Corners, Witnesses
from mountnav.identification.odds import area_share, at_least
from mountnav.identification.plate import similarity_plate
from mountnav.identification.search import identify, scale_windows
from mountnav.identification.selection import spread_brightest, star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.measuring.measurements import Flag, Measurements
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, gnomonic, gnomonic_inverse, separation_arcsec
from mountnav.solution import Reason

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
        arrays = (s.ra_deg, s.dec_deg, s.sigma_arcsec, s.mag, s.pm_ra_cosdec_mas_yr, s.pm_dec_mas_yr)
        return Stars(*(one[chosen] for one in arrays), epoch_yr=epoch_yr, band="V", source=self.name)


def invented_sky(seed=3, count=3000, half_deg=3.0):
    rng = np.random.default_rng(seed)
    xi, eta = np.radians(rng.uniform(-half_deg, half_deg, (2, count)))
    ra, dec = gnomonic_inverse(xi, eta, PLACE.ra_deg, PLACE.dec_deg)
    mag = np.sort(11.0 - rng.exponential(1.2, count))
    nothing = np.zeros(count)
    return InventedSky(Stars(ra, dec, np.full(count, 0.05), mag, nothing, nothing, 2000.0, "V", "invented"))


SKY = invented_sky()


def listed(x, y, flux, width=WIDTH, height=HEIGHT, flags=None):
    order = np.argsort(-flux)
    x, y, flux = x[order], y[order], flux[order]
    one = np.ones(x.size)
    flags = np.zeros(x.size, dtype=np.int64) if flags is None else flags[order]
    return Measurements(
        x, y, 0.1 * one, 0.1 * one, flux, 0.01 * flux, 3 * one, 0 * one, flags, width, height, 100.0, 10.0
    )


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
    )


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


@given(st.integers(0, 2**32 - 1), st.integers(5, 150))
@settings(max_examples=15, deadline=None)
def test_random_lists_never_solve(seed, count):
    rng = np.random.default_rng(seed)
    measurements = listed(
        rng.uniform(0, WIDTH, count), rng.uniform(0, HEIGHT, count), rng.exponential(1, count)
    )
    got = identify(measurements, SKY, Hint(PLACE, 0.1, 5.7, 6.3), epoch_yr=2000.0, budget_s=4)
    assert got.reference is None
    assert got.reason in (
        Reason.NO_MATCH,
        Reason.CHANCE,
        Reason.TIMED_OUT,
        Reason.TOO_FEW_MEASUREMENTS,
    )


def test_scale_unknown_or_wrong_still_solves_rightly():
    measurements = seen(PLACE, scale=6.0, rotation_deg=20, parity=1)
    for hint in (Hint(PLACE, 0.3), Hint(PLACE, 0.3, 4.8, 5.3), Hint(PLACE, 0.3, scale_low_arcsec_px=3.0)):
        got = identify(measurements, SKY, hint, epoch_yr=2000.0)
        assert got.reference is not None, got.detail
        assert separation_arcsec(got.reference.plate.center(), PLACE) < 1.0


def test_the_papers_parameters_solve_too():
    measurements = seen(PLACE, scale=6.0, rotation_deg=20, parity=-1, junk=5, lost=0.0)
    got = identify(
        measurements,
        SKY,
        Hint(PLACE, 0.2, 5.8, 6.2),
        epoch_yr=2000.0,
        settings=IdentificationSettings.paper(),
    )
    assert got.reference is not None, got.detail


def test_each_refusal_says_why():
    measurements = seen(PLACE, scale=6.0, rotation_deg=20, parity=1)
    few = listed(np.arange(4.0), np.arange(4.0), np.ones(4))
    assert identify(measurements, SKY, Hint(), epoch_yr=2000.0).reason is Reason.NO_HINT
    got = identify(few, SKY, Hint(PLACE, 0.2, 5.8, 6.2), epoch_yr=2000.0)
    assert got.reason is Reason.TOO_FEW_MEASUREMENTS
    assert "4 stars" in got.detail
    line = listed(np.linspace(100, 900, 8), np.linspace(100, 700, 8), np.ones(8))
    got = identify(line, SKY, Hint(PLACE, 0.2, 5.8, 6.2), epoch_yr=2000.0)
    assert got.reason is Reason.TOO_FEW_MEASUREMENTS
    assert "no triangle" in got.detail
    empty = Hint(Icrs(30.0, -40.0), 0.2, 5.8, 6.2)
    assert identify(measurements, SKY, empty, epoch_yr=2000.0).reason is Reason.TOO_FEW_CATALOG_STARS
    wrong = Hint(displaced(PLACE, 6000, 6000), 0.2, 5.8, 6.2)
    assert identify(measurements, SKY, wrong, epoch_yr=2000.0).reason in (Reason.NO_MATCH, Reason.CHANCE)
    late = identify(measurements, SKY, Hint(PLACE, 0.2, 5.8, 6.2), epoch_yr=2000.0, budget_s=0)
    assert late.reason is Reason.TIMED_OUT


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
    assert list(star_like(listed(np.arange(5.0), np.arange(5.0), np.arange(5.0, 0, -1), flags=flags))) == [
        0,
        2,
    ]


def test_odds_are_binomial_and_follow_the_density():
    assert at_least(np.array([0]), np.array([5]), 0.1)[0] == 1
    assert at_least(np.array([6]), np.array([5]), 0.1)[0] == 0
    assert at_least(np.array([5]), np.array([5]), 0.1)[0] == pytest.approx(1e-5)
    assert at_least(np.array([1]), np.array([2]), 0.5)[0] == pytest.approx(0.75)
    share = area_share(np.full(50, 10.0), np.full(50, 10.0), 2.0, width_px=100, height_px=100)
    assert share[0, 0] > 10 * share[3, 3] > 0


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
    assert scale_windows(Hint(None, 1.0, 2.0, 2.2))[0] == (2.0, 2.2)
    windows = sorted(scale_windows(Hint()))
    assert windows[0][0] == pytest.approx(0.3)
    assert windows[-1][1] == pytest.approx(200)
    assert all(a[1] == pytest.approx(b[0]) for a, b in pairwise(windows))


def test_the_odds_of_wrong_plates_are_not_understated():
    """Of random plates through three made-up pairs, no more than 5 % may look like a 5 % chance."""
    rng = np.random.default_rng(11)
    stars = SKY.cone(PLACE, 1.0, epoch_yr=2000.0, mag_limit=9.5)
    chances = []
    for _ in range(400):
        turn = 6.0 * np.exp(2j * np.pi * rng.random())
        middle = complex((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
        plate = similarity_plate(
            PLACE, turn, -turn * middle, mirrored=False, width_px=WIDTH, height_px=HEIGHT
        )
        x, y = plate.pixels(*plate.project(stars.ra_deg, stars.dec_deg))
        inside = np.flatnonzero((x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT))
        three = rng.choice(inside, 3, replace=False)
        corners = Corners(x[three], y[three], stars.ra_deg[three], stars.dec_deg[three])
        junk_x, junk_y = rng.uniform(0, WIDTH, 60), rng.uniform(0, HEIGHT, 60)
        witnesses = Witnesses(
            plate,
            corners,
            stars,
            np.concatenate((x[three], junk_x)),
            np.concatenate((y[three], junk_y)),
            width_px=WIDTH,
            height_px=HEIGHT,
            match_px=9.6,
        )
        chances.append(witnesses.chance())
    chances = np.array(chances)
    for level in (0.2, 0.05, 0.01):
        assert np.mean(chances < level) <= level + 3 * math.sqrt(level / chances.size)
