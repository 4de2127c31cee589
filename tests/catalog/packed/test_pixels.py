"""The parts that choose: pixels in two steps, fast stars, and what of the sky a file covers."""

from __future__ import annotations

import pickle
from pathlib import Path

import astropy.units as u
import numpy as np
import pytest
from astropy_healpix import HEALPix, boundaries_lonlat, healpix_to_lonlat, lonlat_to_healpix
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed import pixels as module
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.packed.pixels import (
    TABLE_NSIDE,
    PixelChoice,
    Runs,
    computed_centers,
    largest_pixel_radius_rad,
    pixel_centers,
)
from mountnav.catalog.packed.store import FAST_LIMITS_MAS_YR, MOST_FAST, fast_limit
from mountnav.sky.coordinates import Icrs


def direction(ra_deg: float, dec_deg: float) -> np.ndarray:
    a, d = np.radians([ra_deg, dec_deg])
    return np.array([np.cos(d) * np.cos(a), np.cos(d) * np.sin(a), np.sin(d)])


def scattered(
    rng: np.random.Generator, center: tuple[float, float], radius_deg: float, count: int
) -> np.ndarray:
    """Directions all over a cone, shape (3, count)."""
    z = 1 - rng.uniform(0, 1, count) * (1 - np.cos(np.radians(radius_deg)))
    turn, s = rng.uniform(0, 2 * np.pi, count), np.sqrt(1 - z**2)
    axis = direction(*center)
    east = np.cross([0, 0, 1], axis) if abs(axis[2]) < 0.9 else np.cross([1, 0, 0], axis)
    east /= np.linalg.norm(east)
    north = np.cross(axis, east)
    found: np.ndarray = (
        np.outer(axis, z) + np.outer(east, s * np.cos(turn)) + np.outer(north, s * np.sin(turn))
    )
    return found


@pytest.mark.long
@settings(max_examples=150, deadline=None)
@given(
    level=st.integers(0, 12),
    place=st.one_of(
        st.tuples(st.floats(0, 360), st.floats(-90, 90)),
        st.tuples(st.floats(0, 360), st.sampled_from([-90.0, -89.99, 89.99, 90.0, 0.0, 41.8103])),
        st.tuples(st.sampled_from([0.0, 45.0, 90.0, 359.9999]), st.floats(-90, 90)),
    ),
    spread=st.floats(-3, 2.2),
    seed=st.integers(0, 1000),
)
def test_no_pixel_of_a_cone_is_missing_and_few_are_too_many(
    level: int, place: tuple[float, float], spread: float, seed: int
) -> None:
    nside = 2**level
    radius_deg = min(10.0**spread, 20.0 * np.degrees(largest_pixel_radius_rad(nside)), 180.0)
    runs = PixelChoice(nside).near(direction(*place), np.radians(radius_deg))
    assert np.all(runs.end > runs.first)
    assert np.all(runs.first[1:] > runs.end[:-1])
    points = scattered(np.random.default_rng(seed), place, radius_deg, 300)
    lon, lat = np.arctan2(points[1], points[0]), np.arcsin(np.clip(points[2], -1, 1))
    pixels = lonlat_to_healpix(lon * u.rad, lat * u.rad, nside=nside, order="nested")
    assert set(pixels.tolist()) <= set(runs.all().tolist())
    if radius_deg + 3 * np.degrees(largest_pixel_radius_rad(min(nside, 64))) < 180.0:
        lon, lat = healpix_to_lonlat(runs.all(), nside=nside, order="nested")
        centers = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        away = 2 * np.arcsin(np.linalg.norm(centers.T - direction(*place), axis=1) / 2)
        # pixels that are inside as a whole come with their coarse one: no farther than the padding
        assert away.max() <= np.radians(radius_deg) + largest_pixel_radius_rad(nside) * 1.001


@pytest.mark.long
@pytest.mark.parametrize("nside", [1, 2, 16, 64])
def test_no_pixel_is_larger_than_the_largest(nside: int) -> None:
    numbers = np.arange(12 * nside**2)
    lon, lat = boundaries_lonlat(numbers, 8, nside=nside, order="nested")
    corners = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    lon, lat = healpix_to_lonlat(numbers, nside=nside, order="nested")
    centers = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    away = 2 * np.arcsin(np.linalg.norm(corners - centers[:, :, np.newaxis], axis=0).max() / 2)
    assert 0.98 * largest_pixel_radius_rad(nside) < away < largest_pixel_radius_rad(nside)


@given(st.sets(st.integers(0, 200)))
def test_runs_hold_the_numbers_they_were_made_of(numbers: set[int]) -> None:
    rising = np.array(sorted(numbers), dtype=np.int64)
    assert Runs.of(rising).all().tolist() == sorted(numbers)


def test_what_is_fast_depends_on_how_many_there_are() -> None:
    assert fast_limit([10, 5, 2, 0]) == (500.0, 10)
    assert fast_limit([MOST_FAST + 1, MOST_FAST, 2, 0]) == (1000.0, MOST_FAST)
    assert fast_limit([10**6, 10**6, 10**6, 10**5]) == (FAST_LIMITS_MAS_YR[-1], 10**5)


def filled(path: Path, vectors: np.ndarray, nside: int) -> PackedStore:
    count = vectors.shape[1]
    ten = np.full(count, 10.0)
    columns = CatalogColumns(
        np.degrees(np.arctan2(vectors[1], vectors[0])) % 360,
        np.degrees(np.arcsin(np.clip(vectors[2], -1, 1))),
        np.zeros(count),
        np.zeros(count),
        ten,
        error_curve((ten, ten), (ten, ten), (ten + 1980, ten + 1980)),
    )
    pack(columns, path, name="piece", band="V", epoch_yr=2000.0, nside=nside)
    return PackedStore(path)


@pytest.mark.long
@pytest.mark.parametrize(
    ("center", "radius_deg", "count", "nside"),
    [
        ((10.0, 41.0), 1.0, 20_000, 512),
        ((0.0, 90.0), 3.0, 30_000, 256),
        ((359.9, -2.0), 12.0, 30_000, 64),
        ((200.0, -60.0), 60.0, 200_000, 64),
    ],
)
def test_a_piece_of_the_sky_covers_what_it_holds(
    center: tuple[float, float], radius_deg: float, count: int, nside: int, tmp_path: Path
) -> None:
    rng = np.random.default_rng(7)
    store = filled(tmp_path / "piece.mnc", scattered(rng, center, radius_deg, count), nside)
    area = (1 - np.cos(np.radians(radius_deg))) / 2
    assert 0.95 * area < store.sky_share() < area * 1.5
    said = 0
    for x, y, z in scattered(rng, center, min(radius_deg * 1.5, 180), 300).T:
        place = Icrs(float(np.degrees(np.arctan2(y, x)) % 360), float(np.degrees(np.arcsin(z))))
        away = float(np.degrees(np.arccos(np.clip(direction(*center) @ [x, y, z], -1, 1))))
        asked = float(rng.uniform(0, radius_deg / 3))
        covered = store.covers(place, asked)
        said += covered
        if away + asked > radius_deg:
            assert not covered
        grid = np.degrees(largest_pixel_radius_rad(store._coverage.nside))
        if away + asked < radius_deg - 6 * grid:
            assert covered
    assert said > 5
    assert not store.covers(Icrs(*center), 180.0)


@pytest.mark.long
def test_a_whole_sky_is_covered_however_few_stars_it_has(tmp_path: Path) -> None:
    for count, nside in ((3000, 64), (300_000, 128)):
        store = filled(
            tmp_path / "sky.mnc", scattered(np.random.default_rng(3), (0.0, 0.0), 180.0, count), nside
        )
        assert store.sky_share() == 1.0
        assert store.covers(Icrs(12, 34), 5.0)
        assert store.covers(Icrs(12, 34), 180.0)


def test_a_small_piece_knows_its_border(tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    dec = 90.0 - np.degrees(np.sqrt(rng.random(206))) * np.radians(0.2)
    columns = CatalogColumns(
        rng.uniform(0.0, 360.0, 206),
        dec,
        np.zeros(206),
        np.zeros(206),
        rng.uniform(9.0, 16.0, 206),
        error_curve(*((np.full(206, one),) * 2 for one in (50.0, 5.0, 2000.0))),
    )
    pack(columns, tmp_path / "cap.mnc", name="cap", band="V", epoch_yr=2000.0)
    store = PackedStore(tmp_path / "cap.mnc")
    radius_deg = 90.0 - dec.min()
    whole = 0.5 * (1.0 - np.cos(np.radians(radius_deg)))
    assert store.sky_share() == pytest.approx(whole, rel=0.1)
    assert store.covers(Icrs(10.0, 90.0), 0.5 * radius_deg)
    assert not store.covers(Icrs(10.0, 90.0), 1.5 * radius_deg)
    assert not store.covers(Icrs(10.0, 0.0), 0.01)


def test_a_store_goes_by_the_label_it_is_given(tmp_path: Path) -> None:
    columns = CatalogColumns(
        np.array([10.0]),
        np.array([20.0]),
        np.zeros(1),
        np.zeros(1),
        np.array([9.0]),
        error_curve(*((np.full(1, one),) * 2 for one in (50.0, 5.0, 2000.0))),
    )
    pack(columns, tmp_path / "one.mnc", name="UCAC4", band="V", epoch_yr=2000.0)
    store = pickle.loads(pickle.dumps(PackedStore(tmp_path / "one.mnc", "UCAC4 (one)")))
    assert store.name == "UCAC4 (one)"
    assert store.cone(Icrs(10.0, 20.0), 0.1, epoch_yr=2000.0).source == "UCAC4 (one)"


@pytest.mark.parametrize("nside", [1, 8, TABLE_NSIDE])
def test_every_center_is_that_of_the_library(nside: int) -> None:
    numbers = np.arange(12 * nside**2)
    lon, lat = HEALPix(nside=nside, order="nested").healpix_to_lonlat(numbers)
    x, y, z = pixel_centers(nside)
    assert np.allclose(np.arctan2(y, x) % (2 * np.pi), lon.to_value(u.rad), rtol=0, atol=1e-14)
    assert np.allclose(z, np.sin(lat.to_value(u.rad)), rtol=0, atol=1e-15)
    assert np.allclose(x**2 + y**2 + z**2, 1.0, rtol=0, atol=1e-15)


def test_the_table_is_shipped() -> None:
    assert np.array_equal(np.load(module.TABLE_PATH), computed_centers(TABLE_NSIDE))


@pytest.mark.parametrize("content", [None, b"", b"\x93NUMPY\x01\x00v\x00", "other shape"])
def test_without_a_sound_table_the_library_is_asked(
    content: bytes | str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = tmp_path / "table.npy"
    if isinstance(content, bytes):
        table.write_bytes(content)
    elif content:
        np.save(table, np.zeros((3, 12)))
    monkeypatch.setattr(module, "TABLE_PATH", table)
    assert np.array_equal(pixel_centers(TABLE_NSIDE), computed_centers(TABLE_NSIDE))
