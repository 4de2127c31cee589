"""A real server on a real socket: event streams, stop while a frame is solved, going down while slewing."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import httpx
import pytest

from api.app import create_app
from api.events import Event
from api.jobs import JobState
from api.service import Service
from api.serving import ObservatoryServer, bind, make_server
from mountnav.catalog.embedded import embedded_catalog
from mountnav.catalog.stars import Catalog, Stars
from mountnav.errors import BadSettings
from mountnav.settings import Settings
from mountnav.sky.coordinates import Icrs

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
                stopped = await running.client.post(f"{EAST}/stop")
            assert stopped.json()["cancelled_job_id"] == started.json()["id"]
            job = service.jobs.get(started.json()["id"])
            await job.ended.wait()
            assert job.state is JobState.CANCELLED
            assert not catalog.gate.is_set()
        finally:
            catalog.gate.set()


async def test_stop_while_slewing_leaves_the_mount_at_rest(observatory_toml: str) -> None:
    async with _running(observatory_toml.replace("slew_rate_deg_s = 45.0", "slew_rate_deg_s = 0.5")) as slow:
        icrs = (await slow.client.get(EAST)).json()["icrs"]
        target = {"ra_deg": icrs["ra_deg"], "dec_deg": icrs["dec_deg"] + 30.0}
        async with slow.client.stream("GET", "/v1/events") as stream:
            lines = stream.aiter_lines()
            await anext(lines)
            started = await slow.client.post(f"{EAST}/slew", json=target)
            await _events(lines, "slewing")
            stopped = await slow.client.post(f"{EAST}/stop")
            assert stopped.json()["cancelled_job_id"] == started.json()["id"]
            await _events(lines, "stopped")
        while (await slow.client.get(EAST)).json()["slewing"]:
            await asyncio.sleep(0.05)
        rest = (await slow.client.get(EAST)).json()
        assert abs(rest["icrs"]["dec_deg"] - target["dec_deg"]) > 20.0
        assert rest["job_id"] is None


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
