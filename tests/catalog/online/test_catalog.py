"""The online catalog against the offline one, and its cache: fresh, stale, damaged, shared, prefetched."""

from __future__ import annotations

import json
import multiprocessing
import pickle
import socket
import threading
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.online import OnlineCatalog, OnlineSource, open_online
from mountnav.catalog.online import catalog as rest
from mountnav.catalog.online.tile_cache import TileCache
from mountnav.catalog.packed.packing import CatalogColumns
from mountnav.catalog.stars import StarFlag, Stars
from mountnav.errors import BadRequest
from mountnav.settings.catalogs import OnlineSettings
from mountnav.sky.coordinates import Icrs
from tests.catalog.online import star_server as moods
from tests.catalog.online.star_server import StarServer

TAP = {"protocol": "tap", "table": "own.stars", "columns": {"ra": "raj2000", "dec": "dej2000"}}
CONE = {"protocol": "cone", "table": ""}
KINDS = pytest.mark.parametrize("kind", [{}, TAP, CONE], ids=["vizier", "tap", "cone"])


def online(server: StarServer, cache: Path, **given: Any) -> OnlineCatalog:
    facts: dict[str, Any] = {"table": "I/259", "url": server.url, "timeout_s": 60.0} | given
    return OnlineCatalog(OnlineSource("tycho", **facts), cache, behind=embedded_catalog())


def today() -> str:
    return datetime.now(UTC).date().isoformat()


def in_order(stars: Stars) -> Stars:
    return stars.only(np.lexsort((stars.dec_deg, stars.ra_deg)))


@pytest.mark.long
@KINDS
@pytest.mark.parametrize(
    ("place", "radius_deg"),
    [
        (Icrs(269.452, 4.6934), 0.25),  # Barnard's star, which has moved 280" since the epoch of the tiles
        (Icrs(0.02, -0.01), 0.4),
        (Icrs(217.0, 89.9), 0.5),
        (Icrs(45.0, -90.0), 0.3),
        (Icrs(45.0, 41.8103), 0.5),  # where three tiles meet
        (Icrs(83.8, -5.4), 1.2),
    ],
)
def test_the_same_stars_as_offline(
    server: StarServer, tmp_path: Path, kind: dict[str, object], place: Icrs, radius_deg: float
) -> None:
    catalog = online(server, tmp_path, **kind)
    for mag_limit in (None, 10.0):
        found = catalog.cone(place, radius_deg, epoch_yr=2026.9, mag_limit=mag_limit)
        truth = embedded_catalog().cone(place, radius_deg, epoch_yr=2026.9, mag_limit=mag_limit)
        require_same(found, truth)


def require_same(found: Stars, truth: Stars) -> None:
    assert found.source == "tycho"
    assert len(found) == len(truth) > 0
    assert np.all(np.diff(found.mag) >= 0)
    assert found.band == "V"
    found, truth = in_order(found), in_order(truth)
    mas = 1.0 / 3.6e6
    assert np.allclose(found.dec_deg, truth.dec_deg, rtol=0, atol=0.5 * mas)
    apart_ra = (found.ra_deg - truth.ra_deg + 180.0) % 360.0 - 180.0
    assert np.allclose(apart_ra * np.cos(np.radians(truth.dec_deg)), 0.0, rtol=0, atol=0.5 * mas)
    assert np.allclose(found.mag, truth.mag, rtol=0, atol=0.0011)
    for what in ("pm_ra_cosdec_mas_yr", "pm_dec_mas_yr"):
        assert np.allclose(getattr(found, what), getattr(truth, what), rtol=0, atol=0.11, equal_nan=True)
    # without a proper motion there is a flag for it
    assert ((found.flags & StarFlag.NO_PROPER_MOTION) != 0).tolist() == np.isnan(truth.pm_dec_mas_yr).tolist()


@pytest.mark.long
@KINDS
def test_errors_and_colors_are_those_of_the_answer(
    server: StarServer, tmp_path: Path, kind: dict[str, object]
) -> None:
    place = Icrs(100.0, 20.0)
    found = in_order(online(server, tmp_path, **kind).cone(place, 0.5, epoch_yr=2000.0))
    truth = in_order(embedded_catalog().cone(place, 0.5, epoch_yr=2000.0))
    # at the epoch of the tiles sigma is what the server said, but for the classes of the packed form
    assert np.allclose(found.sigma_arcsec, truth.sigma_arcsec, rtol=0.05)
    if kind:
        assert np.isnan(found.color_mag).all()
    else:
        told = ~np.isnan(found.color_mag)
        assert found.color_name == "B-V"
        assert 0.5 < told.mean() < 1.0
        assert np.allclose(found.color_mag[told], 0.850 * 0.5, atol=0.01)
        assert ((found.flags[~told] & StarFlag.OTHER_BAND) != 0).all()


def test_a_star_that_came_from_another_tile_is_there(server: StarServer, tmp_path: Path) -> None:
    there, epoch_yr = Icrs(78.07376, -45.11465), 2060.0  # Kapteyn's star, 8.7" a year
    found = online(server, tmp_path, **TAP).cone(there, 0.01, epoch_yr=epoch_yr)
    truth = embedded_catalog().cone(there, 0.01, epoch_yr=epoch_yr)
    assert found.source == "tycho"
    assert found.mag.tolist() == truth.mag.tolist() == [8.875]


@pytest.mark.long
def test_tiles_of_several_sizes_give_no_star_twice(server: StarServer, tmp_path: Path) -> None:
    catalog, place = online(server, tmp_path, **TAP), Icrs(100.0, 20.0)
    counts = []
    for radius_deg in (0.02, 0.6, 0.3, 0.1, 0.34):
        found = catalog.cone(place, radius_deg, epoch_yr=2026.9)
        counts.append(len(server.asked))
        truth = embedded_catalog().cone(place, radius_deg, epoch_yr=2026.9)
        assert sorted(found.ra_deg.tolist()) == sorted(truth.ra_deg.tolist())
    # narrow cones lie in the large tiles of the wide one
    assert counts[0] < counts[1] == counts[-1]
    # and that was fetched in large tiles although a part of one was there
    online(server, tmp_path / "fresh", **TAP).cone(place, 0.6, epoch_yr=2026.9)
    assert len(server.asked) - counts[-1] == counts[1] - counts[0]


def test_a_cone_is_asked_for_once(server: StarServer, tmp_path: Path) -> None:
    catalog, place = online(server, tmp_path), Icrs(100.0, 20.0)
    first = catalog.cone(place, 0.3, epoch_yr=2026.9)
    count = len(server.asked)
    assert 1 <= count <= 4
    assert first.steps == (f"tycho: {count} tile{'s' * (count > 1)} fetched from 127.0.0.1",)
    again = online(server, tmp_path).cone(place, 0.2, epoch_yr=2020.0)
    assert len(server.asked) == count
    assert again.steps[0].endswith(f"from the cache of {today()}")
    assert catalog.cached_tiles().tiles == count


def test_who_never_asks_opens_no_socket(
    server: StarServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = Icrs(100.0, 20.0)
    online(server, tmp_path).cone(place, 0.3, epoch_yr=2026.9)

    def no_socket(*_: object, **__: object) -> socket.socket:
        raise AssertionError("a socket was opened")

    monkeypatch.setattr(socket, "socket", no_socket)
    monkeypatch.setattr(socket, "create_connection", no_socket)
    silent = online(server, tmp_path, ask="never")
    assert silent.cone(place, 0.3, epoch_yr=2026.9).source == "tycho"
    elsewhere = silent.cone(Icrs(200.0, -40.0), 0.3, epoch_yr=2026.9)
    assert "tiles are not in the cache, and it is never asked; " in elsewhere.steps[0]
    assert elsewhere.source == embedded_catalog().name


def aged(cache: Path, days: float) -> str:
    """Make all tiles older; the day that they now have."""
    then = datetime.now(UTC) - timedelta(days=days)
    for path in cache.rglob("*.json"):
        record = json.loads(path.read_text())
        path.write_text(json.dumps(record | {"fetched_utc": then.isoformat()}))
    return then.date().isoformat()


@pytest.mark.long
def test_stale_tiles_are_fetched_again_or_taken_as_they_are(server: StarServer, tmp_path: Path) -> None:
    catalog, place = online(server, tmp_path), Icrs(100.0, 20.0)
    truth = catalog.cone(place, 0.3, epoch_yr=2026.9)
    day = aged(tmp_path, 400.0)
    server.mood = moods.no_database
    stars = catalog.cone(place, 0.3, epoch_yr=2026.9)
    assert stars.ra_deg.tolist() == truth.ra_deg.tolist()
    assert stars.steps[0].startswith("tycho: the server says ERROR: The database is not currently reachable")
    assert stars.steps[0].endswith(f"of {day} taken")
    assert " stale tile" in stars.steps[0]
    silent = online(server, tmp_path, ask="never").cone(place, 0.3, epoch_yr=2026.9)
    assert silent.source == "tycho"
    assert "it is never asked" in silent.steps[0]
    rest._failures.clear()
    server.mood = moods.good
    stars = catalog.cone(place, 0.3, epoch_yr=2026.9)
    assert "fetched from 127.0.0.1" in stars.steps[0]
    assert "stale" not in stars.steps[0]
    assert catalog.cached_tiles().oldest == today()


@pytest.mark.long
@pytest.mark.parametrize("suffix", [".mnc", ".json"])
@pytest.mark.parametrize("harm", ["flip", "cut", "empty", "remove"])
def test_damaged_tiles_are_noticed_and_fetched_again(
    server: StarServer, tmp_path: Path, suffix: str, harm: str
) -> None:
    place = Icrs(100.0, 20.0)
    truth = online(server, tmp_path).cone(place, 0.3, epoch_yr=2026.9)
    path = max(tmp_path.rglob(f"*{suffix}"), key=lambda one: one.stat().st_size)
    content = bytearray(path.read_bytes())
    if harm == "flip":
        content[len(content) * 4 // 5] ^= 0x80
    path.unlink()
    if harm != "remove":
        path.write_bytes({"flip": bytes(content), "cut": bytes(content[:-7]), "empty": b""}[harm])
    server.asked.clear()
    stars = online(server, tmp_path).cone(place, 0.3, epoch_yr=2026.9)
    assert stars.ra_deg.tolist() == truth.ra_deg.tolist()
    assert len(server.asked) == 1
    if suffix == ".mnc":
        assert "1 tile in the cache damaged; 1 tile fetched" in stars.steps[0]
    assert len(online(server, tmp_path).cone(place, 0.3, epoch_yr=2026.9)) == len(truth)
    assert len(server.asked) == 1
    # what was damaged is gone
    assert len(list(tmp_path.rglob("*.mnc"))) == online(server, tmp_path).cached_tiles().tiles


def test_an_empty_tile_is_an_answer_where_no_star_is_expected(server: StarServer, tmp_path: Path) -> None:
    server.mood = moods.no_table
    catalog = online(server, tmp_path, table="I/355", mag_limit=2.0)
    for _ in range(2):
        stars = catalog.cone(Icrs(100.0, 20.0), 0.1, epoch_yr=2026.9)
        assert stars.source == embedded_catalog().name
        assert "it has no stars here" in stars.steps[0]
    cached = catalog.cached_tiles()
    assert (cached.stars, cached.tiles) == (0, len(server.asked))


@pytest.mark.parametrize("mood", [moods.no_table, moods.empty_table], ids=lambda mood: mood.__name__)
def test_an_empty_answer_is_not_kept_where_the_sky_has_stars(
    server: StarServer, tmp_path: Path, mood: moods.Mood
) -> None:
    """Four tiles of 3.7 degrees without a star were cached for a year."""
    server.mood = mood
    catalog = online(server, tmp_path)
    stars = catalog.cone(Icrs(100.0, 20.0), 2.0, epoch_yr=2026.9, mag_limit=9.0)
    assert stars.source == embedded_catalog().name
    assert "an empty answer for" in stars.steps[0]
    assert catalog.cached_tiles().tiles == 0


def test_an_empty_answer_of_a_table_of_unknown_extent_is_asked_again_the_next_night(
    server: StarServer, tmp_path: Path
) -> None:
    server.mood = moods.no_table
    catalog = online(server, tmp_path, **CONE)
    place = Icrs(100.0, 20.0)
    assert "it has no stars here" in catalog.cone(place, 0.1, epoch_yr=2026.9).steps[0]
    count = len(server.asked)
    assert "it has no stars here" in catalog.cone(place, 0.1, epoch_yr=2026.9).steps[0]
    assert len(server.asked) == count
    for path in tmp_path.rglob("*.json"):
        record = json.loads(path.read_text())
        assert record["is_doubtful"]
        then = datetime.now(UTC) - timedelta(days=1)
        path.write_text(json.dumps(record | {"fetched_utc": then.isoformat()}))
    server.mood = moods.good
    stars = online(server, tmp_path, **CONE).cone(place, 0.1, epoch_yr=2026.9)
    assert len(server.asked) > count
    assert "fetched" in stars.steps[0]


def test_other_settings_have_other_tiles(server: StarServer, tmp_path: Path) -> None:
    place = Icrs(100.0, 20.0)
    online(server, tmp_path, **TAP).cone(place, 0.2, epoch_yr=2026.9)
    server.asked.clear()
    other = online(server, tmp_path, **(TAP | {"epoch_yr": 1990.0}))
    assert "fetched" in other.cone(place, 0.2, epoch_yr=2026.9).steps[0]
    assert server.asked
    other.clear()
    assert not list(tmp_path.rglob("*.mnc"))


@pytest.mark.long
@pytest.mark.parametrize("limit", [9.0, 10.5])
def test_tiles_have_the_depth_that_is_configured(server: StarServer, tmp_path: Path, limit: float) -> None:
    place = Icrs(100.0, 20.0)
    catalog = online(server, tmp_path, mag_limit=limit)
    assert catalog.faintest_mag == limit
    stars = catalog.cone(place, 0.34, epoch_yr=2026.9)
    truth = embedded_catalog().cone(place, 0.34, epoch_yr=2026.9, mag_limit=limit)
    assert len(stars) == len(truth)
    # deeper settings can't use shallow tiles; shallower ones can use deep tiles
    server.asked.clear()
    deeper = online(server, tmp_path, mag_limit=11.0).cone(place, 0.34, epoch_yr=2026.9)
    assert server.asked
    assert len(deeper) > len(stars)
    server.asked.clear()
    shallow = online(server, tmp_path, mag_limit=limit).cone(place, 0.34, epoch_yr=2026.9, mag_limit=limit)
    assert not server.asked
    assert len(shallow) == len(stars)


def test_wide_cones_are_not_asked_for(server: StarServer, tmp_path: Path) -> None:
    stars = online(server, tmp_path).cone(Icrs(100.0, 20.0), 5.0, epoch_yr=2026.9, mag_limit=8.0)
    assert stars.source == embedded_catalog().name
    assert stars.steps == ("tycho: not asked: a cone of 5.0° is wider than 2.5°; Tycho-2 taken instead",)
    many = online(server, tmp_path, max_radius_deg=10.0, **TAP).cone(Icrs(100.0, 20.0), 5.0, epoch_yr=2026.9)
    assert "not asked: the cone would take" in many.steps[0]
    assert not server.asked


@pytest.mark.parametrize(
    ("place", "radius_deg", "epoch_yr"),
    [(Icrs(np.nan, 0), 1, 2000), (Icrs(0, 91), 1, 2000), (Icrs(0, 0), -1, 2000), (Icrs(0, 0), 1, np.inf)],
)
def test_impossible_cones_are_refused(
    server: StarServer, tmp_path: Path, place: Icrs, radius_deg: float, epoch_yr: float
) -> None:
    with pytest.raises(BadRequest):
        online(server, tmp_path).cone(place, radius_deg, epoch_yr=epoch_yr)
    assert not server.asked


@pytest.mark.long
def test_a_night_is_prefetched_and_then_needs_no_network(server: StarServer, tmp_path: Path) -> None:
    silent = online(server, tmp_path, ask="never", **TAP)
    shares: list[tuple[int, int]] = []
    report = silent.prefetch(Icrs(100.0, 20.0), 1.0, progress=lambda came, all_: shares.append((came, all_)))
    assert report.problem is None
    assert report.tiles == report.fetched == len(server.asked) > 6
    # something is said before the first tile comes, and with each one
    assert shares == [(came, report.tiles) for came in range(report.tiles + 1)]
    again = silent.prefetch(Icrs(100.0, 20.0), 1.0)
    assert (again.tiles, again.fetched) == (report.tiles, 0)
    server.asked.clear()
    for radius_deg in (0.1, 0.3, 0.6, 1.0):
        stars = silent.cone(Icrs(100.0, 20.0), radius_deg, epoch_yr=2026.9)
        assert stars.source == "tycho"
        truth = embedded_catalog().cone(Icrs(100.0, 20.0), radius_deg, epoch_yr=2026.9)
        assert len(stars) == len(truth)
    assert not server.asked
    with pytest.raises(BadRequest):
        silent.prefetch(Icrs(100.0, 20.0), 31.0)


def test_a_prefetch_that_fails_says_why(server: StarServer, tmp_path: Path) -> None:
    server.mood = moods.no_database
    report = online(server, tmp_path).prefetch(Icrs(100.0, 20.0), 1.0)
    assert report.fetched == 0
    assert report.problem is not None
    assert "not currently reachable" in report.problem


@pytest.mark.long
def test_threads_share_it(server: StarServer, tmp_path: Path) -> None:
    catalog, place = online(server, tmp_path), Icrs(100.0, 20.0)
    found: list[list[float]] = []
    threads = [
        threading.Thread(
            target=lambda: found.append(catalog.cone(place, 0.3, epoch_yr=2026.9).ra_deg.tolist())
        )
        for _ in range(6)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    truth = catalog.cone(place, 0.3, epoch_yr=2026.9).ra_deg.tolist()
    assert found == [truth] * 6
    assert len(list(tmp_path.rglob("*.mnc"))) == catalog.cached_tiles().tiles
    assert not [path for path in tmp_path.rglob(".*") if path.is_file()]


@pytest.mark.long
def test_writers_of_one_tile_leave_a_record_with_its_stars(server: StarServer, tmp_path: Path) -> None:
    catalog = online(server, tmp_path)
    catalog.cone(Icrs(100.0, 20.0), 0.1, epoch_yr=2026.9)
    cache = TileCache(tmp_path, catalog.source)
    record = next(cache.records())
    columns = CatalogColumns(
        ra_deg=np.array([100.0, 100.1]),
        dec_deg=np.array([20.0, 20.1]),
        mag=np.array([9.0, 10.0]),
        pm_ra_cosdec_mas_yr=np.zeros(2),
        pm_dec_mas_yr=np.zeros(2),
        error_curve=np.ones((2, 3)),
    )

    def write(minute: int) -> None:
        for second in range(15):
            when = f"2026-11-22T01:{minute:02}:{second:02}+00:00"
            cache.keep(replace(record, fetched_utc=when, stars=2), columns)

    writers = [threading.Thread(target=write, args=(minute,)) for minute in range(6)]
    for writer in writers:
        writer.start()
    # who looks meanwhile sees files come and go
    while any(writer.is_alive() for writer in writers):
        assert cache.size_bytes() > 0
    for writer in writers:
        writer.join()
    last = cache.record(record.tile)
    assert last is not None
    assert [path.name for path in tmp_path.rglob(f"{record.pixel}-*.mnc")] == [last.file]
    assert cache.stars(last) is not None


def _count(sent: bytes, out: multiprocessing.Queue[tuple[int, str]]) -> None:
    stars = pickle.loads(sent).cone(Icrs(100.0, 20.0), 0.3, epoch_yr=2026.9)
    out.put((len(stars), stars.source))


@pytest.mark.long
def test_processes_fetch_the_same_tiles_at_the_same_time(server: StarServer, tmp_path: Path) -> None:
    catalog = online(server, tmp_path)
    context = multiprocessing.get_context("spawn")
    out = context.Queue()
    sent = pickle.dumps(catalog)
    workers = [context.Process(target=_count, args=(sent, out)) for _ in range(2)]
    for worker in workers:
        worker.start()
    answers = [out.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join()
    assert answers == [answers[0]] * 2
    assert answers[0][1] == "tycho"
    assert catalog.cone(Icrs(100.0, 20.0), 0.3, epoch_yr=2026.9).steps[0].endswith(f"of {today()}")


def test_a_cache_that_cannot_be_written_is_told(server: StarServer, tmp_path: Path) -> None:
    in_the_way = tmp_path / "file"
    in_the_way.write_text("")
    stars = online(server, in_the_way).cone(Icrs(100.0, 20.0), 0.3, epoch_yr=2026.9)
    assert stars.source == embedded_catalog().name
    assert "the cache can't be written" in stars.steps[0]


def test_settings_open_it(server: StarServer, tmp_path: Path) -> None:
    settings = OnlineSettings(name="tycho", url=server.url, table="I/259", timeout_s=30.0)
    catalog = open_online(settings.source(), behind=embedded_catalog(), cache=tmp_path)
    assert catalog.name == "tycho"
    assert len(catalog.cone(Icrs(100.0, 20.0), 0.3, epoch_yr=2026.9)) > 0
    defaults = open_online(OnlineSettings(name="gaia", table="I/355").source(), behind=None, cache=tmp_path)
    assert defaults.source.host == "vizier.cds.unistra.fr"
    assert defaults.faintest_mag == 21.5
