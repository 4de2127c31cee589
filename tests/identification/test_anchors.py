"""Two-star anchors: counted exactly, odds never understated, few stars enough where a search was long."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Stars
from mountnav.frames import Hint
from mountnav.identification.anchors import (
    APART,
    LEVELS,
    PARTS_OF_LIMIT,
    PASSES,
    SHARE,
    Anchors,
    AnchorSources,
    Case,
    SearchedPart,
    anchored_odds,
)
from mountnav.identification.budget import Budget
from mountnav.identification.full import Hypothesis, Search
from mountnav.identification.odds import Corners, trials_factor
from mountnav.identification.plate import similarity_plate
from mountnav.identification.search import Reach, identify
from mountnav.identification.selection import star_like
from mountnav.identification.settings import IdentificationSettings
from mountnav.identification.verification import verified
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced, separation_arcsec
from tests.identification.listed_sky import EPOCH, anywhere, seen

WIDTH, HEIGHT, SCALE = 1000, 800, 3.0
HERE = Icrs(200.0, 40.0)
AREA = SearchedPart(HERE, 0.2, (2.9, 3.1), 10)


@dataclass(frozen=True)
class FewStars:
    """A catalog of some stars."""

    stars: Stars
    name: str = "few"

    def cone(self, center, radius_deg, *, epoch_yr, mag_limit=None):
        return self.stars


def made_up(rng, count, spread_arcsec=2400.0):
    places = [displaced(HERE, *rng.uniform(-spread_arcsec / 2, spread_arcsec / 2, 2)) for _ in range(count)]
    ra, dec = np.array([one.ra_deg for one in places]), np.array([one.dec_deg for one in places])
    none = np.zeros(count)
    return Stars(ra, dec, none + 0.05, np.sort(rng.uniform(7, 11, count)), none, none, EPOCH, "V", "made up")


def strewn(rng, count):
    x, y = rng.uniform(0, WIDTH - 1, count), rng.uniform(0, HEIGHT - 1, count)
    return AnchorSources(x, y, np.sort(rng.uniform(-12, -8, count)), WIDTH, HEIGHT)


def all_anchors(stars, sources, most, scales):
    """Every anchor, one by one: two stars, two measurements, a parity."""
    places = [Icrs(float(a), float(d)) for a, d in zip(stars.ra_deg, stars.dec_deg, strict=True)]
    for i in range(min(most, sources.x_px.size)):
        for j in range(i):
            px = math.hypot(sources.x_px[i] - sources.x_px[j], sources.y_px[i] - sources.y_px[j])
            if px < APART * HEIGHT:
                continue
            for a in range(len(places)):
                for b in range(len(places)):
                    if a != b and scales[0] < separation_arcsec(places[a], places[b]) / px <= scales[1]:
                        yield from ((a, b, i, j, mirrored) for mirrored in (False, True))


@pytest.mark.long
def test_the_anchors_of_an_area_are_counted_one_by_one():
    rng = np.random.default_rng(1)
    stars, sources, anchors = made_up(rng, 25), strewn(rng, 20), Anchors()
    anchors.searched(AREA)
    for number, level in enumerate(LEVELS):
        chances = np.full(len(LEVELS), 1.0)
        chances[number] = 1e-12
        counted = sum(1 for _ in all_anchors(stars, sources, level, AREA.scales))
        assert counted > 10
        expected = 2e-12 * counted / PARTS_OF_LIMIT[number] * PASSES / SHARE
        assert anchors.odds(chances, sources, FewStars(stars), EPOCH, 1.0) == pytest.approx(expected)


def test_more_area_means_more_anchors_and_none_is_counted_twice():
    rng = np.random.default_rng(2)
    catalog, sources, chances = FewStars(made_up(rng, 25)), strewn(rng, 20), np.full(len(LEVELS), 1e-12)
    odds = []
    anchors = Anchors()
    for area in (AREA, SearchedPart(HERE, 0.1, (2.95, 3.05), 10), SearchedPart(HERE, 0.2, (3.1, 3.4), 10)):
        anchors.searched(area)
        odds.append(anchors.odds(chances, sources, catalog, EPOCH, 1.0))
    assert odds[0] == odds[1]
    # twice the anchors at least, and what is due for having searched on
    assert odds[2] > 2 * odds[0]
    assert len(anchors.areas) == 2
    # another list of measurements is another search
    anchors.searched(SearchedPart(HERE, 0.2, (2.9, 3.1), 17))
    assert anchors.odds(chances, sources, catalog, EPOCH, 1.0) > odds[2]


def test_nothing_searched_or_too_much_proves_nothing():
    rng = np.random.default_rng(3)
    catalog, sources, chances = FewStars(made_up(rng, 25)), strewn(rng, 20), np.full(len(LEVELS), 1e-300)
    assert Anchors().odds(chances, sources, catalog, EPOCH, 1.0) == 1
    whole_sky = Anchors()
    whole_sky.searched(SearchedPart(HERE, 180.0, (2.9, 3.1), 10))
    assert whole_sky.odds(chances, sources, catalog, EPOCH, 1.0) == 1
    rich = Anchors()
    rich.searched(AREA)
    assert rich.odds(chances, sources, FewStars(made_up(rng, 6000)), EPOCH, 1.0) == 1


def test_both_tests_together_stay_below_the_limit():
    """What the triangle's odds may be fooled with, at worst, and this test's share."""
    n = np.arange(1, 2_000_000)
    fooled = float(np.sum(1.0 / np.array(2.0 * n * (1.0 + np.log(n)) ** 2)))
    rest = 0.5 / (1.0 + math.log(n[-1]))
    assert trials_factor(7) == pytest.approx(2 * 7 * (1 + math.log(7)) ** 2)
    assert fooled + rest + SHARE <= 1.0
    assert sum(PARTS_OF_LIMIT) <= 1.0
    assert len(PARTS_OF_LIMIT) == len(LEVELS)


@pytest.mark.long
def test_the_best_anchor_of_all_is_as_improbable_as_it_claims():
    """Of searches through every anchor there is, no more than 30 (10) % may come to odds below 30 (10) %."""
    rng = np.random.default_rng(4)
    scales, claimed = (2.97, 3.03), []
    for _ in range(60):
        stars, sources = made_up(rng, 12, 3000.0), strewn(rng, 8)
        every = list(all_anchors(stars, sources, LEVELS[0], scales))
        least = 1.0
        for a, b, i, j, mirrored in every:
            z = sources.x_px[[i, j]] + (-1j if mirrored else 1j) * sources.y_px[[i, j]]
            turn = SCALE * np.exp(2j * np.pi * rng.random())
            about = similarity_plate(
                HERE, turn, -turn * z.mean(), mirrored=mirrored, width_px=WIDTH, height_px=HEIGHT
            )
            case = Case(about, stars, sources, 9.6)
            least = min(least, case.chance(np.array([a, i]), np.array([b, j])))
        claimed.append(min(1.0, least * max(len(every), 1)))
    for level in (0.3, 0.1):
        assert np.mean(np.array(claimed) < level) <= level + 2 * math.sqrt(level / len(claimed))
    assert min(claimed) < 1


def few_stars(rng):
    """A field of 0.38° with six to ten catalog stars, a tenth lost, and sixty sources that are no stars."""
    while True:
        place, rotation = anywhere(rng), rng.uniform(0, 360)
        one = seen(place, 0.67, rotation, 1, rng, width=2048, height=2048, depth=12.5, junk=60, noise=0.2)
        if 6 <= one.stars <= 10:
            return one


def true_hypothesis(one):
    """What a triangle of the right stars proposes."""
    width, height = one.measurements.width_px, one.measurements.height_px
    turn = -one.scale * np.exp(-1j * math.radians(one.rotation_deg))
    middle = complex((width - 1) / 2, -(height - 1) / 2)
    plate = similarity_plate(
        one.center, turn, -turn * middle, mirrored=True, width_px=width, height_px=height
    )
    stars = embedded_catalog().cone(one.center, 0.28, epoch_yr=EPOCH)
    x, y = plate.pixels(*plate.project(stars.ra_deg, stars.dec_deg))
    off = np.hypot(x[:, None] - one.measurements.x_px, y[:, None] - one.measurements.y_px)
    star = np.flatnonzero(off.min(axis=1) < 1.5)
    pair = off[star].argmin(axis=1)
    three = slice(0, 3)
    corners = Corners(
        one.measurements.x_px[pair][three],
        one.measurements.y_px[pair][three],
        stars.ra_deg[star][three],
        stars.dec_deg[star][three],
    )
    return Hypothesis(plate, corners), star.size


def judged(one, hypothesis, areas):
    """What comes of it after a search of 20,000 hypotheses in some areas."""
    search = Search(Budget.of(60.0), hypotheses=20_000)
    for area in areas:
        search.anchors.searched(area)
    usable = star_like(one.measurements)
    return verified(
        hypothesis, one.measurements, usable, embedded_catalog(), EPOCH, IdentificationSettings(), search
    )


@pytest.mark.long
def test_few_stars_are_enough_after_a_long_search():
    rng = np.random.default_rng(5)
    found = tried = by_triangles = 0
    while tried < 12:
        one = few_stars(rng)
        hypothesis, pairs = true_hypothesis(one)
        if pairs < 6:
            continue
        tried += 1
        near = displaced(one.center, *rng.uniform(-1800, 1800, 2))
        count = star_like(one.measurements).size
        there = judged(one, hypothesis, [SearchedPart(near, 1.0, (0.64, 0.70), count)])
        by_triangles += judged(one, hypothesis, []) is not None
        # what was not searched for has no anchor
        for other in (
            SearchedPart(near, 1.0, (0.71, 0.8), count),
            SearchedPart(displaced(near, 0, 9000), 1.0, (0.64, 0.70), count),
        ):
            elsewhere = judged(one, hypothesis, [other])
            assert (elsewhere is not None) == (judged(one, hypothesis, []) is not None)
        if there is not None:
            found += 1
            assert there.false_probability <= 1e-9
            assert separation_arcsec(there.reference.plate.center(), one.center) < one.scale
    assert found >= 10
    assert by_triangles < found


def test_few_stars_are_found_nowhere_else():
    rng = np.random.default_rng(7)
    for _ in range(4):
        one = few_stars(rng)
        away = displaced(one.center, 0.0, 4 * 3600.0)
        hint = Hint(center=away, radius_deg=1.0, scale_low_arcsec_px=0.64, scale_high_arcsec_px=0.70)
        got = identify(
            one.measurements,
            embedded_catalog(),
            hint,
            epoch_yr=EPOCH,
            reach=Reach(thorough=False),
            budget_s=20,
        )
        assert got.reference is None
        assert got.false_probability > 1e-6


def test_a_hypothesis_of_few_pairs_has_no_anchor():
    rng = np.random.default_rng(6)
    stars, anchors = made_up(rng, 12), Anchors()
    anchors.searched(AREA)
    turn = complex(SCALE)
    plate = similarity_plate(HERE, turn, -turn * 500, mirrored=False, width_px=WIDTH, height_px=HEIGHT)
    empty = AnchorSources(np.zeros(0), np.zeros(0), np.zeros(0), WIDTH, HEIGHT)
    assert anchored_odds(plate, stars, empty, anchors, FewStars(stars), EPOCH, match_px=9.6) == 1
