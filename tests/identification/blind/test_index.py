"""The index of a small made-up sky: what is built is found again by shape and by place; the file's life."""

import json
import multiprocessing
import os
import pickle
import resource
import signal
import threading
import tracemalloc
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.catalog.space_motion import unit_vectors
from mountnav.errors import BadSettings
from mountnav.identification.blind import building
from mountnav.identification.blind.building import EPOCH_YR, build, make_levels
from mountnav.identification.blind.cache import cached_index, index_path, installed_index
from mountnav.identification.blind.file_format import Header, decode_header, encode_header
from mountnav.identification.blind.index import BlindIndex, Grid, densities
from mountnav.identification.blind.indexed_stars import CatalogRows, IndexedStars
from mountnav.identification.blind.quads import codes, flattened
from mountnav.identification.selection import rank_in_cell
from mountnav.sky.coordinates import Icrs

STARS = 6000


def made_up_catalog(path, seed=1, stars=STARS):
    rng = np.random.default_rng(seed)
    sigma = np.full(stars, 10.0)
    columns = CatalogColumns(
        ra_deg=rng.uniform(0, 360, stars),
        dec_deg=np.degrees(np.arcsin(rng.uniform(-1, 1, stars))),
        pm_ra_cosdec_mas_yr=rng.normal(0, 100, stars),
        pm_dec_mas_yr=rng.normal(0, 100, stars),
        mag=rng.uniform(2, 12, stars),
        error_curve=error_curve((sigma, sigma), (0.1 * sigma, 0.1 * sigma), (200 * sigma, 200 * sigma)),
    )
    columns.pm_dec_mas_yr[:3] = 8000.0, np.nan, -5000.0  # beyond what a record holds, and none
    columns.pm_ra_cosdec_mas_yr[1] = np.nan
    pack(columns, path, name="made up", band="V", epoch_yr=2000.0, nside=8)
    return PackedStore(path)


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    return made_up_catalog(tmp_path_factory.mktemp("blind") / "made_up.mnc")


@pytest.fixture(scope="module")
def index(store, tmp_path_factory):
    path = tmp_path_factory.mktemp("blind") / "made_up.mnq"
    build(store, path)
    return BlindIndex.open(path)


def test_rows_are_the_stars_the_catalog_gives(store):
    rows = CatalogRows(store.path)
    vectors = rows.vectors(np.arange(len(rows)), epoch_yr=2026.0)
    every = store.cone(Icrs(0.0, 0.0), 180.0, epoch_yr=2026.0)
    there = unit_vectors(every.ra_deg, every.dec_deg).T
    order, other = np.lexsort(vectors.T), np.lexsort(there.T)
    np.testing.assert_allclose(vectors[order], there[other], atol=1e-14)
    np.testing.assert_allclose(rows.magnitudes(np.arange(len(rows)))[order], every.mag[other])


def test_a_level_holds_the_brightest_of_each_cell(store):
    rows = CatalogRows(store.path)
    vectors, mag = rows.vectors(np.arange(STARS), epoch_yr=EPOCH_YR), rows.magnitudes(np.arange(STARS))
    levels = make_levels(vectors, mag, 13)
    assert [level.density_deg2 for level in levels] == [density for _, _, density in densities(13)]
    assert levels[0].rows.size == STARS  # far below the finest density: all are in
    assert levels[0].whole.all()
    for level in levels:
        assert len(set(level.rows.tolist())) == level.rows.size
        assert level.rows.size <= level.density_deg2 * 41253 + 1
    coarse = levels[-1]
    assert not coarse.whole.any()
    assert coarse.rows.size > 0.9 * coarse.density_deg2 * 41253
    assert mag[coarse.rows].mean() < mag.mean() - 3


def test_neighbors_that_look_like_one_count_once():
    spot = unit_vectors(np.array([10.0, 10.0, 50.0]), np.array([20.0, 20.0005, 20.0])).T
    (level,) = make_levels(spot, np.array([9.0, 8.0, 7.0]), 1)
    assert sorted(level.rows.tolist()) == [1, 2]


@pytest.mark.long
def test_what_was_built_is_found_by_its_shape(store, index):
    rng = np.random.default_rng(2)
    quad = rng.choice(len(index), 500, replace=False)
    vectors = CatalogRows(store.path).vectors(index.rows(index.stars(quad)).ravel(), epoch_yr=EPOCH_YR)
    code, _ = codes(flattened(vectors.reshape(-1, 4, 3)))
    asked, found = index.alike(code + rng.uniform(-4e-3, 4e-3, code.shape), np.full(len(quad), 4.1e-3))
    got = set(zip(asked.tolist(), quad[asked].tolist(), strict=True)) & set(
        zip(asked.tolist(), found.tolist(), strict=True)
    )
    assert len(got) == len(quad)


@pytest.fixture(scope="module")
def every_code(store, index):
    """The code of each quad, worked out of its stars' places."""
    stars = index.stars(np.arange(len(index)))
    vectors = CatalogRows(store.path).vectors(index.rows(stars).ravel(), epoch_yr=EPOCH_YR)
    return codes(flattened(vectors.reshape(-1, 4, 3)))[0]


@pytest.mark.long
@given(st.integers(0, 2**32 - 1), st.floats(1e-4, 1e-2))
@settings(max_examples=5, deadline=None)
def test_questions_are_answered_as_by_trying_every_quad(every_code, index, seed, tolerance):
    rng = np.random.default_rng(seed)
    code, _ = codes(rng.uniform(-1, 1, (60, 4)) + 1j * rng.uniform(-1, 1, (60, 4)))
    asked, found = index.alike(code, np.full(len(code), tolerance))
    got = set(zip(asked.tolist(), found.tolist(), strict=True))
    assert len(got) == asked.size
    # one of the four numbers after the other: all at once would be four times as much memory
    off = np.zeros((len(code), len(every_code)))
    for k in range(4):
        np.maximum(off, np.abs(every_code[None, :, k] - code[:, None, k]), out=off)
    assert got >= set(zip(*(np.nonzero(off < tolerance - 1e-4)), strict=True))
    assert got <= set(zip(*(np.nonzero(off < tolerance + 2e-4)), strict=True))


@pytest.mark.long
def test_corners_are_named_in_the_order_of_the_code(store, index):
    stars = index.stars(np.arange(0, len(index), 37))
    vectors = CatalogRows(store.path).vectors(index.rows(stars).ravel(), epoch_yr=EPOCH_YR).reshape(-1, 4, 3)
    _, order = codes(flattened(vectors))
    assert (order == np.arange(4)).all(axis=1).mean() > 0.999


@pytest.mark.long
def test_no_four_stars_are_held_twice_and_all_are_of_one_level(index):
    stars = index.stars(np.arange(len(index)))
    level = index.level(stars)
    assert (level == level[:, :1]).all()
    rows = np.sort(index.rows(stars), axis=1)
    assert (np.diff(rows, axis=1) > 0).all()
    assert len(np.unique(rows, axis=0)) == len(index)


@pytest.mark.long
def test_poor_places_have_more_quads_for_a_star(index):
    # in this sky every level of the finest four holds the whole catalog
    assert len(index) > 0.75 * len(building.MORE) * STARS


@given(st.floats(0, 360, exclude_max=True), st.floats(-90, 90), st.floats(0.1, 60), st.integers(0, 12))
@settings(max_examples=60, deadline=None)
def test_stars_round_a_place_are_all_there(store, index, ra, dec, radius, level):
    place = (np.array([ra, (ra + 180) % 360]), np.array([dec, -dec]), np.array([radius, radius]))
    circle, star = index.around(level, *place)
    assert len(set(zip(circle.tolist(), star.tolist(), strict=True))) == star.size
    first, end = index.first_star[level], index.first_star[level + 1]
    vectors = CatalogRows(store.path).vectors(index.rows(np.arange(first, end)), epoch_yr=EPOCH_YR)
    for number in range(2):
        axis = unit_vectors(place[0][number], place[1][number])
        inside = first + np.flatnonzero(vectors @ axis > np.cos(np.radians(radius)))
        assert set(inside.tolist()) <= set(star[circle == number].tolist())


@given(st.floats(0.005, 50))
@settings(max_examples=20)
def test_cells_of_a_grid_are_of_like_size(density):
    grid = Grid.of(density)
    rng = np.random.default_rng(5)
    ra, dec = rng.uniform(0, 360, 2000), np.degrees(np.arcsin(rng.uniform(-1, 1, 2000)))
    cell = grid.cell(ra, dec)
    assert cell.min() >= 0
    assert cell.max() < grid.cells
    assert grid.cell(np.array([0.0, 359.999999]), np.array([90.0, -90.0])).tolist() == [
        grid.first_cell[-2],
        grid.first_cell[1] - 1,
    ]
    assert rank_in_cell(cell).max() < 12 + 12 * 2000 / grid.cells


@pytest.mark.long
def test_two_builds_are_the_same_bytes(store, index, tmp_path):
    shares: list[float] = []
    build(store, tmp_path / "again.mnq", progress=shares.append)
    assert (tmp_path / "again.mnq").read_bytes() == index.path.read_bytes()
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    assert list(tmp_path.iterdir()) == [tmp_path / "again.mnq"]


@pytest.mark.long
def test_memory_grows_with_the_stars_and_not_with_their_quads(tmp_path):
    # what the tables cost, however few stars there are, cancels out
    peaks, quads = [], []
    for stars in (6_000, 18_000):
        catalog = made_up_catalog(tmp_path / f"{stars}.mnc", stars=stars)
        tracemalloc.start()
        try:
            quads.append(build(catalog, tmp_path / f"{stars}.mnq").quads)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    # held in memory, each would take 20 bytes, and as much again for its key and its place in the order
    assert peaks[1] - peaks[0] < 20 * (quads[1] - quads[0])


@pytest.mark.long
def test_a_killed_builder_leaves_only_what_the_next_one_removes(store, tmp_path):
    child = multiprocessing.get_context("spawn").Process(
        target=killed_while_it_builds, args=(store.path, tmp_path)
    )
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert [one.suffix for one in tmp_path.iterdir()] in ([], [".part"])


def killed_while_it_builds(catalog, folder):
    def kill(share):
        if share > 0.85:
            os.kill(os.getpid(), signal.SIGKILL)

    build(PackedStore(catalog), folder / "index.mnq", progress=kill)


def test_a_full_disk_is_told_and_leaves_nothing(store, tmp_path, monkeypatch):
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path))
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(
        resource.RLIMIT_FSIZE, (20_000, hard)
    )  # a write beyond it fails like one to a full disk
    try:
        with pytest.raises(BadSettings, match="can't be written: File too large") as caught:
            cached_index(store)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert "free 300 MB" in str(caught.value)
    assert [one.suffix for one in tmp_path.iterdir()] == [".lock"]


@pytest.mark.long
def test_an_index_goes_to_another_process_as_its_path(index):
    sent = pickle.dumps(index)
    assert len(sent) < 500
    code = np.array([[0.2, 0.3, 0.5, -0.2], [0.1, 0.5, 0.6, 0.1]])
    expected = index.alike(code, np.full(2, 9e-3))
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        got = pool.apply(asked_elsewhere, (sent, code))
    for one, other in zip(got, expected, strict=True):
        np.testing.assert_array_equal(one, other)


def asked_elsewhere(sent, code):
    return pickle.loads(sent).alike(code, np.full(len(code), 9e-3))


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda whole: b"", "no index"),
        (lambda whole: b"MNAVSTAR" + whole[8:], "no index"),
        (lambda whole: whole[:8] + b"\x63" + whole[9:], "version 99"),
        (lambda whole: whole[:200], "cut short"),
        (lambda whole: whole[:-4096], "bytes long"),
        (lambda whole: whole + b"\0", "bytes long"),
        (lambda whole: whole.replace(b'"quads"', b'"quabs"', 1), "damaged"),
        (lambda whole: whole.replace(b'"level_stars": [6000', b'"level_stars": [-600', 1), "damaged"),
    ],
)
def test_a_damaged_file_is_told_from_an_index(index, tmp_path, spoil, told):
    path = tmp_path / "spoiled.mnq"
    path.write_bytes(spoil(index.path.read_bytes()))
    with pytest.raises(BadSettings, match=told) as caught:
        BlindIndex.open(path)
    assert "catalog index --force" in str(caught.value)


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(BadSettings, match="can't be opened"):
        BlindIndex.open(tmp_path / "none.mnq")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_the_cache_lies_where_the_user_says(store, monkeypatch, tmp_path):
    monkeypatch.setenv("MOUNTNAV_CACHE", "/one")
    monkeypatch.setenv("XDG_CACHE_HOME", "/two")
    name = index_path(store).name
    assert index_path(store).parent.as_posix() == "/one"
    monkeypatch.delenv("MOUNTNAV_CACHE")
    assert index_path(store).parent.as_posix() == "/two/mountnav"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/someone")
    assert index_path(store).parent.as_posix() == "/home/someone/.cache/mountnav"
    other = made_up_catalog(tmp_path / "other.mnc", seed=2)
    assert index_path(other).name != name


@pytest.mark.long
def test_it_is_built_once_and_damage_is_mended(store, index, cache):
    told: list[Any] = []
    first = cached_index(store, progress=told.append)
    assert told
    assert first.path == index_path(store)
    assert first.path.read_bytes() == index.path.read_bytes()
    told.clear()
    cached_index(store, progress=told.append)
    assert not told
    cached_index(store, progress=told.append, force=True)
    assert told
    told.clear()
    first.path.write_bytes(first.path.read_bytes()[:5000])
    assert len(cached_index(store, progress=told.append)) == len(index)
    assert told


@pytest.mark.long
def test_what_a_killed_builder_left_behind_is_removed(store, index, cache):
    cache.mkdir()
    left = index_path(store).with_name(f"{index_path(store).name}.4711.part")
    left.write_bytes(b"half of it")
    cached_index(store)
    assert sorted(one.suffix for one in cache.iterdir()) == [".lock", ".mnq"]


@pytest.mark.long
def test_an_index_of_other_stars_under_the_name_is_built_anew(store, index, cache):
    cache.mkdir()
    own, other = store.header.sections_sha256.encode(), b"0" * 64
    index_path(store).write_bytes(index.path.read_bytes().replace(own, other, 1))
    assert installed_index(store) is None
    assert cached_index(store).header.catalog_sha256 == store.header.sections_sha256
    assert installed_index(store) is not None


@pytest.mark.parametrize("section", ["cells", "quads", "rows", "grid"])
def test_damage_within_is_told_when_it_is_come_upon(store, index, tmp_path, section):
    whole = bytearray(index.path.read_bytes())
    at, length = index.header.layout()[section]
    at += len(whole) - index.header.layout()["end"][0]
    noise = np.random.default_rng(4).integers(0, 256, length - 8, dtype=np.uint8)
    whole[at + 4 : at + 4 + noise.size] = noise.tobytes()
    if section == "cells":
        whole[at : at + 4] = bytes(4)
    (tmp_path / "spoiled.mnq").write_bytes(whole)
    sky = IndexedStars(BlindIndex.open(tmp_path / "spoiled.mnq"), store, 2026.0)
    asked_all(IndexedStars(index, store, 2026.0))
    with pytest.raises(BadSettings, match="damaged") as caught:
        asked_all(sky)
    assert "catalog index --force" in str(caught.value)


def asked_all(sky):
    rng = np.random.default_rng(6)
    code, _ = codes(rng.uniform(-1, 1, (200, 4)) + 1j * rng.uniform(-1, 1, (200, 4)))
    _, quad = sky.index.alike(code, np.full(len(code), 5e-3))
    assert sky.vectors(sky.index.stars(quad)).shape == (quad.size, 4, 3)
    axis = unit_vectors(np.array([10.0, 200.0]), np.array([30.0, -60.0])).T
    sky.around(0, axis, np.array([0.3, 0.3]))


@pytest.mark.long
def test_of_several_that_need_it_one_builds(store, cache):
    told: list[list[Any]] = [[], [], []]
    threads = [
        threading.Thread(target=cached_index, args=(store,), kwargs={"progress": one.append}) for one in told
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(bool(one) for one in told) == 1
    assert BlindIndex.open(index_path(store)).header.catalog == "made up"


def test_a_cache_that_cant_be_written_is_told(store, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path / "file"))
    with pytest.raises(BadSettings, match="can't be written") as caught:
        cached_index(store)
    assert "MOUNTNAV_CACHE" in str(caught.value)


def test_the_header_says_what_it_is_of(store, index):
    header = index.header
    assert header.catalog_sha256 == store.header.sections_sha256
    assert header.epoch_yr == EPOCH_YR
    assert header.quads == len(index)
    assert index.name == "quads of made up"
    assert json.loads(json.dumps(header.level_stars)) == [
        int(b - a) for a, b in zip(index.first_star, index.first_star[1:], strict=False)
    ]


def test_close_stars_make_quads_by_the_ranks_of_distance(store, index):
    """The finest level once more, by brute force: each star with its nearest, by the ranks in `MORE`."""
    stars = index.stars(np.arange(len(index)))
    fine = stars[index.level(stars[:, 0]) == 0]
    held = set(map(tuple, np.sort(fine, axis=1).tolist()))
    count = int(index.first_star[1])
    vectors = CatalogRows(store.path).vectors(index.rows(np.arange(count)), epoch_yr=EPOCH_YR)
    for star in range(0, count, 400):
        nearest = np.argsort(-(vectors @ vectors[star]))[:7].tolist()
        near = [star, *(one for one in nearest if one != star)]
        wanted = {tuple(sorted(near[k] for k in (0, *kind))) for kind in building.MORE}
        assert wanted <= held


@pytest.mark.parametrize("epoch_yr", [float("nan"), float("inf"), 1e9, 10**400, -1.0])
def test_an_index_of_an_impossible_year_is_damaged(epoch_yr):
    head = encode_header(Header("c", "0" * 64, epoch_yr, 10, [10], [10]))
    with pytest.raises(BadSettings, match=r"index\.file.*damaged"):
        decode_header(head, file="index.file")
