"""`mountnav catalog doctor` and its address: what scripts and people get."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest

from api.cli.catalog_doctor import lines_of
from api.http.doctor_record import DoctorRecord
from mountnav.catalog.doctor import diagnosis as core
from tests.api.command_here import run_here

MOUNTNAV = (sys.executable, "-m", "api.main", "catalog", "doctor", "--config")
ROOT = Path(__file__).resolve().parents[3]
WIDE = """
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[[telescope]]
id = "wide"
mount = { url = "fake+lx200://" }
camera = { kind = "simulated", width_px = 1600, height_px = 1200, scale_arcsec_px = 4.0 }
"""


def asked(config: Path, *more: str) -> subprocess.CompletedProcess[str]:
    return run_here("catalog", "doctor", "--config", config, *more)


@pytest.fixture(autouse=True)
def _no_other_catalogs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOUNTNAV_CATALOGS", str(tmp_path / "no catalogs"))


@pytest.mark.long
def test_a_telescope_that_sees_enough_ends_with_0(tmp_path: Path) -> None:
    config = tmp_path / "wide.toml"
    config.write_text(WIDE)
    ended = asked(config)
    assert (ended.returncode, ended.stderr) == (0, "")
    assert "suffice" in ended.stdout
    assert "NOT" not in ended.stdout


@pytest.mark.long
def test_the_papers_narrow_telescope_is_told_what_to_get() -> None:
    config = ROOT / "deploy" / "telescopes" / "prompt-8.toml"
    told = subprocess.run([*MOUNTNAV, str(config), "--json"], capture_output=True, text=True, check=False)
    assert (told.returncode, told.stderr) == (1, "")
    real, simulated = json.loads(told.stdout)["telescopes"]
    assert (real["telescope"], simulated["telescope"]) == ("prompt-8", "prompt-8-simulated")
    found = real["catalogs"]
    assert found["verdict"] == "insufficient"
    assert found["camera"]["field_width_deg"] == pytest.approx(0.377, abs=1e-3)
    assert found["sky"]["high_dec_deg"] == pytest.approx(44.831)
    (tycho2,) = found["here"]
    assert tycho2["slug"] == "tycho2"
    assert tycho2["pole_stars"] < tycho2["median_stars"] < tycho2["plane_stars"]
    assert 30 < tycho2["fails_percent"] == found["fails_percent"] < 50
    for remedy in found["remedies"]:
        assert remedy["fails_percent"] < 1
        assert remedy["command"].startswith("mountnav catalog import ")
        assert 0 < remedy["installed_gb"] < remedy["download_gb"] * 10
        assert remedy["terms"]
    lines = list(lines_of(DoctorRecord.model_validate(real)))
    assert max(len(line) for line in lines) < 100
    text = " ".join(" ".join(lines).split())
    assert "do NOT suffice" in text
    assert "mountnav catalog import" in text


@pytest.mark.long
def test_a_camera_of_unknown_size_ends_with_1(tmp_path: Path) -> None:
    config = tmp_path / "unknown.toml"
    config.write_text(
        WIDE
        + f"""
[[telescope]]
id = "unknown"
mount = {{ url = "lx200+socket://127.0.0.1:1" }}
camera = {{ kind = "folder", path = "{tmp_path}" }}
"""
    )
    ended = asked(config)
    assert ended.returncode == 1
    assert "set width_px and height_px" in " ".join(ended.stdout.split())


@pytest.mark.long
@pytest.mark.parametrize(
    "text", ["nonsense", WIDE + "[catalogs]\nuse = ['not-there']\n", WIDE.replace("47.0", "470.0")]
)
def test_wrong_settings_end_with_2(tmp_path: Path, text: str) -> None:
    config = tmp_path / "wrong.toml"
    config.write_text(text)
    ended = asked(config)
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.startswith("mountnav: ")


@pytest.mark.long
def test_a_configured_online_catalog_is_named_and_not_counted(tmp_path: Path) -> None:
    config = tmp_path / "online.toml"
    config.write_text(
        WIDE.replace("1600", "200").replace("1200", "200")
        + '[[catalogs.online]]\nname = "gaia-online"\nurl = "http://127.0.0.1:9/"\ntable = "I/355"\n'
    )
    ended = asked(config, "--json")
    assert (ended.returncode, ended.stderr) == (1, "")
    (only,) = json.loads(ended.stdout)["telescopes"]
    assert only["catalogs"]["online"] == ["gaia-online"]
    assert [one["slug"] for one in only["catalogs"]["here"]] == ["tycho2"]
    assert not any("[[catalogs.online]]" in text for text in only["catalogs"]["advice"])


@pytest.mark.long
async def test_the_address_tells_the_same(client: httpx.AsyncClient) -> None:
    answer = await client.get("/v1/telescopes/east/doctor")
    assert answer.status_code == 200
    told = answer.json()
    assert told["telescope"] == "east"
    assert told["catalogs"]["verdict"] in ("suffices", "marginal")
    assert told["catalogs"]["here"][0]["name"] == "Tycho-2"
    assert (await client.get("/v1/telescopes/west/doctor")).status_code == 404
    unknown = (await client.get("/v1/telescopes/gone/doctor")).json()["catalogs"]
    assert unknown["verdict"] == "unknown"
    assert unknown["fails_percent"] is None
    assert "width_px" in unknown["camera"]["problem"]


async def test_counting_holds_nobody_up_and_is_done_once(
    client: httpx.AsyncClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    from api.http.routes import doctor as route

    begun, go_on, calls = threading.Event(), threading.Event(), []

    def slow(
        camera: core.CameraFacts, reach: core.Reach, stores: object, *, epoch_yr: float
    ) -> core.Diagnosis:
        calls.append(camera.telescope)
        begun.set()
        assert go_on.wait(30)
        return core.diagnose(core.CameraFacts(camera.telescope, None), reach, (), epoch_yr=epoch_yr)

    monkeypatch.setattr(route, "diagnose", slow)
    asked_for = [asyncio.create_task(client.get("/v1/telescopes/east/doctor")) for _ in range(3)]
    assert await asyncio.to_thread(begun.wait, 30)
    began = time.monotonic()
    assert (await client.get("/v1/version")).status_code in (200, 404)
    assert (await client.get("/v1/telescopes")).status_code == 200
    assert not any(one.done() for one in asked_for)
    assert time.monotonic() - began < 30
    go_on.set()
    assert {one.status_code for one in await asyncio.gather(*asked_for)} == {200}
    assert calls == ["east"]
