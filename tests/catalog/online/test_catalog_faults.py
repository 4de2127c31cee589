"""Servers as they are: each bad mood ends in time, in the right catalog, with words for what happened."""

from __future__ import annotations

import gzip
import socket
import threading
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.online import OnlineCatalog, OnlineSource, fetching, request
from mountnav.catalog.online import catalog as rest
from mountnav.catalog.online.request import NotAnswered, Unusable
from mountnav.errors import StarsUnavailable
from mountnav.sky.coordinates import Icrs
from tests.catalog.online import star_server as moods
from tests.catalog.online.star_server import Answering, Mood, StarServer

CENTER, RADIUS_DEG, EPOCH_YR = Icrs(100.0, 20.0), 0.3, 2026.9
PATIENT_S = 60.0
SHORT_S = 0.7


def online(server: StarServer, cache: Path, *, timeout_s: float = PATIENT_S, **given: Any) -> OnlineCatalog:
    facts: dict[str, Any] = {"table": "I/259", "url": server.url} | given
    return OnlineCatalog(
        OnlineSource("vizier-tycho", timeout_s=timeout_s, **facts), cache, behind=embedded_catalog()
    )


TAP = {"protocol": "tap", "table": "own.stars", "columns": {"ra": "raj2000", "dec": "dej2000"}}
CONE = {"protocol": "cone", "table": ""}


@pytest.mark.long
@pytest.mark.parametrize(
    ("mood", "said", "given"),
    [
        (moods.cut_body, "the connection broke", {}),
        (moods.cut_without_length, "the answer was cut in the middle", {}),
        (moods.cut_gzip, "the answer was cut in the middle", {}),
        (moods.reset, "the connection broke", {}),
        (moods.broken, "HTTP status 500: 500 Internal", {}),
        (moods.no_database, "the server says ERROR: The database is not currently reachable.", {}),
        (moods.tap_error, "the server says ERROR: Field query: No such table: no.such", TAP),
        (moods.tap_error_with_200, "the server says ERROR: Field query: No such table: no.such", TAP),
        (moods.cone_error, "the server says ERROR: DEC parameter out-of-range", CONE),
        (moods.web_page, "its answer is a web page: Please log in to the observatory's network", {}),
        (moods.garbage, "its answer is not a VOTable (application/octet-stream)", {}),
        (moods.nothing, "its answer is not a VOTable", {}),
        (moods.broken_xml, "its VOTable can't be read", {}),
        (moods.entities, "its answer defines XML entities", {}),
        (moods.gzip_bomb, "its answer is larger than 32 MB", {}),
        (moods.odd_packing, "its answer is packed as br", {}),
        (moods.wrong_units, "column RAmdeg is in arcmin / s, which is not in deg", {}),
        (moods.hours, "stars lie outside the circle asked for", {}),
        (moods.sexagesimal, "column RAmdeg holds text", {}),
        (moods.no_positions, "rows have no position", {}),
        (moods.galactic, "positions are in galactic, not ICRS", {}),
        (moods.other_columns, "can't determine the column of mag", {}),
        (moods.empty_table, "an empty answer for 3.4 square degrees", {}),
        (moods.no_table, "an empty answer for 3.4 square degrees", {}),
        (moods.no_table, "it has no stars here", CONE),
        (moods.redirect_loop, "it redirects more than 3 times", {}),
        (moods.redirect_nowhere, "it redirects to what is not an address: http://[elsewhere", {}),
        (moods.redirect_elsewhere, "it redirects to another server, elsewhere.invalid", {}),
    ],
    ids=lambda value: value.__name__ if callable(value) else None,
)
def test_a_bad_answer_is_told_and_the_catalog_behind_is_taken_whole(
    server: StarServer, tmp_path: Path, mood: Mood, said: str, given: dict[str, Any]
) -> None:
    server.mood = mood
    stars = online(server, tmp_path, **given).cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    expected = embedded_catalog().cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert server.asked
    assert stars.source == expected.source
    assert stars.ra_deg.tolist() == expected.ra_deg.tolist()
    [step] = stars.steps
    assert step.startswith("vizier-tycho: ")
    assert said in step
    assert step.endswith(f"; {expected.source} taken instead")


@pytest.mark.long
@pytest.mark.parametrize(
    "mood", [moods.silent, moods.trickling_body, moods.trickling_headers], ids=lambda mood: mood.__name__
)
def test_a_slow_server_holds_nobody(server: StarServer, tmp_path: Path, mood: Mood) -> None:
    online(server, tmp_path / "other").cone(
        CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR
    )  # what is imported is there
    server.mood = mood
    # of an earlier test, waiting for the end of its own time: at most `timeout_s`
    others = set(threading.enumerate())
    catalog = online(server, tmp_path, timeout_s=SHORT_S)
    began = time.monotonic()
    stars = catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert time.monotonic() - began < 10 * SHORT_S
    assert stars.source == embedded_catalog().name
    assert f"no answer within {SHORT_S} s" in stars.steps[0]
    # and what was waiting for it goes away by itself
    until = time.monotonic() + 20.0
    while waiting := [one for one in set(threading.enumerate()) - others if one.name == "stars"]:
        assert time.monotonic() < until, waiting
        time.sleep(0.05)


def test_a_body_is_read_to_the_deadline_only(server: StarServer) -> None:
    server.mood = moods.trickling_body
    url = f"{server.url}/?-c=100%2020&-c.rd=0.1"
    with request.new_client(url, PATIENT_S) as client, pytest.raises(NotAnswered, match="no answer in time"):
        request.get(client, url, end=time.monotonic() + SHORT_S)
    assert not server.over.is_set()


def test_a_bomb_is_not_unpacked_as_a_whole(server: StarServer, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = gzip.compress(b" " * 40_000_000)
    server.mood = lambda answering: answering.send(bomb, packing="gzip")
    monkeypatch.setattr(request, "MOST_BYTES", 1_000_000)
    with request.new_client(server.url, PATIENT_S) as client:
        tracemalloc.start()
        try:
            with pytest.raises(Unusable, match="larger than 1 MB"):
                request.get(client, server.url, end=time.monotonic() + PATIENT_S)
            assert tracemalloc.get_traced_memory()[1] < 10_000_000
        finally:
            tracemalloc.stop()


def test_a_server_that_is_not_there(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
        catalog = OnlineCatalog(
            OnlineSource("gaia", url=url, table="I/355"), tmp_path, behind=embedded_catalog()
        )
        stars = catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert "gaia: can't be reached" in stars.steps[0]


def test_after_a_failure_the_source_rests(server: StarServer, tmp_path: Path) -> None:
    server.mood = moods.broken
    catalog = online(server, tmp_path)
    catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    server.mood = moods.good
    stars = catalog.cone(Icrs(200.0, -40.0), RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert not [path for path in server.asked if "-c=19" in path or "-c=20" in path]
    assert "left alone for another 1" in stars.steps[0]
    assert "since: HTTP status 500" in stars.steps[0]
    # another catalog of the same process that asks the same source knows of it as well
    again = online(server, tmp_path).cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert "left alone" in again.steps[0]
    rest._failures.clear()
    assert catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR).source == "vizier-tycho"


def test_rests_become_longer_and_end_with_an_answer() -> None:
    rests = [rest.failed("key", "why").rest_s for _ in range(5)]
    assert rests == [120.0, 240.0, 480.0, 900.0, 900.0]
    rest.answered("key")
    assert rest.resting("key") is None


def test_without_a_catalog_behind_it_is_an_error(server: StarServer, tmp_path: Path) -> None:
    server.mood = moods.no_database
    catalog = OnlineCatalog(OnlineSource("gaia", url=server.url, table="I/355"), tmp_path, behind=None)
    with pytest.raises(StarsUnavailable, match=r"gaia: the server says ERROR: The database") as raised:
        catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert raised.value.retryable


@pytest.mark.long
@pytest.mark.parametrize("mood", [moods.good, moods.packed, moods.redirected], ids=lambda mood: mood.__name__)
def test_good_moods_are_believed(server: StarServer, tmp_path: Path, mood: Mood) -> None:
    server.mood = mood
    stars = online(server, tmp_path).cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert stars.source == "vizier-tycho"
    assert len(stars) == len(embedded_catalog().cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR))


@pytest.mark.long
@pytest.mark.parametrize("told", [True, False], ids=["told", "silently"])
def test_an_overflow_splits_the_tile(
    server: StarServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, told: bool
) -> None:
    if told:
        server.most_rows = 150
    else:
        # cut at the number of rows that was asked for, without a word
        monkeypatch.setattr(fetching, "MOST_ROWS", 150)
        monkeypatch.setattr(request, "MOST_ROWS", 150)

        def cut(answering: Answering) -> None:
            stars = answering.stars()
            count = min(int(answering.query["-out.max"]), len(stars))
            answering.send(moods.tycho2_votable(stars.only(np.arange(count))))

        server.mood = cut
    catalog = online(server, tmp_path)
    stars = catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    expected = embedded_catalog().cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert sorted(stars.ra_deg.tolist()) == sorted(expected.ra_deg.tolist())
    assert "too full and split" in stars.steps[0]
    count = len(server.asked)
    again = catalog.cone(CENTER, RADIUS_DEG, epoch_yr=EPOCH_YR)
    assert len(server.asked) == count
    assert again.ra_deg.tolist() == stars.ra_deg.tolist()


def test_an_overflow_without_end_is_a_failure(server: StarServer, tmp_path: Path) -> None:
    server.mood = moods.overflow_told_behind
    stars = online(server, tmp_path).cone(CENTER, 0.01, epoch_yr=2000.0)
    assert "the server says OVERFLOW truncated (maxtup=2); " in stars.steps[0]
    assert stars.source == embedded_catalog().name


def test_an_empty_answer_is_not_believed_where_the_sky_is_full(server: StarServer, tmp_path: Path) -> None:
    server.mood = moods.no_table
    catalog = online(server, tmp_path, table="I/355")
    stars = catalog.cone(CENTER, 0.1, epoch_yr=EPOCH_YR, mag_limit=15.0)
    assert "an empty answer for 0.8 square degrees, where there are about" in stars.steps[0]
    assert catalog.cached_tiles().tiles == 0


@pytest.mark.long
def test_what_came_before_a_failure_is_kept(server: StarServer, tmp_path: Path) -> None:
    wide = 2.4
    asked: list[str] = []

    def fails_late(answering: moods.Answering) -> None:
        asked.append(answering.path)
        (moods.good if len(asked) <= 3 else moods.broken)(answering)

    server.mood = fails_late
    catalog = online(server, tmp_path)
    stars = catalog.cone(Icrs(45.0, 41.0), wide, epoch_yr=EPOCH_YR)
    assert stars.source == embedded_catalog().name
    # requests that were under way when one failed end by themselves
    for asking in [thread for thread in threading.enumerate() if thread.name == "stars"]:
        asking.join()
    kept = catalog.cached_tiles().tiles
    assert kept >= 1
    rest._failures.clear()
    server.mood = moods.good
    server.asked.clear()
    stars = catalog.cone(Icrs(45.0, 41.0), wide, epoch_yr=EPOCH_YR)
    assert len(server.asked) <= catalog.cached_tiles().tiles - kept
    assert stars.source == "vizier-tycho"
    assert len(stars) == len(embedded_catalog().cone(Icrs(45.0, 41.0), wide, epoch_yr=EPOCH_YR))
