"""`mountnav catalog` and the network: an area is fetched, listed, read from the cache; a local server."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from api.cli.app import app
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.online import catalog
from mountnav.errors import BadRequest, NotFound
from mountnav.sky.coordinates import Icrs
from tests.catalog.online import star_server as moods
from tests.catalog.online.star_server import StarServer, star_server

AREA = ("--ra", "100", "--dec", "20", "--radius", "0.5")


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[StarServer]:
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("MOUNTNAV_CATALOGS", str(tmp_path / "catalogs"))
    catalog._failures.clear()
    with star_server() as started:
        yield started
    catalog._failures.clear()


@pytest.fixture
def config(server: StarServer, tmp_path: Path) -> Path:
    path = tmp_path / "observatory.toml"
    path.write_text(
        f'[[catalogs.online]]\nname = "tycho-live"\nurl = "{server.url}"\ntable = "I/259"\ntimeout_s = 60\n'
    )
    return path


def _ask(*arguments: str | Path) -> Result:
    done = CliRunner().invoke(app, ["catalog", *map(str, arguments)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


@pytest.mark.long
def test_an_area_is_fetched_once_and_then_needs_no_network(server: StarServer, config: Path) -> None:
    done = _ask("fetch", "tycho-live", "--config", config, *AREA, "--json")
    assert done.exit_code == 0
    facts = json.loads(done.stdout)
    assert facts["tiles"] == facts["fetched"] == len(server.asked) > 0
    assert facts["problem"] is None
    assert facts["cached_stars"] > 50
    server.asked.clear()
    done = _ask("fetch", "tycho-live", "--config", config, *AREA)
    assert done.stdout.startswith("tycho-live: 0 tiles came, the area has ")
    cone = _ask("cone", "--catalog", "tycho-live", "--config", config, *AREA, "--epoch", "2026.9")
    stars = embedded_catalog().cone(Icrs(100.0, 20.0), 0.5, epoch_yr=2026.9)
    assert cone.stdout.splitlines()[0].startswith(f"# {len(stars)} stars of tycho-live, ")
    assert cone.stdout.splitlines()[1].startswith("# tycho-live: ")
    assert server.asked == []
    (row,) = [
        one
        for one in map(json.loads, _ask("list", "--config", config, "--json").stdout.splitlines())
        if one["state"] == "online"
    ]
    assert row["cached_stars"] == facts["cached_stars"]
    assert "stars in the cache" in _ask("list", "--config", config).stdout


def test_what_doesnt_come_is_told_with_code_1(server: StarServer, config: Path) -> None:
    server.mood = moods.no_database
    done = _ask("fetch", "tycho-live", "--config", config, *AREA)
    assert done.exit_code == 1
    assert "not all of it: " in done.stdout
    assert "not currently reachable" in done.stdout


def test_listing_asks_no_server(server: StarServer, config: Path) -> None:
    assert _ask("list", "--config", config).exit_code == 0
    assert server.asked == []


@pytest.mark.long
def test_no_such_online_catalog_and_areas_too_large(config: Path, tmp_path: Path) -> None:
    with pytest.raises(NotFound, match="there are: tycho-live"):
        _ask("fetch", "gaia-live", "--config", config, *AREA)
    with pytest.raises(BadRequest, match="mountnav catalog import"):
        _ask("fetch", "tycho-live", "--config", config, "--ra", "1", "--dec", "1", "--radius", "31")
    empty = tmp_path / "empty.toml"
    empty.write_text("")
    with pytest.raises(NotFound, match=r"add a \[\[catalogs.online\]\] table"):
        _ask("fetch", "tycho-live", "--config", empty, *AREA)
