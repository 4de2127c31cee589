"""The folder of imported catalogs: what is there by name, what is damaged, what goes."""

from __future__ import annotations

import fcntl
from pathlib import Path

import numpy as np
import pytest

from mountnav.catalog.installed import (
    catalog_path,
    catalogs_folder,
    find_installed,
    installed,
    remove,
    unfinished,
    unfinished_path,
)
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.errors import BadRequest, BadSettings, Busy, NotFound
from mountnav.sky.coordinates import Icrs


def put(folder: Path, slug: str, count: int = 50) -> Path:
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(count)
    sigma = np.full(count, 20.0)
    columns = CatalogColumns(
        rng.uniform(0, 360, count),
        rng.uniform(-90, 90, count),
        np.zeros(count),
        np.zeros(count),
        rng.uniform(8, 12, count),
        error_curve((sigma, sigma), (sigma, sigma), (100 * sigma, 100 * sigma)),
    )
    path = folder / f"{slug}.mnc"
    pack(columns, path, name=slug.upper(), band="V", epoch_yr=2000.0, nside=2)
    return path


def test_the_folder_is_the_configured_one_then_the_environments(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOUNTNAV_CATALOGS", str(tmp_path / "told"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    assert catalogs_folder(tmp_path / "configured") == tmp_path / "configured"
    assert catalogs_folder() == tmp_path / "told"
    monkeypatch.delenv("MOUNTNAV_CATALOGS")
    assert catalogs_folder() == tmp_path / "data" / "mountnav" / "catalogs"
    monkeypatch.setenv("XDG_DATA_HOME", "")
    assert catalogs_folder() == tmp_path / "home" / ".local" / "share" / "mountnav" / "catalogs"


def test_a_folder_that_isnt_there_holds_none(tmp_path: Path) -> None:
    assert installed(tmp_path / "none") == []
    assert unfinished(tmp_path / "none") == []
    assert not (tmp_path / "none").exists()


def test_all_are_opened_in_the_order_of_their_names(tmp_path: Path) -> None:
    put(tmp_path, "beta", 30)
    put(tmp_path, "alpha", 40)
    (tmp_path / "readme.txt").write_text("no catalog")
    (tmp_path / ".hidden.mnc").write_text("no catalog")
    found = installed(tmp_path)
    assert [one.slug for one in found] == ["alpha", "beta"]
    assert [len(one.store) for one in found if one.store is not None] == [40, 30]
    assert [one.problem for one in found] == [None, None]


@pytest.mark.parametrize("cut", [0, 10, 100, 1000, -1])
def test_a_damaged_one_is_listed_with_its_problem_and_the_others_stay_usable(
    tmp_path: Path, cut: int
) -> None:
    path = put(tmp_path, "bad")
    path.write_bytes(path.read_bytes()[:cut])
    put(tmp_path, "good")
    bad, good = installed(tmp_path)
    assert bad.store is None
    assert bad.problem is not None
    assert "at byte" in bad.problem
    assert good.store is not None
    assert find_installed(tmp_path, "bad").problem == bad.problem


def test_a_file_of_no_possible_name_and_a_dangling_link_are_told(tmp_path: Path) -> None:
    put(tmp_path, "Big Catalog")
    put(tmp_path, "tycho2")
    (tmp_path / "gone.mnc").symlink_to(tmp_path / "nowhere")
    (tmp_path / "folder.mnc").mkdir()
    problems = {one.slug: one.problem for one in installed(tmp_path)}
    assert all(one.store is None for one in installed(tmp_path))
    assert "can't be a catalog's name" in str(problems["Big Catalog"])
    assert "embedded catalog" in str(problems["tycho2"])
    assert "can't be opened" in str(problems["gone"])
    assert "can't be opened" in str(problems["folder"])


def test_a_link_to_another_disk_is_as_good_as_a_file(tmp_path: Path) -> None:
    path = put(tmp_path / "big", "far")
    (tmp_path / "near.mnc").symlink_to(path)
    assert len(find_installed(tmp_path, "near").store or ()) == 50
    assert remove(tmp_path, "near") < 1000
    assert path.exists()


def test_who_asks_for_none_hears_which_there_are(tmp_path: Path) -> None:
    put(tmp_path, "alpha")
    with pytest.raises(NotFound, match=r"no catalog 'beta'.*there are: tycho2, alpha"):
        find_installed(tmp_path, "beta")


def test_nothing_outside_the_folder_is_meant_by_a_name(tmp_path: Path) -> None:
    inside, outside = tmp_path / "inside", put(tmp_path, "alpha")
    unfinished_path(tmp_path, "alpha").mkdir()
    unfinished_path(inside, "alpha").mkdir(parents=True)
    with pytest.raises(NotFound, match=r"no catalog '\.\./alpha'"):
        remove(inside, "../alpha")
    assert outside.exists()
    assert unfinished_path(tmp_path, "alpha").exists()


@pytest.mark.parametrize(
    "slug", ["", "tycho2", "Upper", "a/b", "../up", ".hidden", "a b", "-option", "x" * 41, "näme", "a\n"]
)
def test_what_cant_be_a_name_is_refused(tmp_path: Path, slug: str) -> None:
    with pytest.raises(BadRequest):
        catalog_path(tmp_path, slug)


@pytest.mark.parametrize("slug", ["ucac4", "gaia-g17_north", "0", "x" * 40])
def test_what_can_be_a_name_is_taken(tmp_path: Path, slug: str) -> None:
    assert catalog_path(tmp_path, slug) == tmp_path / f"{slug}.mnc"


def test_removing_takes_the_file_and_what_an_import_left(tmp_path: Path) -> None:
    size = put(tmp_path, "alpha").stat().st_size
    left = unfinished_path(tmp_path, "alpha")
    (left / "spool").mkdir(parents=True)
    (left / "spool" / "part").write_bytes(bytes(1000))
    assert unfinished(tmp_path) == ["alpha"]
    assert remove(tmp_path, "alpha") >= size + 1000
    assert list(tmp_path.iterdir()) == []


def test_colors_beside_a_file_go_with_it(tmp_path: Path) -> None:
    put(tmp_path, "alpha")
    (tmp_path / "alpha.colors").write_bytes(b"colors")
    remove(tmp_path, "alpha")
    assert list(tmp_path.iterdir()) == []


def test_what_is_left_of_an_import_alone_goes_too(tmp_path: Path) -> None:
    unfinished_path(tmp_path, "alpha").mkdir()
    remove(tmp_path, "alpha")
    assert list(tmp_path.iterdir()) == []


def test_an_import_that_is_going_on_is_not_swept_away(tmp_path: Path) -> None:
    path = put(tmp_path, "alpha")
    left = unfinished_path(tmp_path, "alpha")
    left.mkdir()
    with (left / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(Busy, match="going on"):
            remove(tmp_path, "alpha")
    assert path.exists()
    assert left.exists()


def test_the_embedded_one_stays(tmp_path: Path) -> None:
    with pytest.raises(BadRequest, match="embedded"):
        remove(tmp_path, "tycho2")


def test_a_process_that_has_it_open_keeps_its_stars(tmp_path: Path) -> None:
    put(tmp_path, "alpha")
    store = find_installed(tmp_path, "alpha").store
    assert store is not None
    remove(tmp_path, "alpha")
    assert len(store.cone(Icrs(0.0, 90.0), 180.0, epoch_yr=2026.9)) == 50


def test_a_file_where_the_folder_should_be_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(BadSettings, match="can't be read"):
        installed(tmp_path / "file")
