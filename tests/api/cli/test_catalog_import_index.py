"""`mountnav catalog index` as others script it: over a small catalog, and refused where it can't write."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from api.cli import catalog_import
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.identification.blind.index import BlindIndex


@pytest.fixture
def catalog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PackedStore:
    """A small catalog in place of the embedded one, whose index takes half a minute."""
    rng, count = np.random.default_rng(1), 500
    sigma = np.full(count, 10.0)
    columns = CatalogColumns(
        ra_deg=rng.uniform(0, 360, count),
        dec_deg=np.degrees(np.arcsin(rng.uniform(-1, 1, count))),
        pm_ra_cosdec_mas_yr=np.zeros(count),
        pm_dec_mas_yr=np.zeros(count),
        mag=rng.uniform(2, 9, count),
        error_curve=error_curve((sigma, sigma), (sigma, sigma), (200 * sigma, 200 * sigma)),
    )
    pack(columns, tmp_path / "small.mnc", name="small", band="V", epoch_yr=2000.0, nside=2)
    store = PackedStore(tmp_path / "small.mnc")
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr("mountnav.catalog.embedded.embedded_catalog", lambda: store)
    return store


def test_it_tells_where_how_large_and_how_long(
    catalog: PackedStore, capsys: pytest.CaptureFixture[str]
) -> None:
    catalog_import.index(force=False, as_json=True)
    out = capsys.readouterr()
    told = json.loads(out.out)
    index = BlindIndex.open(Path(told["file"]))
    assert told["built"] is True
    assert told["quads"] == len(index) > 500
    assert told["size_mb"] == round(index.path.stat().st_size / 1e6, 1)
    assert told["catalog"] == "small"
    assert told["took_s"] >= 0
    catalog_import.index(force=False, as_json=True)
    out = capsys.readouterr()
    assert json.loads(out.out)["built"] is False
    assert out.err == ""


@pytest.mark.long
def test_force_builds_it_anew(catalog: PackedStore, capsys: pytest.CaptureFixture[str]) -> None:
    index = catalog_import.built_with_progress(catalog)
    index.path.write_bytes(index.path.read_bytes() + b"more")
    catalog_import.index(force=True, as_json=False)
    out = capsys.readouterr()
    assert "built in" in out.out
    assert str(index.path) in out.out
    assert len(BlindIndex.open(index.path)) == len(index)
    catalog_import.index(force=False, as_json=False)
    assert "was there already" in capsys.readouterr().out


def test_the_progress_is_shown_on_stderr_alone(
    catalog: PackedStore, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[bool] = []

    def show_cursor(console: Console, show: bool = True) -> bool:
        shown.append(console.stderr)
        return True

    monkeypatch.setattr(Console, "show_cursor", show_cursor)
    monkeypatch.setenv("FORCE_COLOR", "1")
    catalog_import.index(force=False, as_json=True)
    out = capsys.readouterr()
    json.loads(out.out)
    assert "building the index" in out.err
    assert shown
    assert all(shown)


def test_without_a_terminal_one_line_tells_of_it(
    catalog: PackedStore, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    catalog_import.index(force=False, as_json=True)
    assert capsys.readouterr().err.splitlines() == [
        "building the index for blind solving: once, about half a minute"
    ]


@pytest.mark.long
def test_a_cache_that_cant_be_written_ends_it_with_advice(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    done = subprocess.run(
        [sys.executable, "-m", "api.main", "catalog", "index"],
        capture_output=True,
        text=True,
        check=False,
        env={"MOUNTNAV_CACHE": str(tmp_path / "file"), "PATH": ""},
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert "can't be written" in done.stderr
    assert "MOUNTNAV_CACHE" in done.stderr
    assert "Traceback" not in done.stderr
