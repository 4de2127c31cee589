"""A real server on a real socket: event streams, stop while a frame is solved, going down while slewing."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest

from api.events import Event
from api.http.app import create_app
from api.http.serving import ObservatoryServer, bind, make_server
from api.orders.jobs import JobState
from api.service import Service
from api.solver.process import as_fits
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog, Stars
from mountnav.errors import BadSettings
from mountnav.settings.observatory import Settings
from mountnav.simulation.optics import SimulatedOptics
from mountnav.simulation.render import draw_frame
from mountnav.sky.coordinates import Icrs
from tests.api.http.stop_answers import stopped
from tests.api.solver.moody_catalog import HANGS, MoodyCatalog

EAST = "/v1/telescopes/east"


@dataclass(slots=True)
class Running:
    """A server in this event loop."""

    server: ObservatoryServer
    task: asyncio.Task[None]
    client: httpx.AsyncClient
    service: Service


@asynccontextmanager
async def _running(toml: str, catalog: Catalog | None = None) -> AsyncIterator[Running]:
    app = create_app(Settings.parse(toml), catalog=catalog)
    server = make_server(app, log_level="warning")
    with bind("127.0.0.1", 0) as listener:
        url = f"http://127.0.0.1:{listener.getsockname()[1]}"
        task = asyncio.create_task(server._serve([listener]))
        async with httpx.AsyncClient(base_url=url, timeout=60, trust_env=False) as client:
            while not server.started:
                assert not task.done(), task
                await asyncio.sleep(0.02)
            try:
                yield Running(server, task, client, app.state.service)
            finally:
                server.should_exit = True
                await task


@pytest.fixture
async def running(observatory_toml: str) -> AsyncIterator[Running]:
    async with _running(observatory_toml) as opened:
        yield opened


async def _events(lines: AsyncIterator[str], until: str) -> list[dict[str, str]]:
    """Events up to the first whose kind is `until`."""
    found: list[dict[str, str]] = []
    fields: dict[str, str] = {}
    async for line in lines:
        if line:
            name, _, value = line.partition(":")
            fields[name] = value.strip()
        elif "data" in fields:
            found.append(fields)
            if fields["event"] == until:
                return found
            fields = {}
        else:
            fields = {}
    return found


@pytest.mark.long
async def test_the_stream_tells_each_step_and_can_be_resumed(running: Running) -> None:
    async with running.client.stream("GET", "/v1/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        lines = stream.aiter_lines()
        assert (await anext(lines)).startswith(":")
        started = await running.client.post(f"{EAST}/look")
        told = await _events(lines, "solved")
    kinds = [event["event"] for event in told]
    assert [kind for kind in kinds if kind in {"exposing", "solving", "solved"}] == [
        "exposing",
        "solving",
        "solved",
    ]
    assert {json.loads(event["data"])["job_id"] for event in told} == {started.json()["id"]}
    await running.client.get(started.headers["location"], params={"wait": 60})
    resume = {"Last-Event-ID": told[0]["id"]}
    async with running.client.stream("GET", "/v1/events", headers=resume) as stream:
        again = await _events(stream.aiter_lines(), "solved")
    assert [event["id"] for event in again] == [event["id"] for event in told[1:]]


class GatedCatalog:
    """The embedded catalog behind a gate: with the gate shut a solve hangs in its worker thread."""

    def __init__(self) -> None:
        self._catalog = embedded_catalog()
        self.gate = threading.Event()
        self.gate.set()

    @property
    def name(self) -> str:
        return self._catalog.name

    def cone(
        self, center: Icrs, radius_deg: float, *, epoch_yr: float, mag_limit: float | None = None
    ) -> Stars:
        self.gate.wait()
        return self._catalog.cone(center, radius_deg, epoch_yr=epoch_yr, mag_limit=mag_limit)


@pytest.mark.long
async def test_stop_and_state_answer_while_a_frame_is_solved(observatory_toml: str) -> None:
    catalog = GatedCatalog()
    async with _running(observatory_toml, catalog) as running:
        service = running.service
        publish = service.events.publish

        def shut_when_solving(kind: str, data: dict[str, object]) -> Event:
            if kind == "solving":
                catalog.gate.clear()
            return publish(kind, data)

        service.events.publish = shut_when_solving  # type: ignore[method-assign]
        try:
            async with running.client.stream("GET", "/v1/events") as stream:
                lines = stream.aiter_lines()
                await anext(lines)
                started = await running.client.post(f"{EAST}/look")
                await _events(lines, "solving")
                state = await running.client.get(EAST)
                assert (state.status_code, state.json()["job_id"]) == (200, started.json()["id"])
                answer = await running.client.post(f"{EAST}/stop")
            assert answer.json()["cancelled_job_id"] == started.json()["id"]
            job = service.jobs.get(started.json()["id"])
            await job.ended.wait()
            assert job.state is JobState.CANCELLED
            assert not catalog.gate.is_set()
        finally:
            catalog.gate.set()


@pytest.mark.long
async def test_stop_while_slewing_leaves_the_mount_at_rest(observatory_toml: str) -> None:
    async with _running(observatory_toml.replace("slew_rate_deg_s = 45.0", "slew_rate_deg_s = 0.5")) as slow:
        icrs = (await slow.client.get(EAST)).json()["icrs"]
        target = {"ra_deg": icrs["ra_deg"], "dec_deg": icrs["dec_deg"] + 30.0}
        async with slow.client.stream("GET", "/v1/events") as stream:
            lines = stream.aiter_lines()
            await anext(lines)
            started = await slow.client.post(f"{EAST}/slew", json=target)
            await _events(lines, "slewing")
            answer = await slow.client.post(f"{EAST}/stop")
            assert answer.json()["cancelled_job_id"] == started.json()["id"]
            await _events(lines, "stopped")
        while (await slow.client.get(EAST)).json()["slewing"]:
            await asyncio.sleep(0.05)
        rest = (await slow.client.get(EAST)).json()
        assert abs(rest["icrs"]["dec_deg"] - target["dec_deg"]) > 20.0
        assert rest["job_id"] is None


@pytest.mark.long
async def test_going_down_stops_the_mount_and_ends_the_streams(observatory_toml: str) -> None:
    async with _running(observatory_toml.replace("slew_rate_deg_s = 45.0", "slew_rate_deg_s = 0.5")) as slow:
        icrs = (await slow.client.get(EAST)).json()["icrs"]
        target = {"ra_deg": icrs["ra_deg"], "dec_deg": icrs["dec_deg"] + 30.0}
        async with slow.client.stream("GET", "/v1/events") as stream:
            lines = stream.aiter_lines()
            await anext(lines)
            started = await slow.client.post(f"{EAST}/slew", json=target)
            await _events(lines, "slewing")
            slow.server.should_exit = True
            rest = await _events(lines, "never")
        assert "stopped" in [event["event"] for event in rest]
        await slow.task
        assert slow.service.jobs.get(started.json()["id"]).state is JobState.CANCELLED


def test_a_taken_port_is_told() -> None:
    with (
        bind("127.0.0.1", 0) as listener,
        pytest.raises(BadSettings, match=r"can't listen on 127\.0\.0\.1"),
    ):
        bind("127.0.0.1", listener.getsockname()[1])


def _drawn(place: Icrs) -> bytes:
    optics = SimulatedOptics(800, 600, 4.0)
    instant = datetime(2026, 11, 21, tzinfo=UTC)
    return as_fits(
        draw_frame(place, optics, embedded_catalog(), exposure_s=2.0, mid_exposure_utc=instant, seed=(1, 2))
    )


def _near(place: Icrs) -> dict[str, float]:
    return {
        "ra_deg": place.ra_deg,
        "dec_deg": place.dec_deg,
        "scale_low_arcsec_px": 3.8,
        "scale_high_arcsec_px": 4.2,
    }


@pytest.mark.long
async def test_a_service_with_a_worker(observatory_toml: str, tmp_path: Path) -> None:
    truth = Icrs(85.0, 30.0)
    content = _drawn(truth)
    toml = observatory_toml.replace("worker = false", "worker = true")
    cold = tmp_path / "cold"
    cold.touch()
    async with _running(toml, MoodyCatalog(tmp_path)) as running:
        client, solver = running.client, running.service.solver
        assert solver.worker is not None

        # nobody waits for the worker to get warm
        assert (await client.get("/v1/health")).json()["solver"] == "starting"
        cold.unlink()
        started = await client.post(f"{EAST}/look", json={"exposure_s": 0.2})
        look = (await client.get(started.headers["location"], params={"wait": 60})).json()
        assert look["state"] == "succeeded", look
        for upload in ({"content": content}, {"files": {"file": ("taurus.fits", content)}}):
            record = (await client.post("/v1/solve", params=_near(truth), **upload)).json()
            assert record["solved"], record
        assert (await client.get("/v1/health")).json()["solver"] == "ready"

        # a client that leaves takes its frame along: the process that hangs on it makes room for another
        assert solver.uploads is not None
        before = solver.uploads.pid
        with pytest.raises(httpx.ReadTimeout):
            await client.post("/v1/solve", params=_near(HANGS), content=content, timeout=0.5)
        hanging = asyncio.create_task(client.post("/v1/solve", params=_near(HANGS), content=content))
        while solver.uploads.state != "solving" or solver.uploads.pid == before:
            await asyncio.sleep(0.02)
        # a look has a process of its own, and status and stop answer meanwhile; so does going down
        looking = await client.post(f"{EAST}/look", json={"exposure_s": 0.2})
        look = (await client.get(looking.headers["location"], params={"wait": 60})).json()
        assert look["state"] == "succeeded", look
        assert solver.uploads.state == "solving"
        assert (await client.get(EAST)).status_code == 200
        assert (await stopped(client, f"{EAST}/stop")).json()["stopped"] is True
        last = solver.uploads.pid
        running.server.should_exit = True
        refused = await hanging
        assert (refused.status_code, refused.json()["type"]) == (503, "urn:mountnav:problem:closing")
        await running.task
    assert last is not None
    assert not Path(f"/proc/{last}").exists()


@pytest.mark.long
async def test_a_blind_search_without_an_index_says_so(observatory_toml: str, tmp_path: Path) -> None:
    content = _drawn(Icrs(85.0, 30.0))
    toml = observatory_toml.replace('blind = "never"', 'blind = "after"')
    async with _running(toml, MoodyCatalog(tmp_path)) as running:
        for params in ({"blind": "only"}, {"budget_s": 0.5}):
            record = (await running.client.post("/v1/solve", params=params, content=content)).json()
            assert not record["solved"]
            assert "the catalog moody can't have one" in str(record["notes"])
        never = await running.client.post("/v1/solve", params={"blind": "never"}, content=content)
        assert not any("blind" in note for note in never.json()["notes"])
        for wrong in ({"blind": "maybe"}, {"budget_s": 0}, {"budget_s": 1e6}, {"budget_s": "nan"}):
            answer = await running.client.post("/v1/solve", params=wrong, content=content)
            assert (answer.status_code, answer.json()["type"]) == (422, "urn:mountnav:problem:bad-request")
