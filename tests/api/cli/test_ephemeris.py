"""`mountnav ephemeris` as people and scripts use it: import, list, show, forget."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from api.cli.app import app
from mountnav.ephemeris.imported import use_imports
from mountnav.errors import BadRequest, BadSettings, NotFound
from mountnav.sky.kernel import use_kernels
from tests.ephemeris.samples import CERES_2025, ISS, PALLAS_2024
from tests.ephemeris.test_tables import horizons

HERE = ("--site", "47", "11", "600")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("MOUNTNAV_EPHEMERIDES", str(tmp_path / "ephemerides"))
    yield tmp_path / "ephemerides"
    monkeypatch.undo()
    use_imports()
    use_kernels(())


def run(*arguments: str | Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["ephemeris", *map(str, arguments)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.output


@pytest.mark.long
def test_import_list_show_forget(tmp_path: Path) -> None:
    catalog = tmp_path / "MPCORB.DAT"
    catalog.write_text(f"{CERES_2025}\n{PALLAS_2024}\n")
    assert run("import", catalog) == (0, "mpcorb: 2 objects\n")
    _, listed = run("list")
    assert "de440 (shipped)" in listed
    assert "2015-01-01 to 2055-01-01" in listed
    assert "MPCORB.DAT" in listed
    code, shown = run("show", "Ceres", *HERE, "--at", "2026-11-26T20:00", "--hours", "6", "--step-min", "120")
    assert code == 0
    assert "# 1 Ceres, from 47.0000, 11.0000, 600 m" in shown
    assert shown.count("2026-11-26T2") == 2 + shown.count("at 2026-11-26T2")
    assert run("forget", "mpcorb") == (0, "mpcorb is gone (2 objects)\n")
    with pytest.raises(NotFound):
        run("forget", "mpcorb")
    with pytest.raises(BadRequest, match="nothing here is called 'Ceres'"):
        run("show", "Ceres", *HERE)


@pytest.mark.long
def test_show_for_programs() -> None:
    code, out = run("show", "Mars", *HERE, "--at", "2026-11-26T20:00", "--step-min", "60", "--json")
    rows = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    places, events = [row for row in rows if "ra_deg" in row], [row for row in rows if "event" in row]
    assert len(places) == 13
    assert places[0]["sigma_arcsec"] < 0.1
    assert 0.01 < places[0]["rate_arcsec_s"] < 0.03
    assert [one["event"] for one in events] == ["rises", "meridian"]


@pytest.mark.long
def test_show_of_files(tmp_path: Path) -> None:
    station = tmp_path / "station.tle"
    station.write_text(ISS)
    code, out = run("show", station, *HERE, "--at", "2024-06-18T12:00", "--hours", "1")
    assert code == 0
    assert "# ISS (ZARYA)" in out
    table = tmp_path / "mars.txt"
    table.write_text(horizons(csv=False, degrees=False, apparent=False, center="geocenter"))
    code, out = run("show", table, *HERE, "--at", "2026-03-01T00:00", "--hours", "12", "--step-min", "60")
    assert code == 0
    # nine rows are there: what lies beyond them is told, not made up
    assert "# 4 lines are missing: Mars (499) ends at 2026-03-01 08:00:00 UTC" in out
    with pytest.raises(BadRequest, match="its elements are of 2024-06-18"):
        run("show", station, *HERE, "--at", "2026-03-01T00:00")


@pytest.mark.long
def test_the_site_comes_from_the_settings(tmp_path: Path, folder: Path) -> None:
    settings = tmp_path / "observatory.toml"
    settings.write_text(
        f'[site]\nlatitude_deg = -30.0\nlongitude_deg = 20.0\n[ephemerides]\nfolder = "{folder}/other"\n'
    )
    (tmp_path / "a.dat").write_text(CERES_2025)
    run("import", tmp_path / "a.dat", "--config", settings)
    assert (folder / "other" / "a.mne").is_file()
    _, out = run("show", "Ceres", "--config", settings, "--at", "2026-11-26T20:00", "--hours", "0")
    assert "from -30.0000, 20.0000" in out
    with pytest.raises(BadSettings, match="site is not known"):
        run("show", "Mars")
    with pytest.raises(BadRequest, match="not a possible site"):
        run("show", "Mars", "--site", "97", "0", "0")
    with pytest.raises(BadRequest, match="lines"):
        run("show", "Mars", *HERE, "--step-min", "0.01")
