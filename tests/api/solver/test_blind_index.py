"""The blind search's index in the service: told, waited for, built once; and a lost mount that it finds."""

from __future__ import annotations

import asyncio
import logging
import os
import re
import signal
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from api.http.app import create_app
from api.solver import blind_index
from api.solver.blind_index import BlindIndexKeeper
from api.solver.messages import Setup, SharedFile, Task
from api.solver.process import Bench, as_fits
from mountnav.catalog.packed import PackedStore
from mountnav.catalog.packed.error_classes import error_curve
from mountnav.catalog.packed.packing import CatalogColumns, pack
from mountnav.clock import utc_now
from mountnav.frames import Hint
from mountnav.identification.blind.cache import cached_index, index_path
from mountnav.identification.blind.file_format import decode_header
from mountnav.identification.blind.index import BlindIndex
from mountnav.settings.observatory import Settings
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.chain import icrs_to_apparent
from mountnav.sky.coordinates import Icrs
from mountnav.sky.sphere import separation_arcsec
from mountnav.solution import Verdict
from mountnav.solving.settings import SolveSettings

STARS = 12_000
WIDE = """
[service]
port = 0
[solving]
# so long a look waits for the index as well, whose building on a busy machine takes many seconds
budget_s = 60.0
[site]
latitude_deg = 47.0
longitude_deg = 11.0
[[telescope]]
id = "east"
exposure_s = 0.3
[telescope.mount]
url = "fake+lx200://"
slew_rate_deg_s = 45.0
acceleration_deg_s2 = 8.0
[telescope.camera]
kind = "simulated"
width_px = 1000
height_px = 800
scale_arcsec_px = 40.0
[telescope.centering]
settle_s = 0.0
tolerance_arcsec = 60.0
"""


@pytest.fixture(scope="module")
def made_up_sky(tmp_path_factory: pytest.TempPathFactory) -> PackedStore:
    """A small sky of its own, whose index is built in a second."""
    rng = np.random.default_rng(20261121)
    sigma = np.full(STARS, 10.0)
    columns = CatalogColumns(
        ra_deg=rng.uniform(0, 360, STARS),
        dec_deg=np.degrees(np.arcsin(rng.uniform(-1, 1, STARS))),
        pm_ra_cosdec_mas_yr=rng.normal(0, 30, STARS),
        pm_dec_mas_yr=rng.normal(0, 30, STARS),
        mag=7.0 + np.log10(rng.uniform(1e-3, 1.0, STARS)) / 0.5,
        error_curve=error_curve((sigma, sigma), (0.1 * sigma, 0.1 * sigma), (200 * sigma, 200 * sigma)),
    )
    path = tmp_path_factory.mktemp("sky") / "made_up.mnc"
    pack(columns, path, name="made up", band="V", epoch_yr=2000.0, nside=8)
    return PackedStore(path)


@pytest.fixture
def _empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOUNTNAV_CACHE", str(tmp_path / "cache"))


@pytest.mark.long
@pytest.mark.usefixtures("_empty_cache")
@pytest.mark.parametrize("fails", [False, True])
async def test_who_needs_it_waits_but_not_for_long(
    made_up_sky: PackedStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    monkeypatch.setenv("SLOW_BUILDER", str(tmp_path))
    monkeypatch.setattr(blind_index, "BUILDER", "tests.api.solver.slow_builder")
    told: list[object] = []
    keeper = BlindIndexKeeper(made_up_sky, lambda kind, data: told.append(data["state"]))
    await keeper.find()
    assert keeper.state.startswith("none: not built yet")
    assert await keeper.wait(0.0) is None
    async with asyncio.timeout(30):
        while keeper.state != "building 42 %":
            assert await keeper.wait(0.05) is None  # twice is once: nobody starts a second one
    if fails:
        (tmp_path / "fail").touch()
    (tmp_path / "go on").touch()
    found = await keeper.wait(30.0)
    if fails:
        assert found is None
        assert keeper.state == "none: it could not be built: the cache: no room (make some)"
        assert await keeper.wait(5.0) is None  # at once: it isn't tried with each frame
    else:
        assert (found, keeper.state) == (tmp_path / "index", "ready")
    assert told[:2] == ["building 0 %", "building 42 %"]
    assert told[2] == keeper.state
    assert len(told) == 3
    await keeper.close()


@pytest.mark.long
@pytest.mark.usefixtures("_empty_cache")
async def test_an_index_cut_short_is_none_and_is_built_anew(made_up_sky: PackedStore) -> None:
    path = index_path(made_up_sky)
    path.parent.mkdir()
    path.write_bytes(b"MNAVQUAD and no more")
    keeper = BlindIndexKeeper(made_up_sky, lambda kind, data: None)
    await keeper.find()
    assert keeper.state.startswith("none: not built yet")
    assert await keeper.wait(60.0) == path
    assert keeper.state == "ready"
    assert BlindIndex.open(path).header.catalog_sha256 == made_up_sky.header.sections_sha256
    await keeper.close()


@pytest.mark.long
@pytest.mark.usefixtures("_empty_cache")
def test_damage_within_the_index_costs_the_blind_search_alone(
    made_up_sky: PackedStore, tmp_path: Path
) -> None:
    path = cached_index(made_up_sky).path
    sound = path.read_bytes()
    header, start = decode_header(sound[:70_000], file="the index")
    at, length = header.layout()["rows"]
    path.write_bytes(sound[: start + at] + b"\xee" * length + sound[start + at + length :])
    place = Icrs(83.0, 22.0)
    frame = draw_frame(
        place,
        SimulatedOptics(1000, 800, 40.0),
        made_up_sky,
        exposure_s=2.0,
        mid_exposure_utc=utc_now(),
        seed=(0, 1),
    )
    (tmp_path / "drawn.fits").write_bytes(as_fits(frame))
    bench = Bench(Setup(made_up_sky, path))
    hint = Hint(center=place, radius_deg=1.0, scale_low_arcsec_px=39.0, scale_high_arcsec_px=41.0)

    def solved(hint: Hint | None) -> Verdict:
        with (tmp_path / "drawn.fits").open("rb") as file:
            task = Task(SharedFile("drawn.fits"), hint, SolveSettings(budget_s=5.0), index=path)
            return bench.verdict(task, file.fileno())

    lost = solved(None)
    assert not lost.solved
    assert any("damaged" in note for note in lost.notes), lost
    assert solved(hint).solution is not None
    path.write_bytes(sound)
    os.utime(path, ns=(1, 1))
    found = solved(None)
    assert found.solution is not None, found
    assert not any("damaged" in note for note in found.notes)
    assert separation_arcsec(found.solution.center, place) < 20.0


@pytest.mark.long
@pytest.mark.usefixtures("_empty_cache")
async def test_closing_ends_the_building(
    made_up_sky: PackedStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SLOW_BUILDER", str(tmp_path))
    monkeypatch.setattr(blind_index, "BUILDER", "tests.api.solver.slow_builder")
    keeper = BlindIndexKeeper(made_up_sky, lambda kind, data: None)
    await keeper.wait(0.3)
    async with asyncio.timeout(10):
        await keeper.close()
    assert keeper.state.startswith("none")


@pytest.mark.long
@pytest.mark.usefixtures("_empty_cache")
async def test_a_lost_mount_is_found_blind_and_recovered(made_up_sky: PackedStore) -> None:
    app = create_app(Settings.parse(WIDE), catalog=made_up_sky)
    transport = httpx.ASGITransport(app=app, raise_app_exceptions=False)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1", timeout=90) as client,
    ):

        async def ordered(order: str, **body: object) -> dict[str, Any]:
            started = await client.post(f"/v1/telescopes/east/{order}", json=body or None)
            assert started.status_code == 202, started.text
            found: dict[str, Any] = (
                await client.get(started.headers["location"], params={"wait": 80})
            ).json()
            return found

        assert "ready" not in (await client.get("/v1/health")).json()["blind_index"]
        mechanics = app.state.service.observatory.telescope("east").mechanics
        now = utc_now()
        truth = mechanics.truth(now)
        elsewhere = Icrs((truth.ra_deg + 75.0) % 360.0, truth.dec_deg - 30.0)
        mechanics.sync(icrs_to_apparent(elsewhere, now))

        look = await ordered("look")
        assert look["state"] == "succeeded", look
        assert look["result"]["mode"].startswith("blind/"), look["result"]
        assert look["result"]["offset"]["total_arcsec"] > 50.0 * 3600.0
        assert (await client.get("/v1/health")).json()["blind_index"] == "ready"

        sync = await ordered("sync")
        assert sync["problem"]["type"] == "urn:mountnav:problem:offset-too-large", sync
        recovered = await ordered("recover")
        assert recovered["state"] == "succeeded", recovered
        assert recovered["result"]["second"]["mode"].startswith("blind/")
        target = (await client.get("/v1/telescopes/east")).json()["icrs"]
        assert separation_arcsec(Icrs(target["ra_deg"], target["dec_deg"]), mechanics.truth()) < 40.0
        centered = await ordered("center", ra_deg=target["ra_deg"], dec_deg=target["dec_deg"] - 5.0)
        assert centered["state"] == "succeeded", centered
        wanted = Icrs(target["ra_deg"], target["dec_deg"] - 5.0)
        assert separation_arcsec(mechanics.truth(), wanted) < 75.0


@pytest.mark.long
@pytest.mark.usefixtures("_empty_cache")
async def test_a_builder_that_was_killed_is_told_by_health_and_log(
    made_up_sky: PackedStore,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("SLOW_BUILDER", str(tmp_path))
    monkeypatch.setattr(blind_index, "BUILDER", "tests.api.solver.slow_builder")
    app = create_app(Settings.parse(WIDE), catalog=made_up_sky)
    transport = httpx.ASGITransport(app=app)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client,
    ):
        keeper = app.state.service.solver.blind_index
        async with asyncio.timeout(60):
            while keeper.state != "building 42 %":
                assert await keeper.wait(0.05) is None
        assert not any("blind index" in one for one in (await client.get("/v1/health")).json()["concerns"])
        os.kill(int((tmp_path / "pid").read_text()), signal.SIGKILL)  # as the kernel does for want of memory
        assert await keeper.wait(60.0) is None
        health = (await client.get("/v1/health")).json()
    assert re.fullmatch(
        r"none: it could not be built: process \d+ ended by signal 9; it takes 0\.4 GB of memory.*"
        r"mountnav catalog index",
        health["blind_index"],
    )
    assert health["status"] == "degraded"
    assert f"blind index: {health['blind_index']}" in health["concerns"]
    warned = [one.getMessage() for one in caplog.records if one.levelno >= logging.WARNING]
    assert f"blind index: {health['blind_index']}" in warned
