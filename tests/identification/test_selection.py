"""Pieces of one trail are one source: they are found, and they confirm a plate once."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.identification.anchors import AnchorSources
from mountnav.identification.odds import Confirmation, Corners
from mountnav.identification.plate import similarity_plate
from mountnav.identification.selection import trail_pieces
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import gnomonic_inverse

WIDTH, HEIGHT = 1000, 800


def _comb(x: np.ndarray, y: np.ndarray, offsets: np.ndarray, rng: np.random.Generator):
    """Each place once for each offset, to 0.3 px."""
    many_x, many_y = (x[:, None] + offsets[:, 0]).ravel(), (y[:, None] + offsets[:, 1]).ravel()
    return many_x + rng.normal(0, 0.3, many_x.size), many_y + rng.normal(0, 0.3, many_y.size)


@pytest.mark.parametrize(("stars", "cut_in"), [(10, 2), (30, 3), (50, 5)])
def test_pieces_of_trails_are_one_source(stars: int, cut_in: int) -> None:
    rng = np.random.default_rng(stars)
    offsets = np.arange(cut_in)[:, None] * np.array([17.0, -9.0])
    x, y = rng.uniform(0, WIDTH, stars), rng.uniform(0, HEIGHT, stars)
    source = trail_pieces(*_comb(x, y, offsets, rng)).reshape(stars, cut_in)
    assert (source == source[:, :1]).all()
    # of many trails some lie by chance where pieces of others would
    assert np.unique(source[:, 0]).size >= 0.7 * stars


def test_stars_are_sources_of_their_own() -> None:
    rng = np.random.default_rng(5)
    for count in (5, 40, 150, 400):
        for crowd in (0, count // 2):
            x, y = rng.uniform(0, WIDTH, count), rng.uniform(0, HEIGHT, count)
            x[:crowd], y[:crowd] = rng.normal(500, 60, crowd), rng.normal(400, 60, crowd)
            order = rng.permutation(count)
            assert np.unique(trail_pieces(x[order], y[order])).size == count


@pytest.mark.parametrize("plates", [100, pytest.param(300, marks=pytest.mark.long)])
def test_the_pieces_of_one_trail_confirm_a_wrong_plate_once(plates: int) -> None:
    # a catalog's stars that lie as the pieces of trails do: what hits one piece hits all of them
    rng = np.random.default_rng(8)
    offsets = np.arange(4)[:, None] * np.array([23.0, 11.0])
    turn = 2.0 + 0.0j
    middle = complex((WIDTH - 1) / 2, (HEIGHT - 1) / 2)
    place = Icrs(80.0, 20.0)
    plate = similarity_plate(place, turn, -turn * middle, mirrored=False, width_px=WIDTH, height_px=HEIGHT)
    template = embedded_catalog().cone(place, 3.0, epoch_yr=2000.0)
    claimed: dict[bool, list[Any]] = {True: [], False: []}
    for _ in range(plates):
        x, y = _comb(rng.uniform(60, 900, 12), rng.uniform(60, 700, 12), offsets, rng)
        at_x, at_y = _comb(rng.uniform(60, 900, 9), rng.uniform(60, 700, 9), offsets, rng)
        at_x, at_y = np.concatenate((x[:3], at_x)), np.concatenate((y[:3], at_y))
        xi, eta = plate.tangential(at_x, at_y)
        ra, dec = gnomonic_inverse(
            np.radians(xi / 3600), np.radians(eta / 3600), plate.tangent.ra_deg, plate.tangent.dec_deg
        )
        stars = replace(template.only(np.arange(at_x.size)), ra_deg=np.asarray(ra), dec_deg=np.asarray(dec))
        corners = Corners(x[:3], y[:3], stars.ra_deg[:3], stars.dec_deg[:3])
        for counted, source in ((True, trail_pieces(x, y)), (False, None)):
            confirmation = Confirmation(
                plate, corners, stars, x, y, width_px=WIDTH, height_px=HEIGHT, match_px=9.6, source=source
            )
            claimed[counted].append(confirmation.chance())
    for level in (0.05, 0.01):
        most = level + 3 * math.sqrt(level / plates)
        assert np.mean(np.array(claimed[True]) < level) <= most
    assert np.mean(np.array(claimed[False]) < 0.01) > 0.05


def test_an_anchor_is_not_confirmed_by_its_own_trail() -> None:
    x, y = np.array([100.0, 117.0, 500.0, 800.0]), np.array([100.0, 91.0, 300.0, 600.0])
    sources = AnchorSources(x, y, np.zeros(4), WIDTH, HEIGHT, np.array([0, 0, 1, 2]))
    assert sources.with_pieces(np.array([1])).tolist() == [True, True, False, False]
    assert replace(sources, piece_of=None).with_pieces(np.array([1])).tolist() == [False, True, False, False]
