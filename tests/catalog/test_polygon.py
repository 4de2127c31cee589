"""Stars in a polygon against the plane: in a gnomonic projection great circles are straight lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path as Outline

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.stars import stars_in_polygon
from mountnav.errors import BadRequest
from mountnav.sky.coordinates import Icrs

COUNT = 8000


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> PackedStore:
    rng = np.random.default_rng(11)
    ra, dec = rng.uniform(0, 360, COUNT), np.degrees(np.arcsin(rng.uniform(-1, 1, COUNT)))
    dec[:1000], dec[1000:2000] = 90 - rng.exponential(2, 1000), -90 + rng.exponential(2, 1000)
    ra[2000:3000], dec[2000:3000] = rng.normal(0, 2, 1000) % 360, rng.normal(0, 2, 1000)
    one = np.full(COUNT, 30.0)
    columns = CatalogColumns(
        ra,
        dec,
        np.zeros(COUNT),
        np.zeros(COUNT),
        5.0 + 0.001 * np.arange(COUNT, dtype=np.float64)[rng.permutation(COUNT)],
        error_curve((one, one), (one / 10, one / 10), (one + 1970, one + 1970)),
    )
    path: Path = tmp_path_factory.mktemp("polygon") / "sky.mnc"
    pack(columns, path, name="sky", band="V", epoch_yr=2000.0, nside=16)
    return PackedStore(path)


def tangent(center: Icrs, xi: np.ndarray, eta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places of points in the tangent plane, in degrees."""
    x, y = np.radians(xi), np.radians(eta)
    a0, d0 = np.radians([center.ra_deg, center.dec_deg])
    depth = np.cos(d0) - y * np.sin(d0)
    dec = np.arctan2(np.sin(d0) + y * np.cos(d0), np.hypot(x, depth))
    return np.degrees(a0 + np.arctan2(x, depth)) % 360, np.degrees(dec)


def projected(center: Icrs, ra: np.ndarray, dec: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Plane coordinates in degrees, and whether the point is on this side of the sphere."""
    a, d = np.radians(ra) - np.radians(center.ra_deg), np.radians(dec)
    d0 = np.radians(center.dec_deg)
    z = np.sin(d) * np.sin(d0) + np.cos(d) * np.cos(d0) * np.cos(a)
    with np.errstate(divide="ignore"):
        xi = np.cos(d) * np.sin(a) / z
        eta = (np.sin(d) * np.cos(d0) - np.cos(d) * np.sin(d0) * np.cos(a)) / z
    return np.degrees(xi), np.degrees(eta), z > 0


places = st.one_of(
    st.tuples(st.floats(0, 360), st.floats(-90, 90)),
    st.tuples(st.floats(0, 360), st.floats(88, 90)),
    st.tuples(st.floats(0, 360), st.floats(-90, -88)),
    st.tuples(st.floats(-2, 2), st.floats(-3, 3)),
)


@pytest.mark.long
@settings(max_examples=60, deadline=None)
@given(
    place=places,
    size=st.tuples(st.floats(0.2, 30), st.floats(0.2, 30)),
    turn=st.floats(0, 360),
    shear=st.floats(-0.5, 0.5),
    sides=st.integers(3, 7),
    backwards=st.booleans(),
)
def test_a_polygon_holds_what_it_holds_in_the_plane(
    store: PackedStore,
    place: tuple[float, float],
    size: tuple[float, float],
    turn: float,
    shear: float,
    sides: int,
    backwards: bool,
) -> None:
    center = Icrs(place[0] % 360, place[1])
    angle = np.radians(turn) + 2 * np.pi * np.arange(sides) / sides
    eta = size[1] * np.sin(angle)
    xi = size[0] * np.cos(angle) + shear * eta
    order = np.arange(sides)[:: -1 if backwards else 1]
    ra, dec = tangent(center, xi[order], eta[order])
    found = stars_in_polygon(
        store, [Icrs(float(a), float(d)) for a, d in zip(ra, dec, strict=True)], epoch_yr=2026.9
    )
    everything = store.cone(Icrs(0, 0), 180.0, epoch_yr=2026.9)
    x, y, here = projected(center, everything.ra_deg, everything.dec_deg)
    points = np.stack([x, y], axis=1)
    inner, outer = (
        here & Outline(np.stack([xi, eta], axis=1) * scale).contains_points(points)
        for scale in (1 - 1e-6, 1 + 1e-6)
    )
    assert inner.sum() <= len(found) <= outer.sum()
    assert set(everything.mag[inner]) <= set(found.mag) <= set(everything.mag[outer])
    assert np.all(np.diff(found.mag) >= 0)


def test_a_magnitude_limit_and_colors_go_along(store: PackedStore) -> None:
    corners = [Icrs(350, -5), Icrs(10, -5), Icrs(10, 5), Icrs(350, 5)]
    whole = stars_in_polygon(store, corners, epoch_yr=2000.0)
    bright = stars_in_polygon(store, corners, epoch_yr=2000.0, mag_limit=8.0)
    assert 0 < len(bright) == (whole.mag <= 8.0).sum() < len(whole)
    assert bright.color_mag.size == bright.flags.size == len(bright)


def test_a_polygon_round_the_pole_holds_the_cap(store: PackedStore) -> None:
    corners = [Icrs(ra, 88.0) for ra in range(0, 360, 2)]
    found = stars_in_polygon(store, corners, epoch_yr=2000.0)
    everything = store.cone(Icrs(0, 90), 10.0, epoch_yr=2000.0)
    assert set(everything.mag[everything.dec_deg > 88.01]) <= set(found.mag)
    assert found.dec_deg.min() > 87.99
    assert len(found) > 300


@pytest.mark.parametrize(
    "corners",
    [
        [],
        [Icrs(0, 0), Icrs(1, 1)],
        [Icrs(0, 0), Icrs(1, 0), Icrs(1, 0), Icrs(0, 1)],
        [Icrs(0, 0), Icrs(1, 1), Icrs(1, 0), Icrs(0, 1)],  # a bow tie
        [Icrs(0, 0), Icrs(4, 0), Icrs(1, 1), Icrs(0, 4)],  # pushed in
        [Icrs(0, 0), Icrs(1, 0), Icrs(2, 0)],
        [Icrs(0, 0), Icrs(120, 0), Icrs(240, 0)],
        [Icrs(0, -30), Icrs(120, -30), Icrs(240, -30), Icrs(0, 80)],
        [Icrs(0, 0), Icrs(float("nan"), 0), Icrs(0, 1)],
        [Icrs(0, 0), Icrs(1, 91), Icrs(0, 1)],
        # a pentagram goes round its middle twice
        [
            Icrs(*(float(v) for v in p))
            for p in zip(
                *tangent(
                    Icrs(10, 10), np.cos(np.arange(5) * 0.8 * np.pi), np.sin(np.arange(5) * 0.8 * np.pi)
                ),
                strict=True,
            )
        ],
    ],
)
def test_what_is_no_convex_polygon_is_refused(store: PackedStore, corners: list[Icrs]) -> None:
    with pytest.raises(BadRequest, match="polygon"):
        stars_in_polygon(store, corners, epoch_yr=2000.0)
