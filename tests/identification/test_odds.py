"""The odds that are claimed: never smaller than chance really has it, and small enough for true matches."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.embedded import embedded_catalog
from mountnav.identification.anchors import AnchorSources, Case
from mountnav.identification.odds import (
    Confirmation,
    Corners,
    berk_jones_p,
    binomial_sf,
    local_density,
    strobe_chances,
    trials_factor,
)
from mountnav.identification.plate import similarity_plate
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import displaced
from tests.identification.listed_sky import EPOCH, anywhere

WIDTH, HEIGHT = 1000, 800


def test_odds_are_binomial_and_follow_the_density():
    assert binomial_sf(np.array([0]), np.array([5]), 0.1)[0] == 1
    assert binomial_sf(np.array([6]), np.array([5]), 0.1)[0] == 0
    assert binomial_sf(np.array([5]), np.array([5]), 0.1)[0] == pytest.approx(1e-5)
    assert binomial_sf(np.array([1]), np.array([2]), 0.5)[0] == pytest.approx(0.75)
    share = strobe_chances(np.full(50, 10.0), np.full(50, 10.0), 2.0, width_px=100, height_px=100)
    assert share[0, 0] > 10 * share[3, 3] > 0


def test_density_is_never_less_than_the_mean_and_sees_a_crowd():
    rng = np.random.default_rng(1)
    x = np.concatenate((rng.uniform(0, 1000, 40), rng.normal(300, 5, 40)))
    y = np.concatenate((rng.uniform(0, 800, 40), rng.normal(300, 5, 40)))
    at = np.array([300.0, 900.0])
    dense = local_density(x, y, at, np.array([300.0, 700.0]), width_px=1000, height_px=800)
    assert dense[0] > 100 * dense[1]
    assert dense[1] >= 80 / 800_000


@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_together_grows_with_each_chance_and_is_at_most_one(count, seed):
    rng = np.random.default_rng(seed)
    chances = rng.random(count)
    assert 0 <= berk_jones_p(chances * 0.5) <= berk_jones_p(chances) <= 1
    assert berk_jones_p(np.zeros(0)) == 1
    assert berk_jones_p(np.full(4, 1e-4)) == pytest.approx(4e-16)


def test_together_of_uniform_values_is_no_smaller_than_uniform():
    rng = np.random.default_rng(2)
    got = np.array([berk_jones_p(rng.random(12)) for _ in range(4000)])
    for level in (0.2, 0.05, 0.01, 0.002):
        assert np.mean(got < level) <= level + 3 * math.sqrt(level / got.size)


def test_looks_cover_a_search_that_stops_at_the_first_success():
    """Of searches that stop when looks(n)·p falls below 5 %, no more than 5 % are fooled."""
    rng = np.random.default_rng(3)
    factor = np.array([trials_factor(n) for n in range(1, 2001)])
    fooled = np.mean([np.any(rng.random(2000) * factor < 0.05) for _ in range(3000)])
    assert fooled <= 0.05 + 3 * math.sqrt(0.05 / 3000)
    assert fooled > 0.02


@pytest.mark.long
@pytest.mark.parametrize("kind", ["even", "cluster", "another sky"])
@pytest.mark.parametrize("count", [10, pytest.param(60, marks=pytest.mark.long), 400])
def test_the_odds_of_wrong_plates_are_not_understated(kind, count):
    """Plates through three made-up pairs: no more than 5 % of them may look like a 5 % chance."""
    rng = np.random.default_rng(count)
    scale = 5.0
    chances: list[Any] = []
    middle = complex((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    while len(chances) < 120:
        place = anywhere(rng)
        stars = embedded_catalog().cone(place, 0.9, epoch_yr=EPOCH, mag_limit=11.0)
        turn = scale * np.exp(2j * np.pi * rng.random())
        plate = similarity_plate(
            place, turn, -turn * middle, mirrored=False, width_px=WIDTH, height_px=HEIGHT
        )
        x, y = plate.pixels(*plate.project(stars.ra_deg, stars.dec_deg))
        inside = np.flatnonzero((x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT))
        if inside.size < 5:
            continue
        three = rng.choice(inside, 3, replace=False)
        corners = Corners(x[three], y[three], stars.ra_deg[three], stars.dec_deg[three])
        junk_x, junk_y = rng.uniform(0, WIDTH, count), rng.uniform(0, HEIGHT, count)
        if kind == "cluster":
            part = count // 2
            junk_x[:part] = np.clip(rng.normal(rng.uniform(0, WIDTH), 60, part), 0, WIDTH - 1)
            junk_y[:part] = np.clip(rng.normal(rng.uniform(0, HEIGHT), 60, part), 0, HEIGHT - 1)
        elif kind == "another sky":
            off = displaced(place, 20000.0 + rng.uniform(0, 9000), 0.0)
            others = embedded_catalog().cone(off, 0.9, epoch_yr=EPOCH, mag_limit=11.5)
            there = similarity_plate(
                off, turn, -turn * middle, mirrored=False, width_px=WIDTH, height_px=HEIGHT
            )
            junk_x, junk_y = there.pixels(*there.project(others.ra_deg, others.dec_deg))
            seen = (junk_x > 0) & (junk_x < WIDTH) & (junk_y > 0) & (junk_y < HEIGHT)
            junk_x, junk_y = junk_x[seen][:count], junk_y[seen][:count]
        confirmation = Confirmation(
            plate,
            corners,
            stars,
            np.concatenate((x[three], junk_x)),
            np.concatenate((y[three], junk_y)),
            width_px=WIDTH,
            height_px=HEIGHT,
            match_px=9.6,
        )
        chances.append(confirmation.chance())
    claimed = np.array(chances)
    for level in (0.2, 0.05, 0.01):
        assert np.mean(claimed < level) <= level + 3 * math.sqrt(level / claimed.size)


CLUSTERS = (
    Icrs(56.75, 24.1),
    Icrs(34.7, 57.15),
    Icrs(130.1, 19.67),
    Icrs(160.7, -64.4),
    Icrs(166.4, -58.7),
    Icrs(268.4, -34.8),
)


IN_EVERY_RUN = (
    ("even", 300, 5.0),
    ("cluster", 12, 2.5),
    ("another sky", 12, 2.5),
    ("cluster on cluster", 12, 2.5),
    ("cluster on cluster", 300, 5.0),
)


def stars_on_plate(place, turn, radius_deg, mag_limit):
    """A place's stars and where a camera shows them; those in the frame."""
    stars = embedded_catalog().cone(place, radius_deg, epoch_yr=EPOCH, mag_limit=mag_limit)
    middle = complex((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    plate = similarity_plate(place, turn, -turn * middle, mirrored=False, width_px=WIDTH, height_px=HEIGHT)
    x, y = plate.pixels(*plate.project(stars.ra_deg, stars.dec_deg))
    inside = np.flatnonzero((x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT))
    return plate, stars, x, y, inside


def not_there(kind, count, rng, turn, place):
    """Measurements that have nothing to do with the place."""
    x, y = rng.uniform(0, WIDTH, count), rng.uniform(0, HEIGHT, count)
    mag = np.sort(12 - rng.exponential(1.0, count))
    if kind == "cluster":
        part = rng.permutation(count)[: count // 2]
        x[part] = np.clip(rng.normal(rng.uniform(0, WIDTH), 60, part.size), 0, WIDTH - 1)
        y[part] = np.clip(rng.normal(rng.uniform(0, HEIGHT), 60, part.size), 0, HEIGHT - 1)
    if kind in ("another sky", "cluster on cluster"):
        other = displaced(place, 20000.0 + rng.uniform(0, 9000), 0.0)
        if kind == "cluster on cluster":
            other = CLUSTERS[(CLUSTERS.index(place) + int(rng.integers(1, len(CLUSTERS)))) % len(CLUSTERS)]
        _, stars, there_x, there_y, inside = stars_on_plate(
            other, turn * np.exp(2j * np.pi * rng.random()), 0.9, 11.5
        )
        x, y, mag = there_x[inside][:count], there_y[inside][:count], stars.mag[inside][:count]
    return x, y, mag


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "count", "scale"),
    [
        pytest.param(kind, *other, marks=() if (kind, *other) in IN_EVERY_RUN else pytest.mark.long)
        for kind in ("even", "cluster", "another sky", "cluster on cluster")
        for other in ((12, 2.5), (60, 2.5), (60, 5.0), (300, 5.0))
    ],
)
def test_the_odds_of_wrong_anchors_are_not_understated(kind, count, scale):
    """Plates through two made-up pairs; the brightest, the many and those alike in brightness are asked."""
    rng = np.random.default_rng(count)
    chances: list[Any] = []
    while len(chances) < 100:
        place = CLUSTERS[int(rng.integers(len(CLUSTERS)))] if kind == "cluster on cluster" else anywhere(rng)
        turn = scale * np.exp(2j * np.pi * rng.random())
        plate, stars, x, y, inside = stars_on_plate(place, turn, 0.18 * scale, 11.0)
        if inside.size < 5:
            continue
        two = rng.choice(inside, 2, replace=False)
        if np.hypot(*np.diff([x[two], y[two]], axis=1)) < 200:
            continue
        junk_x, junk_y, junk_mag = not_there(kind, count, rng, turn, place)
        mag = np.concatenate((stars.mag[two] + rng.normal(0, 0.2, 2), junk_mag))
        order = np.argsort(mag, kind="stable")
        sources = AnchorSources(
            np.concatenate((x[two], junk_x))[order],
            np.concatenate((y[two], junk_y))[order],
            mag[order],
            WIDTH,
            HEIGHT,
        )
        first, second = np.flatnonzero(order == 0)[0], np.flatnonzero(order == 1)[0]
        case = Case(plate, stars, sources, 9.6)
        chances.append(case.chance(np.array([two[0], first]), np.array([two[1], second])))
    claimed = np.array(chances)
    for level in (0.2, 0.05, 0.01):
        assert np.mean(claimed < level) <= level + 2 * math.sqrt(level / claimed.size)
